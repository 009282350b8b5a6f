"""The retuner: one sample in, now and then one decision out.

    sample -> watcher -> completed response -> pipeline -> decision
           -> trial desk -> the verified set is restored

The object is a thin shell round pure steps: no clock, no file, no bus. It never writes gains: it hands out a decision,
and learns by `committed` what the controller then reported.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from retuner.adaptive.diagnosis.oscillation_online import Standing
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.region_model.region_model import Belief
from retuner.adaptive.region_model.update import predicted
from retuner.adaptive.signals.recogniser import Phase
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.on_trial import held, promise_of, promised_wrongly, restoring, seen_of
from retuner.adaptive.supervision.pipeline import decide
from retuner.adaptive.supervision.pipeline_types import LEFT, ResponseRecord, StageResult
from retuner.adaptive.supervision.response_finder import Completed, Left, Watcher, WatcherState
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.expectation import Promise
from retuner.adaptive.trial.judge import Finding, Judgement
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.adaptive.trial.supervisor import TrialDesk
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable, Lookup


class RetunerState(NamedTuple):
    """Where a retuner stands; with its table and beliefs, all that later decisions depend on."""

    watcher: WatcherState
    decisions: int


class Retuner:
    """Watches one loop and decides.

    Parameters
    ----------
    table : regions and the gains in force in each.
    settings : see RetunerSettings.
    commissioned : the table as it was at first, when `table` is a later revision of it.
    """

    def __init__(self, table: GainTable, settings: RetunerSettings, commissioned: GainTable | None = None) -> None:
        self.settings = settings
        self.commissioned = commissioned or table
        self.beliefs: dict[int, Belief] = {}
        self.standing: dict[int, Standing] = {}
        self.excitation: dict[int, Excitation] = {}
        self._watcher = Watcher(table, settings)
        self._observe = self._watcher.take
        self.desk = TrialDesk(settings.trial, settings.sample_time_s, self._put_back)
        self._decisions = 0

    @property
    def table(self) -> GainTable:
        """The gains in force."""
        return self._watcher.table

    @property
    def region(self) -> int | None:
        """Index of the region that the loop is in, None before the first sample."""
        return self._watcher.region

    @property
    def scheduled(self) -> tuple[float, float]:
        """The scheduling values in force, x and x2: filtered, and the last good ones while one is not known."""
        return self._watcher.scheduled

    @property
    def phase(self) -> Phase | None:
        """Where the recogniser stands."""
        return self._watcher.phase

    @property
    def band(self) -> float:
        """Noise band in pv units."""
        return self._watcher.band

    def state(self) -> RetunerState:
        """Where it stands: see memory.py, which turns it into plain values."""
        return RetunerState(self._watcher.state(), self._decisions)

    def resume(self, state: RetunerState) -> None:
        """Go on from there."""
        self._watcher.resume(state.watcher)
        self._decisions = state.decisions

    def observe(self, sample: LoopSample) -> Decision | None:
        """Take one sample; a decision comes with the sample that completes a response.

        Raises
        ------
        ValueError
            A number of the sample is not finite or its time does not increase; nothing is changed then.
        """
        if self.desk.busy:
            return self._observe_trial(sample)
        seen = self._observe(sample)
        return None if seen is None else self._seen(seen)

    def committed(self, region: int, gains: PidGains) -> GainTable:
        """Take note that the controller now runs these gains in a region; returns the new table revision.

        gains : as read back from the controller (after its rounding).
        """
        if self.desk.phase(region) != TrialPhase.RESTORING:  # a write that was given up may come through after all
            self._watcher.gains_changed(self.table.with_gains(region, gains))
            self.desk.written(region, gains, self._now_s)
        return self.table

    def not_written(self, region: int) -> None:
        """Take note that a change was not written, and that the controller runs what it ran."""
        self.desk.event(region, TrialEvent.NOT_WRITTEN, self._now_s)

    def abort(self, cause: TrialEvent) -> Decision | None:
        """Something happened that ends every undecided trial; the decision to restore, None when there was none.

        The table has the verified sets when this returns; `restored` says that the controller runs them.
        """
        ended = self.desk.abort(cause, self._now_s)
        return self._give_up(dict.fromkeys(ended, cause)) if ended else None

    def restored(self) -> tuple[int, ...]:
        """Take note that the controller runs the table's gains, as read back; the regions that were to be restored."""
        return self.desk.restored(self._now_s)

    def ordered(
        self, region: int, outcome: StageResult, gains: PidGains | None = None, promised: Promise | None = None
    ) -> Decision:
        """The decision on what a person ordered (see by_order.py): gains to be written, None when it is not done.

        promised : what the gains are held to on trial; without a promise they are written and not on trial.
        """
        phase = self.desk.phase(region)
        free = self.desk.may_change(region, self._now_s, urgent=promised is None) or (
            promised is None and phase == TrialPhase.LOCKED
        )
        if gains is not None and not free:
            gains, outcome = None, StageResult(f"held_{phase.name.lower()}", f"nothing is changed now: {phase}")
        decision = replace(self._decision(region, outcome), action=Action.NONE, gains_after=None, promise=None)
        if gains is None:
            return decision
        if promised is not None:
            self.desk.begin(region, decision.gains_before, gains, promised, self._now_s)
        phase = self.desk.phase(region)
        return replace(decision, action=Action.COMMIT, gains_after=gains, promise=promised, trial=str(phase))

    def taken_back(self, region: int) -> Decision | None:
        """A person wants the change back that is undecided, or waits for approval; None when there is none."""
        back = self.desk.event(region, TrialEvent.ORDERED_BACK, self._now_s)
        return self._give_up({region: TrialEvent.ORDERED_BACK}) if back else None

    @property
    def _now_s(self) -> float:
        """Time of the newest sample."""
        return self._watcher.samples[-1].t_s if self._watcher.samples else 0.0

    def _put_back(self, region: int, gains: PidGains) -> None:
        """A region's verified set comes back into the table."""
        if self.table.gains_of(region) != gains:
            self._watcher.gains_changed(self.table.with_gains(region, gains))

    def _observe_trial(self, sample: LoopSample) -> Decision | None:
        """A sample while a change is undecided, or being taken back."""
        w, last_s, following = self._watcher, self._now_s, self._watcher.recogniser
        seen = self._observe(sample)
        gap_s = self.settings.gap_samples * self.settings.sample_time_s
        blended = self.table.lookup == Lookup.INTERPOLATED
        ended = self.desk.look(sample, w.region, w.band, sample.t_s - last_s, gap_s, blended=blended)
        if not ended:
            return None if seen is None else self._seen(seen)
        if seen is None and TrialEvent.RUNAWAY in ended.values():  # nothing teaches as much as this
            seen = w.cut_short(following)
        return self._give_up(ended, self._seen(seen) if seen is not None else None)

    def _give_up(self, ended: Mapping[int, TrialEvent], learned: Decision | None = None) -> Decision:
        """The decision to restore. learned : what the response under way has taught."""
        region, also = next(iter(ended)), [self.table.regions.names[other] for other in list(ended)[1:]]
        return self._restoring(region, learned or self._decision(region, StageResult("undo", "")), also)

    def _restoring(self, region: int, decision: Decision, also: Sequence[str] = ()) -> Decision:
        """The decision to restore."""
        trial = self.desk.trial(region)
        if promised_wrongly(trial, decision):
            self._forget(region)
        return restoring(decision, self.table.regions.names[region], trial, also)

    def _seen(self, seen: Completed | Left) -> Decision | None:
        """Something came to an end: decide on it."""
        if isinstance(seen, Left):
            return self._decision(seen.region, LEFT[seen.unknown]) if seen.under_way else None
        if self.settings.mode_of(seen.region) == Mode.OFF:
            return None
        case = self._case(seen)
        outcome = decide(case, self.settings)
        if outcome.belief is not None:
            self.beliefs[seen.region] = outcome.belief
        if outcome.standing is not None:
            self.standing[seen.region] = outcome.standing
        if outcome.excitation is not None:
            self.excitation[seen.region] = outcome.excitation
        if outcome.forget:
            self._forget(seen.region)
        judgement = self._judge(case, outcome)
        decision = self._decision(seen.region, outcome, seen.response, judgement)
        if judgement is not None and self.desk.phase(seen.region) == TrialPhase.RESTORING:
            return self._restoring(seen.region, decision)
        if decision.action == Action.COMMIT and decision.gains_after is not None and decision.promise is not None:
            self.desk.begin(
                seen.region,
                decision.gains_before,
                decision.gains_after,
                decision.promise,
                self._now_s,
                urgent=decision.verdict is not None and decision.verdict.urgent,
            )
            decision = replace(decision, trial=str(self.desk.phase(seen.region)))
        return decision

    def _forget(self, region: int) -> None:
        """Nothing is known of a region any more."""
        self.beliefs.pop(region, None)
        self.excitation.pop(region, None)

    def _judge(self, case: ResponseRecord, outcome: StageResult) -> Judgement | None:
        """The response against the promise, when it ran under gains on trial."""
        trial = self.desk.trial(case.region)
        if trial.phase != TrialPhase.TRIAL:
            return None
        if outcome.code == Ground.SATURATED.name.lower():
            self.desk.event(case.region, TrialEvent.SATURATED, self._now_s)
            return Judgement(Finding.INCONCLUSIVE, outcome.reason, dict(outcome.numbers))
        looked_at = seen_of(case, outcome, trial, self.settings)
        ask = self.settings.mode_of(case.region) == Mode.TRIAL
        return self.desk.judge(case.region, looked_at, case.in_force, self._now_s, ask=ask)

    def _case(self, seen: Completed) -> ResponseRecord:
        """Everything that the decision depends on."""
        w = self._watcher
        return ResponseRecord(
            seen.region,
            seen.response,
            w.window(seen.response),
            w.samples,
            w.table,
            self.commissioned,
            self.beliefs,
            self.standing.get(seen.region),
            self.excitation.get(seen.region, Excitation()),
            w.scheduled,
        )

    def _decision(
        self, region: int, outcome: StageResult, response: Response | None = None, judgement: Judgement | None = None
    ) -> Decision:
        """Put the record together."""
        phase_allows = self.desk.may_change(
            region, self._now_s, urgent=bool(outcome.verdict and outcome.verdict.urgent)
        )
        if not phase_allows:
            outcome = held(outcome, self.desk.trial(region), self._now_s)
        accepted = outcome.verdict is not None and outcome.verdict.accepted and phase_allows
        at = self._watcher.scheduled
        promised = promise_of(outcome, self.table, region, at, response, self.settings) if accepted else None
        return self._recorded(region, outcome, response, judgement, promised, accepted=accepted)

    def _recorded(
        self,
        region: int,
        outcome: StageResult,
        response: Response | None,
        judgement: Judgement | None,
        promised: Promise | None,
        *,
        accepted: bool,
    ) -> Decision:
        """The record; accepted : gains may be written, as far as proof and trial desk are concerned."""
        verdict, learned = outcome.verdict, outcome.learned
        mode = self.settings.mode_of(region)
        wanted = Action.COMMIT if mode in {Mode.AUTO, Mode.TRIAL} else Action.ADVISE
        belief = learned.belief if learned else None
        self._decisions += 1
        return Decision(
            number=self._decisions,
            t_s=self._watcher.samples[-1].t_s,
            loop=self.table.loop,
            region=self.table.regions.names[region],
            mode=mode,
            action=wanted if accepted else Action.NONE,
            code=outcome.code,
            reason=outcome.reason,
            numbers=outcome.numbers,
            gains_before=self.table.gains_of(region),
            gains_after=verdict.gains if verdict and accepted else None,
            response=response,
            estimate=learned.estimate if learned else None,
            surprise=learned.surprise if learned else None,
            records=belief.records if belief else 0,
            known=predicted(belief, self._now_s, self.settings.tracker) if belief else None,
            diagnosis=outcome.diagnosis,
            basis=outcome.basis,
            proposal=outcome.proposal,
            verdict=verdict,
            promise=promised,
            judgement=judgement,
            trial=str(self.desk.phase(region)),
        )
