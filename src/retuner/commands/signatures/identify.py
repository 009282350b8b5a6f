"""The options of `retuner identify`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from retuner.commands.options import RecordOptions, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyOptions(RecordOptions):
    """Identify the process from a record: model, standard deviations and settings."""

    open_loop: Annotated[bool, typer.Option("--open-loop", help="The loop was in manual.")] = False
    region_by: Annotated[str, typer.Option(help="A model for each region of pv, sp or co; needs --bounds.")] = ""
    bounds: Annotated[str, typer.Option(help="Boundaries of the regions, increasing: 20,40,60.")] = ""


command(
    app,
    IdentifyOptions,
    "recorded.identify.identify",
    "Example: retuner identify heater.csv --open-loop --columns pv=temperature,co=pwm",
)
