"""The options of `retuner diagnose`."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import RecordOptions, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnoseOptions(RecordOptions):
    """Find the cause of a loop's behaviour, with evidence and recommended settings."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Records of one loop, oldest first; or one, a file for each signal."),
    ]
    kc: float | None = option(None, "Active controller gain; else identified from the record.")
    aim: str = option("tight", "tight; smooth: as slow as --ymax allows; averaging: a tank moves, its flow does not.")
    ymax: float | None = option(None, "With these aims: how far pv may go, in its unit.")
    u0: float | None = option(None, "For this step of the load, co units; default what co had to move.")
    with_evidence: bool = option(False, "All numbers behind it, and other forms.", "--evidence")


command(
    app,
    DiagnoseOptions,
    "recorded.diagnose.diagnose",
    "Example: retuner diagnose loop.csv --kc 0.8 --tau-i 40 --co-min 0 --co-max 100 --plot loop.png",
)
