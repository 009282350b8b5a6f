"""The options of `retuner approve`."""

from pathlib import Path

import typer

from retuner.commands.options import By, Json, Loop, Note, Session, argument, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ApproveOptions:
    """Approve a proposal, named by its hash, or list the open ones, the newest of each region.

    A proposed schedule is written into a configuration (--into); its next run uses it.
    """

    session: Session
    digest: str | None = argument(
        None, "Of the proposal, 8 digits or more; without it: list the open ones.", metavar="[HASH]"
    )
    by: By = None
    note: Note = ""
    unlock: str | None = option(None, "Unlock a region.", metavar="REGION")
    every: bool = option(False, "List superseded proposals, too.", "--all")
    into: Path | None = option(None, "Configuration that gets a proposed schedule.", metavar="CONFIG")
    loop: Loop = None
    as_json: Json = False


command(
    app,
    ApproveOptions,
    "approve.approve",
    "Example: retuner approve runs/demo; retuner approve runs/demo 4bebeed6 --note 'as discussed'",
)
