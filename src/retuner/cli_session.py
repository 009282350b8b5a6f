"""What is done with a recorded or running session: signatures and help only, as in cli.py."""

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Session = Annotated[Path, typer.Argument(metavar="SESSION", help="Folder that a run leaves, or fills right now.")]


def replay(
    target: Annotated[
        Path, typer.Argument(metavar="SESSION|LOG", help="A session's folder; or, with --config, a log.")
    ],
    config: Annotated[
        Path | None,
        typer.Option(help="Say what would have been done on a log (.csv, .parquet, .blf, .asc, .mf4, candump .log)."),
    ] = None,
    columns: Annotated[str, typer.Option(help="Other names in a table: t=time,pv=temp,co=out,sp=target.")] = "",
    json: Json = False,
) -> int:
    """Decide again from recorded frames: the same, byte for byte? Or: what would you have done on this log?"""
    from retuner.commands.replay import replay as work

    return work(target, config=config, columns=columns, as_json=json)


def report(
    session: Session,
    decision: Annotated[int | None, typer.Option(help="Only the page of this decision, by its number.")] = None,
    out: Annotated[Path | None, typer.Option(help="Where to write it; default in the session's folder.")] = None,
    json: Json = False,
) -> int:
    """Make the report of a recorded session again, or the page of one decision: the whole reasoning with pictures."""
    from retuner.commands.report import report as work

    return work(session, decision=decision, out=out, as_json=json)


By = Annotated[str | None, typer.Option(help="Who orders it; default: the user of this process.")]
Note = Annotated[str, typer.Option(help="Why, for the ledger.")]


def approve(
    session: Session,
    digest: Annotated[
        str | None, typer.Argument(metavar="[HASH]", help="Of the proposal, 8 digits or more; without it: list them.")
    ] = None,
    by: By = None,
    note: Note = "",
    unlock: Annotated[str | None, typer.Option(metavar="REGION", help="Let a locked-out region change again.")] = None,
    every: Annotated[bool, typer.Option("--all", help="List superseded proposals, too.")] = False,
    json: Json = False,
) -> int:
    """Order that a proposal be written, named by its hash, or list the open ones: the newest of each region."""
    from retuner.commands.approve import Person
    from retuner.commands.approve import approve as work

    return work(session, digest, Person(by, note), unlock=unlock, every=every, as_json=json)


ledger = typer.Typer(
    no_args_is_help=True,
    help="What was seen, decided and written: read it, and look whether it can be believed.",
    epilog="Example: retuner ledger show runs/demo",
)


@ledger.command(epilog="Example: retuner ledger verify runs/demo/ledger.sqlite --head 61f2ae1c0d3b")
def verify(
    file: Annotated[Path, typer.Argument(metavar="SESSION", help="Folder of a run, or the ledger.sqlite in it.")],
    head: Annotated[
        str | None, typer.Option(help="Hash that was noted when it was written; cut-off rows show.")
    ] = None,
    json: Json = False,
) -> int:
    """Recompute the hash chain: status 0 when it holds, 1 when it is broken, and where."""
    from retuner.commands.ledger import verify as work

    return work(file, head=head, as_json=json)


@ledger.command(epilog="Example: retuner ledger show runs/demo --decision 3")
def show(
    session: Session,
    decision: Annotated[int | None, typer.Option(help="Only this decision and what came of it.")] = None,
    since: Annotated[float | None, typer.Option(help="Only from this time of the run on, s.")] = None,
    kind: Annotated[str | None, typer.Option(help="Only rows of this kind: decision, order, committed, ...")] = None,
    json: Json = False,
) -> int:
    """Who, when, why, from what to what, on what evidence, with what verdict: row by row."""
    from retuner.commands.ledger_show import Selection
    from retuner.commands.ledger_show import show as work

    return work(session, Selection(decision, since, kind), as_json=json)


@ledger.command(epilog="Example: retuner ledger export runs/demo --csv demo.csv")
def export(
    session: Session,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="A table for a spreadsheet.")] = None,
    jsonl: Annotated[Path | None, typer.Option(metavar="FILE", help="One JSON document a line, whole.")] = None,
) -> int:
    """Write the rows into a file for other programs."""
    from retuner.commands.ledger_show import export as work

    return work(session, as_csv=csv, as_jsonl=jsonl)


@ledger.command(epilog="Example: retuner ledger revert runs/demo --decision 3 --note 'pump changed'")
def revert(
    session: Session,
    decision: Annotated[int, typer.Option("--decision", "--to", help="Back to the gains before this decision.")],
    by: By = None,
    note: Note = "",
    json: Json = False,
) -> int:
    """Order the way back: the gains before a decision, in its region; by the running session, or by the next one."""
    from retuner.commands.approve import Person
    from retuner.commands.approve import revert as work

    return work(session, decision, Person(by, note), as_json=json)
