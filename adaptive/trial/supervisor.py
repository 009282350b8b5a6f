"""The trials of one loop: which region's change is being written, on trial, rolled back, cooling down.

A thin shell round phase.py (what follows what), judge.py and diverging_trial.py (what a response and a sample say),
rollback.py (which set is to run after a cause that is no response). It keeps one Trial a region and has one effect:
when a trial begins to roll back, the set that is to run goes into the table at once, whatever led there, so that
nothing writes another one. That the controller runs it is told by `restored`.

    cool-down = base x 2^(rollbacks - 1), base from the settings or the restored set's integral time
    hold of a person's gains = edit_hold_s x 2^(edits - 1)
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from retuner.adaptive.signals.sample import EVERYWHERE, LoopMode, LoopSample
from retuner.adaptive.trial.diverging_trial import divergence_begin, divergence_step, law_of
from retuner.adaptive.trial.judge import JudgedResponse, Judgement, TrialFinding, judge
from retuner.adaptive.trial.phase import (
    ABORTS,
    LASTING,
    ROLLBACK_CAUSES,
    TO_BE_SEEN,
    UNDECIDED,
    UNSURE,
    TrialEvent,
    TrialPhase,
    after,
)
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, Rollback, StillAllowed, rollback, unstable_again
from retuner.adaptive.trial.trial import Trial
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains

P, E = TrialPhase, TrialEvent
LEAST_SAMPLES = 60  # Cool-downs and times at a limit last at least so many samples
FINDINGS = {
    TrialFinding.BETTER: E.GOOD,
    TrialFinding.AS_PROMISED: E.AS_PROMISED,
    TrialFinding.WORSE: E.WORSE,
    TrialFinding.INCONCLUSIVE: E.INCONCLUSIVE,
}
KEPT = (E.GOOD, E.AS_PROMISED)
WITH_GAINS = (E.PROPOSED, E.URGENT, E.ORDERED, E.WRITTEN, E.OPERATOR_EDIT)
DECIDED = (E.STAYS, E.ENSURED)  # What may be decided instead of ending a trial
AFTER_SILENCE = {P.RESTORING: "are rolled back", P.WAITING: "stay, awaiting operator approval"}
"""What becomes of a trial that no response decided; else its gains stay."""
MOST_EDITS = 6  # doublings of the time for which a person's gains are held


class TrialSupervisor:
    """See the head of this file.

    settings : see TrialSettings. sample_time_s : of the controller.
    into_table : puts the set that is to run into the table; called on entering a phase.
    known : what is known of a region's process, when it is to be decided which of its sets runs.
    asks : whether a person has the next word on a region's trial. pv_range : what the transmitter can say, pv units.
    """

    def __init__(
        self,
        settings: TrialSettings,
        sample_time_s: float,
        into_table: Callable[[int, PidGains], None],
        known: Callable[[int], StillAllowed] = lambda _region: NOTHING_KNOWN,
        asks: Callable[[int], bool] = lambda _region: False,
        pv_range: tuple[float, float] = EVERYWHERE,
    ) -> None:
        self.settings, self._pv_range = settings, pv_range
        self._shortest_s = LEAST_SAMPLES * sample_time_s
        self._into_table, self._known, self._asks = into_table, known, asks
        self._trials: dict[int, Trial] = {}
        self._at: int | None = None
        self.busy = False
        """Whether a change is undecided or being rolled back: only then is there anything to watch."""

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
        """Regions of which the controller has not yet reported that it runs what it should."""
        return tuple(region for region, trial in self._trials.items() if trial.phase in TO_BE_SEEN)

    @property
    def left_open(self) -> tuple[int, ...]:
        """Regions of which it is not settled what runs when the session ends: all but those where a set stays."""
        restoring = self.restoring
        return restoring + tuple(region for region in self.concerned(E.STOPPED) if region not in restoring)

    def may_change(self, region: int, t_s: float, *, urgent: bool = False, ordered: bool = False) -> bool:
        """Whether a change of the region's gains may be asked for now. urgent : in the safe direction, of a loop that
        swings: need not wait for the cool-down. ordered : by a person, who may change what he has set.
        """
        self._time_over(region, t_s)
        wire_is_free = not any(trial.phase in {P.WRITING, *TO_BE_SEEN} for trial in self._trials.values())
        return wire_is_free and after(self.phase(region), _asked(urgent, ordered)) == P.WRITING

    def idle(self, region: int, t_s: float) -> bool:
        """Whether nothing is on trial in a region, nor held, locked or cooling down by now; and its last change was
        not refuted there, which only responses of its own may take up again.
        """
        self._time_over(region, t_s)
        return self.phase(region) is P.IDLE and not self.of(region).rollbacks

    def away(self, region: int) -> bool:
        """Whether a change there is on trial and was never refuted, and the loop is elsewhere."""
        return self.phase(region) is P.AWAY and not self.of(region).rollbacks

    def held_by_a_person(self, region: int, t_s: float) -> bool:
        """Whether the region's gains are a person's, and nothing but a proposal may follow now."""
        self._time_over(region, t_s)
        return self.phase(region) == P.HELD

    def begin(
        self,
        region: int,
        old: PidGains,
        new: PidGains,
        prediction: Prediction,
        t_s: float,
        *,
        urgent: bool = False,
        ordered: bool = False,
    ) -> None:
        """A change of a region's gains from `old` (as the table has them) to `new` is to be written.

        Raises ValueError: the region may not be changed now; see may_change.
        """
        if not self.may_change(region, t_s, urgent=urgent, ordered=ordered):
            raise ValueError(f"region {region} may not be changed now: {self.phase(region)}")
        was = self.of(region)
        begun = Trial(was.phase, old, new, prediction, since_s=t_s, rollbacks=was.rollbacks, edits=was.edits)
        self._trials[region] = replace(begun, until_s=was.until_s, earlier=was.earlier)
        self._move(region, _asked(urgent, ordered), t_s)

    def written(self, region: int, gains: PidGains, t_s: float) -> bool:
        """The controller runs the tried set, as read back; whether it is to run from now on.

        A write that was given up may come through after all: then that set has run as well, and is decided upon anew.
        """
        trial = self.of(region)
        if trial.phase == P.WRITING:
            self._trials[region] = replace(trial, new=gains, ran=True)
            self._move(region, E.WRITTEN, t_s)
            if self._at is not None and self._at != region:
                self._move(region, E.LEFT, t_s)
            return True
        cause = trial.cause
        if trial.phase != P.RESTORING or trial.ran or cause is None or cause in ROLLBACK_CAUSES:
            return False
        self._trials[region] = replace(trial, new=gains, ran=True)
        found = self._rollback(region, cause)
        if found.stays:
            self._trials[region] = replace(self.of(region), back=found)
            self._move(region, E.ENSURED, t_s)
        return found.stays

    def edited(self, region: int, now: PidGains, ours: PidGains, t_s: float) -> None:
        """A person has set other gains in a region, and they run. ours : those that were in force before."""
        trial = self.of(region)
        edits = trial.edits + (trial.ran and ours == trial.new and trial.cause != E.OPERATOR_EDIT)
        kept = replace(trial.with_earlier(ours), old=ours, new=now, ran=True, prediction=None, edits=edits, back=None)
        hold_s = self.settings.edit_hold_s * 2.0 ** min(max(edits - 1, 0), MOST_EDITS)
        self._trials[region] = replace(kept, until_s=t_s + hold_s, cause=E.OPERATOR_EDIT)
        self._move(region, E.OPERATOR_EDIT, t_s)

    def event(self, region: int, event: TrialEvent, t_s: float) -> bool:
        """Anything that happened to one region; whether its phase changed.

        Raises ValueError: the event comes with gains: use `begin` and `written`.
        """
        if event in WITH_GAINS:
            raise ValueError(f"{event.name} comes with gains; use begin(), written() or edited()")
        if event in DECIDED:
            raise ValueError(f"{event.name} is decided here; tell the cause")
        if event in ABORTS and self.phase(region) in UNDECIDED:
            return self._stay_or_roll_back(region, event, t_s)
        return self._move(region, event, t_s)

    def concerned(self, cause: TrialEvent) -> tuple[int, ...]:
        """Regions with an undecided change to which a cause that ends trials has not been put yet."""
        return tuple(region for region in self.undecided if not self._was_put(region, cause))

    def abort(self, cause: TrialEvent, t_s: float) -> tuple[int, ...]:
        """A cause that ends undecided trials; the regions where it is decided anew what is to run."""
        return tuple(region for region in self.concerned(cause) if self._stay_or_roll_back(region, cause, t_s))

    def restored(self, t_s: float) -> tuple[int, ...]:
        """The controller runs the table's set as read back: what was to run does; the regions."""
        return tuple(region for region in self.restoring if self._move(region, E.RESTORED, t_s))

    def no_rollback(self, region: int) -> str:
        """Why a person's order does not lead back to the set before the trial; empty when it does (see rollback.py)."""
        trial = self.of(region)
        return "" if trial.old is None else unstable_again(trial.sets, self._known(region))

    def watch(
        self, sample: LoopSample, region: int | None, band: float, elapsed_s: float, gap_s: float, *, blended: bool
    ) -> dict[int, TrialEvent]:
        """One sample while a trial is undecided: the regions where it was decided what is to run, with the cause.

        region : where the loop is now. elapsed_s : since the last sample; more than gap_s is a gap. blended : the
        table interpolates, so a region's set takes part beyond its boundaries.
        """
        # what concerns every trial of the loop, if anything
        cause = E.MANUAL if sample.mode != LoopMode.AUTO else E.GAP if elapsed_s > gap_s else None
        self._at = region
        ended: dict[int, TrialEvent] = {}
        for at in self.undecided:
            elsewhere = not blended and self.phase(at) is P.AWAY and region not in {at, None}  # its set does not run
            of_loop = None if elsewhere else cause
            found = of_loop or self._region_cause(at, sample, region, band, blended=blended)
            if found is not None and not self._was_put(at, found) and self._stay_or_roll_back(at, found, sample.t_s):
                ended[at] = found
        return ended

    def judge(self, region: int, seen: JudgedResponse, ran: PidGains, t_s: float, *, ask: bool) -> Judgement | None:
        """Judge a response of a region on trial, and go on accordingly; None when it is not on trial.

        ran : gains under which it ran (in an interpolated table, the mean that was in force).
        ask : a person has the next word when the trial passes.
        """
        trial = self.of(region)
        if trial.phase != P.TRIAL or trial.prediction is None:
            return None
        more = trial.old is not None and abs(ran.ki) >= abs(trial.old.ki)
        found = judge(seen, trial.prediction, ran, self.settings, more=more)
        event = FINDINGS[found.finding]
        if event in ROLLBACK_CAUSES:
            self._stay_or_roll_back(region, event, t_s)
        elif event in KEPT:
            kept = trial.kept + 1
            self._trials[region] = replace(trial, kept=kept)
            if kept >= self.settings.responses:
                self._move(region, E.PASSED_FOR_APPROVAL if ask else E.PASSED, t_s)
        else:
            enough = seen.next_due and not ask
            return self.silent(region, found, t_s, enough=enough, robust=seen.robust)
        return found

    def silent(
        self, region: int, found: Judgement, t_s: float, *, enough: bool = False, robust: bool = False
    ) -> Judgement:
        """A response said nothing for or against: enough of them end the trial. found : why it did not; with that.

        enough : this one does, because a change is due that must not wait for others. robust : by all samples the tried
        set is, and the models say nothing.
        """
        trial = self.of(region)
        if trial.phase != P.TRIAL:
            return found
        self._trials[region] = replace(trial, silent=trial.silent + 1)
        known = NOTHING_KNOWN._replace(by_loads=True) if robust else None
        few = trial.silent + 1 < self.settings.inconclusive and not enough
        if few or not self._stay_or_roll_back(region, E.TIMED_OUT, t_s, known):
            return found
        what = AFTER_SILENCE.get(self.phase(region), "stay")
        why = "another change is due" if enough else f"{trial.silent + 1} responses were inconclusive"
        return replace(found, reason=f"{found.reason}; {why}, the trial gains {what}")

    def to_dict(self) -> dict[str, object]:
        """All that later decisions depend on, in plain JSON values."""
        return {"at": self._at, "trials": {str(region): trial.to_dict() for region, trial in self._trials.items()}}

    def resume(self, body: Mapping[str, Any]) -> None:
        """Go on from there. Raises KeyError, TypeError, ValueError: something is missing, or no value of its kind."""
        self._at = body["at"]
        self._trials = {int(region): Trial.from_dict(trial) for region, trial in body["trials"].items()}
        self._notice()

    def _time_over(self, region: int, t_s: float) -> None:
        """A cool-down or hold ends by itself."""
        trial = self.of(region)
        if trial.phase in {P.COOLING, P.HELD} and t_s >= trial.until_s:
            self._move(region, E.COOLED if trial.phase == P.COOLING else E.HOLD_OVER, t_s)

    def _was_put(self, region: int, cause: TrialEvent) -> bool:
        """Whether a cause goes on that has been put to the region already, or asks for no more than the end has."""
        trial = self.of(region)
        stays = trial.back is not None and trial.back.stays
        put = trial.cause == cause or (trial.cause == E.STOPPED and cause in LASTING)
        return stays and put and trial.phase in {P.TRIAL, P.PAUSED, P.AWAY, P.ENSURING}

    def _rollback(self, region: int, cause: TrialEvent, known: StillAllowed | None = None) -> Rollback:
        """What is to run after a cause. known : of the process; None for what the region's models say."""
        return rollback(cause, self.of(region).sets, known or self._known(region), self.settings)

    def _stay_or_roll_back(self, region: int, cause: TrialEvent, t_s: float, known: StillAllowed | None = None) -> bool:
        """A cause that may end an undecided trial; whether anything was decided by it. known : see _rollback."""
        found = self._rollback(region, cause, known)
        if not found.stays or cause in ROLLBACK_CAUSES:
            return self._move(region, cause, t_s, found)
        self._trials[region] = replace(self.of(region), cause=cause, back=found)
        if cause == E.TIMED_OUT:
            return self._move(region, E.UNDECIDED_FOR_APPROVAL if self._asks(region) else E.UNDECIDED, t_s)
        event = E.ENSURED if cause in UNSURE else E.STAYS
        self._move(region, event, t_s)
        return True

    def _region_cause(
        self, at: int, sample: LoopSample, region: int | None, band: float, *, blended: bool
    ) -> TrialEvent | None:
        """What concerns one region's trial, if anything; comings and goings are taken note of."""
        if region != at:
            left = blended and self.phase(at) in {P.TRIAL, P.PAUSED}
            if left and not self._rollback(at, E.LEFT_INTERPOLATED).stays:
                return E.LEFT_INTERPOLATED
            self._move(at, E.LEFT, sample.t_s)
            return self._watch(at, sample, band) if blended and self.phase(at) == P.AWAY else None
        self._move(at, E.ENTERED, sample.t_s)
        trial = self.of(at)
        if trial.phase == P.PAUSED and not (trial.cause == E.SATURATED and sample.limited):
            self._move(at, E.WATCHED, sample.t_s)
        found = self._watch(at, sample, band)
        trial = self.of(at)  # which watching may have moved
        if found is not None or trial.phase != P.TRIAL or not self._asks(at) or trial.prediction is None:
            return found
        # a trial that no response decides is a person's, where he has the next word
        patience = trial.prediction.patience_s
        own_s = max(patience if math.isfinite(patience) else 0.0, self._tau_i_s(trial.new), self._shortest_s)
        return E.TIMED_OUT if sample.t_s - trial.since_s > self.settings.settles * own_s else None

    def _watch(self, at: int, sample: LoopSample, band: float) -> TrialEvent | None:
        trial = self.of(at)
        if trial.phase not in {P.TRIAL, P.AWAY} or trial.prediction is None:
            return None
        law = law_of(trial.prediction, self.settings, self._shortest_s, self._pv_range)
        seen, found = divergence_step(law, trial.seen or divergence_begin(sample.sp), sample, band)
        if seen is not trial.seen:
            self._trials[at] = replace(trial, seen=seen)
        return found

    def _move(self, region: int, event: TrialEvent, t_s: float, back: Rollback | None = None) -> bool:
        """The one way from phase to phase, with what belongs to entering each. back : what is to run, and why."""
        trial = self.of(region)
        now = after(trial.phase, event)
        if now == trial.phase:
            return False
        trial = replace(trial, phase=now, seen=None)
        if now == P.RESTORING:
            found = back or self._rollback(region, event)
            trial = replace(trial, cause=event, back=found, rollbacks=trial.rollbacks + (event in ROLLBACK_CAUSES))
        elif now == P.COOLING:
            base = self.settings.cool_down_s
            if base is None:
                tau_i_s = self._tau_i_s(trial.back.gains if trial.back else trial.old)
                base = max(self.settings.cool_down_tau_i * tau_i_s, self._shortest_s)
            doubled = min(max(trial.rollbacks - 1, 0), self.settings.cool_down_most)
            trial = replace(trial, until_s=t_s + base * 2.0**doubled)
        elif event in {E.PASSED, E.PASSED_FOR_APPROVAL, E.UNLOCKED, E.APPROVED}:
            trial = replace(trial, rollbacks=0, edits=0 if event in {E.UNLOCKED, E.APPROVED} else trial.edits)
        elif now in {P.AWAY, P.TRIAL} and trial.cause != E.STOPPED:  # the end goes on
            trial = replace(trial, cause=None, back=None)
        if event in {E.PASSED, E.PASSED_FOR_APPROVAL, E.UNDECIDED, E.UNDECIDED_FOR_APPROVAL}:
            trial = trial.with_earlier(trial.old)
        self._trials[region] = trial
        self._notice()
        if now == P.RESTORING and trial.back is not None:
            self._into_table(region, trial.back.gains)
        if now == P.COOLING and trial.rollbacks >= self.settings.lock_out_after:
            self._move(region, E.TOO_MANY_UNDOS, t_s)
        return True

    @staticmethod
    def _tau_i_s(gains: PidGains | None) -> float:
        return gains.kp / gains.ki if gains is not None and gains.ki else 0.0

    def _notice(self) -> None:
        self.busy = bool(self.undecided or self.restoring)


def _asked(urgent: bool, ordered: bool) -> TrialEvent:
    return E.ORDERED if ordered else E.URGENT if urgent else E.PROPOSED
