"""The options of `retuner audit`."""

from pathlib import Path
from typing import Annotated

import typer

from retuner.audit import AREA
from retuner.commands.options import Controller, FormOptions, Json, PvSpan, command, option
from retuner.schedule.late_dataclass import dataclass

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditOptions(FormOptions):
    """Rank the loops of a plant by what a visit would bring; nothing is written to any controller."""

    sources: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Folders, files or patterns of trends.")]
    out: Path = option(Path("audit"), "Folder of the page and the results; an audit in it goes on.")
    tag_pattern: str = option("", r"Tag in the names of files without tags: ^([A-Z]+\d+)_", metavar="REGEX")
    stretches: int = option(4, "Stretches of each record that are diagnosed at most, up to 24; 0 screens only.")
    diagnose: float = option(100.0, "Share of the loops that is diagnosed, in percent: the worst by the screening.")
    area: str = option(AREA, "Area in a tag: its first group.", metavar="REGEX")
    controller: Controller = None
    pv_span: PvSpan = None
    since: Path | None = option(None, "Folder of an earlier audit: what became worse?")
    jobs: int = option(0, "Processes; 0: one for each core.")
    scheduler: str = option("", "A dask cluster that does the work.", metavar="ADDRESS")
    as_json: Json = False


command(app, AuditOptions, "recorded.audit.audit", "Example: retuner audit trends/ --out audit/ --stretches 6")
