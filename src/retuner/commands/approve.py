"""retuner approve: approve a proposal of a session, or list what is open."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import By, Json, Loop, Note, Session

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner approve runs/demo; retuner approve runs/demo 4bebeed6 --note 'as discussed'")
def approve(
    session: Session,
    digest: Annotated[
        str | None,
        typer.Argument(metavar="[HASH]", help="Of the proposal, 8 digits or more; without it: list the open ones."),
    ] = None,
    by: By = None,
    note: Note = "",
    unlock: Annotated[str | None, typer.Option(metavar="REGION", help="Unlock a region.")] = None,
    every: Annotated[bool, typer.Option("--all", help="List superseded proposals, too.")] = False,
    into: Annotated[
        Path | None, typer.Option(metavar="CONFIG", help="Configuration that gets a proposed schedule.")
    ] = None,
    loop: Loop = None,
    as_json: Json = False,
) -> int:
    """Approve a proposal, named by its hash, or list the open ones, the newest of each region.

    A proposed schedule is written into a configuration (--into); its next run uses it.
    """
    from retuner.commands.work import approve as work

    asked = work.Asked(digest, unlock, every, loop, into)
    return work.approve(session, asked, work.Person(by, note), as_json=as_json)
