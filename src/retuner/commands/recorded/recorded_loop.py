"""What identify and diagnose share: a recorded loop with its columns, and the controller that was in force."""

import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any

import numpy as np

from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.commands.options import FormOptions, RecordOptions, check_plot, controller_units
from retuner.decision_page.shown_units import show_units
from retuner.drivers.historian.assumption import Assumption, in_a_line, in_full
from retuner.drivers.historian.loop_record import LoopRecord, read_loop_record, read_records
from retuner.drivers.historian.record_form import COLUMN_ROLES, RecordForm, form_from_toml
from retuner.drivers.recorded.recording import Recording, require_setpoint
from retuner.errors import UserError, user_input
from retuner.schedule.controller_units import Acting
from retuner.schedule.gains import Form, PidGains, from_form
from retuner.verbosity import LOGGER, busy, quiet


def record_form(options: FormOptions) -> RecordForm:
    """What the options fix, over what the file of --record fixes.

    Raises UserError, RecordingError: a value out of range, or a file that cannot be used.
    """
    form = form_from_toml(options.record) if options.record is not None else RecordForm()
    texts = ("tag", "time_format", "time_unit", "zone", "decimal", "good")
    given: dict[str, Any] = {name: getattr(options, name) for name in texts if getattr(options, name)}
    given |= {k: v for k, v in (("sp", options.sp), ("dt_s", options.dt)) if v is not None}
    given |= {"bad": (*form.bad, options.bad)} if options.bad else {}
    given |= {"dbc": tuple(map(str, options.dbc))} if options.dbc else {}
    with user_input("the form of the record"):
        # --scale as signal to what it is recorded as and stands for
        found: dict[str, str] = {}
        for part in (p.strip() for p in options.scale.split(",") if p.strip()):
            role, equals, scaling = part.partition("=")
            if not equals or role in found:
                raise UserError(f"--scale {part}: give signal=range, each signal once, as in pv=4..20:0..200")
            found[role] = scaling
        scale = {**form.scale, **found}
        return replace(form, columns={**form.columns, **renamed(options.columns)}, scale=scale, **given)


def renamed(text: str) -> dict[str, str]:
    """--columns as role to column name.

    Raises UserError: a part is not role=name, a role is not known, or is given twice.
    """
    found: dict[str, str] = {}
    for part in (p.strip() for p in text.split(",") if p.strip()):
        role, equals, name = part.partition("=")
        if not equals or role not in COLUMN_ROLES or not name or role in found:
            raise UserError(f"--columns {part}: give role=name, each role once; roles are {', '.join(COLUMN_ROLES)}")
        found[role] = name
    return found


def read_record(
    files: Sequence[Path], options: FormOptions, *, in_automatic: bool = False, others: Sequence[str] = ()
) -> LoopRecord:
    """The record in these files. others : further columns that are wanted.

    Raises UserError, RecordingError: a file or an option cannot be used.
    """
    with busy(f"reading {', '.join(map(str, files))}"):
        form = record_form(options)
        form = replace(form, others=tuple(dict.fromkeys((*form.others, *others))))
        read = read_loop_record(files, form, in_automatic=in_automatic)
    LOGGER.info("read %d samples from %s", len(read.recording.t_s), read.recording.source)
    return read


def days_told(days: int, records: int) -> tuple[Assumption, ...]:
    """Words where records were read in parts."""
    told = f"{days} parts, each a record of its own: gaps without samples, or with the controller off, left out"
    return (Assumption(told),) if days > records else ()


def tell_assumed(assumed: tuple[Assumption, ...], options: FormOptions) -> None:
    """What was assumed, on the error stream, beside the result: in one line, or as a [record] section."""
    if options.assume:
        sys.stderr.write("\n".join(in_full(assumed)) + "\n")
    elif assumed and not quiet():
        sys.stderr.write(f"assumed: {in_a_line(assumed)} (--assume prints how to fix it otherwise)\n")


MOST_BEYOND = 0.9  # share of co beyond a limit from which the limit is meant in another unit
SHARE = (-0.05, 1.05)  # ends between which co may be a share of its range
PER_CENT, PER_CENT_WITHIN = 100.0, 2.0
"""Ratio of a gain for co in percent to one for its share, and the factor within which it is taken for that."""
FEWEST_SAMPLES = 20  # shorter records are refused: a model has four numbers, a load two, and noise must show besides


def read_loop(options: RecordOptions) -> LoopRecord:
    """The record with what was assumed in reading it, checked against what the options say of it.

    Raises UserError, RecordingError: the file or an option cannot be used, or a closed loop has no setpoint.
    """
    _check_options(options)
    return _checked(read_record(options.files, options, in_automatic=not options.open_loop), options)


def read_records_of_loop(options: RecordOptions) -> list[LoopRecord]:
    """The records of one loop, a file each, or one record in several files; checked likewise, errors as read_loop."""
    _check_options(options)
    with busy(f"reading {', '.join(map(str, options.files))}"):
        found = read_records(options.files, record_form(options))
    for read in found:
        LOGGER.info("read %d samples from %s", len(read.recording.t_s), read.recording.source)
    return [_checked(read, options) for read in found]


def _check_options(options: RecordOptions) -> None:
    # Refuse limits that are none
    for name, value in (("--co-min", options.co_min), ("--co-max", options.co_max)):
        if value is not None and not math.isfinite(value):
            raise UserError(f"{name} {value}: give a finite number")
    if options.co_min is not None and options.co_max is not None and options.co_min >= options.co_max:
        raise UserError(f"--co-min {options.co_min:g} is not below --co-max {options.co_max:g}: exchange them")
    check_plot(options.plot)


