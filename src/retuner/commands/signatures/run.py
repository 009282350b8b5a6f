"""The options of `retuner run`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import Channel, ConfigFile, Interface, Json, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Watch a loop, retune it over CAN, and leave a report."""

    config: ConfigFile
    interface: Interface = None
    channel: Channel = None
    speed: Annotated[
        str, typer.Option(help="max: simulated time; a number: how much faster than real time the device runs.")
    ] = "max"
    mode: Annotated[str | None, typer.Option(help="off, advise, trial or auto; overrides the configuration.")] = None
    out: Annotated[Path | None, typer.Option(help="Folder for report, ledger, trend and bus log.")] = None
    compare: Annotated[bool, typer.Option(help="Also run with fixed gains, where the plant is simulated.")] = True
    pretune: Annotated[
        bool, typer.Option("--pretune", help="Begin with a step test of co, for a first model and gains.")
    ] = False
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="On a terminal: the evidence behind each decision.")
    ] = False
    serve: Annotated[bool, typer.Option("--serve", help="Show it in a browser while it runs.")] = False
    as_json: Json = False


command(app, RunOptions, "run.run", "Example: retuner run examples/oven.toml --out runs/oven")
