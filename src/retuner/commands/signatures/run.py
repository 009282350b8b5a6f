"""The options of `retuner run`."""

from pathlib import Path

import typer

from retuner.commands.options import Channel, ConfigFile, Interface, Json, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Watch a loop, retune it over CAN, and leave a report."""

    config: ConfigFile
    interface: Interface = None
    channel: Channel = None
    speed: str = option("max", "max: simulated time; a number: how much faster than real time the device runs.")
    mode: str | None = option(None, "off, advise, trial or auto; overrides the configuration.")
    out: Path | None = option(None, "Folder for report, ledger, trend and bus log.")
    compare: bool = option(True, "Also run with fixed gains, where the plant is simulated.")
    pretune: bool = option(False, "Begin with a step test of co, for a first model and gains.", "--pretune")
    verbose: bool = option(False, "On a terminal: the evidence behind each decision.", "--verbose", "-v")
    serve: bool = option(False, "Show it in a browser while it runs.", "--serve")
    as_json: Json = False


command(app, RunOptions, "run.run", "Example: retuner run examples/oven.toml --out runs/oven")
