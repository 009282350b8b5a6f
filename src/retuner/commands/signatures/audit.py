"""The options of `retuner audit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.audit import AREA
from retuner.commands.options import Controller, FormOptions, Json, PvSpan, command

app = typer.Typer(add_completion=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditOptions(FormOptions):
    """Rank the loops of a plant by what a visit would bring; nothing is written to any controller."""

    sources: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Folders, files or patterns of trends.")]
    out: Annotated[Path, typer.Option(help="Folder of the page and the results; an audit in it goes on.")] = Path(
        "audit"
    )
    tag_pattern: Annotated[
        str, typer.Option(help=r"Tag in the names of files without tags: ^([A-Z]+\d+)_", metavar="REGEX")
    ] = ""
    stretches: Annotated[
        int, typer.Option(help="Stretches of each record that are diagnosed at most, up to 24; 0 screens only.")
    ] = 4
    diagnose: Annotated[
        float, typer.Option(help="Share of the loops that is diagnosed, in percent: the worst by the screening.")
    ] = 100.0
    area: Annotated[str, typer.Option(help="Area in a tag: its first group.", metavar="REGEX")] = AREA
    controller: Controller = None
    pv_span: PvSpan = None
    since: Annotated[Path | None, typer.Option(help="Folder of an earlier audit: what became worse?")] = None
    jobs: Annotated[int, typer.Option(help="Processes; 0: one for each core.")] = 0
    scheduler: Annotated[str, typer.Option(metavar="ADDRESS", help="A dask cluster that does the work.")] = ""
    as_json: Json = False


command(app, AuditOptions, "recorded.audit.audit", "Example: retuner audit trends/ --out audit/ --stretches 6")
