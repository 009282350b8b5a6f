"""The options of `retuner replay`."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.commands.options import FormOptions, Json, Loop, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions(FormOptions):
    """Repeat the decisions of a session byte for byte, or apply retuner to a recorded log."""

    target: Annotated[Path, typer.Argument(metavar="SESSION|LOG", help="A session's folder; or, with --config, a log.")]
    config: Path | None = option(
        None, "Apply this configuration to a log (.csv, .parquet, .blf, .asc, .mf4, candump .log)."
    )
    loop: Loop = None
    as_json: Json = False


command(
    app,
    ReplayOptions,
    "replay.replay",
    "Example: retuner replay runs/demo; retuner replay loop.csv --config loop.toml --columns pv=temp",
)
