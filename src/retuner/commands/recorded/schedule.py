"""retuner schedule: a gain schedule from ordinary records of a loop."""

import sys
import time
from pathlib import Path

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.signals.sample import Window
from retuner.commands.options import controller_units, tell
from retuner.commands.recorded.other_cause import contradiction, diagnosed, other_cause
from retuner.commands.recorded.recorded_loop import read_record, require_length, tell_assumed
from retuner.commands.signatures import ScheduleOptions
from retuner.decision_page.shown_units import chosen_units, show_units
from retuner.drivers.historian.loop_record import LoopRecord
from retuner.drivers.recorded.recording import RecordingError, require_excitation, require_setpoint
from retuner.errors import UserError, user_input
from retuner.files import write_whole
from retuner.schedule.config_section import schedule_section
from retuner.schedule.document import PERCENT, from_toml, to_toml
from retuner.schedule.table import GainTable
from retuner.schedule_report.schedule_page import (
    aim_sentence,
    experiment_sentence,
    limit_sentence,
    message_sentence,
    motion_sentences,
    push_sentence,
    variable_sentence,
)
from retuner.scheduling import AUTO, OWN, RecordedGains, ScheduleDesign, design_schedule
from retuner.verbosity import quiet

PATIENCE_S = 2.0  # work that takes longer says what it is at


def schedule(options: ScheduleOptions) -> int:
    """Design and show; the exit status: 0, or 1 when the records do not say enough.

    Raises UserError, RecordingError: a file or an option cannot be used.
    """
    show_units(controller_units(options.controller, options.pv_span, options.action, (options.co_min, options.co_max)))
    # names of the columns of the active gains, none where they are not given
    gain_columns = [name.strip() for name in options.gain_columns.split(",") if name.strip()]
    if gain_columns and len(gain_columns) not in (2, 3):
        raise UserError(f"--gain-columns {options.gain_columns}: give kp,ki or kp,ki,kd, as in --gain-columns KP,KI")
    if gain_columns and options.gains is not None:
        raise UserError("--gains and --gain-columns exclude each other: give the active gains once")
    by = list(dict.fromkeys(options.by or [AUTO]))
    outside = [name for name in by if name not in {AUTO, *OWN}]
    # the records, each one that a process may be found from
    records = _read(options, [*outside, *gain_columns])
    for one in records:
        require_setpoint(one.recording)
        require_excitation(one.recording)
        require_length(one.recording)
    with user_input("retuner schedule"):
        active: GainTable | RecordedGains | None = None
        if gain_columns:
            columns = [np.concatenate([one.others[name] for one in records]) for name in gain_columns]
            kd = columns[2] if len(columns) > 2 else np.zeros(len(columns[0]))
            active = RecordedGains(columns[0], columns[1], kd)
        elif options.gains is not None:
            active = _in_force(options.gains)
        # progress on the error stream, a line every PATIENCE_S at the most and none before that
        told = [time.monotonic()]

        def say(stage: str, share: float) -> None:
            now = time.monotonic()
            if now - told[0] >= PATIENCE_S and not quiet():
                told[0] = now
                sys.stderr.write(f"schedule: {share:4.0%} done, {stage}\n")
                sys.stderr.flush()

        found = design_schedule(
            records,
            [*OWN, *outside] if AUTO in by else by,
            values={name: [one.others[name] for one in records] for name in outside},
            low=options.low,
            high=options.high,
            co_min=options.co_min,
            co_max=options.co_max,
            ms_limit=options.ms,
            j_limit=options.j,
            lookup=options.lookup,
            name=options.name or records[0].tag or options.files[0].stem,
            unit=options.unit,
            gains=active,
            progress=say,
        )
    assumed = tuple(dict.fromkeys(a for one in records for a in one.assumed))
    windows = [one.recording.window() for one in records]
    written = _written(found, windows, options)
    tell_assumed(assumed, options)
    other = no_cure_by_gains(windows, (options.co_min, options.co_max))
    said = {"diagnosis": None if other is None else other.to_dict(), "assumed": [a.what for a in assumed]}
    lines = [*described(found), *contradiction(other), *(f"{path} written" for path in written)]
    tell(found.to_dict() | said | {"files": [str(p) for p in written]}, lines, as_json=options.as_json)
    return 0 if found.table is not None else 1


