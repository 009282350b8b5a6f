"""One loop of an audit: its records read, screened, its telling stretches diagnosed, all of it in one row.

A row is plain JSON under a versioned schema, so that it can be kept, sent between processes and machines, and compared
with that of an earlier audit. A loop that fails is a row with the reason.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from retuner.adaptive.audit.loop_screen import DAY_S, LoopScreen, joined_screen, screen_loop
from retuner.adaptive.audit.over_time import (
    MONDAY_S,
    NUMBERS,
    PartOfTime,
    joined_parts,
    over_time,
    period_of,
    spread_over,
    stretches_of_interest,
)
from retuner.adaptive.audit.tracks import damped_track, swing_track, trend_track
from retuner.adaptive.audit.verdict import SWINGS, LoopVerdict, StretchVerdict, asks, loop_verdict, with_foreseen
from retuner.adaptive.choice.foreseen import Foreseen, foreseen, weighed_models
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.identification.robust_simc import RobustSettings, believed
from retuner.adaptive.indexes.days import MOST_DAYS, days_of, off_in
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.audit.catalogue import ANY_FAULT, Task, told_fault
from retuner.diagnosing import RecordDiagnosis, diagnose_windows, parts_of
from retuner.drivers.historian.loop_record import LoopRecord, loop_in_pieces, read_loop_record, read_loops
from retuner.drivers.historian.parquet_tables import MOST_ROWS
from retuner.drivers.historian.record_form import RecordForm
from retuner.drivers.recorded.recording import RecordingError
from retuner.report.what_if import of_diagnosis
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.plain_values import plain_values

SCHEMA = 6  # version of a row's keys
OWN_SWING = frozenset({Cause.AGGRESSIVE, Cause.SLOW_INTEGRATING})  # causes by which a loop oscillates of itself
DRAWN = 1_200  # points of a trend that are drawn: twice as many as a screen has columns, lowest and highest of each
DRAWN_OF_A_STRETCH = 600
FEWEST_PARTS = 2  # Days or weeks of a loop that are a course
HALF = 0.5  # no confidence is told of what is no likelier than not
Row = dict[str, Any]
Trend = dict[str, list[float]]  # Times and signals of a picture


@dataclass(frozen=True, slots=True)
class AuditSettings:
    """How an audit is made.

    stretches : of each record that are diagnosed at most, 0 to 24; 0 screens only. form : of the records.

    Raises ValueError: stretches is outside 0 to 24.
    """

    stretches: int = 4
    form: RecordForm = field(default_factory=RecordForm)

    def __post_init__(self) -> None:
        if not 0 <= self.stretches <= 24:
            raise ValueError(f"stretches = {self.stretches}: give 0 to 24")


def audit_task(task: Task, settings: AuditSettings) -> list[Row]:
    """The rows of the loops of a task."""
    if task.separate:
        broken: list[RecordingError] = []
        row = _row(task.tags[0], _each_by_itself(task, settings, broken), settings, common_clock=False)
        told = [f"left out: {error}" for error in broken]
        return [row if "failed" in row else row | {"assumed": [*row["assumed"], *told]}]
    if task.in_pieces:
        return [_row(tag, loop_in_pieces(task.files, settings.form, tag, MOST_ROWS), settings) for tag in task.tags]
    try:
        read = read_loops(task.files, settings.form, task.tags)
    except ANY_FAULT as error:
        return [failed(tag, told_fault(error)) for tag in task.tags]
    missing = RecordingError(f"{task.files[0]}: no usable values")
    found = {tag: read.get(tag, missing) for tag in task.tags}
    return [
        failed(tag, told_fault(one)) if isinstance(one, RecordingError) else _row(tag, iter([one]), settings)
        for tag, one in found.items()
    ]


def _each_by_itself(task: Task, settings: AuditSettings, broken: list[RecordingError]) -> Iterator[LoopRecord]:
    """The records of a loop whose files have clocks of their own; broken ones are put there, if one is whole."""
    for path in task.files:
        try:
            yield read_loop_record([path], settings.form, in_automatic=True)
        except RecordingError as error:
            broken.append(error)
    if len(broken) == len(task.files):
        raise broken[0]


def failed(tag: str, reason: str) -> Row:
    """The row of a loop that could not be judged."""
    return {"schema": SCHEMA, "tag": tag, "failed": reason, "rank": 0.0, "cause": "failed", "action": "read the reason"}


def _row(tag: str, read: Iterator[LoopRecord], settings: AuditSettings, *, common_clock: bool = True) -> Row:
    """The row of a loop; its records are read one after the other. common_clock : their times are other loops' too."""
    seen = _LoopRecords()
    try:
        for record in read:
            seen.add(record, settings)
        # The row of a loop whose records were seen
        screen = joined_screen([one for one in seen.screens if one.setpoint] or seen.screens)
        now = _under_newest(seen.parts)
        verdict = loop_verdict(screen, [part.verdict for part in now])
        cure = _cure(verdict, [part.found for part in now])
        then = _foreseen(cure, seen.spread) if cure is not None else None
        if verdict.cause in TUNING_CAUSES:
            proposed = cure is not None and cure.recommended is not None
            verdict = with_foreseen(verdict, then, proposed=proposed)
            verdict = replace(verdict, reason=cure.diagnosis.reason) if cure is not None and proposed else verdict
        harmonics = (part.found.diagnosis.evidence.get("third_harmonic", 0.0) for part in seen.parts)
        own = [part for part in seen.parts if part.found is cure]
        able = own or sorted(seen.parts, key=lambda part: -part.verdict.confidence)
        begin_s, since = seen.begin_s, verdict.since_s
        named = verdict.cause != Cause.UNKNOWN
        avoidable = verdict.avoidable if named or 0 < verdict.avoidable < 1 else None
        # the trends of several records as one, where their times tell how they follow; else the longest
        if len(seen.trends) == 1 or len({later_s for later_s, _ in seen.trends}) < len(seen.trends):
            one_trend = max((trend for _, trend in seen.trends), key=lambda trend: trend["t_s"][-1] - trend["t_s"][0])
        else:
            ordered = sorted(seen.trends, key=lambda one: one[0])
            times = np.concatenate([np.array(trend["t_s"]) + later_s for later_s, trend in ordered])
            values = {name: np.concatenate([trend[name] for _, trend in ordered]) for name in ("sp", "pv", "co")}
            one_trend = _thinned(times, values, DRAWN)
        return {
            "schema": SCHEMA,
            "tag": tag,
            "records": len(seen.screens),
            "begin": _moment(begin_s, 0.0),
            "end": _moment(begin_s, seen.end_s),
            "cause": str(verdict.cause),
            "confidence": verdict.confidence if named or verdict.confidence > HALF else None,
            **plain_values(verdict, "action reason"),
            "since": _moment(begin_s, since) if since is not None else None,
            "since_s": since,
            **plain_values(verdict, "seen looked_at"),
            "avoidable": avoidable,
            **plain_values(verdict, "rank basis"),
            "loss_per_day": avoidable * screen.iae_per_day if avoidable is not None and screen.setpoint else None,
            "screen": screen.to_dict(),
            "assumed": list(seen.assumed),
            "asks": asks(screen),
            "harmonic": max(harmonics, default=0.0),
            "sticks": sum(p.verdict.confidence for p in seen.parts if p.verdict.cause == Cause.STICTION)
            / max(len(seen.parts), 1),
            **_cure_words(cure, then),
            "what_if": next(
                (told for part in able if (told := of_diagnosis(part.window, part.found)) is not None), None
            ),
            "tracks": seen.tracks if common_clock else {},
            "stretches": [part.shown for part in seen.parts],
            "trend": one_trend,
            "over_time": _course(seen),
        }
    except ANY_FAULT as error:
        return failed(tag, told_fault(error))


