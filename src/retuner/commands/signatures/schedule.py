"""The options of `retuner schedule`."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import ActionOption, Controller, FormOptions, Json, PvSpan, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleOptions(FormOptions):
    """Find what changes along a variable, and the fewest sets of gains that serve it everywhere."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="RECORD...", help="Records of one loop as exported, or a file for each signal."),
    ]
    by: list[str] | None = option(
        None, "sp, pv, co or any column; of several the evidence chooses 1 or 2.", "--by", metavar="VARIABLE"
    )
    low: float | None = option(None, "Lower end of the first variable; default: as far as the records go.")
    high: float | None = option(None, "Upper end of the first variable.")
    co_min: float | None = option(None, "Lower limit of co, in its own unit.")
    co_max: float | None = option(None, "Upper limit of co.")
    ms: float = option(1.8, "Largest Ms anywhere, over the plausible models; 1.5 to 2.5.")
    j: float = option(1.25, "Largest J over that of a place's own settings; 1.05 to 2.", "--j")
    lookup: str = option("auto", "hard, interpolated or auto.")
    gains: Path | None = option(None, "Gain table active then, to compare; else identified.", metavar="TOML")
    gain_columns: str = option(
        "", "Columns of the active gains, parallel, to compare; kd is optional.", metavar="KP,KI,KD"
    )
    controller: Controller = None
    action: ActionOption = None
    pv_span: PvSpan = None
    name: str = option("", "Name of the loop in the table; default: its tag, else the file's.")
    unit: str = option("", "Unit of the variable.")
    out: Path | None = option(None, "Write gains.toml, schedule.toml and report.html there.", metavar="FOLDER")
    as_json: Json = False


command(
    app,
    ScheduleOptions,
    "recorded.schedule.schedule",
    "Example: retuner schedule examples/records/day.csv --by pv --out runs/oven-schedule",
)
