"""From a record to a cause: explain the record in rival ways, then look at what the best explanation means.

    no loop at work in the record (dead, manual, no response, ...)   unknown, said in words
    co at its limits for much of the time                            saturation
    nothing but noise                                                noise
    rivals.py: linear, external tone, stuck valve                    compared by the information criterion per record
        a stuck valve wins                                           stiction
        a tone wins                                                  external
        linear wins, the loop was excited, the record explained      the margins decide (tuning_cause.py)
        linear wins otherwise                                        unknown: an unexplained disturbance

Shapes and classic indexes (indexes/) screen and are evidence; they do not decide where the fits can. A verdict that may
change gains must hold on the models that the record allows, weighted by their likelihood.
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.diagnosis.indexes.condition import Condition
from retuner.adaptive.diagnosis.indexes.screening import Screening, screen
from retuner.adaptive.diagnosis.rivals import WHITE, external, linear
from retuner.adaptive.diagnosis.sticking import Sticking, sticking
from retuner.adaptive.diagnosis.tuning_cause import CauseSettings, tuning_cause
from retuner.adaptive.estimate import ModelEstimate
from retuner.adaptive.fit.candidate import Candidate
from retuner.adaptive.fit.choice import ChoiceSettings
from retuner.adaptive.identify import FitSettings, estimate_of
from retuner.adaptive.robust_settings import RobustSettings, RobustTuning, later, robust_simc
from retuner.adaptive.sample import Window
from retuner.schedule.gains import PidGains

PADDED = 4
"""Zero padding of the spectrum: peaks to a quarter of a line."""
FEWEST_CYCLES = 2
"""Cycles in the record of a tone that is looked for."""
SAME_TONE = 0.03
"""Two frequencies closer than this (in logarithms) lead to the same fit."""


@dataclass(frozen=True, slots=True)
class DiagnosisSettings:
    """Settings.

    saturated_share : share of samples at a limit of co from which saturation is the cause; 0.1 to 0.8, default 0.25.
    least_lead : by how much the criterion of an external tone or a stuck valve must be the smaller one;
        5 to 100, default 20 (odds of e^10). lead_per_sample : and by so much per sample; default 0.02.
    tone_explains : a tone that leaves no more than this many times the noise has explained the record, and a valve
        must do better; 1.05 to 1.5, default 1.15 (no limit cycle is as regular).
    stuck_handicap : where it leaves more, a valve may leave so many times as much: its band differs from stop to stop,
        and the scan may miss it; 1 to 2.5, default 1.6.
    rival_explains : a tone that leaves more than this many times the noise is none; 1.2 to 5, default 2.
    oscillating_residual : a linear explanation that leaves more than this many times the noise is put against its
        rivals even where nothing oscillates regularly; 1.05 to 3, default 1.12.
    explained : a change of gains needs a remainder within this many times the noise; 1.1 to 3, default 1.5.
    explained_steps : the same where several setpoint steps agree; 1.5 to 10, default 3.
    majority : weight of the models that must share a verdict that changes gains; 0.5 to 0.99, default 0.7.
    """

    saturated_share: float = 0.25
    least_lead: float = 20.0
    lead_per_sample: float = 0.02
    tone_explains: float = 1.15
    stuck_handicap: float = 1.6
    rival_explains: float = 2.0
    oscillating_residual: float = 1.12
    explained: float = 1.5
    explained_steps: float = 3.0
    majority: float = 0.7
    fit: FitSettings = field(
        default_factory=lambda: FitSettings(ChoiceSettings(most_loads=6, most_order=WHITE), most_samples=1000)
    )
    cause: CauseSettings = field(default_factory=lambda: CauseSettings(slack=1.75))
    robust: RobustSettings = field(default_factory=RobustSettings)


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


NOT_AT_WORK = frozenset(
    {Condition.DEAD_PV, Condition.DEAD_CO, Condition.NO_RESPONSE, Condition.MANUAL, Condition.NOT_CONTROLLING}
)
"""Conditions in which no loop is at work."""


def diagnose_window(
    window: Window,
    gains: PidGains | None,
    co_min: float | None = None,
    co_max: float | None = None,
    settings: DiagnosisSettings | None = None,
    *,
    direction: int | None = None,
) -> Found:
    """Name the cause of a loop's behaviour in a record.

    Parameters
    ----------
    window : the record. gains : in force; without them nothing can be said of the tuning.
    co_min, co_max : limits of co where known. direction : sign of the controller's gain where no more is known.
    """
    settings = settings or DiagnosisSettings()
    seen = screen(window, gains, co_min, co_max)
    obvious = _obvious(seen, settings)
    if obvious is not None:
        return Found(obvious)
    sign = gains.direction if gains else direction
    signs = (sign,) if sign else (1, -1)
    found = linear(window, signs, settings.fit.choice, settings.fit.most_samples)
    return _compared(window, gains, found, seen, settings)


def _obvious(seen: Screening, settings: DiagnosisSettings) -> Diagnosis | None:
    """What needs no fit."""
    condition, evidence = seen.condition.condition, dict(seen.evidence)
    share = seen.limits.low + seen.limits.high
    if condition in NOT_AT_WORK and condition != Condition.NOT_CONTROLLING:
        return Diagnosis(Cause.UNKNOWN, 1.0, evidence, seen.condition.sentence)
    if share > settings.saturated_share:
        reason = f"the controller output stands at a limit for {share:.0%} of the record"
        return Diagnosis(Cause.SATURATION, min(1.0, 0.5 + share), evidence, reason)
    if condition in {Condition.NOT_CONTROLLING, Condition.MOVING_SETPOINT}:
        return Diagnosis(Cause.UNKNOWN, 1.0, evidence, seen.condition.sentence)
    if condition == Condition.QUIET:
        return Diagnosis(Cause.NOISE, 0.9, evidence, seen.condition.sentence)
    return None


def _compared(
    window: Window, gains: PidGains | None, found: list[Candidate], seen: Screening, settings: DiagnosisSettings
) -> Found:
    """The linear explanation against its rivals."""
    best = found[0]
    fits = {"linear": best}
    evidence = dict(seen.evidence) | {"linear_left": _left(best), "loads": float(best.fit.misfit.loads)}
    by_loads = best.fit.misfit.loads > 0 and not seen.evidence.get("setpoint_steps")
    if seen.oscillates or by_loads or _left(best) > settings.oscillating_residual:
        period_s = seen.period_s or seen.evidence.get("period_s") or _time_scale(best)
        tone = external(best, _frequencies(best, period_s), settings.fit.choice.most_loads)
        valve = sticking(best, period_s, settings.fit.choice.most_loads)
        fits |= {"external": tone, "stuck": valve.fit}
        evidence |= {"external_left": _left(tone), "stuck_left": _left(valve.fit)}
        evidence |= {
            "external_lead": best.criterion - tone.criterion,
            "stuck_lead": best.criterion - valve.fit.criterion,
        }
        verdict = _rival_verdict(best, tone, valve, evidence, settings)
        if verdict is not None:
            return Found(verdict, fits=fits)
    return _linear_verdict(window, gains, found, evidence, fits, seen.oscillates, settings)


def _left(candidate: Candidate) -> float:
    """What a fit leaves, in standard deviations of the noise."""
    return candidate.colour.std / candidate.fit.misfit.record.noise_std


def _time_scale(best: Candidate) -> float:
    """A typical time of the record's movement where there is no period: a tenth of it."""
    return best.fit.misfit.record.span_s / 10


