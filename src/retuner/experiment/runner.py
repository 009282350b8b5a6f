"""One experiment on a controller: takes over, excites, and leaves the loop as it was, whatever happens meanwhile.

Like a session it is driven by `poll(now_s)` and never waits. What the controller should be in each phase is a target
(target.py) that is sent when a phase is entered and again until telemetry and read-back show it; so the way back hangs
on the phase, not on the edge that led to it. Everything is told to the recorder before it takes effect.

What ends an experiment: each limit a function or small watch that names the cause and what was seen, or nothing.
"""

from collections.abc import Callable, Mapping

from retuner.adaptive.experiments.phases import AbortCause, Happening, Phase, after
from retuner.adaptive.experiments.plan import (
    Experiment,
    LoopAtRest,
    Plan,
    RelayState,
    at_rest,
    enough,
    relay_start,
    relay_step,
)
from retuner.adaptive.signals.sample import LoopMode, LoopSample, finite
from retuner.adaptive.supervision.decision import gains_dict
from retuner.drivers.device import (
    CommandFailed,
    Device,
    DeviceRestarted,
    Event,
    LeaseChanged,
    LinkChanged,
    LinkState,
    Reverted,
    RunningChanged,
    SamplesLost,
    WriteFailed,
)
from retuner.errors import LedgerError
from retuner.experiment.target import CO_SHOWN, Helm, OldState, Target, target
from retuner.ledger import Recorder
from retuner.stopping import unstoppable

# ---- What ends an experiment

LIMITED_MOST = 2  # samples for which the output may stand at a limit during a setpoint experiment

Trouble = tuple[AbortCause, str]


class Following:
    """Whether the controller does what it is told: output, mode and setpoint.

    A new target may take some samples to show. Once mode and setpoint have shown, another one is somebody else's at
    once: the next output of a relay must not override a person who has taken over.

    kind : of the experiment. helm : knows what is shown. patience : samples that a new target may take to show.
    """

    def __init__(self, kind: Experiment, helm: Helm, patience: int) -> None:
        self._kind, self._helm, self._patience = kind, helm, patience
        self._limited = self._foreign = 0
        self._shown = False

    def expect(self) -> None:
        """The target has changed: it may take its time to show."""
        self._foreign, self._shown = 0, False

    def trouble(self, wanted: Target, sample: LoopSample) -> Trouble | None:
        """One sample under a target. In manual the setpoint may be anything: some controllers let it follow pv."""
        differs = self._helm.differs(wanted, sample)
        self._shown = self._shown or not differs
        self._foreign = self._foreign + 1 if differs else 0
        if self._foreign > (0 if self._shown else self._patience):
            return AbortCause.FOREIGN, differs
        if self._kind == Experiment.SETPOINT:
            self._limited = self._limited + 1 if sample.limited else 0
            if self._limited > LIMITED_MOST:
                return AbortCause.SATURATED, f"co is at {sample.co:.4g} %; give a smaller amplitude or kc0"
            return None
        off = wanted.co is not None and sample.mode == LoopMode.MANUAL and abs(sample.co - wanted.co) > CO_SHOWN
        self._limited = self._limited + 1 if off else 0
        if self._limited > self._patience:
            return AbortCause.SATURATED, f"co is at {sample.co:.4g} %, commanded was {wanted.co:.4g} %"
        return None


FEWEST_PATIENT = 6  # samples that a new output, setpoint or mode may take to show at least
LOST_MOST = 3  # samples in a row that may be missing from the record of an experiment
VERIFY_SAMPLES = 3  # samples in a row that must show the old state before it counts as restored
RESTORE_SAMPLES, RESTORE_SILENCES = 200, 10
"""Samples, and lengths of silence, within which the old state must have been verified; the longer of the two counts."""
LIMITED = {Phase.RESTING, Phase.PREPARING, Phase.EXCITING}  # phases that a limit or silence ends
TAKING_OVER = {Phase.PREPARING, Phase.EXCITING}
"""Phases in which a refused command ends the experiment; on the way back it is sent again."""


def restore_patience_s(sample_time_s: float, silent_s: float) -> float:
    """How long to wait for the controller to show what it was told."""
    return max(RESTORE_SAMPLES * sample_time_s, RESTORE_SILENCES * silent_s)


