"""One loop under supervision: device events in, decisions and writes out, everything recorded before it takes effect.

The same object serves simulated and real time: it is driven by `poll(now_s)` and never waits. Two things may ask for a
write: a decision of the retuner, and the schedule (another region, other gains). Both go through the device's two-phase
write, one at a time; a decision changes the table only when the controller has reported the gains as running.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Protocol

from retuner.adaptive.decision import Action, Decision, gains_dict
from retuner.adaptive.guard import change_factor
from retuner.adaptive.retuner import Retuner
from retuner.adaptive.sample import LoopSample
from retuner.drivers.device import (
    CommandDone,
    CommandFailed,
    Device,
    DeviceConflict,
    DeviceRestarted,
    Event,
    ForeignHost,
    LeaseChanged,
    LinkChanged,
    Reverted,
    RunningChanged,
    RunningSet,
    SamplesLost,
    VariableChanged,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
    WriteUnknown,
)
from retuner.drivers.link_faults import HOLDING, FaultNews
from retuner.scenario import ScenarioPlayer
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable, Lookup
from retuner.trend import Trend

SAME_GAINS = 1.00001
"""Gains closer than this factor are one set: float32 on the wire rounds by 1.0000001."""
INTERPOLATION_STEP = 1.02
"""An interpolated schedule is written when a gain has moved by this factor: a write costs about ten frames."""
RETRY_SAMPLES = 30
"""Samples to wait after a refused or failed write before the schedule asks again."""
HOLD_SAMPLES = 30
"""Samples without trouble on the link before a decision is written again; what was decided meanwhile is dropped."""


DECISIONS_KEPT = 5000
"""Decisions that are kept for report and summary, the newest ones; the ledger has all of them."""
HELD_BY = (LinkChanged, DeviceRestarted, RunningChanged, Reverted, DeviceConflict, VariableChanged)


class Why(StrEnum):
    """What asked for a write."""

    RETUNE = "retune"
    SCHEDULE = "schedule"


class Recorder(Protocol):
    """Keeps rows for good before it returns: the ledger, seen from here."""

    def __call__(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record one row."""
        ...


def trouble(event: Event) -> tuple[str, dict[str, object]]:
    """The row that tells of an event which is neither a sample nor the end of a write or command."""
    match event:
        case WriteUnknown():
            return "unknown", {"sequence": event.seq, "reason": event.reason}
        case LinkChanged():
            return "link", {"state": event.state.name.lower(), "reason": event.reason}
        case DeviceRestarted():
            return "restart", {"epoch": event.epoch, "gains": gains_dict(event.running.gains)}
        case RunningChanged() | Reverted():
            kind = "reverted" if isinstance(event, Reverted) else "foreign"
            return kind, {"gains": gains_dict(event.running.gains)}
        case LeaseChanged() | VariableChanged():
            return "lease" if isinstance(event, LeaseChanged) else "variable", asdict(event)
        case ForeignHost():
            return "foreign_host", {"commands": event.count}
        case DeviceConflict():
            return "conflict", {"node": event.node}
        case SamplesLost():
            return "lost", {"samples": event.count}
        case CommandFailed():
            return "command", {"command": event.command, "reason": event.reason}
        case _:
            raise TypeError(f"{type(event).__name__} is not an event that a session records")


@dataclass(frozen=True, slots=True)
class Write:
    """A write under way."""

    why: Why
    region: int
    gains: PidGains
    seq: int
    decision: Decision | None = None