def _frequencies(best: Candidate, period_s: float) -> list[float]:
    """Where to look for a tone, rad/s: at the screened period, and at the peak of what the linear fit leaves."""
    record = best.fit.misfit.record
    left = record.pv - best.fit.at.explained
    power = np.abs(np.fft.rfft(left * np.hanning(len(left)), PADDED * len(left))) ** 2
    first = FEWEST_CYCLES * PADDED
    peak = first + int(np.argmax(power[first:]))
    found = [2 * math.pi / period_s, 2 * math.pi * peak / (PADDED * len(left) * record.sample_time_s)]
    return found if abs(math.log(found[1] / found[0])) > SAME_TONE else found[:1]


def _rival_verdict(
    best: Candidate, tone: Candidate, valve: Sticking, evidence: dict[str, float], settings: DiagnosisSettings
) -> Diagnosis | None:
    """Stiction or external, where one of them explains the record clearly better than the loop by itself."""
    n = len(best.fit.misfit.record.pv)
    needed = max(settings.least_lead, settings.lead_per_sample * n)
    leads = {Cause.EXTERNAL: evidence["external_lead"], Cause.STICTION: evidence["stuck_lead"]}
    if max(leads.values()) < needed:
        return None
    tone_left, stuck_left = evidence["external_left"], evidence["stuck_left"]
    if leads[Cause.STICTION] < needed or (tone_left <= settings.tone_explains and tone_left < stuck_left):
        cause = Cause.EXTERNAL
    else:
        cause = Cause.STICTION if stuck_left < settings.stuck_handicap * tone_left else Cause.EXTERNAL
    if min(tone_left, stuck_left) > settings.rival_explains and cause == Cause.EXTERNAL:
        reason = (
            f"something swings here that is neither the loop's own doing nor a regular tone nor a valve of one stick "
            f"band: {tone_left:.1f} times the noise is left at best"
        )
        return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)
    apart = abs(math.log(stuck_left / tone_left / (1 if cause == Cause.EXTERNAL else settings.stuck_handicap)))
    confidence = 0.5 + 0.5 * math.tanh(min(leads[cause] / needed / 2, 4 * apart))
    if cause == Cause.STICTION:
        evidence |= {"stick": valve.valve.stick, "slip_jump": valve.valve.jump}
        reason = (
            f"a valve that sticks over {valve.valve.stick:.3g} of co and jumps by {valve.valve.jump:.3g} explains the "
            f"record; without it {evidence['linear_left']:.1f} times the noise is left, with it "
            f"{evidence['stuck_left']:.1f}"
        )
    else:
        period = 2 * math.pi / math.exp(float(tone.fit.p[-1]))
        evidence["external_period_s"] = period
        reason = (
            f"an oscillation from outside with a period of {period:.3g} s explains the record; without it "
            f"{evidence['linear_left']:.1f} times the noise is left, with it {evidence['external_left']:.1f}"
        )
    return Diagnosis(cause, confidence, evidence, reason)


