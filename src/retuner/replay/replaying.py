"""Deciding again: recorded frames and events through a fresh retuner, every decision compared byte for byte.

    bus log -> codec, joiner -> samples  \
                                          > fresh Retuner -> decisions == decisions of the ledger?
    ledger -> events in their places     /

Every row says how many samples had been seen when it was written, so an event enters between the same two samples as
it did then; and it says the time of the last one, so a log that lacks frames is found at the first row after them.
"""

import itertools
import json
from collections.abc import Mapping
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from retuner.adaptive.fit.engine import engine_name
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Decision
from retuner.decisions.proposed_schedule import ROW, refined, same_proposal
from retuner.drivers.bus.bus import LinkFault
from retuner.drivers.bus.bus_opening import log_parts
from retuner.drivers.recorded.frame_log import Overhearing, read_parts
from retuner.drivers.recorded.recording import RecordingError
from retuner.drivers.recorded.sample_note import Notes
from retuner.errors import UserError
from retuner.ledger import Row
from retuner.ledger.chain import canonical, without_place
from retuner.ledger.trend import COLUMNS, COLUMNS_2, NO_PYARROW
from retuner.report.scores import Columns
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.plain_values import plain_values
from retuner.session.assembly import make_retuner, retuner_settings, schedule_inputs
from retuner.session.ledger_rows import feed
from retuner.session.memory_file import started_with
from retuner.session.outputs import BUS_LOG, TREND, RecordedSession, file_sha256

