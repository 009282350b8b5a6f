"""The options of `retuner diagnose`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import RecordOptions, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnoseOptions(RecordOptions):
    """Find the cause of a loop's behaviour, with evidence and recommended settings."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Records of one loop, oldest first; or one, a file for each signal."),
    ]
    kc: Annotated[float | None, typer.Option(help="Active controller gain; else identified from the record.")] = None
    aim: Annotated[
        str, typer.Option(help="tight; smooth: as slow as --ymax allows; averaging: a tank moves, its flow does not.")
    ] = "tight"
    ymax: Annotated[float | None, typer.Option(help="With these aims: how far pv may go, in its unit.")] = None
    u0: Annotated[
        float | None, typer.Option(help="For this step of the load, co units; default what co had to move.")
    ] = None
    with_evidence: Annotated[bool, typer.Option("--evidence", help="All numbers behind it, and other forms.")] = False


command(
    app,
    DiagnoseOptions,
    "recorded.diagnose.diagnose",
    "Example: retuner diagnose loop.csv --kc 0.8 --tau-i 40 --co-min 0 --co-max 100 --plot loop.png",
)
