"""The options of `retuner init`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions:
    """Write a configuration: a commented starter, or by a few questions, or of a record's loop."""

    path: Annotated[Path, typer.Argument(metavar="FILE", help="Where to write it.")] = Path("retuner.toml")
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False
    profile: Annotated[str, typer.Option(help="For a controller that exists: odrive, cia402, cia404.")] = ""
    record: Annotated[
        Path | None, typer.Option("--from", metavar="RECORD", help="Of the loop in a record, with its process to try.")
    ] = None
    kc: Annotated[float | None, typer.Option(help="With --from: the active gain, % per pv unit, series form.")] = None
    tau_i: Annotated[float | None, typer.Option(help="With --from: the active integral time, s.")] = None
    tau_d: Annotated[float, typer.Option(help="With --from: the active derivative time, s.")] = 0.0
    ask: Annotated[
        bool | None, typer.Option("--ask/--no-ask", help="Questions about the loop; asked on a terminal.")
    ] = None


command(app, InitOptions, "init.init", "Example: retuner init oven.toml; or retuner init loop.toml --from trend.csv")
