"""The options of `retuner approve`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import By, Json, Loop, Note, Session, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ApproveOptions:
    """Approve a proposal, named by its hash, or list the open ones, the newest of each region.

    A proposed schedule is written into a configuration (--into); its next run uses it.
    """

    session: Session
    digest: Annotated[
        str | None,
        typer.Argument(metavar="[HASH]", help="Of the proposal, 8 digits or more; without it: list the open ones."),
    ] = None
    by: By = None
    note: Note = ""
    unlock: Annotated[str | None, typer.Option(metavar="REGION", help="Unlock a region.")] = None
    every: Annotated[bool, typer.Option("--all", help="List superseded proposals, too.")] = False
    into: Annotated[
        Path | None, typer.Option(metavar="CONFIG", help="Configuration that gets a proposed schedule.")
    ] = None
    loop: Loop = None
    as_json: Json = False


command(
    app,
    ApproveOptions,
    "approve.approve",
    "Example: retuner approve runs/demo; retuner approve runs/demo 4bebeed6 --note 'as discussed'",
)
