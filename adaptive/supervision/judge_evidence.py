"""What the judge is shown of gains on trial: what they were predicted to do, what was seen, what is known by then."""

import math
from collections.abc import Sequence
from itertools import islice

import numpy as np

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import believed
from retuner.adaptive.region_model.update import Agreement, Learned
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings
from retuner.adaptive.supervision.question import OTHER_LOOP, ResponseRecord
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.judge import JudgedResponse
from retuner.adaptive.trial.load_variability import load_variability
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.posterior_check import PosteriorCheck, check_posterior
from retuner.adaptive.trial.prediction import Prediction, decay_seen, predict, predict_without_model
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import replace
from retuner.schedule.table import GainTable

OUTSIDE = frozenset({Cause.EXTERNAL, Cause.STICTION, Cause.NOISE})
"""Causes behind a response for which the gains on trial are not to blame."""
NOT_ADMITTED = frozenset(ground.name.lower() for ground in Ground if ground not in {Ground.ADMITTED, Ground.SATURATED})
AGREED = 2
"""Records that agree, from which on one that does not identify the process says nothing against what they show."""


def may_follow(trial: Trial, settings: RetunerSettings) -> bool:
    """Whether a change may follow this response: of a region that rests or cools down, or whose trial it may end."""
    last_one = trial.kept + 1 >= settings.trial.responses
    return trial.phase in {TrialPhase.IDLE, TrialPhase.COOLING} or (trial.phase is TrialPhase.TRIAL and last_one)


def prediction_of(
    proof: Proof | None,
    table: GainTable,
    region: int,
    at: tuple[float, float],
    response: Response | None,
    settings: RetunerSettings,
    samples: Sequence[LoopSample] = (),
    last: Trial | None = None,
) -> Prediction | None:
    """What the accepted gains promise on the models on which they were proved; None when nothing was accepted.

    at : scheduling values; in an interpolated table, what runs there is a mean of several regions' sets.
    samples : all that are kept, for how much the error moves while nothing happens. last : the trial of the gains in
    force, which knows how far it moved before them, where they have not run for long.
    """
    if proof is None or proof.gains is None:
        return None
    in_force, new = table.at(region, *at), table.with_gains(region, proof.gains).at(region, *at)
    if proof.allowed:
        prediction = predict(
            proof.allowed, in_force, new, settings.sample_time_s, settings.setpoint_weight, settings.filter_s
        )
        prediction = replace(prediction, decay_seen=decay_seen(response))
    elif response:
        prediction = predict_without_model(response, in_force, new)
    else:
        return None
    swung = prediction.decay_seen is not None and prediction.decay_seen > settings.trial.harmless_decay
    wander, moved = load_variability(samples)
    if not moved and last is not None and last.prediction is not None and last.new == in_force:
        moved = last.prediction.moved
    cut = abs(new.kp) < abs(in_force.kp) or abs(new.ki) < abs(in_force.ki)  # else a swing passes for a load's
    own = (abs(one.sp - one.pv) for one in samples if one.revision == samples[-1].revision)
    furthest = max(own, default=math.inf)
    return replace(
        prediction, wander=0.0 if swung else wander, moved=0.0 if swung and cut else moved, furthest=furthest
    )


def prediction_of_proof(found: Findings, proof: Proof) -> Prediction | None:
    """What the gains of a proof promise; how pv moved before steps to and fro is what loads do by themselves."""
    record = found.record
    at = record.table, record.region, record.at
    told = prediction_of(proof, *at, record.pattern, found.settings, record.samples, found.question.trial)
    if told is None or found.steps is None:
        return told
    return replace(told, wander=max(told.wander, found.steps.wander))


def posterior_of(
    case: ResponseRecord, learned: Learned | None, trial: Trial, settings: RetunerSettings
) -> PosteriorCheck | None:
    """What the record of a trial says of both sets; None where it shows nothing of the process, or leaves more than
    noise unexplained. A response that crossed a boundary speaks by all that is known of the region it agrees with.
    """
    if learned is None or trial.old is None or not learned.estimate.plausible:
        return None
    known, estimate = learned.region_model, learned.estimate
    if case.crossed:
        if known is None or learned.agreement != Agreement.AGREES:
            return None
        return _both_sets(case, known.plausible, trial.old, settings, known.identifiable)
    # against several that agree, a record that names no process by itself: its load was no step
    odd = learned.agreement == Agreement.CONTRADICTS and not estimate.identifiable
    outvoted = odd and known is not None and known.records >= AGREED
    left = estimate.unexplained(float(np.ptp(case.window.pv)))
    if learned.agreement == Agreement.SILENT or outvoted or left > settings.swing.unexplained:
        return None
    found = _both_sets(case, estimate.plausible, trial.old, settings, estimate.identifiable)
    agreed = learned.agreement == Agreement.AGREES and known is not None and known.records > AGREED
    return replace(found, agreed=agreed)


def _both_sets(
    case: ResponseRecord, models: Sequence[Plausible], old: PidGains, settings: RetunerSettings, settled: bool
) -> PosteriorCheck:
    before = case.table.with_gains(case.region, old).at(case.region, *case.at)
    allowed = believed(models, settings.guard.believed)
    more = (settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    return replace(check_posterior(allowed, before, case.in_force, *more), settled=settled)


def seen_of(case: ResponseRecord, outcome: Outcome) -> JudgedResponse:
    """What the judge looks at: the response, how much of it was at a limit, whether something else was behind it, and
    what its own record says of the tried set and of the one before.
    """
    found, window = outcome.diagnosis, case.window
    blameless = outcome.code in {OTHER_LOOP, *NOT_ADMITTED} or (found is not None and found.cause in OUTSIDE)
    recent = islice(reversed(case.samples), len(window.t_s))
    limited = sum(1 for sample in recent if sample.limited) / len(window.t_s)
    outside = outcome.reason if blameless else ""
    proof = outcome.proof
    by_book = outcome.basis is Basis.ALL_SAMPLES
    next_due = proof is not None and proof.accepted and (proof.urgent or by_book)
    return JudgedResponse(
        case.response, window, limited, outside, outcome.posterior, case.crossed, next_due, outcome.robust
    )
