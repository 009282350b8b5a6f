"""One loop of an audit: its records read, screened, its telling stretches diagnosed, all of it in one row.

A row is plain JSON under a versioned schema, so that it can be kept, sent between processes and machines, and compared
with that of an earlier audit. A loop that fails is a row with the reason.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from retuner.adaptive.audit.loop_screen import LoopScreen, screen_loop
from retuner.adaptive.audit.verdict import LoopVerdict, StretchVerdict, loop_verdict
from retuner.adaptive.audit.windows import stretches_of_interest
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.api import RecordDiagnosis, diagnose_record
from retuner.audit.catalogue import Task, form_for
from retuner.drivers.historian.loop_record import LoopRecord, read_loop_record, read_loops
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.recorded.recording import RecordingError

SCHEMA = 1
"""Version of a row's keys."""
DRAWN = 1_200
"""Points of a trend that are drawn: twice as many as a screen has columns, lowest and highest of each."""
DRAWN_OF_A_STRETCH = 600
Row = dict[str, object]


@dataclass(frozen=True, slots=True)
class AuditSettings:
    """How an audit is made.

    stretches : of each record that are diagnosed at most, 1 to 24. form : of the records.

    Raises
    ------
    ValueError
        stretches is outside 1 to 24.
    """

    stretches: int = 4
    form: RecordForm = field(default_factory=RecordForm)

    def __post_init__(self) -> None:
        if not 1 <= self.stretches <= 24:
            raise ValueError(f"stretches = {self.stretches}: give 1 to 24")


def audit_task(task: Task, settings: AuditSettings) -> list[Row]:
    """The rows of the loops of a task."""
    if task.separate:
        return [_row(task.tags[0], _each_by_itself(task, settings), settings)]
    if len(task.tags) == 1:
        return [_row(task.tags[0], _one(task, settings), settings)]
    try:
        read = read_loops(task.files, settings.form)
    except RecordingError as error:
        return [failed(tag, str(error)) for tag in task.tags]
    return [_row(tag, read.get(tag, RecordingError("no values that are known")), settings) for tag in task.tags]


Read = Sequence[LoopRecord] | LoopRecord | RecordingError


def _one(task: Task, settings: AuditSettings) -> Read:
    """The one loop of a task."""
    try:
        return read_loop_record(task.files, form_for(task, task.tags[0], settings.form), in_automatic=True)
    except RecordingError as error:
        return error


def _each_by_itself(task: Task, settings: AuditSettings) -> Read:
    """The records of a loop whose files have clocks of their own; broken ones are left out, if one is whole."""
    read: list[LoopRecord] = []
    broken: list[RecordingError] = []
    for path in task.files:
        try:
            read.append(read_loop_record([path], settings.form, in_automatic=True))
        except RecordingError as error:
            broken.append(error)
    return read if read or not broken else broken[0]


def failed(tag: str, reason: str) -> Row:
    """The row of a loop that could not be judged."""
    return {"schema": SCHEMA, "tag": tag, "failed": reason, "rank": 0.0, "cause": "failed", "action": "read the reason"}


def _row(tag: str, read: Read, settings: AuditSettings) -> Row:
    """The row of a loop."""
    if isinstance(read, RecordingError):
        return failed(tag, str(read))
    records = [read] if isinstance(read, LoopRecord) else list(read)
    if any(record.recording.sp is None for record in records):
        return failed(tag, f"{records[0].recording.source}: no setpoint; name its column, or give --sp")
    try:
        return _judged(tag, records, settings)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return failed(tag, f"{records[0].recording.source}: {type(error).__name__}: {error}")


