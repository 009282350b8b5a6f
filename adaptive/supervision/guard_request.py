"""From what is known of a loop to the guard's question, may this region have these gains, and to what the judge is
shown of gains on trial: what they promise, what was seen, and what is known by then of the tried set and the old one.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from itertools import islice

import numpy as np

from retuner.adaptive.choice.expected_cost import (
    Choosable,
)
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis, over_words, tuning_cause, with_second_lag
from retuner.adaptive.guard import Verdict
from retuner.adaptive.guard.between_knots import eased, worst_between
from retuner.adaptive.guard.both_sides_of_border import borders_of, likeliest_between, mixed
from retuner.adaptive.guard.model_set import allowed
from retuner.adaptive.guard.request import ChangeRequest, Evidence, NeighbourBorder, Support
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import believed
from retuner.adaptive.region_model.at_knots import at_knots
from retuner.adaptive.region_model.from_neighbours import borrowed
from retuner.adaptive.region_model.kalman import gate
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import SECONDS_PER_DAY, Agreement, Learned, predicted
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.decision import Basis
from retuner.adaptive.supervision.pipeline_types import OTHER_LOOP, Findings, ResponseRecord, StageResult
from retuner.adaptive.supervision.proposal_from_model import RobustProposal, propose
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.judge import NOISE_RISES, JudgedResponse
from retuner.adaptive.trial.load_variability import wander_of
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.posterior_check import PosteriorCheck, check_posterior
from retuner.adaptive.trial.prediction import Prediction, decay_seen, predict, predict_without_model
from retuner.adaptive.trial.random_walk import beside_a_walk
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.table import GainTable, Lookup


@dataclass(frozen=True)
class KnownProcesses:
    """What is known of the processes where the regions' own sets run, worked out once a question.

    table : in force. region_models : by region, from records. t_s : now, s.
    """

    table: GainTable
    region_models: Mapping[int, RegionModel]
    t_s: float
    settings: RetunerSettings

    @cached_property
    def where_gains_run(self) -> Mapping[int, RegionModel]:
        """The models there: in an interpolated table at the knots. Of every region, by what the others lend where
        nothing is known of it itself.
        """
        regions, sign, settings = self.table.regions, self.table.gains[0].direction, self.settings
        hard, models = self.table.lookup is Lookup.HARD, self.region_models
        own = dict(models) if hard else at_knots(models, regions, self.t_s, settings.tracker)
        found = dict(own)
        for region in range(len(regions)):
            if region not in found:
                lent = borrowed(own, region, regions, self.t_s, sign, settings.borrowing, settings.tracker)
                found.update({} if lent is None else {region: lent})
        return found

    @cached_property
    def allowed(self) -> Mapping[int, tuple[Plausible, ...]]:
        """The models that are still allowed there, by region.

        A step ends at its border: of what is only lent beyond it, the likeliest model is asked. A mean of two sets runs
        all the way, and is asked of all.
        """
        found = {}
        for region, model in self.where_gains_run.items():
            only_lent = self.table.lookup is Lookup.HARD and region not in self.region_models
            found[region] = still_allowed(model, self.t_s, self.settings)[: 1 if only_lent else None]
        return found

    def borders(self, region: int) -> tuple[NeighbourBorder, ...]:
        """The ways from a region to its neighbours."""
        return borders_of(self.table, region, {i: models for i, models in self.allowed.items() if i != region})

    def likeliest(self, region: int) -> LogModel:
        """The likeliest process of a region where its gains run, as it may be met now."""
        return predicted(self.where_gains_run[region], self.t_s, self.settings.tracker)


def change_request(
    proposal: Tuning,
    region: int,
    commissioned: GainTable,
    known: KnownProcesses,
    learned: Learned | None,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that a model supports.

    Parameters
    ----------
    region : index. known : of all regions, that of this one as it is now.
    learned : outcome of the last record; None when none is at hand.
    damping : of the response, None when it did not swing.
    """
    settings, model = known.settings, known.region_models[region]
    contradicting = learned is not None and learned.agreement == Agreement.CONTRADICTS
    return ChangeRequest(
        in_force=known.table.gains_of(region),
        commissioned=commissioned.gains_of(region),
        proposal=proposal,
        models=known.allowed[region],
        sample_time_s=settings.sample_time_s,
        evidence=Evidence(
            records=model.records,
            age_s=max(known.t_s - model.t_s, 0.0),
            innovation=learned.innovation if learned is not None and contradicting else 0.0,
            gate=gate(len(model.log.x), settings.tracker.gate),
            borrowed=model.records == 0,
            settled=model.identifiable,
        ),
        borders=known.borders(region),
        filter_s=settings.filter_s,
        urgent=_urgent(damping, settings),
        locks=settings.locks_of(region),
        units=settings.units,
    )


