"""Writes the gains that the controller is to run, one two-phase write at a time, each recorded before it begins:

    1  the set to run, while a change is being rolled back: before everything else, until it has been read back
    2  a decision of the retuner, when the loop is still in its region and the link has been sound for a while
    3  the schedule: another region, other gains

A decision on a region where the loop is not changes the table alone: the schedule writes its set when the loop comes.
While a change is being rolled back the table has the set to run already, so nothing writes another one. A write goes to
the device's `begin_write` (on CAN drivers/host/can_device.py), whose WriteDone or WriteFailed come back here.
"""

from enum import Enum, StrEnum

from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor
from retuner.adaptive.supervision.decision import Action, Decision, gains_dict
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.drivers.device import Device, RunningSet, WriteDone, WriteFailed, WriteRefusedError
from retuner.drivers.state_machine import StateMachine
from retuner.ledger import Recorder
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.table import GainTable, Lookup

INTERPOLATION_STEP = 1.02
"""An interpolated schedule is written when a gain has moved by this factor: a write costs about ten frames."""
RETRY_SAMPLES = 30  # samples to wait after a refused or failed write before the schedule asks again
RESTORE_RETRY_SAMPLES = 5
"""Sample times before a refused restore is tried again; doubled each time, RESTORE_DOUBLINGS times at most."""
RESTORE_DOUBLINGS = 5
HOLD_SAMPLES = 30
"""Samples without trouble on the link before a decision is written again; what was decided meanwhile is dropped."""


BACK = "the gains before are being restored"
LATER = "the loop is in another region; the schedule writes them when it comes"


class Why(StrEnum):
    """What asked for a write."""

    RESTORE = "restore"
    RETUNE = "retune"
    SCHEDULE = "schedule"


class WriterPhase(Enum):
    """What is being written, and whether a decision waits for the wire."""

    IDLE = "nothing to write"
    ASKED = "a decision waits for the wire"
    FOLLOWING = "the schedule's set is being written"
    FOLLOWING_ASKED = "the schedule's set is being written, and a decision waits"
    CHANGING = "a decision's set is being written"
    RESTORING = "the verified gains are being written"


class WriterInput(Enum):
    """What can happen to it."""

    ASK = "a decision wants its gains written"
    DROP = "the decision that waited is not written"
    FOLLOW = "begin to write the schedule's set"
    CHANGE = "begin to write the decision's set"
    RESTORE = "begin to write the verified gains"
    DONE = "the controller runs the set, as read back"
    FAILED = "the write did not happen"


BEGIN = {Why.RESTORE: WriterInput.RESTORE, Why.RETUNE: WriterInput.CHANGE, Why.SCHEDULE: WriterInput.FOLLOW}
"""What beginning a write is to the writer."""
P, W = WriterPhase, WriterInput
WRITING: dict[tuple[WriterPhase, WriterInput], WriterPhase] = {
    (P.IDLE, W.ASK): P.ASKED,
    (P.IDLE, W.FOLLOW): P.FOLLOWING,
    (P.IDLE, W.RESTORE): P.RESTORING,
    (P.ASKED, W.DROP): P.IDLE,
    (P.ASKED, W.CHANGE): P.CHANGING,
    (P.FOLLOWING, W.ASK): P.FOLLOWING_ASKED,
    **{(phase, end): P.IDLE for phase in (P.FOLLOWING, P.CHANGING, P.RESTORING) for end in (W.DONE, W.FAILED)},
    **{(P.FOLLOWING_ASKED, end): P.ASKED for end in (W.DONE, W.FAILED)},
}
"""A decision that asks while another one waits or is written has no row here: it is dropped, and told."""

OPEN = (P.FOLLOWING, P.FOLLOWING_ASKED, P.CHANGING, P.RESTORING)


@dataclass(frozen=True, slots=True)
class WantedSet:
    """A set that should run. stored : what the region's place in the table holds then, for a decision.

    later : it was decided on while the loop was in another region, so that it runs when the loop comes.
    """

    why: Why
    region: int
    gains: PidGains
    decision: Decision | None = None
    stored: PidGains | None = None
    later: bool = False