MISSING = "nothing"  # stands for the side of a difference that has no such key or decision


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a replay first leaves its session.

    decision : its number. row : of the ledger; None when the ledger has no such decision. key : path inside the
    decision. recorded, replayed : both values.
    """

    decision: int
    row: int | None
    key: str
    recorded: object
    replayed: object

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return plain_values(self, "decision row key recorded replayed")


@dataclass(slots=True)
class ReplayedSession:
    """What a replay has come to.

    samples : taken from the log. decisions : made again. compared : of these with the ledger. difference : the first.
    stopped : why the rest could not be compared; empty when all was. engines : the one of then and the one here, where
    they are two; then verdicts are compared and not bytes. rounded : decisions of the same verdict, but not the same
    bytes.
    """

    samples: int = 0
    decisions: list[Decision] = field(default_factory=list)
    compared: int = 0
    difference: Difference | None = None
    stopped: str = ""
    engines: tuple[str, str] | None = None
    rounded: int = 0

    @property
    def agrees(self) -> bool:
        """Whether every decision of the ledger was made again, and no other: with the same bytes, or, by another
        engine, with the same verdict.
        """
        return self.difference is None and not self.stopped

    @property
    def identical(self) -> bool:
        """Whether every decision of the ledger was made again with the same bytes, and no other."""
        return self.agrees and not self.rounded


NOTHING_ELSE = "only a log with notes can be decided again; run it with this release"


class Replay:
    """A session decided again; see the head of this file. Made for one run()."""

    def __init__(self, session: RecordedSession) -> None:
        self._session = session
        settings = retuner_settings(session.config, session.mode)
        begun = started_with(session.folder, session.rows, session.config, settings)
        self._retuner = begun.retuner if begun is not None else make_retuner(session.config, session.mode)
        loop, bus = session.config.loop, session.config.bus
        gaps = [int(row.body["gap"]) for row in session.rows if row.kind == "restart"]
        after_s = begun.last_s if begun is not None else None
        self._heard: Overhearing | Notes = (
            Overhearing(bus.node, loop.sample_time_s, schedule_inputs(session.config), gaps=gaps, after_s=after_s)
            if session.config.foreign_device is None
            else Notes(loop.name)
        )
        not_of_samples = {"session", "end"} if session.name else {"session"}  # of several loops each has its "over"
        self._rows = [row for row in session.rows if row.kind not in not_of_samples]
        self._next = 0
        self._t_s = 0.0
        self._waiting: list[Decision] = []  # made again, and not yet met in the ledger
        here, then = engine_name(), session.versions.get("engine", "")
        self._result = ReplayedSession(engines=(then, here) if then and then != here else None)

    def run(self) -> ReplayedSession:
        """Take the whole log, or what there is of it. Raises UserError: there is no log."""
        result, known = self._result, self._session.bus_log_sha256
        log = self._session.bus_log
        if not log.is_file():
            raise UserError(f"{log}: no such file; a session is decided again from its bus log")
        parts = log_parts(log)
        if known not in {None, file_sha256(*parts.paths)}:
            result.stopped = f"{log}: is not the log of this session, or was changed after it"
            return result
        if parts.gone:
            result.stopped = (
                f"{log}: its beginning is gone, {parts.gone} full part{'s' * (parts.gone > 1)}, and only from there "
                f"can a session be decided again; [output] bus_log_mb = {self._session.config.output.bus_log_mb:g}"
            )
            return result
        try:
            self._rows_here()
            for message in read_parts(log):
                joined = self._heard.take(message)
                if joined is None:
                    continue
                # where the ledger ends the session ended; what came later was heard by nobody
                if self._next >= len(self._rows):
                    break
                result.samples += 1
                self._t_s = joined.sample.t_s
                self._decided(self._observe(joined.sample))
                self._rows_here()
                if not result.agrees:
                    break
        except RecordingError as error:
            result.stopped = str(error)
        if result.agrees and isinstance(self._heard, Notes) and not result.samples:
            result.stopped = f"{log}: no sample is noted in it, and of a controller that counts none {NOTHING_ELSE}"
        elif result.agrees and self._next < len(self._rows):
            row = self._rows[self._next]
            result.stopped = (
                f"{log}: ends after sample {result.samples}, and row {row.seq} of the ledger stands after sample "
                f"{row.body.get('samples')}{self._log_trouble()}"
            )
        return result

    def _observe(self, sample: LoopSample) -> Decision | None:
        """Take a sample as the session did: a question was answered at once, unless a row here says that it was not."""
        step = self._retuner.step(sample)
        samples, coming = self._result.samples, islice(self._rows, self._next, None)  # rows not taken yet
        waits = any(row.kind == "question" for row in takewhile(lambda row: row.body.get("samples") == samples, coming))
        if step.question is None or waits:
            return step.decision
        return self._retuner.enter(step.question, decide(step.question), self._retuner.sample_number)

    def _decided(self, decision: Decision | None) -> None:
        if decision is not None:
            self._waiting.append(decision)
            self._result.decisions.append(decision)

    def _rows_here(self) -> None:
        """The rows that were written after this sample and before the next one."""
        while self._next < len(self._rows) and self._rows[self._next].body.get("samples") == self._result.samples:
            row = self._rows[self._next]
            self._next += 1
            if row.clock_s != self._t_s:
                self._result.stopped = (
                    f"{self._session.bus_log}: lacks frames: row {row.seq} of the ledger stands after sample "
                    f"{self._result.samples} at {row.clock_s:g} s, which the log has at {self._t_s:g} s"
                    f"{self._log_trouble()}"
                )
                return
            try:
                if row.kind == "decision":
                    self._compare(row)
                elif row.kind == ROW:
                    found = refined(self._retuner)
                    if not same_proposal(row.body, found, rounded=self._result.engines is not None):
                        now = MISSING if found is None else found.sentence
                        self._result.difference = Difference(0, row.seq, ROW, row.body["reason"], now)
                elif row.kind == "link" and row.body["state"] != "up":
                    self._heard.contact_lost()
                else:
                    self._decided(feed(self._retuner, row.kind, row.body, row.clock_s))
            except (KeyError, TypeError, ValueError) as error:
                self._result.stopped = (
                    f"row {row.seq} of the ledger is not what a session of this release writes: {error}"
                )
            if not self._result.agrees:
                return
        if self._waiting:
            made = self._waiting[0]
            self._result.difference = Difference(made.number, None, "", MISSING, made.reason)

    def _compare(self, row: Row) -> None:
        """A decision of the ledger with the one that was made again in its place."""
        recorded = without_place(row.body)
        if not self._waiting:
            self._result.difference = Difference(recorded["number"], row.seq, "", recorded["reason"], MISSING)
            return
        made = self._waiting.pop(0)
        self._result.compared += 1
        if made.canonical() == canonical(recorded):
            return
        again = json.loads(made.canonical())
        if self._result.engines is not None:
            key, then, now = first_difference(verdict_of(recorded), verdict_of(again))
            if not key:
                self._result.rounded += 1
                return
        else:
            key, then, now = first_difference(recorded, again)
        self._result.difference = Difference(made.number, row.seq, key, then, now)

    def _log_trouble(self) -> str:
        rows = [r.seq for r in self._session.rows if r.kind == "bus" and r.body.get("fault") == LinkFault.LOG]
        return f"; row {rows[0]} tells that the log could not be written" if rows else ""


def verdict_of(decision: Mapping[str, Any]) -> dict[str, object]:
    """What a decision comes to: what is done where, for which cause, and with which gains, to three digits."""
    return {
        **{name: decision.get(name) for name in ("number", "t_s", "region", "action", "code", "basis")},
        "cause": (decision.get("diagnosis") or {}).get("cause"),
        "gains_after": {name: f"{value:.3g}" for name, value in (decision.get("gains_after") or {}).items()},
    }


def first_difference(then: object, now: object, path: str = "") -> tuple[str, object, object]:
    """Path, and both values, of the first place in which two JSON values differ; an empty path when they do not."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key in sorted({*then, *now}):
            inner = f"{path}.{key}" if path else key
            if key not in then or key not in now:
                return inner, then.get(key, MISSING), now.get(key, MISSING)
            if then[key] != now[key]:
                return first_difference(then[key], now[key], inner)
    if isinstance(then, list) and isinstance(now, list):
        for i in range(max(len(then), len(now))):
            inner = f"{path}[{i}]"
            if i >= len(then) or i >= len(now):
                return inner, then[i] if i < len(then) else MISSING, now[i] if i < len(now) else MISSING
            if then[i] != now[i]:
                return first_difference(then[i], now[i], inner)
    return path, then, now


