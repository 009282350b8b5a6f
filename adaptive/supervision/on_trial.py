"""Where the pipeline meets the trials: what a change promises, what the judge looks at, what is held back."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.identification.robust_simc import believed
from retuner.adaptive.region_model.update import ANEW, Learned, Surprise
from retuner.adaptive.signals.response import Response
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.decision import Action, Decision
from retuner.adaptive.supervision.pipeline_types import ResponseRecord, StageResult
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.expectation import Promise, decay_seen, promise, promise_without_model
from retuner.adaptive.trial.judge import JudgedResponse
from retuner.adaptive.trial.phase import UNDOS, TrialPhase
from retuner.adaptive.trial.posterior_check import PosteriorCheck, check_posterior
from retuner.adaptive.trial.settings import TrialSettings
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.table import GainTable

OUTSIDE = frozenset({Cause.EXTERNAL, Cause.STICTION, Cause.NOISE})
"""Causes behind a response for which the gains on trial are not to blame."""
NOT_ADMITTED = frozenset(ground.name.lower() for ground in Ground if ground not in {Ground.ADMITTED, Ground.SATURATED})


def may_follow(trial: Trial, settings: TrialSettings) -> bool:
    """Whether a change may follow this response: of a region that rests or cools down, or whose trial it may end."""
    last_one = trial.kept + 1 >= settings.responses
    return trial.phase in {TrialPhase.IDLE, TrialPhase.COOLING} or (trial.phase is TrialPhase.TRIAL and last_one)


def promise_of(
    outcome: StageResult,
    table: GainTable,
    region: int,
    at: tuple[float, float],
    response: Response | None,
    settings: RetunerSettings,
) -> Promise | None:
    """What the accepted gains promise on the models on which they were proved; None when nothing was accepted.

    at : scheduling values; in an interpolated table, what runs there is a mean of several regions' sets.
    """
    verdict = outcome.verdict
    if verdict is None or verdict.gains is None:
        return None
    in_force, new = table.at(region, *at), table.with_gains(region, verdict.gains).at(region, *at)
    if verdict.allowed:
        promised = promise(
            verdict.allowed, in_force, new, settings.sample_time_s, settings.setpoint_weight, settings.filter_s
        )
        return replace(promised, decay_seen=decay_seen(response))
    return promise_without_model(response, in_force, new) if response else None


def seen_of(case: ResponseRecord, outcome: StageResult) -> JudgedResponse:
    """What the judge looks at: the response, how much of it was at a limit, whether something else was behind it, and
    what its own record says of the tried set and of the one before.
    """
    found, window = outcome.diagnosis, case.window
    blameless = outcome.code in NOT_ADMITTED or (found is not None and found.cause in OUTSIDE)
    recent = islice(reversed(case.samples), len(window.t_s))
    limited = sum(1 for sample in recent if sample.limited) / len(window.t_s)
    outside = outcome.reason if blameless else ""
    return JudgedResponse(case.response, window, limited, outside, outcome.posterior)


def posterior_of(
    case: ResponseRecord, learned: Learned | None, trial: Trial, settings: RetunerSettings
) -> PosteriorCheck | None:
    """None where the record shows nothing of the process, or leaves more than noise unexplained."""
    if learned is None or trial.old is None or not learned.estimate.plausible:
        return None
    estimate = learned.estimate
    if (
        learned.surprise == Surprise.SILENT
        or estimate.unexplained(float(np.ptp(case.window.pv))) > settings.swing.unexplained
    ):
        return None
    old = case.table.with_gains(case.region, trial.old).at(case.region, *case.at)
    allowed = believed(estimate.plausible, settings.guard.believed)
    found = check_posterior(
        allowed, old, case.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s
    )
    return replace(found, settled=estimate.identifiable)


def held(outcome: StageResult, trial: Trial, now_s: float) -> StageResult:
    """The outcome with the reason why nothing may be changed now, when something was accepted."""
    if outcome.verdict is None or not outcome.verdict.accepted:
        return outcome
    words = str(trial.phase)
    if trial.phase == TrialPhase.COOLING:
        words += f" for another {max(trial.until_s - now_s, 0.0):,.0f} s after {trial.cause}"
    elif trial.phase == TrialPhase.LOCKED:
        words += f" after {trial.undos} changes that had to be undone; a person must unlock the region"
    elif trial.phase == TrialPhase.IDLE:
        words = "the change of another region is on its way"
    return replace(outcome, code=f"held_{trial.phase.name.lower()}", reason=f"nothing is changed now: {words}")


def promised_wrongly(trial: Trial, decision: Decision) -> bool:
    """Whether the models behind a change that is given up are not to be believed any more.

    decision : on the response that ended it; it may have put another model in their place.
    """
    by_models = trial.promise is not None and trial.promise.models > 0
    return trial.cause in UNDOS and by_models and decision.surprise not in ANEW


def restoring(decision: Decision, region: str, trial: Trial, also: Sequence[str]) -> Decision:
    """The decision that goes with taking a set back. also : other regions that are restored with this one."""
    cause = trial.cause
    assert cause is not None  # of a trial that is being restored
    judged = decision.judgement.reason if decision.judgement else ""
    reason = f"the verified gains are restored: {judged or cause}" + (f"; also in {', '.join(also)}" if also else "")
    if promised_wrongly(trial, decision):
        reason += "; what was known of this process had promised otherwise, and is forgotten"
    return replace(
        decision,
        region=region,
        action=Action.RESTORE,
        code=f"undo_{cause.name.lower()}",
        reason=reason,
        numbers={**decision.numbers, "undos": float(trial.undos)},
        gains_before=trial.new or decision.gains_before,
        gains_after=trial.old,
        promise=trial.promise,
        trial=str(trial.phase),
    )