def _linear_verdict(
    window: Window, gains: PidGains | None, found: list[Candidate], evidence: dict[str, float],
    fits: Mapping[str, Candidate], oscillates: bool, settings: DiagnosisSettings,
) -> Found:  # fmt: skip
    """The loop by itself explains the record best: is it the tuning?"""
    estimate = estimate_of(found, float(window.t_s[0]), {}, settings.fit)
    events = evidence.get("setpoint_steps", 0.0) + evidence["loads"]
    if not events:
        return Found(_undisturbed(estimate, evidence, oscillates), estimate, fits=fits)
    if gains is None:
        reason = "the loop by itself explains the record; without the settings in force no more can be said"
        return Found(Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason), estimate, fits=fits)
    if not estimate.identifiable:
        return Found(Diagnosis(Cause.UNKNOWN, 0.5, evidence, estimate.reason), estimate, fits=fits)
    tuning = robust_simc(estimate, window.sample_time_s, settings.robust)
    verdict = _weighed(estimate, gains, tuning, window.sample_time_s / 2, settings.cause)
    verdict = replace(verdict, evidence=verdict.evidence | evidence)
    if verdict.cause in TUNING_CAUSES:
        if verdict.confidence < settings.majority:
            reason = f"perhaps {verdict.cause} ({verdict.confidence:.0%}): {verdict.reason}"
            return Found(replace(verdict, cause=Cause.UNKNOWN, reason=reason), estimate, fits=fits)
        limit = settings.explained_steps if evidence.get("setpoint_steps", 0.0) > 1 else settings.explained
        if evidence["linear_left"] > limit or evidence["loads"] >= settings.fit.choice.most_loads:
            reason = (
                f"an unexplained disturbance: {evidence['loads']:.0f} load steps and still "
                f"{evidence['linear_left']:.1f} times the noise is left"
            )
            return Found(replace(verdict, cause=Cause.UNKNOWN, reason=reason), estimate, fits=fits)
    return Found(verdict, estimate, tuning if verdict.retune else None, fits)


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
    estimate: ModelEstimate, gains: PidGains, tuning: RobustTuning, half_sample_s: float, settings: CauseSettings
) -> Diagnosis:
    """The verdict that most of the models share that the record allows; its weight is the confidence."""
    weights: dict[Cause, float] = defaultdict(float)
    firsts: dict[Cause, Diagnosis] = {}
    for p in estimate.plausible:
        model = later(p.model, half_sample_s)
        verdict = tuning_cause(model, gains, tuning.tuning.gains, 0.1, settings)
        weights[verdict.cause] += math.exp(-p.excess / 2)
        firsts.setdefault(verdict.cause, verdict)
    cause = max(weights, key=lambda c: weights[c])
    return replace(firsts[cause], confidence=weights[cause] / sum(weights.values()))
