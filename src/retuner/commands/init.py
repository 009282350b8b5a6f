"""retuner init: a commented starter configuration, one by questions, or the loop of a record."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from retuner.errors import UserError
from retuner.files import write_whole
from retuner.templates import starter

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner init oven.toml; or retuner init loop.toml --from trend.csv")
def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("retuner.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
    profile: Annotated[str, typer.Option(help="For a controller that exists: odrive, cia402, cia404.")] = "",
    record: Annotated[
        Path | None, typer.Option("--from", metavar="RECORD", help="Of the loop in a record, with its process to try.")
    ] = None,
    kc: Annotated[float | None, typer.Option(help="With --from: the active gain, % per pv unit, series form.")] = None,
    tau_i: Annotated[float | None, typer.Option(help="With --from: the active integral time, s.")] = None,
    tau_d: Annotated[float, typer.Option(help="With --from: the active derivative time, s.")] = 0.0,
    ask: Annotated[
        bool | None, typer.Option("--ask/--no-ask", help="Questions about the loop; asked on a terminal.")
    ] = None,
) -> int:
    """Write a configuration: a commented starter, or by a few questions, or of a record's loop."""
    # Refuse a place where no file can go, or where one is
    if path.is_dir():
        raise UserError(f"{path}: is a folder; give the name of a file in it")
    if path.exists() and not force:
        raise UserError(f"{path}: exists; give another name, or --force to replace it")
    if not path.resolve().parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; make it first")
    texts = {path: starter(profile)}
    asking = not profile and (ask or (ask is None and sys.stdin.isatty() and sys.stderr.isatty()))
    if record is not None or asking:
        from retuner.commands.work.starter import asked, of_record, series

        texts = {path: asked(path)} if record is None else of_record(record, path, series(kc, tau_i, tau_d))
    for file, text in texts.items():
        try:
            write_whole(file, text)
        except OSError as error:
            raise UserError(f"{file}: cannot be written: {error.strerror}") from None
    sys.stdout.write(f"{path} written. Next: retuner check {path}, then retuner run {path}\n")
    return 0
