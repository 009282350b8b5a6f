"""The options of `retuner init`."""

from pathlib import Path

import typer

from retuner.commands.options import argument, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions:
    """Write a configuration: a commented starter, or by a few questions, or of a record's loop."""

    path: Path = argument(Path("retuner.toml"), "Where to write it.", metavar="FILE")
    force: bool = option(False, "Replace a file that exists.", "--force")
    profile: str = option("", "For a controller that exists: odrive, cia402, cia404.")
    record: Path | None = option(None, "Of the loop in a record, with its process to try.", "--from", metavar="RECORD")
    kc: float | None = option(None, "With --from: the active gain, % per pv unit, series form.")
    tau_i: float | None = option(None, "With --from: the active integral time, s.")
    tau_d: float = option(0.0, "With --from: the active derivative time, s.")
    ask: bool | None = option(None, "Questions about the loop; asked on a terminal.", "--ask/--no-ask")


command(app, InitOptions, "init.init", "Example: retuner init oven.toml; or retuner init loop.toml --from trend.csv")
