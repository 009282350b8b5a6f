"""The options of `retuner identify`."""

import typer

from retuner.commands.options import RecordOptions, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyOptions(RecordOptions):
    """Identify the process from a record: model, standard deviations and settings."""

    open_loop: bool = option(False, "The loop was in manual.", "--open-loop")
    region_by: str = option("", "A model for each region of pv, sp or co; needs --bounds.")
    bounds: str = option("", "Boundaries of the regions, increasing: 20,40,60.")


command(
    app,
    IdentifyOptions,
    "recorded.identify.identify",
    "Example: retuner identify heater.csv --open-loop --columns pv=temperature,co=pwm",
)