class Part(NamedTuple):
    """A diagnosed stretch: its verdict, what is shown of it, the whole diagnosis, and its samples."""

    verdict: StretchVerdict
    shown: Row
    found: RecordDiagnosis
    window: Window


@dataclass(slots=True)
class _LoopRecords:
    """What is kept of a loop's records, whatever their length."""

    screens: list[LoopScreen] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    spread: list[Window] = field(default_factory=list)
    trends: list[tuple[float, Trend]] = field(default_factory=list)
    assumed: dict[str, None] = field(default_factory=dict)
    begin_s: float | None = None
    end_s: float = 0.0
    tracks: Row = field(default_factory=dict)
    period_s: float | None = None
    course: list[PartOfTime] = field(default_factory=list)

    def add(self, record: LoopRecord, settings: AuditSettings) -> None:
        """Screen a record and diagnose its telling stretches; without a setpoint nothing can be diagnosed."""
        known, pv = record.recording.sp is not None, record.recording.pv
        mean = np.full(len(pv), float(np.mean(pv)))  # stands in for a setpoint that is not recorded
        window = record.recording.window() if known else Window(record.recording.t_s, mean, pv, record.recording.co)
        days = days_of(window, len(window.t_s)) if known else [window]
        worked = days if off_in(window).any() else [window]  # a controller that is off is judged by nothing
        screen = joined_screen([screen_loop(day, setpoint=known) for day in worked])
        if not self.screens:
            self.begin_s = record.begin_s
            self.period_s = period_of(float(window.t_s[-1] - window.t_s[0]))
        later_s = record.begin_s - self.begin_s if record.begin_s is not None and self.begin_s is not None else 0.0
        if self.period_s is not None:
            first_s = float(window.t_s[0]) if record.begin_s is None else MONDAY_S - record.begin_s
            swings = screen.swinging > 0
            parts = over_time(window, self.period_s, first_s, setpoint=known, swings=swings)
            self.course += [replace(part, begin_s=round(part.begin_s + later_s)) for part in parts]
        days = days[-MOST_DAYS:]
        most = -(-settings.stretches // len(days)) if known else 0
        for stretch in (one for day in days for one in stretches_of_interest(day, screen.period_s, most)):
            found = diagnose_windows(parts_of([stretch], None))
            told = found.diagnosis
            begin_s, end_s = float(stretch.t_s[0]) + later_s, float(stretch.t_s[-1]) + later_s
            seen = StretchVerdict(begin_s, end_s, told.cause, told.confidence, told.reason)
            shown = {
                "file": Path(record.recording.source).name,
                **plain_values(seen, "begin_s end_s cause confidence reason"),
                "evidence": {k: v for k, v in told.evidence.items() if math.isfinite(v)},
                "trend": drawn(stretch, DRAWN_OF_A_STRETCH),
            }
            self.parts.append(Part(seen, shown, found, _own_copy(stretch)))
        if settings.stretches and known:
            self.spread += [_own_copy(part) for part in spread_over(max(worked, key=lambda day: len(day.t_s)))]
        if screen.span_s >= max((one.span_s for one in self.screens), default=0.0):
            # What is kept of a record to compare it with those of other loops. own_s : about the period with which a
            # loop that is named too strong oscillates, four times its dead time
            strong = (one.found.estimate for one in self.parts if one.found.diagnosis.cause in OWN_SWING)
            models = (one.log.model() for one in strong if one is not None)
            own_s = next((4 * (model.theta_s + model.tau2_s / 2) for model in models), None)
            t_s, error = window.t_s + (record.begin_s or 0.0), window.sp - window.pv
            swings = screen.period_s is not None and screen.swinging >= SWINGS
            track = swing_track(t_s, error, screen.period_s).to_dict() if swings and screen.period_s else None
            damped = damped_track(t_s, error, own_s).to_dict() if own_s and not swings else None
            trend = trend_track(t_s, window.sp, window.co).to_dict()
            self.tracks = {"swing": track, "damped": damped, "damped_s": own_s, "trend": trend}
        self.end_s = max(self.end_s, later_s + float(window.t_s[-1]))
        self.screens.append(screen)
        self.trends.append((later_s, drawn(window, DRAWN)))
        self.assumed |= dict.fromkeys(a.what for a in record.assumed)


def _course(seen: _LoopRecords) -> Row | None:
    """How the loop ran part by part of its time, as lists; None where it has no course."""
    parts = joined_parts(seen.course)
    if seen.period_s is None or len(parts) < FEWEST_PARTS:
        return None
    told: Row = {
        one.name: [None if math.isnan(value := getattr(part, one.name)) else float(f"{value:.4g}") for part in parts]
        for one in NUMBERS
    }
    begins = [_moment(seen.begin_s, part.begin_s) or f"{part.begin_s / DAY_S:g} d" for part in parts]
    return {"days": seen.period_s / DAY_S, "begin": [begin[:10] for begin in begins], **told}


def _moment(begin_s: float | None, after_s: float) -> str | None:
    if begin_s is None:
        return None
    return datetime.fromtimestamp(begin_s + after_s, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _under_newest(parts: Sequence[Part]) -> list[Part]:
    """The stretches without those whose tuning was another one than the newest, as far as settings are known."""
    known = [(part.verdict.end_s, part.found.active) for part in parts if part.found.active is not None]
    newest = max(known, key=itemgetter(0))[1] if known else None

    def other(found: RecordDiagnosis) -> bool:
        if found.active is None or newest is None or found.cause not in {Cause.OK, *TUNING_CAUSES}:
            return False
        pairs = ((found.active.kp, newest.kp), (found.active.ki, newest.ki))
        return any(max(map(abs, two)) > OTHER * min(map(abs, two)) for two in pairs)

    return [part for part in parts if not other(part.found)]


OTHER = 1.5  # ratio of two gains that were read off, each to 15 % (LawSettings), from which they are not the same


def _cure(verdict: LoopVerdict, found: Sequence[RecordDiagnosis]) -> RecordDiagnosis | None:
    """The surest stretch of a cause of tuning that told the process, one with settings where there is one."""
    if verdict.cause not in TUNING_CAUSES:
        return None
    telling = [f for f in found if f.diagnosis.cause == verdict.cause and (f.estimate or f.foreseen)]
    return max(telling, key=lambda f: (f.settings is not None, f.diagnosis.confidence), default=None)


def _own_copy(part: Window) -> Window:
    """A part that does not hold its whole record."""
    return Window(part.t_s.copy(), part.sp.copy(), part.pv.copy(), part.co.copy())


def _foreseen(cure: RecordDiagnosis, records: Sequence[Window]) -> Foreseen | None:
    """What settings would have made of parts spread over the record; of the stretch itself where many processes are
    weighed.
    """
    estimate = cure.estimate
    if estimate is None or cure.likely or cure.settings is None or not records:
        return cure.foreseen
    rule, gains = RobustSettings(), cure.settings.gains
    allowed = replace(estimate, plausible=tuple(believed(estimate.plausible, rule.believed)))
    return foreseen(records, weighed_models(allowed), gains, cure.active)


def _cure_words(cure: RecordDiagnosis | None, then: Foreseen | None) -> Row:
    """Keys settings, and process: the one that was identified, and what settings for it would have made of the record;
    each None where there is none.
    """
    settings = process = None
    if cure is not None and cure.settings is not None:
        told = cure.settings.to_dict()
        settings = {name: told[name] for name in ("gains", "form", "parallel", "margins")}
        settings["first_step"] = cure.aim is not None
    model = None if cure is None else cure.estimate.log.model() if cure.estimate else cure.model
    if model is not None:
        process = {"model": model.to_dict(), "foreseen": then.to_dict() if then else None}
    return {"settings": settings, "process": process}


def drawn(window: Window, points: int) -> Trend:
    """A trend for a screen: of each of its columns the lowest and the highest value, so that no peak is lost."""
    return _thinned(window.t_s, {name: getattr(window, name) for name in ("sp", "pv", "co")}, points)


def smaller(trend: Trend, points: int) -> Trend:
    """A trend that was drawn already, with fewer points."""
    return _thinned(np.array(trend["t_s"]), {name: np.array(trend[name]) for name in ("sp", "pv", "co")}, points)


def _thinned(t_s: FloatArray, signals: Mapping[str, FloatArray], points: int) -> Trend:
    n = len(t_s)
    if n <= points:
        return {"t_s": _short(t_s, 10), **{name: _short(values) for name, values in signals.items()}}
    edges = np.linspace(0, n, points // 2 + 1).astype(int)
    found = {"t_s": _short(np.repeat(t_s[edges[:-1]], 2), 10)}
    for name, values in signals.items():
        both = np.column_stack((np.minimum.reduceat(values, edges[:-1]), np.maximum.reduceat(values, edges[:-1])))
        found[name] = _short(both.ravel())
    return found


def _short(values: FloatArray, digits: int = 6) -> list[float]:
    size = np.abs(values)
    places = digits - 1 - np.floor(np.log10(size, out=np.zeros(len(size)), where=size > 0)).astype(int)
    up, down = 10.0 ** np.maximum(places, 0), 10.0 ** np.maximum(-places, 0)
    short: list[float] = (np.round(values / down * up) * down / up).tolist()
    return short


def is_fault(row: Row) -> bool:
    """Whether a row asks for a visit; a cause that is known stays one however little its cure brings."""
    return row.get("cause") not in {str(Cause.OK), str(Cause.NOISE)} and float(str(row["rank"])) > 0
