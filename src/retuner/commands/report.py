"""retuner report: the report of a recorded session made again, or the page of one of its decisions."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import Json, Loop, Session

app = typer.Typer(add_completion=False)


@app.command(epilog="Example: retuner report runs/demo; retuner report runs/demo --decision 7 --out page.html")
def report(
    session: Session,
    decision: Annotated[int | None, typer.Option(help="Only the page of this decision, by its number.")] = None,
    out: Annotated[Path | None, typer.Option(help="Where to write it; default in the session's folder.")] = None,
    loop: Loop = None,
    as_json: Json = False,
) -> int:
    """Make the report of a recorded session again, or the page of one decision with its full reasoning."""
    from retuner.commands.work import report as work

    return work.report(session, decision, out, loop, as_json=as_json)
