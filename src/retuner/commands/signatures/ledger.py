"""The options of `retuner ledger` verify, show, export and revert."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import By, Json, Loop, Note, Session, command

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
    head: Annotated[str | None, typer.Option(help="Hash that was noted when it was written; cut-off rows show.")] = None
    as_json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowOptions:
    """Who, when, why, from what to what, on what evidence, with what verdict: row by row."""

    session: Session
    decision: Annotated[int | None, typer.Option(help="Only this decision and what came of it.")] = None
    since: Annotated[float | None, typer.Option(help="Only from this time of the run on, s.")] = None
    kind: Annotated[str | None, typer.Option(help="Only rows of this kind: decision, order, committed, ...")] = None
    loop: Loop = None
    as_json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Write the rows into a file for other programs."""

    session: Session
    as_csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="A table for a spreadsheet.")] = None
    as_jsonl: Annotated[
        Path | None, typer.Option("--jsonl", metavar="FILE", help="One JSON document a line, whole.")
    ] = None


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
    app,
    VerifyOptions,
    "ledger.verify",
    "Example: retuner ledger verify runs/demo/ledger.sqlite --head 61f2ae1c0d3b",
)
command(app, ShowOptions, "ledger.show", "Example: retuner ledger show runs/demo --decision 3")
command(app, ExportOptions, "ledger.export", "Example: retuner ledger export runs/demo --csv demo.csv")
command(
    app, RevertOptions, "approve.revert", "Example: retuner ledger revert runs/demo --decision 3 --note 'pump changed'"
)
