"""retuner init: a commented starter configuration."""

import sys
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from retuner.errors import UserError
from retuner.files import write_whole

app = typer.Typer(add_completion=False)


STARTER = "starter"


def starter(profile: str = "") -> str:
    """The starter configuration as TOML text, or that of a device's profile.

    Raises
    ------
    UserError
        There is no such profile.
    """
    templates = files("retuner").joinpath("templates")
    known = sorted(entry.name.removesuffix(".toml") for entry in templates.iterdir() if entry.name.endswith(".toml"))
    if profile and (profile == STARTER or profile not in known):
        known.remove(STARTER)
        raise UserError(f"--profile {profile}: there is {', '.join(known)}")
    return templates.joinpath(f"{profile or STARTER}.toml").read_text(encoding="utf-8")


@app.command(epilog="Example: retuner init oven.toml")
def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("retuner.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
    profile: Annotated[str, typer.Option(help="For a controller that exists: odrive, cia402, cia404.")] = "",
) -> int:
    """Write a commented starter configuration."""
    text = starter(profile)
    if path.is_dir():
        raise UserError(f"{path}: is a folder; give the name of a file in it")
    if path.exists() and not force:
        raise UserError(f"{path}: exists; give another name, or --force to replace it")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; make it first")
    try:
        write_whole(path, text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror}") from None
    sys.stdout.write(f"{path} written. Next: retuner check {path}, then retuner run {path}\n")
    return 0
