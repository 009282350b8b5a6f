"""The options of `retuner ledger` verify, show, export and revert."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import By, Json, Loop, Note, Session, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="Read, verify, export or revert what was seen, decided and written.",
    epilog="Example: retuner ledger show runs/demo",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyOptions:
    """Recompute the hash chain: status 0 when it holds, 1 when it is broken, and where."""

    file: Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of a run, or the ledger.sqlite in it.")]
    head: str | None = option(None, "Hash that was noted when it was written; cut-off rows show.")
    as_json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowOptions:
    """Who, when, why, from what to what, on what evidence, with what verdict: row by row."""

    session: Session
    decision: int | None = option(None, "Only this decision and what came of it.")
    since: float | None = option(None, "Only from this time of the run on, s.")
    kind: str | None = option(None, "Only rows of this kind: decision, order, committed, ...")
    loop: Loop = None
    as_json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Write the rows into a file for other programs."""

    session: Session
    as_csv: Path | None = option(None, "A table for a spreadsheet.", "--csv", metavar="FILE")
    as_jsonl: Path | None = option(None, "One JSON document a line, whole.", "--jsonl", metavar="FILE")


@dataclass(frozen=True, slots=True, kw_only=True)
class RevertOptions:
    """Request a rollback to the gains before a decision, in its region, by the running or the next session."""

    session: Session
    decision: Annotated[int, typer.Option("--decision", "--to", help="Back to the gains before this decision.")]
    by: By = None
    note: Note = ""
    loop: Loop = None
    as_json: Json = False


command(
    app, VerifyOptions, "ledger.verify", "Example: retuner ledger verify runs/demo/ledger.sqlite --head 61f2ae1c0d3b"
)
command(app, ShowOptions, "ledger.show", "Example: retuner ledger show runs/demo --decision 3")
command(app, ExportOptions, "ledger.export", "Example: retuner ledger export runs/demo --csv demo.csv")
command(
    app, RevertOptions, "approve.revert", "Example: retuner ledger revert runs/demo --decision 3 --note 'pump changed'"
)
