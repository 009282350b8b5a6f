"""What can be seen of a loop now, as one value: the terminal and the page show this and nothing else.

The observer only looks. It costs a few comparisons a sample; Ms is worked out again when gains or knowledge change.
"""

import math

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.update import predicted
from retuner.adaptive.signals.recogniser import RecogniserPhase, RecogniserState
from retuner.adaptive.signals.response import Peak
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TrialPhase
from retuner.decision_page.decision_words import settings_text
from retuner.drivers.device import Device
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values


@dataclass(frozen=True, slots=True)
class RegionSeen:
    """One region: its gains in the table, Ms of them on the process as known (None: not known, infinite: unstable).

    records : behind what is known. learned_s : time of the last of them, None without one. rollbacks : in a row.
    """

    name: str
    gains: PidGains
    commissioned: PidGains
    ms: float | None
    records: int
    learned_s: float | None
    mode: str
    trial: str
    rollbacks: int

    def to_dict(self) -> dict[str, object]:
        """Plain values; an unstable loop is `unstable` with ms null."""
        return {
            "name": self.name,
            "settings": settings_text(self.gains),
            **plain_values(self, "gains"),
            "commissioned": settings_text(self.commissioned),
            **plain_values(self, "ms"),
            "unstable": self.ms is not None and math.isinf(self.ms),
            **plain_values(self, "records learned_s mode trial undos=rollbacks"),
        }


@dataclass(frozen=True, slots=True)
class LoopSeen:
    """One loop now. sp, pv in pv units, co in percent, at t_s.

    region : index, None while it is not known. running : the gains in force. peaks : of the error (time, sp - pv), the
    newest may still grow. band : errors below it count as none. scheduled : the scheduling values in force.
    promised : what a change on trial is held to, in words.
    """

    loop: str
    sample: LoopSample
    region: int | None
    running: PidGains | None
    recogniser: str
    peaks: tuple[Peak, ...]
    band: float
    waits_for: str
    scheduled: tuple[float, float]
    regions: tuple[RegionSeen, ...]
    promised: str = ""

    @property
    def here(self) -> RegionSeen | None:
        """The region that the loop is in."""
        return self.regions[self.region] if self.region is not None else None

    @property
    def manual(self) -> bool:
        """Whether a person has the output."""
        return self.sample.mode != LoopMode.AUTO

    @property
    def needs_a_person(self) -> str:
        """What waits for a person, empty when nothing does."""
        told = {str(TrialPhase.WAITING): "trial passed, awaiting operator approval", str(TrialPhase.LOCKED): "locked"}
        return "; ".join(f"{one.name}: {told[one.trial]}" for one in self.regions if one.trial in told)

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "loop": self.loop,
            "t_s": self.sample.t_s,
            "region": self.region,
            "running": settings_text(self.running, self.loop) if self.running else None,
            "recogniser": self.recogniser,
            "peaks": [[peak.t_s, peak.e] for peak in self.peaks],
            **plain_values(self, "band waits_for scheduled manual needs=needs_a_person promised regions"),
        }


R = RecogniserPhase
FOLLOWING = {
    R.LOCATE_1: "the first peak",
    R.VERIFY_1: "the error to change sign or settle",
    R.LOCATE_2: "the second peak",
    R.VERIFY_2: "the error to change sign again or settle",
    R.LOCATE_3: "the third peak",
    R.VERIFY_3: "the third peak to be passed",
    R.ADAPT: "the decision",
    R.SETTLE: "the loop to settle",
}
"""What the recogniser waits for in each of its states."""
T = TrialPhase
TRIAL_WAITS = {
    T.RESTORING: "the verified gains to become active again",
    T.WRITING: "the new gains to be written",
    T.PAUSED: "the loop to be observable again, a change is on trial",
    T.ENSURING: "the trial gains to become active",
    T.HELD: "nothing; an operator set these gains, and they are on hold",
    T.WAITING: "operator approval of the trial",
    T.LOCKED: "an operator to unlock the region",
}
"""What a trial waits for, where that comes before the recogniser."""


