"""The trials of one loop: which region's change is being written, on trial, taken back, cooling down.

A thin shell round phase.py (what follows what), judge.py and watch.py (what a response and a sample say). It keeps one
Trial a region and has one effect: ENTERING the restoring phase puts the verified set back into the table, at once and
whatever led there, so that nothing writes the tried set any more. That the controller runs it is told by `restored`.

    cool-down = base x 2^(undos - 1), base from the settings or the restored set's integral time
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.trial.expectation import Promise
from retuner.adaptive.trial.judge import JudgedResponse, Judgement, TrialFinding, judge
from retuner.adaptive.trial.phase import UNDECIDED, UNDOS, TrialEvent, TrialPhase, after
from retuner.adaptive.trial.runaway import law_of, runaway_begin, runaway_step
from retuner.adaptive.trial.settings import TrialSettings
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains

P, E = TrialPhase, TrialEvent
LEAST_SAMPLES = 60
"""Cool-downs and times at a limit last at least so many samples."""
FINDINGS = {
    TrialFinding.BETTER: E.GOOD,
    TrialFinding.AS_PROMISED: E.AS_PROMISED,
    TrialFinding.WORSE: E.WORSE,
    TrialFinding.INCONCLUSIVE: E.INCONCLUSIVE,
}
KEPT = (E.GOOD, E.AS_PROMISED)
WITH_GAINS = (E.PROPOSED, E.URGENT, E.WRITTEN)


class TrialSupervisor:
    """See the head of this file.

    Parameters
    ----------
    settings : see TrialSettings. sample_time_s : of the controller.
    put_back : puts a region's verified set into the table; called on entering the restoring phase.
    """

    def __init__(
        self, settings: TrialSettings, sample_time_s: float, put_back: Callable[[int, PidGains], None]
    ) -> None:
        self.settings = settings
        self._shortest_s = LEAST_SAMPLES * sample_time_s
        self._put_back = put_back
        self._trials: dict[int, Trial] = {}
        self._at: int | None = None
        self.busy = False
        """Whether a change is undecided or being taken back: only then is there anything to watch."""

    def of(self, region: int) -> Trial:
        """Where the region stands."""
        return self._trials.get(region, Trial())

    def phase(self, region: int) -> TrialPhase:
        """The region's phase."""
        return self.of(region).phase

    @property
    def undecided(self) -> tuple[int, ...]:
        """Regions whose change has neither passed nor been given up."""
        return tuple(region for region, trial in self._trials.items() if trial.phase in UNDECIDED)

    @property
    def restoring(self) -> tuple[int, ...]:
        """Regions whose verified set the controller has not yet reported to run again."""
        return tuple(region for region, trial in self._trials.items() if trial.phase == P.RESTORING)

    def may_change(self, region: int, t_s: float, *, urgent: bool = False) -> bool:
        """Whether a change of the region's gains may be asked for now. urgent : in the safe direction, of a loop that
        swings: need not wait for the cool-down.
        """
        trial = self.of(region)
        if trial.phase == P.COOLING and t_s >= trial.until_s:
            self._move(region, E.COOLED, t_s)
        event = E.URGENT if urgent else E.PROPOSED
        wire_is_free = not any(trial.phase in {P.WRITING, P.RESTORING} for trial in self._trials.values())
        return wire_is_free and after(self.phase(region), event) == P.WRITING

    def begin(
        self, region: int, old: PidGains, new: PidGains, promised: Promise, t_s: float, *, urgent: bool = False
    ) -> None:
        """A change of a region's gains from `old` (verified, as the table has them) to `new` is to be written.

        Raises
        ------
        ValueError
            The region may not be changed now; see may_change.
        """
        if not self.may_change(region, t_s, urgent=urgent):
            raise ValueError(f"region {region} may not be changed now: {self.phase(region)}")
        self._trials[region] = replace(
            self.of(region), old=old, new=new, promise=promised, since_s=t_s, kept=0, cause=None, seen=None
        )
        self._move(region, E.URGENT if urgent else E.PROPOSED, t_s)

    def written(self, region: int, gains: PidGains, t_s: float) -> bool:
        """The controller runs the tried set, as read back; whether it is on trial now (not when it was given up)."""
        if self.phase(region) == P.WRITING:
            self._trials[region] = replace(self.of(region), new=gains)
            self._move(region, E.WRITTEN, t_s)
            if self._at is not None and self._at != region:
                self._move(region, E.LEFT, t_s)
            return True
        return False

    def event(self, region: int, event: TrialEvent, t_s: float) -> bool:
        """Anything that happened to one region; whether its phase changed.

        Raises
        ------
        ValueError
            The event comes with gains: use `begin` and `written`.
        """
        if event in WITH_GAINS:
            raise ValueError(f"{event.name} comes with gains; use begin() or written()")
        return self._move(region, event, t_s)

    def abort(self, cause: TrialEvent, t_s: float) -> tuple[int, ...]:
        """A cause that ends every undecided trial; the regions that are being taken back from now on."""
        return tuple(region for region in self.undecided if self._move(region, cause, t_s))

    def restored(self, t_s: float) -> tuple[int, ...]:
        """The controller runs the table's set as read back: what was to be taken back is; the regions."""
        return tuple(region for region in self.restoring if self._move(region, E.RESTORED, t_s))

    def look(
        self, sample: LoopSample, region: int | None, band: float, elapsed_s: float, gap_s: float, *, blended: bool
    ) -> dict[int, TrialEvent]:
        """One sample while a trial is undecided: the regions whose trial it ends, with the cause.

        region : where the loop is now. elapsed_s : since the last sample; more than gap_s is a gap. blended : the
        table interpolates, so a region's set takes part beyond its borders.
        """
        cause = self._loop_cause(sample, elapsed_s, gap_s)
        self._at = region
        ended: dict[int, TrialEvent] = {}
        for at in self.undecided:
            found = cause or self._region_cause(at, sample, region, band, blended=blended)
            if found is not None and self._move(at, found, sample.t_s):
                ended[at] = found
        return ended

    def judge(self, region: int, seen: JudgedResponse, ran: PidGains, t_s: float, *, ask: bool) -> Judgement | None:
        """Judge a response of a region on trial, and go on accordingly; None when it is not on trial.

        ran : gains under which it ran (in an interpolated table, the mean that was in force).
        ask : a person has the next word when the trial passes.
        """
        trial = self.of(region)
        if trial.phase != P.TRIAL or trial.promise is None:
            return None
        found = judge(seen, trial.promise, ran, self.settings)
        event = FINDINGS[found.finding]
        self._move(region, event, t_s)
        if event in KEPT:
            kept = trial.kept + 1
            self._trials[region] = replace(self.of(region), kept=kept)
            if kept >= self.settings.responses:
                self._move(region, E.PASSED_FOR_APPROVAL if ask else E.PASSED, t_s)
        return found

    def to_dict(self) -> dict[str, object]:
        """All that later decisions depend on, in plain JSON values."""
        return {"at": self._at, "trials": {str(region): trial.to_dict() for region, trial in self._trials.items()}}

    def resume(self, body: Mapping[str, Any]) -> None:
        """Go on from there.

        Raises
        ------
        KeyError, TypeError, ValueError
            Something is missing, or no value of its kind.
        """
        self._at = body["at"]
        self._trials = {int(region): Trial.from_dict(trial) for region, trial in body["trials"].items()}
        self._notice()

    def _loop_cause(self, sample: LoopSample, elapsed_s: float, gap_s: float) -> TrialEvent | None:
        """What ends every trial of the loop, if anything."""
        if sample.mode != LoopMode.AUTO:
            return E.MANUAL
        return E.LOST_TELEMETRY if elapsed_s > gap_s else None

    def _region_cause(
        self, at: int, sample: LoopSample, region: int | None, band: float, *, blended: bool
    ) -> TrialEvent | None:
        """What ends one region's trial, if anything; comings and goings are taken note of."""
        trial = self.of(at)
        if sample.t_s - trial.since_s > self.settings.timeout_s:
            return E.TIMED_OUT
        if region != at:
            if blended:
                return E.LEFT_INTERPOLATED
            self._move(at, E.LEFT, sample.t_s)
            return None
        self._move(at, E.ENTERED, sample.t_s)
        return self._watch(at, sample, band)

    def _watch(self, at: int, sample: LoopSample, band: float) -> TrialEvent | None:
        """The sample under the tried set."""
        trial = self.of(at)
        if trial.phase != P.TRIAL or trial.promise is None:
            return None
        law = law_of(trial.promise, self.settings, self._shortest_s)
        seen, found = runaway_step(law, trial.seen or runaway_begin(sample.sp), sample, band)
        if seen is not trial.seen:
            self._trials[at] = replace(trial, seen=seen)
        return found

    def _move(self, region: int, event: TrialEvent, t_s: float) -> bool:
        """The one way from phase to phase, with what belongs to entering each."""
        trial = self.of(region)
        now = after(trial.phase, event)
        if now == trial.phase:
            return False
        trial = replace(trial, phase=now, seen=None)
        if now == P.RESTORING:
            trial = replace(trial, cause=event, undos=trial.undos + (event in UNDOS))
        elif now == P.COOLING:
            trial = replace(trial, until_s=t_s + self._cool_down_s(trial))
        elif event in {E.PASSED, E.PASSED_FOR_APPROVAL, E.UNLOCKED}:
            trial = replace(trial, undos=0)
        self._trials[region] = trial
        self._notice()
        if now == P.RESTORING and trial.old is not None:
            self._put_back(region, trial.old)
        if now == P.COOLING and trial.undos >= self.settings.lock_out_after:
            self._move(region, E.TOO_MANY_UNDOS, t_s)
        return True

    def _cool_down_s(self, trial: Trial) -> float:
        """Length of the cool-down that begins."""
        base, old = self.settings.cool_down_s, trial.old
        if base is None:
            tau_i = old.kp / old.ki if old is not None and old.ki else 0.0
            base = max(self.settings.cool_down_tau_i * tau_i, self._shortest_s)
        return base * 2.0 ** min(max(trial.undos - 1, 0), self.settings.cool_down_most)

    def _notice(self) -> None:
        """Whether there is anything to watch."""
        self.busy = bool(self.undecided or self.restoring)