def _judged(tag: str, records: Sequence[LoopRecord], settings: AuditSettings) -> Row:
    """The row of a loop whose records could be read."""
    windows = [record.recording.window() for record in records]
    screens = [screen_loop(window) for window in windows]
    main = max(range(len(windows)), key=lambda i: screens[i].span_s)
    parts: list[tuple[Window, StretchVerdict, RecordDiagnosis]] = []
    for window, screen in zip(windows, screens, strict=True):
        for stretch in stretches_of_interest(window, screen.period_s, settings.stretches):
            found = diagnose_record(stretch)
            told = found.diagnosis
            begin_s, end_s = float(stretch.t_s[0]), float(stretch.t_s[-1])
            seen = StretchVerdict(begin_s, end_s, told.cause, told.confidence, told.reason)
            parts.append((stretch, seen, found))
    verdict = loop_verdict(screens[main], [part[1] for part in parts])
    return {
        **_told(tag, records, screens[main], verdict),
        "harmonic": max((part[2].diagnosis.evidence.get("third_harmonic", 0.0) for part in parts), default=0.0),
        "settings": _settings(verdict, [part[2] for part in parts]),
        "stretches": [_stretch(*part) for part in parts],
        "trend": drawn(windows[main], DRAWN),
    }


def _told(tag: str, records: Sequence[LoopRecord], screen: LoopScreen, verdict: LoopVerdict) -> Row:
    """What a table shows of a loop."""
    begin_s = records[0].begin_s
    since = verdict.since_s
    assumed = dict.fromkeys(a.what for record in records for a in record.assumed)
    return {
        "schema": SCHEMA,
        "tag": tag,
        "records": len(records),
        "begin": _moment(begin_s, 0.0),
        "cause": str(verdict.cause),
        "confidence": verdict.confidence,
        "action": str(verdict.action),
        "reason": verdict.reason,
        "since": _moment(begin_s, since) if since is not None else None,
        "since_s": since,
        "seen": verdict.seen,
        "looked_at": verdict.looked_at,
        "avoidable": verdict.avoidable,
        "rank": verdict.rank,
        "loss_per_day": verdict.avoidable**0.5 * screen.iae_per_day,
        "screen": screen.to_dict(),
        "assumed": list(assumed),
    }


def _moment(begin_s: float | None, after_s: float) -> str | None:
    """A moment of the record, where its times are of a calendar."""
    if begin_s is None:
        return None
    return datetime.fromtimestamp(begin_s + after_s, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _settings(verdict: LoopVerdict, found: Sequence[RecordDiagnosis]) -> Row | None:
    """The settings that would cure the loop, with their margins: of the surest stretch that has them."""
    fitting = [f for f in found if f.diagnosis.cause == verdict.cause and f.diagnosis.retune and f.settings is not None]
    best = max(fitting, key=lambda f: f.diagnosis.confidence, default=None)
    if best is None or best.settings is None:
        return None
    told = best.settings.to_dict()
    return {name: told[name] for name in ("gains", "form", "margins")} | {"first_step": best.aim is not None}


def _stretch(window: Window, verdict: StretchVerdict, found: RecordDiagnosis) -> Row:
    """What is shown of a stretch."""
    evidence = {k: v for k, v in found.diagnosis.evidence.items() if math.isfinite(v)}
    return {
        "begin_s": verdict.begin_s,
        "end_s": verdict.end_s,
        "cause": str(verdict.cause),
        "confidence": verdict.confidence,
        "reason": verdict.reason,
        "evidence": evidence,
        "trend": drawn(window, DRAWN_OF_A_STRETCH),
    }


def drawn(window: Window, points: int) -> dict[str, list[float]]:
    """A trend for a screen: of each of its columns the lowest and the highest value, so that no peak is lost."""
    n = len(window.t_s)
    if n <= points:
        return {name: _short(getattr(window, name)) for name in ("t_s", "sp", "pv", "co")}
    edges = np.linspace(0, n, points // 2 + 1).astype(int)
    found = {"t_s": _short(np.repeat(window.t_s[edges[:-1]], 2))}
    for name in ("sp", "pv", "co"):
        values = getattr(window, name)
        both = np.column_stack((np.minimum.reduceat(values, edges[:-1]), np.maximum.reduceat(values, edges[:-1])))
        found[name] = _short(both.ravel())
    return found


def _short(values: FloatArray) -> list[float]:
    """Values with as many digits as a picture shows."""
    return [float(f"{v:.6g}") for v in values]


def is_fault(row: Row) -> bool:
    """Whether a row asks for a visit."""
    return row.get("cause") not in {str(Cause.OK), str(Cause.NOISE)} and float(str(row["rank"])) > 0