class LoopObserver:
    """Looks at a loop.

    retuner : watches the loop. device : runs the gains.
    """

    def __init__(self, retuner: Retuner, device: Device) -> None:
        self._retuner, self._device = retuner, device
        self._parts: tuple[object, ...] = ()
        self._stands: tuple[object, ...] = ()
        self._regions: tuple[RegionSeen, ...] = ()

    @property
    def region(self) -> int | None:
        """Where the loop is."""
        return self._retuner.region

    @property
    def running(self) -> PidGains | None:
        """The gains in force."""
        running = self._device.running
        return running.gains if running else None

    def moved(self) -> tuple[object, ...]:
        """What tells whether anything but the samples has changed: equal values, nothing to be told."""
        r, state = self._retuner, self._retuner.recogniser
        return (state and state.phase, r.region, id(r.table), r.trials.phase(r.region or 0), r.open_question is None)

    def look(self, sample: LoopSample) -> LoopSeen:
        """What can be seen at a sample."""
        r = self._retuner
        following = r.recogniser
        return LoopSeen(
            loop=r.table.loop,
            sample=sample,
            region=r.region,
            running=self.running,
            recogniser=recogniser_words(following),
            peaks=peaks_so_far(following),
            band=r.band,
            waits_for=self._waits_for(following),
            scheduled=r.scheduled,
            regions=self._every_region(sample.t_s),
            promised=self._promised(),
        )

    def _waits_for(self, state: RecogniserState | None) -> str:
        r = self._retuner
        if r.region is None:
            return "the first sample"
        phase = r.trials.phase(r.region)
        if phase in TRIAL_WAITS:
            return TRIAL_WAITS[phase]
        if r.settings.mode_of(r.region) == Mode.OFF:
            return "nothing; this region is off, only watched"
        if r.open_question is not None:
            return "the decision in progress"
        if state is None or (state.phase == R.LOCATE_1 and not state.started):
            trial = " to judge the trial by" * (phase == T.TRIAL)
            return f"a setpoint or load step{trial}"
        return FOLLOWING[R(state.phase)]

    def _promised(self) -> str:
        """What a change on trial promises, beside what it was before: IAE per unit of the upset."""
        r = self._retuner
        trial = r.trials.of(r.region or 0)
        if trial.prediction is None or trial.phase not in {T.TRIAL, T.AWAY, T.PAUSED, T.ENSURING, T.WAITING}:
            return ""
        prediction, told = trial.prediction.to_dict(), []
        for upset in ("setpoint", "load"):
            spread = prediction.get(upset)
            iae = spread.get("iae") if isinstance(spread, dict) else None
            if iae and iae[0] is not None and iae[2] is not None:
                told.append(f"IAE per unit {upset} step {iae[0]:.3g} ({iae[1]:.3g} to {iae[2]:.3g})")
        kept = f"{trial.kept} of {r.settings.trial.responses} responses matched"
        return f"{', '.join(told) or 'a decay as before'}; {kept}"

    def _every_region(self, t_s: float) -> tuple[RegionSeen, ...]:
        """Each region, looked at again when its gains, its trial or what is known of it have changed."""
        r = self._retuner
        places = range(len(r.table.regions.names))
        trials = [r.trials.of(i) for i in places]
        parts = (r.table, r.settings, *(r.region_models.get(i) for i in places))
        stands = tuple((one.phase, one.rollbacks) for one in trials)
        if stands == self._stands and all(a is b for a, b in zip(parts, self._parts, strict=False)):
            return self._regions
        found = []
        for i, trial in enumerate(trials):
            model, gains, ms = r.region_models.get(i), r.table.gains_of(i), None
            if model is not None:
                process = predicted(model, max(t_s, model.t_s), r.settings.tracker).model()
                sampled = process.seen_by_controller(r.settings.sample_time_s).linear()
                ms = sensitivity_peak(sampled, gains, r.settings.filter_s)
            seen = RegionSeen(
                name=r.table.regions.names[i],
                gains=gains,
                commissioned=r.commissioned.gains_of(i),
                ms=ms,
                records=model.records if model else 0,
                learned_s=model.t_s if model else None,
                mode=str(r.settings.mode_of(i)),
                trial=str(trial.phase),
                rollbacks=trial.rollbacks,
            )
            found.append(seen)
        self._parts, self._stands, self._regions = parts, stands, tuple(found)
        return self._regions


def recogniser_words(state: RecogniserState | None) -> str:
    """The recogniser's state, in EXACT's words."""
    if state is None:
        return "no sample yet"
    phase = RecogniserPhase(state.phase)
    if phase is R.LOCATE_1 and not state.started:
        return "at rest"
    return phase.name.lower().replace("_", " ")


def peaks_so_far(state: RecogniserState | None) -> tuple[Peak, ...]:
    """The extremes of the error found in the response under way, the newest one still open."""
    if state is None or not state.started or state.phase >= R.ADAPT:
        return ()
    first, second, newest = (Peak(state.t1_s, state.e1), Peak(state.t2_s, state.e2), Peak(state.t_peak_s, state.e_peak))
    return (*{0: (), 1: (first,), 2: (first, second)}[state.phase // 2], newest)
