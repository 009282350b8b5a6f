"""Samples out of recorded loops of any origin: tables (CSV, Parquet) and logs of bus traffic.

A table needs t, sp, pv and co. What else a controller knows is taken where it is there (the columns of a run's trend:
x, x2, mode, limited, kp, ki, kd) and else follows from the rest: x is the scheduling variable, mode is automatic,
limited is where co stands at a limit. In a log of bus traffic the protocol has all of it.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from retuner.adaptive.signals.sample import LARGEST, FloatArray, LoopMode, LoopSample, median
from retuner.drivers.recorded.frame_log import Overhearing, read_frames
from retuner.drivers.recorded.recording import (
    ROLES,
    Recording,
    RecordingError,
    column_names,
    read_columns,
    require_setpoint,
)
from retuner.drivers.telemetry.signal_source import ScheduleInputs
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

GAINS = ("kp", "ki", "kd")
FURTHER = ("x", "x2", "mode", "limited", *GAINS)
"""What a controller knows beside the signals of its loop: columns of a run's trend."""
TIME_TOLERANCE = 0.1  # share by which the record's sampling interval may differ from the configured one


class Recorded(NamedTuple):
    """A sample, and the gains that the record says were in force, if it does."""

    sample: LoopSample
    gains: PidGains | None


@dataclass(frozen=True, slots=True)
class LoopFacts:
    """What a record does not say of its loop.

    sample_time_s : of the controller, s. variable : scheduling variable. co_min, co_max : limits of co. node : on the
    bus.
    """

    sample_time_s: float
    variable: str | ScheduleInputs
    co_min: float
    co_max: float
    node: int


def table_samples(path: Path, columns: Mapping[str, str], facts: LoopFacts) -> Iterator[Recorded]:
    """Samples of a CSV or Parquet file; columns : other names of t, sp, pv, co.

    Raises RecordingError: the file is malformed, or sampled at another rate than the controller.
    """
    names = {role: columns.get(role, role) for role in ROLES}
    further = [name for name in FURTHER if name not in names.values()]
    table = read_columns(path, [*names.values(), *further], list(names.values()))
    t, sp, pv, co = (table[names[role]] for role in ROLES)
    yield from _samples(str(path), (t, sp, pv, co), table, facts)


def has_more_than_signals(path: Path, columns: Mapping[str, str]) -> bool:
    """Whether a table is one of t, sp, pv, co under these names and holds what only a controller knows of itself.

    Such a table is a run's trend; any other is read as historians export it.
    """
    try:
        names = column_names(path)
    except RecordingError:
        return False
    plain = {columns.get(role, role) for role in ROLES}
    return plain <= names and bool(names - plain & set(FURTHER))


def recording_samples(recording: Recording, facts: LoopFacts) -> Iterator[Recorded]:
    """Samples of a record that is nothing but t, sp, pv and co; errors as table_samples."""
    require_setpoint(recording)
    window = recording.window()
    yield from _samples(recording.source, (window.t_s, window.sp, window.pv, window.co), {}, facts)


def _samples(
    path: str, signals: tuple[FloatArray, ...], table: Mapping[str, FloatArray], facts: LoopFacts
) -> Iterator[Recorded]:
    """Samples of t, sp, pv, co and of what else a table holds."""
    t, sp, pv, co = signals
    # Refuse what is no record of this loop
    if len(t) < 3:
        raise RecordingError(f"{path}: {len(t)} samples; a response has at least dozens of them")
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        raise RecordingError(
            f"{path}: sample {back[0] + 2}: t = {t[back[0] + 1]:g} follows {t[back[0]]:g}; it must increase"
        )
    if max(float(np.max(np.abs(signal))) for signal in (t, *(sp, pv, co))) > LARGEST:
        raise RecordingError(f"{path}: a value is beyond {LARGEST:g}; give the record in its engineering units")
    interval = median(np.diff(t))
    if abs(interval - facts.sample_time_s) > TIME_TOLERANCE * facts.sample_time_s:
        raise RecordingError(
            f"{path}: is sampled every {interval:g} s, loop.sample_time_s is {facts.sample_time_s:g} s; make them equal"
        )
    inputs = ScheduleInputs.of(facts.variable)
    own = {"sp": sp, "pv": pv, "co": co, "": np.zeros(len(t))}
    scheduled = []  # a scheduling variable: its column, else what the loop's own signals say of it
    for name, variable in (("x", inputs.variable), ("x2", inputs.variable2)):
        values = table.get(name, own.get(variable))
        if values is None:
            raise RecordingError(
                f'{path}: no column "{name}": the scheduling variable is a signal on the bus, which sp, '
                "pv and co do not tell; add the column"
            )
        scheduled.append(values)
    mode = table.get("mode", np.full(len(t), float(LoopMode.AUTO)))
    limited = table.get("limited", np.where(co >= facts.co_max, 1.0, np.where(co <= facts.co_min, -1.0, 0.0)))
    known = all(name in table for name in GAINS)
    rows = np.column_stack((t, sp, pv, co, mode, limited, *scheduled)).tolist()
    for i, (t_s, sp_i, pv_i, co_i, mode_i, limited_i, x_i, x2_i) in enumerate(rows):
        try:
            gains = PidGains(*(float(table[name][i]) for name in GAINS)) if known else None
        except ValueError as error:
            raise RecordingError(f"{path}: sample {i + 1}: {error}") from error
        yield Recorded(LoopSample(t_s, sp_i, pv_i, co_i, int(mode_i), int(limited_i), x_i, 0, x2_i), gains)


def frame_samples(path: Path, facts: LoopFacts) -> Iterator[Recorded]:
    """Samples of a log of bus traffic, as a bystander hears them.

    Raises RecordingError: the log cannot be read, or holds no telemetry of this node.
    """
    heard = Overhearing(facts.node, facts.sample_time_s, facts.variable, as_host=False)
    samples = 0
    for message in read_frames(path):
        joined = heard.take(message)
        if joined is not None:
            samples += 1
            yield Recorded(joined.sample, heard.running.gains if heard.running else None)
    if not samples:
        what = f"{heard.frames} frames of node {facts.node}, but no" if heard.frames else "no frame of node and no"
        raise RecordingError(f"{path}: {what} telemetry in it; is bus.node = {facts.node} the right one?")
