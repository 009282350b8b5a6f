"""retuner schedule: a gain schedule from ordinary records of a loop."""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from retuner.adaptive.signals.sample import Window
from retuner.commands.options import Json, signed_by
from retuner.commands.recorded.record_form import FormOptions, read_record, tell_assumed
from retuner.commands.recorded.recorded_loop import require_length
from retuner.drivers.historian.assumption import Assumption
from retuner.drivers.historian.loop_record import LoopRecord
from retuner.drivers.recorded.recording import RecordingError, require_excitation, require_setpoint
from retuner.errors import UserError, user_input
from retuner.files import write_whole
from retuner.schedule.document import from_toml, to_toml
from retuner.schedule.table import GainTable
from retuner.schedule_report.sentences import experiment_sentence, motion_sentences
from retuner.scheduling import AUTO, ScheduleDesign, design_schedule, schedule_section
from retuner.verbosity import quiet

app = typer.Typer(add_completion=False)

PATIENCE_S = 2.0
"""Work that takes longer says what it is at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleOptions(FormOptions):
    """Find what changes along a variable, and the fewest sets of gains that serve it everywhere."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="RECORD...", help="Records of one loop as exported, or a file for each signal."),
    ]
    by: Annotated[
        list[str] | None,
        typer.Option("--by", metavar="VARIABLE", help="sp, pv, co; several or none: the evidence chooses."),
    ] = None
    low: Annotated[float | None, typer.Option(help="Lower end of the variable; default: what was visited.")] = None
    high: Annotated[float | None, typer.Option(help="Upper end of the variable.")] = None
    co_min: Annotated[float | None, typer.Option(help="Lower limit of co, in its own unit.")] = None
    co_max: Annotated[float | None, typer.Option(help="Upper limit of co.")] = None
    ms: Annotated[float, typer.Option(help="Largest Ms anywhere, over the plausible models; 1.5 to 2.5.")] = 1.8
    j: Annotated[float, typer.Option("--j", help="Largest J over that of a place's own settings; 1.05 to 2.")] = 1.25
    lookup: Annotated[str, typer.Option(help="hard, interpolated or auto.")] = AUTO
    gains: Annotated[
        Path | None,
        typer.Option(metavar="TOML", help="Gain table active then, to compare; else identified."),
    ] = None
    name: Annotated[str, typer.Option(help="Name of the loop in the table; default: its tag, else the file's.")] = ""
    unit: Annotated[str, typer.Option(help="Unit of the variable.")] = ""
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write gains.toml, schedule.toml and report.html there.")
    ] = None
    as_json: Json = False


@app.command(epilog="Example: retuner schedule examples/records/day.csv --by pv --out runs/oven-schedule")
@signed_by(ScheduleOptions)
def schedule(options: ScheduleOptions) -> int:
    """Design and show; the exit status: 0, or 1 when the records do not say enough.

    Raises
    ------
    UserError, RecordingError
        A file or an option cannot be used.
    """
    records = _read(options)
    for one in records:
        require_setpoint(one.recording)
        require_excitation(one.recording)
        require_length(one.recording)
    with user_input("retuner schedule"):
        found = design_schedule(
            records,
            AUTO if options.by is None or AUTO in options.by else options.by,
            low=options.low,
            high=options.high,
            co_min=options.co_min,
            co_max=options.co_max,
            ms_limit=options.ms,
            j_limit=options.j,
            lookup=options.lookup,
            name=options.name or records[0].tag or options.files[0].stem,
            unit=options.unit,
            gains=None if options.gains is None else _in_force(options.gains),
            progress=told_when_slow(),
        )
    assumed = tuple(dict.fromkeys(a for one in records for a in one.assumed))
    written = _written(found, [one.recording.window() for one in records], options)
    tell_assumed(assumed, options)
    _tell(found, assumed, written, options)
    return 0 if found.table is not None else 1


def _read(options: ScheduleOptions) -> list[LoopRecord]:
    """Each file a record, or all of them together one whose signals or times stand in several."""
    if len(options.files) == 1:
        return [read_record(options.files, options, in_automatic=True)]
    try:
        return [read_record([file], options, in_automatic=True) for file in options.files]
    except RecordingError:
        return [read_record(options.files, options, in_automatic=True)]


def _in_force(path: Path) -> GainTable:
    """The table that ran while the records were made."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UserError(f"--gains {path}: cannot be read: {error.strerror}; give a gains.toml") from None
    with user_input(f"--gains {path}"):
        return from_toml(text)


def told_when_slow() -> Callable[[str, float], None]:
    """Progress on the error stream, a line every PATIENCE_S at the most and none before that."""
    told = [time.monotonic()]

    def tell(stage: str, share: float) -> None:
        now = time.monotonic()
        if now - told[0] >= PATIENCE_S and not quiet():
            told[0] = now
            sys.stderr.write(f"schedule: {share:4.0%} done, {stage}\n")
            sys.stderr.flush()

    return tell


def _written(found: ScheduleDesign, windows: list[Window], options: ScheduleOptions) -> list[Path]:
    """Files that were written."""
    folder = options.out
    if folder is None:
        return []
    from retuner.schedule_report.drawing import schedule_png  # noqa: PLC0415  matplotlib only when it is wanted
    from retuner.schedule_report.page import page  # noqa: PLC0415

    name = found.table.loop if found.table is not None else options.files[0].stem
    files: dict[Path, str | bytes] = {
        folder / "report.html": page(found, windows, name),
        folder / "schedule.png": schedule_png(found, windows),
    }
    if found.table is not None:
        files |= {folder / "gains.toml": to_toml(found.table), folder / "schedule.toml": schedule_section(found.table)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            write_whole(path, content)
    except OSError as error:
        raise UserError(f"--out {folder}: cannot be written: {error.strerror}") from None
    return list(files)


def _tell(
    found: ScheduleDesign, assumed: tuple[Assumption, ...], written: list[Path], options: ScheduleOptions
) -> None:
    """The result on the screen."""
    if options.as_json:
        document = found.to_dict() | {"assumed": [a.what for a in assumed], "files": [str(p) for p in written]}
        sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")
        return
    lines = described(found) + [f"{path} written" for path in written]
    sys.stdout.write("\n".join(lines) + "\n")


def described(found: ScheduleDesign) -> list[str]:
    """A design in lines."""
    lines = [f"{found.variable}: {found.reason}", *_place_lines(found)]
    if found.table is not None:
        lines += ["", schedule_section(found.table).rstrip()]
    return [*lines, "", *motion_sentences(found), experiment_sentence(found)]


def _place_lines(found: ScheduleDesign) -> list[str]:
    """Process and settings at some places."""
    columns = (("k", 9), ("tau", 8), ("theta", 8), ("+- Kc", 8), ("Kc", 10), ("tau_I", 8), ("Ms", 7), ("J", 5))
    lines = [f"  {found.variable:>8}  " + " ".join(f"{name:>{width}}" for name, width in columns)]
    for place in found.places[::3]:
        model = place.model
        lag = model.tau1_s + model.tau2_s
        row = f"  {place.x:8.4g}  {model.k:9.4g} {lag:8.4g} {model.theta_s:8.4g}   {place.gain_std:6.0%}"
        if found.table is not None and place.known:
            gains, judged = found.gains_at(place.x), place.judged(found.gains_at(place.x))
            row += f"   {gains.kp:8.4g} {gains.kp / gains.ki:8.4g}   {judged.ms:5.2f} {judged.j:5.2f}"
        lines.append(row if place.known else f"{row}   not accurate enough")
    return lines