class ExperimentRunner:
    """See the head of this file.

    device : the controller. plan : what to do. sample_time_s : of the controller. silent_s : without telemetry for so
        long, an experiment is given up; as long may a new target take to show.
    record : keeps rows for good. on_sample : told of every sample and the phase.
    """

    def __init__(
        self,
        device: Device,
        plan: Plan,
        sample_time_s: float,
        silent_s: float,
        record: Recorder,
        on_sample: Callable[[LoopSample, Phase], None] | None = None,
    ) -> None:
        self.device, self.plan = device, plan
        self.phase = Phase.CONNECTING
        self.cause: AbortCause | None = None
        self.detail = ""
        self.before: OldState | None = None
        self.rest: LoopAtRest | None = None
        self.samples: list[LoopSample] = []
        self.excited_from = self.excited_to = 0
        self.touched = False
        self.lost_ledger: LedgerError | None = None
        self._dt_s, self._silent_s = sample_time_s, silent_s
        self._patience_s = restore_patience_s(sample_time_s, silent_s)
        self._to_ledger = record
        self._on_sample = on_sample
        self._helm = Helm(device, sample_time_s)
        self._following = Following(plan.kind, self._helm, max(round(silent_s / sample_time_s), FEWEST_PATIENT))
        self._relay = RelayState(high=True, switches=0)
        self._parking = False
        self._now_s = self._heard_s = self._phase_s = 0.0
        self._shown = 0

    @property
    def excited(self) -> list[LoopSample]:
        """The samples of the excitation, with the last ones before it, so that the record begins at rest."""
        return self.samples[self.excited_from - min(self.excited_from, self.plan.rest_samples) : self.excited_to]

    @property
    def text(self) -> str:
        """How it ended, in one line."""
        if self.cause is None:
            return str(self.phase.value)
        return f"{self.cause.value}: {self.detail}" if self.detail else self.cause.value

    def poll(self, now_s: float) -> None:
        """Take what the device has to tell and do what is due.

        Raises DeviceError: before the first connection: nobody answers, or the wrong controller does.
        """
        self._now_s = now_s
        for event in self.device.poll(now_s):
            if isinstance(event, LoopSample):
                self._sample(event)
            elif not self.phase.over:
                self._event(event)
        if not self.phase.over:
            # limits that count even when nothing arrives
            since = self._now_s - self._phase_s
            if self.phase in LIMITED:
                age = self._now_s - self._heard_s
                if age > self._silent_s:
                    self.abort(AbortCause.SILENT, f"no sample for {age:.3g} s")
            if self.phase in {Phase.PARKING, Phase.RESTORING} and since > self._patience_s:
                self._move(Happening.GIVEN_UP)
            # send what is wanted and not shown yet; during the excitation once is enough, or somebody else has spoken
            last = self.samples[-1] if self.samples else None
            refusal = self._helm.steer(self._target(), last, self._now_s, insist=self.phase is not Phase.EXCITING)
            if refusal and self.phase in TAKING_OVER:
                self.abort(AbortCause.REFUSED, refusal)

    def conduct(self, turn: Callable[[], float], stopping: Callable[[], None] = lambda: None) -> None:
        """Go on turn by turn until the old state is back; Ctrl-C is an abort like any other. turn : lets time pass; the
        time in s. stopping : is called at Ctrl-C, before the way back begins.
        """
        while not self.phase.over:
            try:
                now_s = turn()
                with unstoppable():
                    self.poll(now_s)
            except KeyboardInterrupt:
                stopping()
                self.abort(AbortCause.INTERRUPTED)

    def abort(self, cause: AbortCause, detail: str = "") -> None:
        """Leave for the old state; the first cause is the one that is told."""
        if self.phase.over:
            return
        if self.cause is None:
            self.cause, self.detail = cause, detail
        self._move(Happening.ABORTED)

    def _move(self, happening: Happening) -> None:
        """Go where the table says, and begin what belongs to the new phase."""
        old, self.phase = self.phase, after(self.phase, happening)
        if self.phase is old:
            return
        self._phase_s = self._now_s
        self._shown = 0
        self.touched = self.touched or self.phase.touched
        if old is Phase.EXCITING:
            self.excited_to = len(self.samples)
        if self.phase is Phase.EXCITING:
            self.excited_from = len(self.samples)
            self._relay = relay_start()
        if self.phase is Phase.PARKING:
            last = self.samples[-1] if self.samples else None
            self._parking = last is not None and last.mode == LoopMode.MANUAL and self.cause is not AbortCause.RESTARTED
        self._note({"phase": self.phase.name.lower(), "cause": self.text if self.cause else None})

    def _note(self, body: Mapping[str, object]) -> None:
        """Record a row; a ledger that fails ends the experiment, but not the way back."""
        if self.lost_ledger is not None:
            return
        try:
            self._to_ledger("experiment", self.samples[-1].t_s if self.samples else 0.0, body)
        except LedgerError as error:
            self.lost_ledger = error
            self.abort(AbortCause.RECORDER, str(error))

    def _event(self, event: Event) -> None:
        match event:
            case LinkChanged() if event.state is not LinkState.UP:
                self.abort(AbortCause.SILENT, event.reason)
            case DeviceRestarted():
                self._helm.forget()
                self._parking = False
                self.abort(AbortCause.RESTARTED, f"boot epoch {event.epoch}")
            case RunningChanged():
                if self.before is not None:  # theirs from now on, and none of ours to undo
                    self.before = self.before._replace(gains=event.running.gains)
                self.abort(AbortCause.FOREIGN, "another gain set was written")
            case LeaseChanged() if not event.ours:
                self.abort(AbortCause.FOREIGN, f"host {event.owner} holds the lease")
            case CommandFailed() | WriteFailed() if self.phase in TAKING_OVER:
                self.abort(AbortCause.REFUSED, event.reason)
            case Reverted() if self.phase in TAKING_OVER:
                self.abort(AbortCause.REFUSED, "it returned to its confirmed gains")
            case SamplesLost() if event.count > LOST_MOST and self.phase is Phase.EXCITING:
                self.abort(AbortCause.SILENT, f"{event.count} samples are missing at {event.t_s:g} s")

    def _sample(self, sample: LoopSample) -> None:
        self._heard_s = self._now_s
        if not finite(sample):
            self.abort(AbortCause.SILENT, "telemetry is not a number")
            return
        self.samples.append(sample)
        if self._on_sample is not None:
            self._on_sample(sample, self.phase)
        low, high = self.plan.pv_low, self.plan.pv_high
        if self.phase in LIMITED and not low <= sample.pv <= high:
            self.abort(AbortCause.PV_BAND, f"pv = {sample.pv:.6g}, band {low:.6g} to {high:.6g}")
            return
        shows = self._helm.shows(self._target(), sample)
        match self.phase:
            case Phase.CONNECTING if self.device.connected:  # heard, and what runs has been read back
                self.samples = self.samples[-1:]
                self._move(Happening.CONNECTED)
            case Phase.RESTING:
                self._wait_for_rest(sample)
            case Phase.PREPARING if shows:
                self._move(Happening.PREPARED)
            case Phase.PREPARING if self._now_s - self._phase_s > self._patience_s:
                self.abort(AbortCause.REFUSED, "it does not show what was commanded")
            case Phase.EXCITING:
                self._excite(sample)
            case Phase.PARKING if not self._parking or sample.mode == LoopMode.AUTO or shows:
                self._move(Happening.PARKED)  # the output is where it was, unless the controller has it already
            case Phase.RESTORING:
                self._shown = self._shown + 1 if shows else 0
                if self._shown >= VERIFY_SAMPLES:
                    self._move(Happening.VERIFIED)

    def _wait_for_rest(self, sample: LoopSample) -> None:
        """Watch until pv rests; what is seen then is the state to come back to."""
        running = self.device.running
        if running is None:
            return
        rest = at_rest(self.plan, self.samples)
        if rest is None:
            watched = self._now_s - self._phase_s
            if watched > self.plan.rest_time_s + self.plan.rest_samples * self._dt_s:
                self.abort(AbortCause.NOT_AT_REST, f"pv still moves after {watched:.4g} s; wait, or widen the pv band")
            return
        self.rest, self.plan = rest, self.plan.about(rest.pv)
        co = sample.co if sample.mode == LoopMode.MANUAL else rest.co
        self.before = OldState(running.gains, sample.sp, sample.mode, co)
        low, high = self.plan.co_levels(rest.co)
        if not (self.plan.co_low <= low and high <= self.plan.co_high):
            levels = f"co = {rest.co:.4g} % would go to {low:.4g} and {high:.4g} %"
            room = f"its range is {self.plan.co_low:g} to {self.plan.co_high:g} %"
            self.abort(AbortCause.NO_ROOM, f"{levels}, {room}")
            return
        if self.plan.kind == Experiment.SETPOINT and sample.mode != LoopMode.AUTO:
            self.abort(AbortCause.WRONG_MODE, "a setpoint experiment needs auto, it is in manual")
            return
        self._note(
            {
                "phase": "before",
                "gains": gains_dict(running.gains),
                "sp": sample.sp,
                "mode": sample.mode,
                "co": rest.co,
                "kind": self.plan.kind,
                "amplitude": self.plan.amplitude,
            }
        )
        if self.lost_ledger is None:
            self._move(Happening.AT_REST)

    def _excite(self, sample: LoopSample) -> None:
        plan, rest, before = self.plan, self.rest, self.before
        assert rest is not None
        assert before is not None
        trouble = self._following.trouble(self._target(), sample)
        if trouble is None:
            if plan.kind == Experiment.RELAY:
                self._relay = relay_step(self._relay, sample.pv, rest, before.gains.direction)
            since = self.samples[self.excited_from :]
            if plan.kind == Experiment.VALVE:
                self._relay = RelayState(True, int((sample.t_s - since[0].t_s) // plan.hold_s))
            elif plan.hold_s:
                out = sample.t_s - since[0].t_s < plan.hold_s
                if self._relay.high and not out:
                    self._following.expect()
                self._relay = RelayState(out, 0)
            if enough(plan, since, rest, self._relay):
                self._move(Happening.FINISHED)
                return
            if len(since) * self._dt_s > plan.time_s:
                trouble = AbortCause.TIME, f"{plan.time_s:g} s; give more time, or a larger amplitude"
                if plan.kind == Experiment.RELAY and self._relay.switches < 2:
                    why = "are amplitude, bias and the sign of the active gains right?"
                    told = f"{plan.time_s:g} s for {self._relay.switches} switchings; {why}"
                    trouble = AbortCause.NEVER_SWITCHED, told
        if trouble:
            self.abort(*trouble)

    def _target(self) -> Target:
        return target(self.phase, self.plan, self.before, self.rest, self._relay, parking=self._parking)