def known_with(record: ResponseRecord, model: RegionModel, settings: RetunerSettings) -> KnownProcesses:
    """What is known at a response, its region's model as it is with it."""
    models = {**record.region_models, record.region: model}
    return KnownProcesses(record.table, models, float(record.window.t_s[-1]), settings)


BEYOND = 1.05
"""Times the limit of a cause above which a set is one at a border: the neighbour's model moves with its records."""


BETWEEN = "ms_between"
"""Evidence that a set is over its limit on the way to a neighbour: the Ms there."""


def choosable(record: ResponseRecord, known: KnownProcesses, gains: PidGains) -> Choosable:
    """A set of the record's region as it would run there, with its Ms on the ways to the neighbours."""
    region, settings = record.region, known.settings
    runs = known.table.with_gains(region, gains).at(region, *record.at)
    if len(known.table.regions) == 1:
        return Choosable(runs)
    process = known.likeliest(region).model()
    worst = worst_between(known.borders(region), process, gains, settings.sample_time_s, settings.filter_s)
    return Choosable(runs, worst.ms / settings.guard.ms_border if worst is not None else 0.0)


def tuning_of(known: KnownProcesses, region: int, in_force: PidGains) -> RobustProposal:
    """What the rule gives for a region, eased to what its part of the ways to the neighbours bears, and whether its
    tuning is a cause (guard/between_knots.py).

    In an interpolated table what ran, in_force, is a mean of several sets: asked is what the region's own does.
    """
    settings, hard = known.settings, known.table.lookup is Lookup.HARD
    dt_s, guard, model = settings.sample_time_s, settings.guard, known.where_gains_run[region]
    log, own = known.likeliest(region), in_force if hard else known.table.gains_of(region)
    found, process = propose(model, log, own, settings), log.model()
    borders = known.borders(region)
    limit, high = guard.ms_nominal, settings.cause.ms_high * (BEYOND if hard else 1.0)
    easier = eased(found.tuning.gains, borders, process, limit, dt_s, settings.filter_s)
    if easier == found.tuning.gains:
        return found
    given = (process.seen_by_controller(dt_s), own, easier, log.gain_uncertainty(dt_s), settings.cause)
    told = tuning_cause(*given, with_second_lag(model.plausible, dt_s))
    found = replace(found, tuning=replace(found.tuning, gains=easier), diagnosis=told)
    worst = worst_between(borders, process, own, dt_s, settings.filter_s)
    if worst is None or worst.ms <= high or abs(easier.ki) >= abs(own.ki):
        return found
    seen = "the loop is unstable" if math.isinf(worst.ms) else over_words(worst.ms, high)
    words = f"{seen} on the way to region {worst.to}"
    evidence = {**found.diagnosis.evidence, BETWEEN: worst.ms}
    return replace(found, diagnosis=Diagnosis(Cause.AGGRESSIVE, found.diagnosis.confidence, evidence, words))


