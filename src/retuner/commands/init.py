"""retuner init: a commented starter configuration."""

import sys
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from retuner.errors import UserError
from retuner.files import write_whole

app = typer.Typer(add_completion=False)


def starter() -> str:
    """The starter configuration as TOML text."""
    return files("retuner").joinpath("templates", "starter.toml").read_text(encoding="utf-8")


@app.command(epilog="Example: retuner init oven.toml")
def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("retuner.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> int:
    """Write a commented starter configuration."""
    if path.is_dir():
        raise UserError(f"{path}: is a folder; give the name of a file in it")
    if path.exists() and not force:
        raise UserError(f"{path}: exists; give another name, or --force to replace it")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; make it first")
    try:
        write_whole(path, starter())
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror}") from None
    sys.stdout.write(f"{path} written. Next: retuner check {path}, then retuner run {path}\n")
    return 0