class Session:
    """See the head of this file.

    Parameters
    ----------
    device : the controller. retuner : watches it. scenario : what to do to it. record : keeps rows for good.
    on_sample : told of every sample (progress).
    """

    def __init__(
        self,
        device: Device,
        retuner: Retuner,
        scenario: ScenarioPlayer,
        record: Recorder,
        on_sample: Callable[[LoopSample], None] | None = None,
    ) -> None:
        self.device = device
        self.retuner = retuner
        self.scenario = scenario
        self.trend = Trend()
        self.decisions: deque[Decision] = deque(maxlen=DECISIONS_KEPT)
        self.commits: list[tuple[float, int]] = []
        self._record = record
        self._on_sample = on_sample
        self._write: Write | None = None
        self._pending: tuple[int, PidGains, Decision] | None = None
        self.frozen = ""
        self.samples = 0  # seen so far: the place of a row in the order of events, for replay
        self._t_s = 0.0
        self._retry_at_s = self._hold_until_s = 0.0
        self._holding = ""

    @property
    def table(self) -> GainTable:
        """The gain table as it stands."""
        return self.retuner.table

    @property
    def finished(self) -> bool:
        """Whether the scenario is over, or the session was frozen, and no write is left open."""
        return (self.scenario.finished or bool(self.frozen)) and self._write is None

    def freeze(self, reason: str) -> None:
        """Begin no write any more: what cannot be recorded must not be done. A write under way goes to its end."""
        self.frozen = self.frozen or reason

    def poll(self, now_s: float) -> int:
        """Take what the device has to tell; returns the number of samples among it.

        Raises
        ------
        DeviceError
            Before the first connection: nobody answers, or the wrong controller does.
        """
        samples = 0
        for event in self.device.poll(now_s):
            if isinstance(event, LoopSample):
                samples += 1
                self._sample(event, now_s)
            else:
                self._event(event)
        self._keep_gains(now_s)
        return samples

    def link_faults(self, news: Iterable[FaultNews]) -> None:
        """Record what the link has to tell, and hold the adaptation where frames may be missing or stale."""
        for fault, times in news:
            self._record("bus", self._t_s, {"fault": fault, "times": times})
            if fault in HOLDING:
                self._hold(fault)

    def _hold(self, reason: str) -> None:
        """Write no decision for a while."""
        self._holding = reason
        self._hold_until_s = self._t_s + HOLD_SAMPLES * self.retuner.settings.sample_time_s

    def _sample(self, sample: LoopSample, now_s: float) -> None:
        """One sample of the loop: play the scenario, watch, decide."""
        self._t_s = sample.t_s
        self.samples += 1
        for step in self.scenario.due(sample.t_s):
            if step.sp is not None:
                self.device.send_setpoint(step.sp, now_s)
            if step.load is not None:
                self.device.send_load(step.load, now_s)
        decision = self.retuner.observe(sample)
        if self.retuner.region is not None and self.device.running is not None:
            self.trend.add(sample, self.retuner.region, self.device.running.gains)
        if self._on_sample is not None:
            self._on_sample(sample)
        if decision is not None:
            self._decided(decision)

    def _decided(self, decision: Decision) -> None:
        """Record a decision; what it wants written waits for the wire."""
        self.decisions.append(decision)
        self._record("decision", decision.t_s, decision.to_dict())
        if decision.action == Action.COMMIT and decision.gains_after is not None:
            self._pending = (self.table.regions.names.index(decision.region), decision.gains_after, decision)

    def _keep_gains(self, now_s: float) -> None:
        """Have the controller run what the table, or a decision, says."""
        running = self.device.running
        if self.frozen or self._write or self.device.writing or not self.device.connected or running is None:
            return
        wanted = self._wanted(running.gains)
        if wanted is None:
            return
        self._start(running, *wanted, now_s)

    def _start(
        self, running: RunningSet, why: Why, region: int, gains: PidGains, decision: Decision | None, now_s: float
    ) -> None:
        """Record what is meant, then begin to write it; what could not be recorded is not written."""
        body = {"why": why, "region": self._name(region), "gains": gains_dict(gains), "base": running.seq,
                "before": gains_dict(running.gains), "decision": decision.digest() if decision else None}  # fmt: skip
        self._record("intent", self._t_s, body)
        if self.frozen:
            return
        try:
            seq = self.device.begin_write(gains, now_s)
        except WriteRefusedError as error:
            self._give_up(region, str(error))
            return
        self._write = Write(why, region, gains, seq, decision)

    def _wanted(self, running: PidGains) -> tuple[Why, int, PidGains, Decision | None] | None:
        """What should be written now, if anything: a decision for the region in force first, then the schedule."""
        region = self.retuner.region
        if region is None:
            return None
        if self._pending is not None:
            meant, gains, decision = self._pending
            self._pending = None
            held = self._t_s < self._hold_until_s
            if meant == region and not held:
                return Why.RETUNE, region, gains, decision
            reason = f"too soon after: {self._holding}" if held else "the loop has left the region"
            self._record("dropped", self._t_s, {"decision": decision.digest(), "reason": reason})
        if self._t_s < self._retry_at_s:
            return None
        gains = self.table.at(region, *self.retuner.scheduled)
        step = INTERPOLATION_STEP if self.table.lookup == Lookup.INTERPOLATED else SAME_GAINS
        return (Why.SCHEDULE, region, gains, None) if change_factor(running, gains) > step else None

    def _event(self, event: Event) -> None:
        """Everything that is not a sample."""
        match event:
            case WriteDone():
                self._done(event)
            case WriteFailed():
                if self._write:
                    self._give_up(self._write.region, event.reason, event.running.gains)
            case CommandDone():
                pass
            case _:
                if isinstance(event, Reverted):  # it was not confirmed in time: no hurry to write it again
                    self._retry_at_s = self._t_s + RETRY_SAMPLES * self.retuner.settings.sample_time_s
                kind, body = trouble(event)
                self._record(kind, self._t_s, body)
                if isinstance(event, HELD_BY):
                    self._hold(kind)

    def _done(self, event: WriteDone) -> None:
        """The controller runs the set, as read back; only now does the table change."""
        write, self._write = self._write, None
        if write is None:
            return
        body = {"why": write.why, "region": self._name(write.region), "sequence": event.seq,
                "gains": gains_dict(event.gains), "crc": event.running.crc}  # fmt: skip
        self._record("committed", self._t_s, body)
        if write.why == Why.RETUNE:
            self.retuner.committed(write.region, event.gains)
            self.commits.append((self._t_s, write.region))

    def _give_up(self, region: int, reason: str, running: PidGains | None = None) -> None:
        """A write that did not come about: the old set runs; the schedule waits before it asks again."""
        why = self._write.why if self._write else Why.SCHEDULE
        self._write = None
        self._retry_at_s = self._t_s + RETRY_SAMPLES * self.retuner.settings.sample_time_s
        body = {"why": why, "region": self._name(region), "reason": reason,
                "running": gains_dict(running) if running else None}  # fmt: skip
        self._record("refused", self._t_s, body)

    def _name(self, region: int) -> str:
        """Name of a region."""
        return self.table.regions.names[region]