def _checked(read: LoopRecord, options: RecordOptions) -> LoopRecord:
    if options.begin or options.end:
        recording = read.recording
        t_s = recording.t_s
        first = _moment_s(read, "--from", options.begin, options.zone) if options.begin else float(t_s[0])
        last = _moment_s(read, "--to", options.end, options.zone) if options.end else float(t_s[-1])
        kept = (t_s >= first) & (t_s <= last)
        if (left := np.count_nonzero(kept)) < FEWEST_SAMPLES:
            dated = any("-" in text[1:] for text in (options.begin, options.end))
            wanted, there = (
                [_told(read, t, options.zone, dated) for t in two] for two in ((first, last), t_s[[0, -1]])
            )
            raise UserError(
                f"{recording.source}: from {wanted[0]} to {wanted[1]} there are {left} samples; the record runs from "
                f"{there[0]} to {there[1]}"
            )
        sp = None if recording.sp is None else recording.sp[kept]
        part = Recording(recording.source, t_s[kept], recording.pv[kept], recording.co[kept], sp)
        read = replace(read, recording=part, others={name: values[kept] for name, values in read.others.items()})
    if not options.open_loop:
        require_setpoint(read.recording)
    # Refuse limits in another unit than the record's: most of co lies beyond them
    recording = read.recording
    low, high = float(recording.co.min()), float(recording.co.max())
    for name, limit, beyond in (
        ("--co-min", options.co_min, None if options.co_min is None else recording.co < options.co_min),
        ("--co-max", options.co_max, None if options.co_max is None else recording.co > options.co_max),
    ):
        if beyond is not None and float(beyond.mean()) > MOST_BEYOND:
            raise UserError(
                f"{name} {limit:g}: co runs from {low:g} to {high:g} in {recording.source}; give the limits in its unit"
            )
    return read


def _told(read: LoopRecord, t_s: float, zone: str, dated: bool) -> str:
    """A time of the record as it was asked for: a moment, or seconds."""
    if not dated or read.begin_s is None:
        return f"{t_s:g} s"
    return datetime.fromtimestamp(read.begin_s + t_s, _zone(zone)).replace(tzinfo=None).isoformat(timespec="seconds")


def _zone(zone: str) -> tzinfo:
    from zoneinfo import ZoneInfo

    return ZoneInfo(zone) if zone else UTC


def _moment_s(read: LoopRecord, option: str, text: str, zone: str) -> float:
    """A time of the record in its own seconds.

    Raises UserError: it is neither seconds nor a moment; or it is a moment, and the record has no dates.
    """
    with suppress(ValueError):
        if math.isfinite(found := float(text)):
            return found
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise UserError(f"{option} {text}: give seconds of the record, or a time as 2026-05-04T08:30") from None
    if read.begin_s is None:
        raise UserError(f"{option} {text}: {read.recording.source} has no dates; give seconds of the record")
    moment = moment.replace(tzinfo=moment.tzinfo or _zone(zone))
    return moment.timestamp() - read.begin_s


def require_length(recording: Recording) -> None:
    """Refuse a record too short for anything. Raises UserError: it has fewer than FEWEST_SAMPLES."""
    n = len(recording.t_s)
    if n < FEWEST_SAMPLES:
        raise UserError(
            f"{recording.source}: {n} samples are too few for a loop; give at least {FEWEST_SAMPLES}, better 100"
        )


def controller(options: RecordOptions) -> PidGains | None:
    """The gains in force, when they were given.

    Raises UserError: times without a gain, a controller in an open loop, an unknown form, or a value outside its range.
    """
    if options.form not in set(Form):
        raise UserError(f"--form {options.form}: give one of {', '.join(Form)}")
    units = controller_units(options.controller, options.pv_span, options.action, (options.co_min, options.co_max))
    show_units(units)
    if options.kc is None:
        if options.tau_i is not None or options.tau_d:
            raise UserError("--tau-i and --tau-d need --kc: give the gain of the active controller, too")
        return None
    if options.open_loop:
        raise UserError("--open-loop and --kc exclude each other: in manual there was no controller")
    with user_input("--kc, --tau-i, --tau-d"):
        if units is not None:
            return units.gains(options.kc, options.tau_i, options.tau_d)
        return from_form(options.form, options.kc, options.tau_i, options.tau_d)


def require_fitting(recording: Recording, gains: PidGains | None) -> None:
    """Refuse gains that are not those of the controller that the record shows.

    Raises UserError: the record shows the controller's law, and it acts the other way, or has a gain of another unit.
    """
    if gains is None:
        return
    found = settings_in_force(recording.window()).gains
    if found is not None and found.direction != gains.direction:
        raise UserError(
            f"--kc: these gains are {Acting.of(gains)} acting; {recording.source} shows a {Acting.of(found)}-acting "
            "controller: change the sign of --kc, or --action"
        )
    # A gain for percent beside co as a share of its range
    low, high = float(recording.co.min()), float(recording.co.max())
    times = gains.kp / found.kp if found is not None and found.kp else 1.0
    if SHARE[0] <= low and high <= SHARE[1] and 1 / PER_CENT_WITHIN < times / PER_CENT < PER_CENT_WITHIN:
        raise UserError(
            f"--kc: this gain is for co in percent, {times:.3g} times what {recording.source} shows, where co runs "
            f"from {low:.3g} to {high:.3g}; give --scale co=0..1:0..100, or the gain for co as it is recorded"
        )
