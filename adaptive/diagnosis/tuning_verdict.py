"""Is it the tuning? The verdict where the loop by itself explains the record best.

The margins of the fitted process with the gains in force decide (tuning_cause.py), weighed over all models that the
record allows. Before gains may change, doubts are asked for: is the record explained, would a tone from outside do
better, does the model contradict the record?
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, CauseSettings, Diagnosis, tuning_cause
from retuner.adaptive.diagnosis.settings import DiagnosisSettings
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.identification.estimate import ModelEstimate, gain_spread
from retuner.adaptive.identification.identify import estimate_of
from retuner.adaptive.identification.robust_simc import RobustTuning, robust_simc
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains


@dataclass(frozen=True, slots=True)
class Found:
    """A diagnosis with what it rests on.

    estimate : the process, where it could be told. tuning : settings that would cure it, for causes of tuning.
    fits : explanations of pv by name.
    """

    diagnosis: Diagnosis
    estimate: ModelEstimate | None = None
    tuning: RobustTuning | None = None
    fits: Mapping[str, Candidate] = field(default_factory=dict)


def linear_verdict(
    window: Window,
    gains: PidGains | None,
    found: list[Candidate],
    evidence: dict[str, float],
    fits: Mapping[str, Candidate],
    oscillates: bool,
    settings: DiagnosisSettings,
) -> Found:
    """The loop by itself explains the record best: is it the tuning?"""
    estimate = estimate_of(found, float(window.t_s[0]), {}, settings.fit)
    events = evidence.get("setpoint_steps", 0.0) + evidence["loads"]
    if not events:
        return Found(_undisturbed(estimate, evidence, oscillates), estimate, fits=fits)
    if gains is None:
        reason = "the loop by itself explains the record; without the settings in force no more can be said"
        return Found(Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason), estimate, fits=fits)
    spread = gain_spread(estimate.plausible, window.sample_time_s)
    if not estimate.identifiable and spread > settings.spread_limit:
        return Found(Diagnosis(Cause.UNKNOWN, 0.5, evidence, estimate.reason), estimate, fits=fits)
    tuning = robust_simc(estimate, window.sample_time_s, settings.robust)
    verdict = _weighed(estimate, gains, tuning, window.sample_time_s, settings.cause)
    verdict = replace(verdict, evidence=verdict.evidence | evidence)
    doubt = _doubt(verdict, window, oscillates, settings) if verdict.cause in TUNING_CAUSES else None
    if doubt is not None:
        return Found(replace(verdict, cause=doubt[0], confidence=0.5, reason=doubt[1]), estimate, fits=fits)
    return Found(verdict, estimate, tuning if verdict.retune else None, fits)


def _doubt(
    verdict: Diagnosis, window: Window, oscillates: bool, settings: DiagnosisSettings
) -> tuple[Cause, str] | None:
    """Why a verdict may not change gains, if so, and what the cause is then."""
    evidence = verdict.evidence
    steps, loads, left = evidence.get("setpoint_steps", 0.0), evidence["loads"], evidence["linear_left"]
    if verdict.confidence < settings.majority:
        reason = f"perhaps {verdict.cause} ({verdict.confidence:.0%} of what the record allows): {verdict.reason}"
        return Cause.UNKNOWN, reason
    if left > (settings.explained_steps if steps > 1 else settings.explained) or loads >= (
        settings.many_loads_beside if steps else settings.many_loads
    ):
        reason = f"an unexplained disturbance: {loads:.0f} load steps and still {left:.1f} times the noise is left"
        return Cause.UNKNOWN, reason
    as_good = settings.tone_as_good if steps else settings.tone_as_good_loads
    as_likely = evidence.get("external_lead", -math.inf) > -settings.tone_odds
    if as_likely and evidence["external_left"] < as_good * left:
        return Cause.EXTERNAL, "load steps explain the record, but an oscillation from outside does it better"
    if oscillates and not steps:
        return Cause.EXTERNAL, "a lasting oscillation without a setpoint step that could have shown the tuning"
    if math.isinf(evidence["ms"]) and not _grows(window):
        reason = "the process that fits would be unstable with the gains in force, and the record does not grow"
        return Cause.UNKNOWN, reason
    return None


def _grows(window: Window) -> bool:
    """Whether the control error swings wider at the end of a record than before."""
    error = window.sp - window.pv
    third = len(error) // 3
    return float(np.std(error[-third:])) > GROWTH * float(np.std(error[third:-third]))


GROWTH = 1.3
"""Ratio of the last third's standard deviation to the middle third's from which a loop is running away."""


def _undisturbed(estimate: ModelEstimate, evidence: dict[str, float], oscillates: bool) -> Diagnosis:
    """Neither a setpoint nor a load step: noise, or a disturbance that nothing here explains.

    One tone never identifies a process: whatever G explains it explains any loop. What swings on and on without a
    cause inside comes from outside.
    """
    if oscillates:
        reason = f"a lasting oscillation of {evidence['period_s']:.3g} s without any step that could have begun it"
        return Diagnosis(Cause.EXTERNAL, 0.8, evidence, reason)
    if evidence.get("noise_share", 0.0) > NOISY or estimate.noise_std >= estimate.residual_std:
        return Diagnosis(Cause.NOISE, 0.8, evidence, "nothing but noise moves this loop")
    reason = "an unexplained disturbance moves this loop: neither steps nor a regular oscillation"
    return Diagnosis(Cause.UNKNOWN, 0.6, evidence, reason)


NOISY = 0.5
"""Share of white noise in the movement of pv from which noise is what moves it."""


def _weighed(
    estimate: ModelEstimate, gains: PidGains, tuning: RobustTuning, sample_time_s: float, settings: CauseSettings
) -> Diagnosis:
    """The verdict that most of the models share that the record allows; its weight is the confidence."""
    weights: dict[Cause, float] = defaultdict(float)
    firsts: dict[Cause, Diagnosis] = {}
    for p in estimate.plausible:
        model = p.model.seen_by_controller(sample_time_s)
        verdict = tuning_cause(model, gains, tuning.tuning.gains, 0.1, settings)
        weights[verdict.cause] += math.exp(-p.excess / 2)
        firsts.setdefault(verdict.cause, verdict)
    cause = max(weights, key=lambda c: weights[c])
    return replace(firsts[cause], confidence=weights[cause] / sum(weights.values()))
