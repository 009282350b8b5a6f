"""The options of `retuner report`."""

from pathlib import Path

import typer

from retuner.commands.options import Json, Loop, Session, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions:
    """Make the report of a recorded session again, or the page of one decision with its full reasoning."""

    session: Session
    decision: int | None = option(None, "Only the page of this decision, by its number.")
    out: Path | None = option(None, "Where to write it; default in the session's folder.")
    loop: Loop = None
    as_json: Json = False


command(
    app,
    ReportOptions,
    "report.report",
    "Example: retuner report runs/demo; retuner report runs/demo --decision 7 --out page.html",
)