def unproved_request(
    proposal: Tuning,
    region: int,
    tables: tuple[GainTable, GainTable],
    settings: RetunerSettings,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that no model supports; arguments as above."""
    in_force, commissioned = tables
    evidence = Evidence(records=0, support=Support.PATTERN)
    own = (in_force.gains_of(region), commissioned.gains_of(region))
    return ChangeRequest(
        *own,
        proposal,
        (),
        settings.sample_time_s,
        evidence,
        urgent=_urgent(damping, settings),
        locks=settings.locks_of(region),
        units=settings.units,
    )


def known_of(known: KnownProcesses, region: int) -> StillAllowed:
    """What is known of a region's process now, as it is asked which of its sets is to run.

    In an interpolated table that is asked at the region's knot, and half way to its neighbours. Of a region without
    records the others tell: its gains were proved on what they lend.
    """
    own, settings = known.where_gains_run.get(region), known.settings
    if own is None:
        return NOTHING_KNOWN
    dt_s, asked = settings.sample_time_s, still_allowed(own, known.t_s, settings)
    alone = tuple(found.model.seen_by_controller(dt_s).linear() for found in asked)
    likely = tuple(math.exp(-found.excess / (2.0 * settings.choice.temper)) for found in asked)
    if known.table.lookup is Lookup.HARD:
        return StillAllowed(alone, settings.filter_s, weights=likely)
    best = known.allowed[region][0].model
    halves = [
        (
            likeliest_between(border, best, HALF).seen_by_controller(dt_s).linear(),
            partial(mixed, border=border, share=HALF),
        )
        for border in known.borders(region)
    ]
    return StillAllowed(alone, settings.filter_s, tuple(halves), likely)


HALF = 0.5
"""Weight of a neighbour half way to it."""


def _urgent(damping: float | None, settings: RetunerSettings) -> bool:
    """Whether a response swings on as if it would not end."""
    return damping is not None and damping >= settings.guard.urgent_damping


def allowed_models(
    region: int, region_models: Mapping[int, RegionModel], t_s: float, settings: RetunerSettings
) -> tuple[Plausible, ...]:
    """The models of a region that its records still allow now; none where nothing is known of it."""
    known = region_models.get(region)
    return () if known is None else still_allowed(known, t_s, settings)


def still_allowed(region_model: RegionModel, t_s: float, settings: RetunerSettings) -> tuple[Plausible, ...]:
    """The models of a region that its records still allow now."""
    walk = settings.tracker.walk_per_day**2 * max(t_s - region_model.t_s, 0.0) / SECONDS_PER_DAY
    return allowed(predicted(region_model, t_s, settings.tracker), region_model.plausible, walk, settings.guard)


OUTSIDE = frozenset({Cause.EXTERNAL, Cause.STICTION, Cause.NOISE})
"""Causes behind a response for which the gains on trial are not to blame."""
NOT_ADMITTED = frozenset(ground.name.lower() for ground in Ground if ground not in {Ground.ADMITTED, Ground.SATURATED})


def may_follow(trial: Trial, settings: RetunerSettings) -> bool:
    """Whether a change may follow this response: of a region that rests or cools down, or whose trial it may end."""
    last_one = trial.kept + 1 >= settings.trial.responses
    return trial.phase in {TrialPhase.IDLE, TrialPhase.COOLING} or (trial.phase is TrialPhase.TRIAL and last_one)


def prediction_of(
    verdict: Verdict | None,
    table: GainTable,
    region: int,
    at: tuple[float, float],
    response: Response | None,
    settings: RetunerSettings,
    samples: Sequence[LoopSample] = (),
) -> Prediction | None:
    """What the accepted gains promise on the models on which they were proved; None when nothing was accepted.

    at : scheduling values; in an interpolated table, what runs there is a mean of several regions' sets.
    samples : all that are kept, for how much the error moves while nothing happens.
    """
    if verdict is None or verdict.gains is None:
        return None
    in_force, new = table.at(region, *at), table.with_gains(region, verdict.gains).at(region, *at)
    if verdict.allowed:
        prediction = predict(
            verdict.allowed, in_force, new, settings.sample_time_s, settings.setpoint_weight, settings.filter_s
        )
        prediction = replace(prediction, decay_seen=decay_seen(response))
    elif response:
        prediction = predict_without_model(response, in_force, new)
    else:
        return None
    swung = prediction.decay_seen is not None and prediction.decay_seen > settings.trial.harmless_decay
    return prediction if swung else replace(prediction, wander=wander_of(samples))


def prediction_of_verdict(found: Findings, verdict: Verdict) -> Prediction | None:
    """What the gains of a verdict promise; how pv moved before steps to and fro is what loads do by themselves."""
    record = found.record
    at = record.table, record.region, record.at
    told = prediction_of(verdict, *at, record.pattern, found.settings, record.samples)
    if told is None or found.steps is None:
        return told
    return replace(told, wander=max(told.wander, found.steps.wander))


def posterior_of(
    case: ResponseRecord, learned: Learned | None, trial: Trial, settings: RetunerSettings
) -> PosteriorCheck | None:
    """None where the record shows nothing of the process, or leaves more than noise unexplained."""
    if learned is None or trial.old is None or not learned.estimate.plausible:
        return None
    if case.crossed:
        # The same of a response that crossed a border: by all that is known of the region, where it agrees with that
        known = learned.region_model
        if known is None or learned.agreement != Agreement.AGREES:
            return None
        before = case.table.with_gains(case.region, trial.old).at(case.region, *case.at)
        allowed = believed(known.plausible, settings.guard.believed)
        found = check_posterior(
            allowed, before, case.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s
        )
        return replace(found, settled=known.identifiable)
    estimate = learned.estimate
    if (
        learned.agreement == Agreement.SILENT
        or _outvoted(learned)
        or estimate.unexplained(float(np.ptp(case.window.pv))) > settings.swing.unexplained
    ):
        return None
    old = case.table.with_gains(case.region, trial.old).at(case.region, *case.at)
    allowed = believed(estimate.plausible, settings.guard.believed)
    found = check_posterior(
        allowed, old, case.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s
    )
    known = learned.region_model
    agreed = learned.agreement == Agreement.AGREES and known is not None and known.records > AGREED
    return replace(found, settled=estimate.identifiable, agreed=agreed)


def walked(
    case: ResponseRecord, against: Sequence[Plausible], trial: Trial, settings: RetunerSettings
) -> StillAllowed | None:
    """What the loop did lately leaves of its process beside a load that wanders (trial/random_walk.py). Asked where the
    error was seen to wander before the change, else None.
    """
    prediction, noise = trial.prediction, case.response.band / NOISE_RISES
    if prediction is None or prediction.wander <= WANDERS * noise:
        return None
    models = [found.model for found in sorted(against, key=lambda found: found.excess)]
    limits = (settings.trial.harmless_ms, settings.trial.level)
    return beside_a_walk(case.samples, models, case.in_force, settings.sample_time_s, settings.filter_s, *limits)


WANDERS = 2.0
"""Standard deviation of the error before a change over that of the noise, from which a load wanders."""
AGREED = 2
"""Records that agree, from which on one that does not identify the process says nothing against what they show."""


def _outvoted(learned: Learned) -> bool:
    """The record contradicts several that agree, and could not name the process by itself: its load was no step."""
    known = learned.region_model
    records = known.records if known is not None else 0
    alone = learned.agreement == Agreement.CONTRADICTS and not learned.estimate.identifiable
    return alone and records >= AGREED


def seen_of(case: ResponseRecord, outcome: StageResult) -> JudgedResponse:
    """What the judge looks at: the response, how much of it was at a limit, whether something else was behind it, and
    what its own record says of the tried set and of the one before.
    """
    found, window = outcome.diagnosis, case.window
    blameless = outcome.code in {OTHER_LOOP, *NOT_ADMITTED} or (found is not None and found.cause in OUTSIDE)
    recent = islice(reversed(case.samples), len(window.t_s))
    limited = sum(1 for sample in recent if sample.limited) / len(window.t_s)
    outside = outcome.reason if blameless else ""
    verdict = outcome.verdict
    next_due = verdict is not None and verdict.accepted and (verdict.urgent or outcome.basis is Basis.ALL_SAMPLES)
    told = (outcome.posterior, case.crossed, next_due, outcome.walked)
    return JudgedResponse(case.response, window, limited, outside, *told)