class GainWriter:
    """See the head of this file.

    device : the controller. retuner : whose table and decisions count. record : keeps rows for good.
    """

    def __init__(self, device: Device, retuner: Retuner, record: Recorder) -> None:
        self.device, self.retuner = device, retuner
        self.changes: list[tuple[float, int]] = []
        self.frozen = False  # begin nothing any more but the way back
        self.t_s = 0.0
        self.machine = StateMachine(WRITING, WriterPhase.IDLE)
        self._to_ledger = record
        self._under_way: WantedSet | None = None
        self._pending: WantedSet | None = None
        self._retry_at_s = self._hold_until_s = 0.0
        self._restore_at_s = float("-inf")
        self._refusals = 0  # of the verified set, in a row
        self._in_order: tuple[int, PidGains, GainTable] | None = None  # what runs where the schedule asked for no other
        self._newest: Why | None = None  # of the writes that came about
        self._holding = ""

    @property
    def open(self) -> bool:
        """Whether a write has not come to its end."""
        return self.machine.phase in OPEN

    @property
    def free(self) -> bool:
        """Whether what is asked for now would be begun at once: nothing under way, waiting, held or being restored."""
        held = self.t_s < self._hold_until_s or self.frozen or self.retuner.action_reversed
        return not held and self.device.connected and self.machine.phase is WriterPhase.IDLE and not self.restoring

    @property
    def restoring(self) -> bool:
        """Whether a verified set is not known to run again."""
        return self.retuner.trials.busy and bool(self.retuner.trials.restoring)

    def queue(self, decision: Decision) -> None:
        """A decision wants its gains to run. A change waits until `begin_due_write` has it written, unless another one
        is ahead of it. A way back does not wait: the table has its set already, and that is written first of all.

        Gains that a person orders without a prediction run without a trial, which would keep the set before them.
        """
        if decision.gains_after is None:
            return
        if decision.action is Action.RESTORE:
            cause = decision.code.removeprefix("undo_")
            if cause != decision.code:
                body = {
                    "region": decision.region,
                    "cause": cause,
                    "reason": decision.reason,
                    "gains": gains_dict(decision.gains_after),
                    "decision": decision.digest(),
                }
                self._to_ledger("restore", decision.t_s, body)
            return
        region = self.retuner.table.regions.names.index(decision.region)
        later = region != self.retuner.region and self.retuner.table.lookup is Lookup.HARD
        wanted = WantedSet(Why.RETUNE, region, decision.gains_after, decision, decision.gains_after, later)
        if self.machine.take(WriterInput.ASK):
            self._pending = wanted
        elif self.machine.phase is WriterPhase.RESTORING:
            self._dropped(wanted, BACK)
        else:
            self._dropped(wanted, "another change is in progress")

    def hold(self, reason: str) -> None:
        """Write no decision for a while."""
        self._holding = reason
        self._hold_until_s = self.t_s + self._span_s(HOLD_SAMPLES)

    def wait(self) -> None:
        """Let the schedule wait before it asks again."""
        self._retry_at_s = self.t_s + self._span_s(RETRY_SAMPLES)

    def begin_due_write(self, now_s: float) -> None:
        """Write the gains that the controller is to run and does not, if any; called once a poll."""
        running = self.device.running
        if self.open or self.device.writing or not self.device.connected or running is None:
            return
        if self.retuner.action_reversed:  # no restore either: a person has to look
            self._drop("the controller acts in the other direction")
            return
        # A write under way when the last session died: what runs tells whether it took effect
        trials = self.retuner.trials
        for at in trials.undecided + trials.restoring if trials.busy else ():
            trial = trials.of(at)
            if trial.ran or trial.new is None or self.machine.phase is not WriterPhase.IDLE:
                continue
            meant = WantedSet(Why.RETUNE, at, trial.new, None, trial.new)
            if at == self.retuner.region and change_factor(self._here(meant).gains, running.gains) <= SAME_GAINS:
                self._came_about(meant, running.seq, running)
            elif trial.phase is TrialPhase.WRITING:
                reason = "the session ended in the middle of it, and it does not run"
                self._note("dropped", meant, decision=None, reason=reason)
                self.retuner.not_written(at)
        wanted = self._to_restore(running, now_s) if self.restoring else self._wanted(running.gains)
        if wanted is None or (self.frozen and wanted.why != Why.RESTORE):
            return
        # What is meant is recorded, then begun; what could not be recorded is not written, but the way back: leaving
        # gains in force that nothing vouches for would be worse than a missing row
        new, before = gains_dict(wanted.gains), gains_dict(running.gains)
        digest = wanted.decision.digest() if wanted.decision else None
        self._note("intent", wanted, gains=new, base=running.seq, before=before, decision=digest)
        if self.frozen and wanted.why != Why.RESTORE:
            return
        try:
            self.device.begin_write(wanted.gains, now_s, back=wanted.why == Why.RESTORE)
        except WriteRefusedError as error:
            if wanted.why == Why.RETUNE:
                self._pending = None
                self.machine.take(WriterInput.DROP)
            self._give_up(wanted, str(error), now_s)
            return
        self.machine.take(BEGIN[wanted.why])
        self._under_way = wanted
        if wanted.why == Why.RETUNE:
            self._pending = None

    def done(self, event: WriteDone) -> None:
        """The controller runs the set, as read back; only now does the table change."""
        write, self._under_way = self._under_way, None
        if not self.machine.take(WriterInput.DONE) or write is None:
            return
        self._came_about(write, event.seq, event.running)

    def _came_about(self, write: WantedSet, seq: int, running: RunningSet) -> None:
        """A set runs, as read back: recorded, then the table has it."""
        mixed = self.retuner.table.lookup == Lookup.INTERPOLATED
        stored = write.stored if mixed and write.stored is not None else running.gains
        more = {"stored": gains_dict(stored)} if write.why == Why.RETUNE and mixed else {}
        self._note("committed", write, sequence=seq, gains=gains_dict(running.gains), crc=running.crc, **more)
        self._newest = write.why
        if write.why == Why.RETUNE:
            self._in_table_now(write, stored)

    def _in_table_now(self, write: WantedSet, stored: PidGains) -> None:
        before = self.retuner.table
        if self.retuner.committed(write.region, stored) is before:  # given up meanwhile; it is being rolled back
            return
        self.changes.append((self.t_s, write.region))
        # Record that a change is on trial from now on, if it is
        trial = self.retuner.trials.of(write.region)
        if trial.phase in {TrialPhase.TRIAL, TrialPhase.AWAY, TrialPhase.ENSURING} and trial.old is not None:
            row = {
                "region": self._name(write.region),
                "gains": gains_dict(stored),
                "verified": gains_dict(trial.old),
                "promise": trial.prediction.to_dict() if trial.prediction else None,
                "decision": write.decision.digest() if write.decision else None,
            }
            if trial.phase == TrialPhase.ENSURING:  # it was given up, came through after all, and is the better one
                row["reason"] = f"it was written after all, and stays{f': {trial.back.reason}' if trial.back else ''}"
            self._to_ledger("trial", self.t_s, row)

    def failed(self, event: WriteFailed, now_s: float) -> TrialEvent | None:
        """A write did not come about; the cause when that ends a trial, because something unexpected runs.

        That may be the tried set, in a region that the loop has come to and the schedule could not write for.
        """
        write, self._under_way = self._under_way, None
        if not self.machine.take(WriterInput.FAILED) or write is None:
            return None
        wanted = self._in_table()
        known = wanted is not None and change_factor(event.running.gains, wanted) <= self._tolerance
        self._give_up(write, event.reason, now_s, event.running.gains, written=not known)
        if known:
            return None
        # What runs is a person's where it is neither in the table nor on trial, nor altered by the controller that took
        # it; a mean of sets may be either
        altered = write.why == Why.RETUNE and event.running.seq == event.seq
        table, trials = self.retuner.table, self.retuner.trials
        tried = (gains for i in range(len(table.gains)) for gains in (trials.of(i).old, trials.of(i).new))
        ours = (gains for gains in (*table.gains, *tried) if gains is not None)
        strange = all(change_factor(event.running.gains, gains) > SAME_GAINS for gains in ours)
        if strange and not altered and table.lookup != Lookup.INTERPOLATED:
            return TrialEvent.OPERATOR_EDIT
        return TrialEvent.WRITE_UNKNOWN if write.why != Why.RESTORE else None

    def _to_restore(self, running: RunningSet, now_s: float) -> WantedSet | None:
        """The verified set, unless it runs: then this is the proof of it.

        It has run before, so it needs no probation; but the controller must hold it for confirmed, for else it may go
        back to the tried set, which was confirmed when the trial began.
        """
        self._drop(BACK)
        region, gains = self.retuner.region, self._in_table()
        if region is None or gains is None:
            return None
        # a tried set may lie within the schedule's step
        if change_factor(running.gains, gains) <= (self._tolerance if self._newest == Why.RESTORE else SAME_GAINS):
            if self.device.confirm(now_s):
                self._restored(running)
            return None
        return WantedSet(Why.RESTORE, region, gains) if now_s >= self._restore_at_s else None

    def _restored(self, running: RunningSet) -> None:
        trials = self.retuner.trials
        regions = trials.restoring
        body = {
            "regions": [self._name(region) for region in regions],
            "gains": gains_dict(running.gains),
            "sequence": running.seq,
            "crc": running.crc,
        }
        table, here = self.retuner.table, self.retuner.region
        waits = [region for region in regions if table.lookup is Lookup.HARD and region != here]
        if waits:  # what runs is the set of the region that the loop is in
            body["waits"] = {self._name(region): gains_dict(table.gains_of(region)) for region in waits}
        self._to_ledger("restored", self.t_s, body)
        self._refusals = 0
        self._restore_at_s = float("-inf")
        self.retuner.restored()
        for region in regions:
            if trials.phase(region) == TrialPhase.LOCKED:
                self._to_ledger(
                    "lockout", self.t_s, {"region": self._name(region), "undos": trials.of(region).rollbacks}
                )

    def _wanted(self, running: PidGains) -> WantedSet | None:
        """What should be written now, if anything: a decision for the region in force first, then the schedule."""
        region = self.retuner.region
        if region is None:
            return None
        if self._pending is not None:
            held = self.t_s < self._hold_until_s
            # A change that was to be on trial and no longer is would be watched by nobody
            predicted = self._pending.decision is not None and self._pending.decision.prediction is not None
            if predicted and self.retuner.trials.phase(self._pending.region) != TrialPhase.WRITING:
                self._drop("it was dropped before it could be written")
            elif self._pending.region == region and not held and not self.frozen:
                return self._here(self._pending)
            elif self._pending.later and not held and not self.frozen:
                # a set of a region where the loop is not: the table has it from now on
                write, self._pending = self._pending, None
                self.machine.take(WriterInput.DROP)
                gains = self.retuner.settings.rounded(write.gains)
                self._note("committed", write, gains=gains_dict(gains), reason=LATER)
                self._in_table_now(write, gains)
            else:
                self._drop(f"too soon after: {self._holding}" if held else "the loop has left the region")
        here = (region, running, self.retuner.table)
        if self.t_s < self._retry_at_s or here == self._in_order:
            return None
        scheduled = self._in_table()
        if scheduled is not None and change_factor(running, scheduled) > self._tolerance:
            return WantedSet(Why.SCHEDULE, region, scheduled)
        if self.retuner.table.lookup is Lookup.HARD:  # else the mean moves with the scheduling values
            self._in_order = here
        return None

    def _here(self, wanted: WantedSet) -> WantedSet:
        """What a decision means here and now: in an interpolated table the region's new set is a part of a mean."""
        table = self.retuner.table
        if table.lookup != Lookup.INTERPOLATED:
            return wanted
        new = table.with_gains(wanted.region, wanted.gains)
        return replace(wanted, gains=self.retuner.settings.rounded(new.at(wanted.region, *self.retuner.scheduled)))

    def _drop(self, reason: str) -> None:
        pending, self._pending = self._pending, None
        if pending is not None and self.machine.take(WriterInput.DROP):
            self._dropped(pending, reason)

    def _dropped(self, wanted: WantedSet, reason: str) -> None:
        if wanted.decision is not None:
            self._note("dropped", wanted, decision=wanted.decision.digest(), reason=reason)
            self.retuner.not_written(wanted.region)

    def _give_up(
        self, wanted: WantedSet, reason: str, now_s: float, running: PidGains | None = None, *, written: bool = False
    ) -> None:
        """A write that did not come about. written : something else than before runs."""
        self.wait()
        if wanted.why == Why.RESTORE:
            self._restore_at_s = now_s + self._span_s(RESTORE_RETRY_SAMPLES << min(self._refusals, RESTORE_DOUBLINGS))
            self._refusals += 1
        runs = gains_dict(running) if running else None
        self._note("refused", wanted, reason=reason, running=runs, unchanged=not written)
        if wanted.why == Why.RETUNE and not written:
            self.retuner.not_written(wanted.region)

    def _note(self, kind: str, of: WantedSet, **more: object) -> None:
        self._to_ledger(kind, self.t_s, {"why": of.why, "region": self._name(of.region), **more})

    def _in_table(self) -> PidGains | None:
        region, retuner = self.retuner.region, self.retuner
        return None if region is None else retuner.settings.rounded(retuner.table.at(region, *retuner.scheduled))

    @property
    def _tolerance(self) -> float:
        """Factor within which what runs is what the table says."""
        return INTERPOLATION_STEP if self.retuner.table.lookup == Lookup.INTERPOLATED else SAME_GAINS

    def _span_s(self, samples: int) -> float:
        return samples * self.retuner.settings.sample_time_s

    def _name(self, region: int) -> str:
        return self.retuner.table.regions.names[region]
