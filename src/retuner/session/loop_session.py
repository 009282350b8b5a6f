"""One loop under supervision: device events in, decisions and writes out, everything recorded before it takes effect.

The same object serves simulated and real time: it is driven by `poll(now_s)` and never waits. What the controller shall
run is gain_writer.py's business. What happens on the bus, or to the session, is told to the retuner as causes that may
end a trial (adaptive/trial/supervisor.py). At a loop's end an undecided change is decided upon first, for as long as
patience lasts and the link holds. Several loops, and what they share, are session.py's.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from enum import Enum

from retuner.adaptive.orders.operator_orders import acts
from retuner.adaptive.setpoint_bumps.bump_planner import BumpNews, BumpPhase
from retuner.adaptive.setpoint_bumps.loop_bumps import LoopBumps
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Action, Decision, gains_dict
from retuner.adaptive.supervision.findings import WRONG_WAY
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TrialEvent
from retuner.decisions.decider import LATE, LOST, DecideHere, Decider
from retuner.drivers.bus.bus import HOLDING, FaultNews
from retuner.drivers.device import (
    CommandDone,
    Device,
    Event,
    Reverted,
    RunningChanged,
    RunningSet,
    WriteDone,
    WriteFailed,
)
from retuner.drivers.state_machine import StateMachine
from retuner.ledger import Recorder
from retuner.ledger.trend import Trend
from retuner.schedule.table import GainTable
from retuner.session.gain_writer import GainWriter
from retuner.session.ledger_rows import HELD_BY, abort_cause, trouble
from retuner.session.scenario import ScenarioPlayer

DECISIONS_KEPT = 5000  # decisions that are kept for report and summary, the newest ones; the ledger has all of them
UNSEEN_SAMPLES = 30
"""Sample times without a sample after which nobody watches a trial any more, though the link may live."""
END_PATIENCE_SAMPLES = 200
"""Sample times that the end of a session waits for an open write and for the verified set to run again."""

GAINS_OPEN = "the controller has not reported that it runs the gains that should run"
SETPOINT_OPEN = "the setpoint is still bumped"
TURNED = "the active gains have the other sign than the configured ones: the loop may drive away"


class SessionPhase(Enum):
    """How a session stands."""

    WATCHING = "watching"
    ENDING = "ending: what is to be active after an undecided change is settled"
    FAILING = "ending after a defect: no sample is looked at any more"
    SETTLED = "over: nothing is open"
    LEFT_OPEN = "over: the verified gains are not known to be active"


class SessionInput(Enum):
    """What can happen to it."""

    PLAYED = "the scenario is over"
    STOPPED = "someone ends it"
    FROZEN = "rows cannot be recorded any more"
    FAILED = "a defect"
    CLOSED = "no write is open and no set is to be restored"
    IMPATIENT = "the waiting time is over"
    TURNED = "the controller acts in the other direction, so nothing can be restored"


P, S = SessionPhase, SessionInput
COURSE: dict[tuple[SessionPhase, SessionInput], SessionPhase] = {
    (P.WATCHING, S.PLAYED): P.ENDING,
    (P.WATCHING, S.STOPPED): P.ENDING,
    (P.WATCHING, S.FROZEN): P.ENDING,
    (P.WATCHING, S.FAILED): P.FAILING,
    (P.ENDING, S.FAILED): P.FAILING,
    **{(phase, S.CLOSED): P.SETTLED for phase in (P.ENDING, P.FAILING)},
    **{(phase, event): P.LEFT_OPEN for phase in (P.ENDING, P.FAILING) for event in (S.IMPATIENT, S.TURNED)},
}
"""Everything that is not here leaves the phase as it is: the first reason to end counts."""
TO_END, OVER = (P.ENDING, P.FAILING), (P.SETTLED, P.LEFT_OPEN)


class LoopSession:
    """See the head of this file.

    device : the controller. retuner : watches it. scenario : what to do to it. record : keeps rows for good.
    on_sample : told of every sample (progress). decider : where decisions are made; None for here, at once.
    """

    def __init__(
        self,
        device: Device,
        retuner: Retuner,
        scenario: ScenarioPlayer,
        record: Recorder,
        on_sample: Callable[["LoopSession", LoopSample], None] = lambda _loop, _sample: None,
        decider: Decider | None = None,
    ) -> None:
        self.device = device
        self.decider = decider or DecideHere()
        self.retuner = retuner
        self.scenario = scenario
        self.trend = Trend(two=retuner.table.regions.second is not None)
        self.decisions: deque[Decision] = deque(maxlen=DECISIONS_KEPT)
        self.writer = GainWriter(device, retuner, record)
        self.changes = self.writer.changes  # of the table: time and region
        self._to_ledger = record
        self._on_sample = on_sample
        self.frozen = ""
        self.bumps: LoopBumps | None = None  # bumps the setpoint, where that is allowed
        self.remember: Callable[[float], None] = lambda _t_s: None
        self.orders: Callable[[float], Iterable[Decision]] = lambda _t_s: ()  # decisions on what people ordered by now
        self.samples = 0  # seen so far: the place of a row in the order of events, for replay
        self._events: deque[Event] = deque()  # told by the device, and not dealt with yet
        self._acted: RunningSet | None = None  # the newest set whose direction is known
        self._sampled_s = math.inf  # when the newest sample came, by the clock of poll
        self._ends_at_s = math.inf  # when the waiting time is over, once the end has begun
        self.machine = StateMachine(COURSE, SessionPhase.WATCHING)
        self.ended_by = ""  # why it was ended, if somebody or something did
        self.left_open = ""  # what the session could not bring to its end, in a sentence

    @property
    def name(self) -> str:
        """Name of the loop."""
        return self.retuner.table.loop

    @property
    def table(self) -> GainTable:
        """The gain table as it stands."""
        return self.retuner.table

    @property
    def finished(self) -> bool:
        """Whether the end has begun, no write is open, and no set is to be restored, or the waiting time is over."""
        return self.machine.phase in OVER

    @property
    def seen(self) -> bool:
        """Whether a sample has come."""
        return self.samples > 0

    def freeze(self, reason: str) -> None:
        """Begin no write any more: what cannot be recorded must not be done, but the way back to the verified set.

        A write under way goes to its end.
        """
        self.frozen = self.frozen or reason
        self.writer.frozen = True
        self.machine.take(SessionInput.FROZEN)

    def stop(self, reason: str) -> None:
        """Come to an end: what is active after an undecided change is settled; `finished` tells when."""
        self.ended_by = self.ended_by or reason
        self.machine.take(SessionInput.STOPPED)

    def fail(self, reason: str) -> None:
        """Come to an end after a defect: no sample is looked at any more, and the verified set comes back."""
        self.ended_by = self.ended_by or reason
        self.machine.take(SessionInput.FAILED)

    @property
    def wrong_way(self) -> str:
        """What is wrong where the controller acts the wrong way; else empty."""
        if all(decision.code != WRONG_WAY for decision in self.decisions):
            return ""
        return f"loop {self.name}: the controller acts the wrong way; turn its action or the sign of its gain round"

    def poll(self, now_s: float) -> int:
        """Take what the device has to tell; returns the number of samples among it.

        Raises DeviceError: before the first connection: nobody answers, or the wrong controller does.
        """
        samples = 0
        self._events += self.device.poll(now_s)
        while self._events:
            event = self._events.popleft()
            if isinstance(event, LoopSample):
                samples += 1
                self._sampled_s = now_s
                self._sample(event, now_s)
            else:
                self._event(event, now_s)
        running = self.device.running
        if running is not None and running is not self._acted:
            self._watch_action(running)
        if now_s - self._sampled_s > UNSEEN_SAMPLES * self.retuner.settings.sample_time_s:
            self._abort(TrialEvent.LOST_TELEMETRY)
        if self.machine.phase is SessionPhase.WATCHING and self.scenario.finished:
            self.machine.take(SessionInput.PLAYED)
        if self.machine.phase is not SessionPhase.WATCHING:
            self.writer.frozen = True
            patience_s = END_PATIENCE_SAMPLES * self.retuner.settings.sample_time_s
            self._ends_at_s = min(self._ends_at_s, now_s + patience_s)
            home = self.bumps.planner.end(self.writer.t_s) if self.bumps is not None else None
            if home is not None:
                self._bump_told(home, now_s)
            self._abort(TrialEvent.STOPPED)  # what is decided while the end waits is no exception
        self.writer.begin_due_write(now_s)
        if self.machine.phase in TO_END:
            # The end is reached when nothing is open; or the waiting time is over, and what is left open is said.
            nothing_open, turned = not self.writer.open and not self._bumped, self.retuner.action_reversed
            if nothing_open and not turned and not self.writer.restoring:
                self.machine.take(SessionInput.CLOSED)
            elif now_s >= self._ends_at_s or (nothing_open and turned):
                self.machine.take(SessionInput.TURNED if turned else SessionInput.IMPATIENT)
                self.tell_what_is_open()
        return samples

    def link_faults(self, news: Iterable[FaultNews]) -> None:
        """Record what the link has to tell, and hold the adaptation where frames may be missing or stale."""
        for fault, times in news:
            self._to_ledger("bus", self.writer.t_s, {"fault": fault, "times": times})
            if fault in HOLDING:
                self.writer.hold(fault)

    def _sample(self, sample: LoopSample, now_s: float) -> None:
        self.writer.t_s = sample.t_s
        self.samples += 1
        if self.machine.phase is SessionPhase.FAILING:
            self._bump(sample, now_s)
            return
        for step in self.scenario.due(sample.t_s):
            if step.sp is not None:
                self.device.send_setpoint(step.sp, now_s)
            if step.load is not None:
                self.device.send_load(step.load, now_s)
        # a question that the sample raises is answered by decide.py, here and now or in another process, and the answer
        # entered as a decision; with what ended a trial at this sample, if anything did: see Retuner.enter
        taken = self.retuner.step(sample)
        decision, raised = taken.decision, taken.question
        if raised is not None:
            self.decider.ask(raised)
            answer = self.decider.answer(self.retuner.sample_number)
            if answer is not None:
                decision = self.retuner.enter(raised, answer.result, self.retuner.sample_number)
            else:
                name = self.table.regions.names[raised.record.region]
                self._to_ledger("question", raised.t_s, {"asked": raised.sample_number, "region": name})
        region, running = self.retuner.region, self.device.running
        if region is not None and running is not None:
            self.trend.add(sample, region, running.gains)
        self._on_sample(self, sample)
        if decision is not None:
            self._decided(decision)
        if self.retuner.open_question is not None:
            question, answer = self.retuner.open_question, self.decider.answer(self.retuner.sample_number)
            if answer is not None:
                # Recorded before it is entered: a replay enters it at the same sample
                body = {"asked": question.sample_number, "code": answer.result.code, "reason": answer.trouble}
                self._to_ledger("answer", self.writer.t_s, body)
                if answer.result.code in {LATE, LOST}:
                    self._to_ledger("worker", self.writer.t_s, {"reason": answer.trouble})
                self._decided(self.retuner.enter(question, answer.result, self.retuner.sample_number))
        if self.writer.free:
            for ordered in self.orders(sample.t_s):
                self._decided(ordered)
        self._bump(sample, now_s)

    def _bump(self, sample: LoopSample, now_s: float) -> None:
        """Whether the setpoint is to be bumped, or goes back; what has not arrived is sent once more."""
        if self.bumps is None:
            return
        if self.retuner.action_reversed:  # as in manual: a bump goes back, none begins
            sample = sample._replace(mode=LoopMode.MANUAL)
        news = self.bumps.step(sample, free=self.writer.free and self.machine.phase is SessionPhase.WATCHING)
        again = self.bumps.planner.again(sample.t_s)
        if news is not None:
            self._bump_told(news, now_s)
        elif again is not None:
            self.device.send_setpoint(again, now_s)

    def _bump_told(self, news: BumpNews, now_s: float) -> None:
        """Record what becomes of a bump, and send its setpoint; what cannot be recorded is not begun."""
        self._to_ledger("bump", self.writer.t_s, news.to_dict())
        if news.setpoint is not None and not (self.frozen and news.phase is BumpPhase.GOING):
            self.device.send_setpoint(news.setpoint, now_s)

    @property
    def _bumped(self) -> bool:
        return self.bumps is not None and self.bumps.planner.out

    def _decided(self, decision: Decision) -> None:
        self.decisions.append(decision)
        if self.bumps is not None:
            self.bumps.decided(decision)
        self.remember(self.writer.t_s)  # before the row: what the ledger says was decided is never forgotten
        self._to_ledger("decision", decision.t_s, decision.to_dict())
        judged = decision.judgement
        if judged is not None:
            self._to_ledger(
                "judged", decision.t_s, {"region": decision.region, **judged.to_dict(), "trial": decision.trial}
            )
        if decision.action in {Action.WRITE, Action.RESTORE}:
            self.writer.queue(decision)

    def _event(self, event: Event, now_s: float) -> None:
        match event:
            case WriteDone():
                self.writer.done(event)
            case WriteFailed():
                cause = self.writer.failed(event, now_s)
                if cause is TrialEvent.OPERATOR_EDIT:
                    self._event(RunningChanged(event.running), now_s)
                else:
                    self._abort(cause)
            case CommandDone():
                pass
            case _:
                if isinstance(event, Reverted):  # it was not confirmed in time: no hurry to write it again
                    self.writer.wait()
                if isinstance(event, RunningChanged):
                    self._watch_action(event.running)
                kind, body = trouble(event)
                self._to_ledger(kind, self.writer.t_s, body)
                if isinstance(event, HELD_BY):
                    self.writer.hold(kind)
                if isinstance(event, RunningChanged):
                    # Somebody else has changed the running set: it is theirs, and stays
                    decision = None if self.retuner.action_reversed else self.retuner.edited(event.running.gains)
                    if decision is not None:
                        self._decided(decision)
                self._abort(abort_cause(event))

    def _watch_action(self, running: RunningSet) -> None:
        """Whether what runs acts in the commissioned direction: a turned one puts the loop on hold, and is told once.

        Whatever turned it: an edit, a switch of the action, a restart, or gains that were there before the session.
        """
        decision = acts(self.retuner, running.gains)
        self._acted = running if self.retuner.region is not None else None
        if decision is None:
            return
        body = {"turned": self.retuner.action_reversed, "gains": gains_dict(running.gains), "reason": decision.reason}
        self._to_ledger("action", self.writer.t_s, body)
        self._decided(decision)

    def _abort(self, cause: TrialEvent | None) -> None:
        """Put a cause to the undecided trials that do not know it: recorded, then what is to run is decided."""
        if cause is None or not self.retuner.trials.concerned(cause):
            return
        self._to_ledger("abort", self.writer.t_s, {"cause": cause.name.lower(), "reason": str(cause)})
        decision = self.retuner.abort(cause)
        if decision is not None:
            self._decided(decision)

    def tell_what_is_open(self) -> None:
        """Record that the session ends without knowing that the verified set runs, if it is so."""
        trials = self.retuner.trials
        gains_open = self.writer.open or bool(trials.left_open)
        if not self.left_open and (gains_open or self._bumped or self.retuner.action_reversed):
            self.left_open = TURNED if self.retuner.action_reversed else GAINS_OPEN if gains_open else SETPOINT_OPEN
            running = self.device.running
            names = self.table.regions.names
            body = {
                "regions": [names[region] for region in trials.left_open],
                "write_open": self.writer.open,
                "setpoint_bumped": self._bumped,
                "running": gains_dict(running.gains) if running else None,
                "reason": self.left_open,
            }
            self._to_ledger("unrestored", self.writer.t_s, body)

    def tell_absent(self, reason: str) -> None:
        """Record that the session goes on without this loop: its controller was never there."""
        self._to_ledger("absent", self.writer.t_s, {"reason": reason})

    def tell_over(self) -> None:
        """Record that no sample of this loop is looked at any more: in a session of several, where each has its end."""
        self._to_ledger("over", self.writer.t_s, {"course": self.machine.phase.name.lower()})