def _read(options: ScheduleOptions, others: list[str]) -> list[LoopRecord]:
    """Each file a record, or all of them together one whose signals or times stand in several.

    Stretches in manual count as well: a fit needs pv and co alone.
    """
    if len(options.files) == 1:
        return [read_record(options.files, options, others=others)]
    try:
        return [read_record([file], options, others=others) for file in options.files]
    except RecordingError as alone:
        try:
            return [read_record(options.files, options, others=others)]
        except RecordingError as together:
            beside = any(f'no column "{name}"' in str(alone) for name in others)
            raise (alone if beside else together) from None


def _in_force(path: Path) -> GainTable:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UserError(f"--gains {path}: cannot be read: {error.strerror}; give a gains.toml") from None
    with user_input(f"--gains {path}"):
        return from_toml(text)


def _written(found: ScheduleDesign, windows: list[Window], options: ScheduleOptions) -> list[Path]:
    folder = options.out
    if folder is None:
        return []
    from retuner.decision_page.svg import drawn
    from retuner.schedule_report.schedule_page import SHOWS, page, schedule_figure

    name = found.table.loop if found.table is not None else options.files[0].stem
    files: dict[Path, str | bytes] = {
        folder / "report.html": page(found, windows, name),
        folder / "schedule.png": drawn(schedule_figure(found, windows), SHOWS, ".png"),
    }
    if found.table is not None:
        low, high = (f(float(f(window.co)) for window in windows) for f in (min, max))
        co = f"in the unit of the records, where it runs from {low:g} to {high:g}"
        told = f"# co {co}. A configuration has co {PERCENT}: convert first where that is another.\n"
        files |= {folder / "gains.toml": to_toml(found.table, co)}
        files |= {folder / "schedule.toml": told + schedule_section(found.table)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            write_whole(path, content)
    except OSError as error:
        raise UserError(f"--out {folder}: cannot be written: {error.strerror}") from None
    return list(files)


def no_cure_by_gains(windows: list[Window], co_limits: tuple[float | None, float | None]) -> Diagnosis | None:
    """What diagnose says of the records, where no gains cure it: a gain along pv is what a schedule is for."""
    told = other_cause(diagnosed(windows, None, co_limits, cause_only=True).diagnosis)
    return None if told is None or told.cause in {Cause.NONLINEAR, Cause.UNKNOWN} else told


def described(found: ScheduleDesign) -> list[str]:
    """A design in lines."""
    along = " and ".join(filter(None, (found.variable, found.second)))
    units = chosen_units()
    heads = (("Kc", 10), ("tau_I", 8)) if units is None else ((units.heads, max(len(units.heads), 19)),)
    columns = (("k", 9), ("tau", 8), ("theta", 8), ("+- Kc", 8), *heads, ("Ms", 7), ("J", 5))
    second = f"{found.second:>8}  " if found.second else ""
    lines = [f"  {found.variable:>8}  {second}" + " ".join(f"{name:>{width}}" for name, width in columns)]
    for place in found.places[:: 2 if found.second else 3]:
        model = place.model
        lag = model.tau1_s + model.tau2_s
        beside = "" if place.x2 is None else f"{place.x2:8.4g}  "
        row = f"  {place.x:8.4g}  {beside}{model.k:9.4g} {lag:8.4g} {model.theta_s:8.4g}   {place.gain_std:6.0%}"
        if found.table is not None and place.known:
            gains = found.gains_at(place.x, place.x2)
            judged = place.judged(gains)
            if units is None:
                row += f"   {gains.kp:8.4g} {gains.kp / gains.ki:8.4g}   {judged.ms:5.2f} {judged.j:5.2f}"
            else:
                row += f" {units.short(gains):>{columns[4][1]}}   {judged.ms:5.2f} {judged.j:5.2f}"
        lines.append(row if place.known else f"{row}   not accurate enough")
    lines = [f"{along}: {found.reason}", *(told for told in (variable_sentence(found),) if told), *lines]
    if found.table is not None:
        lines += ["", schedule_section(found.table).rstrip()]
    doubts = [told for told in (aim_sentence(found), push_sentence(found), limit_sentence(found)) if told]
    last = [told for told in (message_sentence(found),) if told]
    return [*lines, "", *doubts, *motion_sentences(found), experiment_sentence(found), *last]