# ---- The samples of a recorded session: its trend, or, while it goes on or after it was killed, what its bus log holds

FROM_LOG = ("t", "sp", "pv", "co", "region")  # columns that a bus log gives; the region is not in it and reads 0


def recorded_columns(session: RecordedSession) -> Columns:
    """The samples by column.

    Raises UserError: there is neither a trend nor a bus log with samples, or the trend is none of ours.
    """
    csv, path = (session.folder / TREND).with_suffix(".csv"), (session.folder / TREND).with_suffix(".parquet")
    if csv.is_file():
        return _csv(csv)
    if path.is_file():
        try:
            from pyarrow import ArrowException, parquet  # noqa: PLC0415  an extra, loaded when wanted
        except ImportError:
            raise UserError(f"{path}: {NO_PYARROW}") from None
        try:
            table = parquet.read_table(path)
        except (ArrowException, OSError) as error:
            raise UserError(f"{path}: is damaged: {error}") from None
        return _checked(path, {name: table[name].to_numpy().astype(np.float64) for name in table.column_names})
    try:
        # The samples of the bus log; without its beginning, in which the host got to know the device, as a
        # bystander
        config = session.config
        heard = Overhearing(config.bus.node, config.loop.sample_time_s, as_host=not log_parts(session.bus_log).gone)
        joined = (heard.take(message) for message in read_parts(session.bus_log))
        rows = [(s.sample.t_s, s.sample.sp, s.sample.pv, s.sample.co, 0.0) for s in joined if s is not None]
        if not rows:
            raise UserError(f"{session.bus_log}: holds no samples of the loop")
        table = np.array(list(itertools.chain.from_iterable(rows)), dtype=np.float64).reshape(-1, len(FROM_LOG))
        return {name: table[:, i] for i, name in enumerate(FROM_LOG)}
    except RecordingError as error:
        raise UserError(f"{session.folder}: has no trend, and its bus log cannot be used: {error}") from None


def _csv(path: Path) -> Columns:
    with path.open(encoding="utf-8") as file:
        head = file.readline().strip()
        names = next((known for known in (COLUMNS, COLUMNS_2) if head == ",".join(known)), None)
        if names is None:
            raise UserError(f"{path}: line 1: is not the head of a trend that a run has left")
        lines = file.readlines()
    for number, line in enumerate(lines, start=2):
        if line.count(",") != len(names) - 1:
            there = f"{line.count(',') + 1} of {len(names)} columns"
            raise UserError(
                f"{path}:{number}: is damaged, {there}; without this file the report is made from {BUS_LOG}"
            )
    try:
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError as error:
        raise UserError(f"{path}: is damaged: {error}") from None
    return _checked(path, {name: table[:, i] for i, name in enumerate(names)} if table.size else {})


def _checked(path: Path, columns: Columns) -> Columns:
    if not set(FROM_LOG) <= columns.keys():
        raise UserError(f"{path}: holds no samples of a run")
    for name in FROM_LOG:
        if not np.all(np.isfinite(columns[name])):
            raise UserError(f"{path}: column {name} holds a value that is not a finite number")
    return columns
