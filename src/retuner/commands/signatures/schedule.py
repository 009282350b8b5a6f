"""The options of `retuner schedule`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import ActionOption, Controller, FormOptions, Json, PvSpan, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleOptions(FormOptions):
    """Find what changes along a variable, and the fewest sets of gains that serve it everywhere."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="RECORD...", help="Records of one loop as exported, or a file for each signal."),
    ]
    by: Annotated[
        list[str] | None,
        typer.Option(
            "--by", metavar="VARIABLE", help="sp, pv, co or any column; of several the evidence chooses 1 or 2."
        ),
    ] = None
    low: Annotated[
        float | None, typer.Option(help="Lower end of the first variable; default: as far as the records go.")
    ] = None
    high: Annotated[float | None, typer.Option(help="Upper end of the first variable.")] = None
    co_min: Annotated[float | None, typer.Option(help="Lower limit of co, in its own unit.")] = None
    co_max: Annotated[float | None, typer.Option(help="Upper limit of co.")] = None
    ms: Annotated[float, typer.Option(help="Largest Ms anywhere, over the plausible models; 1.5 to 2.5.")] = 1.8
    j: Annotated[float, typer.Option("--j", help="Largest J over that of a place's own settings; 1.05 to 2.")] = 1.25
    lookup: Annotated[str, typer.Option(help="hard, interpolated or auto.")] = "auto"
    gains: Annotated[
        Path | None,
        typer.Option(metavar="TOML", help="Gain table active then, to compare; else identified."),
    ] = None
    gain_columns: Annotated[
        str, typer.Option(metavar="KP,KI,KD", help="Columns of the active gains, parallel, to compare; kd is optional.")
    ] = ""
    controller: Controller = None
    action: ActionOption = None
    pv_span: PvSpan = None
    name: Annotated[str, typer.Option(help="Name of the loop in the table; default: its tag, else the file's.")] = ""
    unit: Annotated[str, typer.Option(help="Unit of the variable.")] = ""
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write gains.toml, schedule.toml and report.html there.")
    ] = None
    as_json: Json = False


command(
    app,
    ScheduleOptions,
    "recorded.schedule.schedule",
    "Example: retuner schedule examples/records/day.csv --by pv --out runs/oven-schedule",
)
