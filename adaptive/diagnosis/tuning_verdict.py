"""Is it the tuning? The verdict where the loop by itself explains the record best.

The margins of the fitted process with the gains in force decide (cause.py), weighed over all models that the
record allows. Before gains may change, doubts are asked for: is the record explained, would a tone from outside do
better, does the model contradict the record?
"""

import math
from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from retuner.adaptive.diagnosis.cause import (
    TUNING_CAUSES,
    Cause,
    CauseSettings,
    Diagnosis,
    asks_for_less,
    tuning_cause,
    with_second_lag,
)
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import moves_pv
from retuner.adaptive.fit.record import apart, setpoint_changes
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.identification.dead_time_bound import bounded
from retuner.adaptive.identification.estimate import ModelEstimate, factor_text, gain_spread
from retuner.adaptive.identification.first_step import MOST_AT_ONCE, first_step
from retuner.adaptive.identification.identify import FEWEST_SAMPLES_IN_THETA, TWO_WAYS, Fits, estimate_of
from retuner.adaptive.identification.robust_simc import RobustTuning, robust_simc
from retuner.adaptive.indexes.condition import one_sided
from retuner.adaptive.indexes.harmonics import pure_tone_s
from retuner.adaptive.indexes.recording_quality import hidden_sigma
from retuner.adaptive.loop.margins import margins, sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.valve.valve_fit import with_play
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace


@dataclass(frozen=True, slots=True)
class RecordVerdict:
    """A diagnosis with what it rests on.

    estimate : the process, where it could be told. tuning : settings that would cure it, for causes of tuning.
    fits : explanations of pv by name. aim : where tuning is a first step only, the settings that it leads to.
    """

    diagnosis: Diagnosis
    estimate: ModelEstimate | None = None
    tuning: RobustTuning | None = None
    fits: Mapping[str, Candidate] = field(default_factory=dict)
    aim: RobustTuning | None = None


@dataclass(frozen=True, slots=True)
class JudgedLoop:
    """What a verdict is about. found : linear explanations, best first. fits : as identification makes them.

    tone : the explanation by an oscillation from outside, where one was tried.
    """

    window: Window
    gains: PidGains
    found: list[Candidate]
    fits: Fits
    settings: DiagnosisSettings
    tone: Candidate | None = None

    @property
    def best(self) -> Candidate:
        """The explanation that the verdict rests on."""
        return self.found[0]


def linear_verdict(
    window: Window,
    gains: PidGains | None,
    found: list[Candidate],
    evidence: dict[str, float],
    fits: Mapping[str, Candidate],
    oscillates: bool,
    settings: DiagnosisSettings,
) -> RecordVerdict:
    """The loop by itself explains the record best: is it the tuning?"""
    estimate = estimate_of(found, float(window.t_s[0]), {}, settings.fit)
    if setpoint_changes(window):  # a load whose time is not known bounds no dead time
        estimate = bounded(window, estimate, settings.fit)
    events = evidence.get("setpoint_steps", 0.0) + evidence["loads"]
    if not events:
        return RecordVerdict(_undisturbed(window, estimate, evidence, oscillates), estimate, fits=fits)
    if gains is None:
        reason = "the loop alone explains the record; give the active settings for a verdict on the tuning"
        return RecordVerdict(Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason), estimate, fits=fits)
    loop = JudgedLoop(
        window, gains, found, Fits(window, (gains.direction,), settings.identified), settings, fits.get("external")
    )
    reason = estimate.reason + not_brought_back(window)
    told = _by_margins(loop, RecordVerdict(Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason), estimate), oscillates)
    told = replace(told, fits=fits)
    return told if oscillates or told.diagnosis.cause is not Cause.UNKNOWN else _in_order(loop, told)


def _by_margins(loop: JudgedLoop, found: RecordVerdict, oscillates: bool) -> RecordVerdict:
    """The verdict by the margins of the models that the record allows. found : nothing said as yet."""
    window, settings, estimate = loop.window, loop.settings, found.estimate
    assert estimate is not None
    spread = gain_spread(estimate.plausible, window.sample_time_s)
    far = not estimate.identifiable and spread > settings.spread_limit
    if far and not estimate.log.model().linear().integrators:
        return found
    tuning = robust_simc(estimate, window.sample_time_s, settings.robust, loop.gains)
    verdict = weighed(estimate, loop.gains, tuning, window.sample_time_s, settings.cause)
    verdict = replace(verdict, evidence=verdict.evidence | found.diagnosis.evidence)
    if far:
        slow = verdict.cause is Cause.SLOW_INTEGRATING and _doubt(verdict, loop, oscillates) is None
        return (_slow_oscillation(loop, RecordVerdict(verdict, estimate)) if slow else None) or found
    if verdict.cause in TUNING_CAUSES and estimate.explained < settings.fit.explained_limit:
        cause, sure, why = Cause.UNKNOWN, 0.5, estimate.reason
        if verdict.evidence.get("noise_share", 0.0) > NOISY:
            cause, sure, why = Cause.NOISE, 0.8, "only noise moves this loop"
        return RecordVerdict(replace(verdict, cause=cause, confidence=sure, reason=why), estimate)
    if verdict.cause not in TUNING_CAUSES:
        return _if_agreed(loop, RecordVerdict(verdict, estimate))
    doubt = _doubt(verdict, loop, oscillates)
    if doubt is not None and (not doubt.may_be_asked or not second_opinion(loop, verdict)):
        return RecordVerdict(replace(verdict, cause=doubt.cause, confidence=0.5, reason=doubt.reason), estimate)
    return _if_agreed(loop, RecordVerdict(verdict, estimate, tuning), asked=doubt is not None)


def _in_order(loop: JudgedLoop, found: RecordVerdict) -> RecordVerdict:
    """The verdict, "in order" where the cause stays open but the setpoint responses speak for themselves.

    The loop has followed its setpoint without much overshoot, and without load steps at the setpoint changes the record
    is explained by models on all of which the loop is robust. How fast it could be they do not say.
    """
    verdict, settings = found.diagnosis, loop.settings
    if not setpoint_changes(loop.window) or verdict.evidence.get("overshoot", math.inf) > settings.most_overshoot:
        return found
    estimate = estimate_of(loop.fits.barred, float(loop.window.t_s[0]), {}, loop.settings.identified)
    few = len(estimate.load_times_s) < settings.many_loads_beside
    if estimate.explained < settings.in_order_explained or not few:
        return found
    dt, gains = loop.window.sample_time_s, loop.gains
    peaks = [sensitivity_peak(p.model.seen_by_controller(dt).linear(), gains) for p in estimate.plausible]
    weights = np.exp([-p.excess / 2 for p in estimate.plausible])
    robust = float(weights @ (np.array(peaks) <= settings.cause.ms_high)) / float(np.sum(weights))
    if peaks[0] > settings.cause.ms_high or robust < settings.majority:
        return found
    told = f"the loop follows its setpoint without much overshoot, Ms {peaks[0]:.2f}"
    open_because = CONTRADICTED if verdict.reason == UNSTABLE else verdict.reason
    room = robust_simc(estimate, dt, settings.robust, gains).tuning.gains.ki / gains.ki if gains.ki else math.inf
    seen = margins(estimate.plausible[0].model.seen_by_controller(dt).linear(), gains)  # of the model that is told of
    kept = {name: value for name, value in verdict.evidence.items() if name not in RATIOS}
    evidence = kept | {"ms": seen.ms, "gm": seen.gm, "pm_deg": seen.pm_deg}
    if max(room, verdict.evidence.get("ki_ratio", 0.0)) > settings.cause.slack:
        slow = f"{told}, and is perhaps slower than necessary: {open_because}"
        return replace(found, diagnosis=replace(verdict, evidence=evidence, reason=slow))
    reason = f"{told}. The record does not show how fast it could be: {open_because}"
    return replace(found, diagnosis=Diagnosis(Cause.OK, 0.6, evidence, reason))


RATIOS = frozenset({"ki_ratio", "kp_ratio"})  # evidence of how much faster a loop could be


def _if_agreed(loop: JudgedLoop, found: RecordVerdict, *, asked: bool = False) -> RecordVerdict:
    """The verdict, unless another model of the record, as good as its own, gives other settings.

    asked : identification has confirmed the cause already, with a model of its own.
    """
    estimate, verdict, settings = found.estimate, found.diagnosis, loop.settings
    assert estimate is not None
    rival = loop.fits.rival(loop.best)
    if rival is not None:
        estimate = replace(estimate, rival=rival)
        if rival.apart > settings.fit.apart_limit:
            estimate = replace(estimate, identifiable=False, reason=rival.sentence)
            return _torn(loop, replace(found, estimate=estimate), rival.model, rival.sentence)
    if verdict.cause not in TUNING_CAUSES:
        return replace(found, estimate=estimate)
    in_order = _in_order_with_play(loop, found)
    if in_order:
        told = replace(verdict, cause=Cause.UNKNOWN, confidence=0.5, reason=in_order)
        return replace(found, diagnosis=told, estimate=estimate, tuning=None)
    # The settings that would cure it, where identification knows the process as well and means the same
    found = replace(found, estimate=estimate)
    other = loop.fits.estimate()
    if setpoint_changes(loop.window):
        other = bounded(loop.window, other, loop.settings.identified)
    between = apart(estimate.log.model(), other.log.model(), loop.window.sample_time_s)
    unsure = next((e.reason for e in (estimate, other) if not e.identifiable), "")
    if hidden_sigma(loop.window.pv):
        unsure = unsure or "pv was compressed by its recorder, and the shape of a response is the recorder's"
    if not unsure and between > loop.settings.fit.apart_limit:
        unsure = TWO_WAYS.format(factor_text(between))
        if not asked:
            return _torn(loop, found, other.log.model(), unsure)
    if not unsure:
        assert found.tuning is not None
        events = verdict.evidence.get("setpoint_steps", 0.0) + verdict.evidence["loads"]
        step = first_step(found.tuning, loop.gains, events, estimate.log.model(), loop.window.sample_time_s)
        if step is None:
            return found  # no farther at once than the record carries
        told = replace(verdict, reason=f"{verdict.reason}; {step.sentence}")
        return replace(found, diagnosis=told, tuning=step.now, aim=step.aim)
    slow = _slow_oscillation(loop, found)
    if slow is not None:
        return slow
    # by a model that is not known, a loop is not called slow that overshoots: the loads that explain it are a cover
    covered = _overshoots(found.diagnosis.evidence, loop.settings) if found.diagnosis.cause is Cause.SLUGGISH else ""
    if covered and found.diagnosis.evidence["loads"]:
        return _torn(loop, found, other.log.model(), f"perhaps sluggish, by a model that needs load steps{covered}")
    return _open(found, unsure)


def _in_order_with_play(loop: JudgedLoop, found: RecordVerdict) -> str:
    """Why the valve and not the tuning may be the cause, empty when it is not so.

    Play in a valve slows the loop and turns its phase, and a linear fit takes it for a longer lag. A valve with play
    that explains the record as well must agree on the cause. It hardly ever does so where there is no play.
    """
    assert found.tuning is not None
    least = loop.best.criterion
    most, limit = loop.settings.fit.choice.most_loads, least + loop.settings.play_asked
    asked = {candidate.found: candidate for candidate in loop.found if candidate.criterion < limit}
    rivals = [with_play(candidate, most) for candidate in asked.values()]
    played = min(rivals, key=lambda s: s.fit.criterion)
    if played.fit.criterion > least:
        return ""
    model = played.fit.model.seen_by_controller(loop.window.sample_time_s)
    other = tuning_cause(model, loop.gains, found.tuning.tuning.gains, 0.1, loop.settings.cause)
    if other.cause == found.diagnosis.cause:
        return ""
    share = played.valve.stick / played.fit.fit.misfit.record.co_range
    return (
        f"a valve with play of {share:.0%} of the range of co explains the record as well. "
        f"With it the cause is {other.cause}: {other.reason}. Without it it is {found.diagnosis.cause}"
    )


def _slow_oscillation(loop: JudgedLoop, found: RecordVerdict) -> RecordVerdict | None:
    """The cure of a slow swing of an integrating loop, which hangs on k' alone; None where it is none, or k' not known.

    The factor on k' Kc tau_I that makes it DAMPED (rules/slow_oscillation.py) is shared by gain and integral time, the
    gain growing no more than one event carries, and only as far as every model bears it with an interval more of dead
    time.
    """
    estimate, now = found.estimate, loop.gains
    assert estimate is not None
    model, dt = estimate.log.model(), loop.window.sample_time_s
    if found.diagnosis.cause is Cause.AGGRESSIVE or model.linear().integrators != 1 or not (now.kp and now.ki):
        return None
    other, product = loop.fits.estimate().log.model(), abs(model.k * now.kp * now.kp / now.ki)
    unlike = other.linear().integrators != 1 or abs(math.log(other.k / model.k)) > 2 * SLOPE_KNOWN
    unsure = unlike or estimate.log.std()["k"] > SLOPE_KNOWN * abs(model.k) or hidden_sigma(loop.window.pv) > 0
    if unsure or product >= DAMPED or without_second_lag(model).theta_s >= FEWEST_SAMPLES_IN_THETA * dt:
        return None
    late = [replace(p.model, theta_s=p.model.theta_s + dt).seen_by_controller(dt) for p in estimate.plausible]
    most = min(math.sqrt(DAMPED / product), MOST_AT_ONCE)
    for factor in np.geomspace(most, 1.0, GAINS_TRIED).tolist():
        new = PidGains(now.kp * factor, now.ki * product / DAMPED * factor**2, now.kd * factor)
        peaks = [sensitivity_peak(one.linear(), new) for one in late]
        if max(peaks) <= loop.settings.cause.ms_high:
            told = (
                f"a slow oscillation of an integrating loop by too little k' Kc tau_I: {product:.2g}, where {DAMPED:g} "
                f"does not swing. The dead time, shorter than the {dt:.3g} s logging interval, hardly matters"
            )
            tuning = RobustTuning(Tuning("slow-oscillation", "series", new), peaks[0], max(peaks))
            return replace(found, diagnosis=replace(found.diagnosis, reason=told), tuning=tuning)
    return None


DAMPED, SLOPE_KNOWN, GAINS_TRIED = 4.0, 0.1, 6
"""k' Kc tau_I from which PI on an integrator does not swing; how well k' must be known, a standard deviation's share;
gains that are tried between the largest and the old."""


def _torn(loop: JudgedLoop, found: RecordVerdict, other: ProcessModel, why: str) -> RecordVerdict:
    """Two models of a record far apart: no settings, and no cause but that the loop is too strong on either."""
    verdict = found.diagnosis
    strong = sensitivity_peak(other.linear(), loop.gains) > loop.settings.cause.ms_high
    if verdict.cause is Cause.AGGRESSIVE and strong:
        return _open(found, why)
    return replace(found, diagnosis=replace(verdict, cause=Cause.UNKNOWN, confidence=0.5, reason=why), tuning=None)


def _open(found: RecordVerdict, why: str) -> RecordVerdict:
    """The cause without settings, and without a number that rests on what is not known."""
    slow = found.diagnosis.cause is Cause.SLUGGISH
    told = "loads are rejected more slowly than necessary" if slow else found.diagnosis.reason
    reason = f"{told}. No settings: {why}"
    return replace(found, diagnosis=replace(found.diagnosis, reason=reason, settled=False), tuning=None)


def second_opinion(loop: JudgedLoop, verdict: Diagnosis) -> bool:
    """Whether identification's own fit, with no load step at a setpoint change, names the same cause.

    It whitens what is left instead of buying load steps, so a verdict that many of them, or a tone, put in doubt is
    seen by it in another light.
    """
    settings = loop.settings
    estimate = estimate_of(loop.fits.barred, float(loop.window.t_s[0]), {}, loop.settings.identified)
    if len(estimate.load_times_s) > settings.second_loads:
        return False
    tuning = robust_simc(estimate, loop.window.sample_time_s, settings.robust, loop.gains)
    other = weighed(estimate, loop.gains, tuning, loop.window.sample_time_s, settings.cause)
    calms = asks_for_less(other, settings.cause)
    same = calms == asks_for_less(verdict, settings.cause) and (calms or other.cause is verdict.cause)
    return same and other.confidence >= settings.majority


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why a verdict may not change gains, and what the cause is then. may_be_asked : a second opinion may dispel it."""

    cause: Cause
    reason: str
    may_be_asked: bool = False


def _doubt(verdict: Diagnosis, loop: JudgedLoop, oscillates: bool) -> Doubt | None:
    """The first doubt of a verdict that would change gains."""
    evidence, window, settings = verdict.evidence, loop.window, loop.settings
    steps, loads, left = evidence.get("setpoint_steps", 0.0), evidence["loads"], evidence["linear_left"]
    if verdict.confidence < settings.majority and not settings.by_odds:
        reason = f"perhaps {verdict.cause} ({verdict.confidence:.0%} of what the record allows): {verdict.reason}"
        return Doubt(Cause.UNKNOWN, reason)
    refuted = math.isinf(evidence["ms"]) and not _grows(window)
    explained = left < settings.second_explained and not refuted
    unexplained = _unexplained(steps, loads, left, settings)
    if unexplained:
        seen = _overshoots(evidence, settings) or not_brought_back(window)
        return Doubt(Cause.UNKNOWN, unexplained + seen, explained)
    by_tone = None if settings.by_odds else _tone_doubt(loop, evidence, explained and not oscillates)
    if by_tone is not None and (not steps or moves_pv(loop.tone, evidence, settings)):
        return by_tone
    as_likely = evidence.get("external_lead", -math.inf) > -settings.tone_odds
    if oscillates and not steps and (as_likely or not explained):
        return Doubt(Cause.EXTERNAL, "a lasting oscillation without a setpoint step that could have shown the tuning")
    pv, noise = loop.best.fit.misfit.record.pv, evidence.get("noise_share", 0.0)
    away = float(np.var(pv - loop.best.fit.explained) / np.var(pv))  # of pv's variance, its noise with it
    share = 1 - max(away - noise, 0.0) / max(1 - noise, 1e-9)
    if not steps and share < settings.explained_alone:
        reason = f"perhaps {verdict.cause}: by load steps alone, and {1 - share:.0%} of pv's movement is unexplained"
        return Doubt(Cause.UNKNOWN, reason)
    waves = _waves(loop.best.fit.explained)
    if verdict.cause == Cause.AGGRESSIVE and not steps and waves < settings.waves_a_load * loads:
        reason = f"perhaps aggressive, but {loads:.0f} load steps are needed to explain {waves} half cycles"
        return Doubt(Cause.UNKNOWN, reason)
    if refuted:
        return Doubt(Cause.UNKNOWN, UNSTABLE)
    return None


def _tone_doubt(loop: JudgedLoop, evidence: Mapping[str, float], explained: bool) -> Doubt | None:
    """The doubt where a tone explains a record as well or better than load steps.

    A second fit without a tone dispels it where the tone is not the likelier one: it would be as near its boundary.
    """
    settings, lead = loop.settings, evidence.get("external_lead", -math.inf) + by_coincidence(evidence)
    as_good = settings.tone_as_good if evidence.get("setpoint_steps", 0.0) else settings.tone_as_good_loads
    may_be_asked = explained and lead < min(settings.least_lead, settings.tone_odds)
    if lead > -settings.tone_odds and evidence["external_left"] < as_good * evidence["linear_left"]:
        assert loop.tone is not None
        period_s = 2 * math.pi / math.exp(float(loop.tone.fit.p[-1]))
        if loop.tone.fit.misfit.record.span_s >= settings.tone_cycles * period_s:  # fewer cycles are a load's
            reason = "load steps explain the record, but an external oscillation explains it better"
            return Doubt(Cause.EXTERNAL, reason, may_be_asked)
        reason = (
            f"load steps explain the record; a swing of {period_s:.3g} s does it better, too short to tell its cause"
        )
        return Doubt(Cause.UNKNOWN, reason + _overshoots(evidence, settings), may_be_asked)
    if lead > 0:
        reason = "load steps explain the record, and an external oscillation does so about as well"
        return Doubt(Cause.UNKNOWN, reason + _overshoots(evidence, settings), may_be_asked)
    return None


def by_coincidence(evidence: Mapping[str, float]) -> float:
    """What it costs that a loop stands so near its boundary, as a criterion: 2 ln Ms; nothing where a setpoint step
    shows the process, or the loop is past its boundary.

    A swing that neither grows nor decays is explained by any process that all but swings. Loops are met at any distance
    from their boundary, in |1 - gm| about evenly, so one comes within 1/Ms of it with a probability like that. A tone
    has a height of its own whatever the loop.
    """
    ms = evidence.get("ms", 1.0)
    return 2.0 * math.log(ms) if math.isfinite(ms) and not evidence.get("setpoint_steps") else 0.0


def _overshoots(evidence: Mapping[str, float], settings: DiagnosisSettings) -> str:
    """What setpoint responses show whatever explains the record; empty where they do not overshoot."""
    overshoot = evidence.get("overshoot", 0.0)
    return f". Its setpoint responses overshoot by {overshoot:.0%}" if overshoot > settings.most_overshoot else ""


def not_brought_back(window: Window) -> str:
    """What is seen where pv stays on one side of its setpoint while co goes one way; empty where it is not so."""
    share = one_sided(window)
    if share is None:
        return ""
    side = "above" if float(np.mean(window.pv - window.sp)) > 0 else "below"
    return (
        f". pv stays {side} its setpoint for {share:.0%} of the record while co goes one way, "
        f"from {window.co[0]:.4g} to {window.co[-1]:.4g}. The integral action is slow, or the valve has little effect"
    )


UNSTABLE = "the fitted process would be unstable with the active gains, but the record does not grow"
CONTRADICTED = "with load steps at the setpoint changes a model explains pv as well on which the loop would be unstable"
"""What is told of a loop that is called stable without such load steps."""


def _unexplained(steps: float, loads: float, left: float, settings: DiagnosisSettings) -> str:
    """Why the loop by itself does not explain a record, or only with load steps enough for any; empty when it does."""
    if left > (settings.explained_steps if steps > 1 else settings.explained):
        leave = "1 load step leaves" if loads == 1 else f"{loads:.0f} load steps leave"
        return f"an unexplained disturbance: {leave} a residual of {left:.1f} times the noise"
    if loads >= (max(settings.many_loads_beside, steps) if steps else settings.many_loads):
        return f"an unexplained disturbance: {loads:.0f} load steps explain the record, but so many would explain any"
    return ""


def _waves(explained: FloatArray) -> int:
    """Half waves of what a model says of pv, those of less than a tenth of its range, or of its noise, left out."""
    least = max(WAVE * float(np.ptp(explained)), WAVE_NOISE * noise_sigma(explained))
    found, way, extreme = 0, 0, float(explained[0])
    for value in explained.tolist():
        if (value - extreme) * way > 0:
            extreme = value
        elif abs(value - extreme) > least:
            found, extreme, way = found + 1, value, 1 if value > extreme else -1
    return found


WAVE, WAVE_NOISE = 0.1, 5.0


def _grows(window: Window) -> bool:
    """Whether the control error swings wider at the end of a record than before."""
    error = window.sp - window.pv
    third = len(error) // 3
    return float(np.std(error[-third:])) > GROWTH * float(np.std(error[third:-third]))


GROWTH = 1.3  # ratio of the last third's standard deviation to the middle third's from which a loop is running away


def _undisturbed(window: Window, estimate: ModelEstimate, evidence: dict[str, float], oscillates: bool) -> Diagnosis:
    """Neither a setpoint nor a load step: noise, or a disturbance that nothing here explains.

    One tone never identifies a process: whatever G explains it explains any loop. What swings on and on without a
    cause inside comes from outside.
    """
    period_s = evidence["period_s"] if oscillates else pure_tone_s(window.t_s, window.sp - window.pv)
    if period_s is not None:
        reason = f"a lasting oscillation of {period_s:.3g} s without any step that could have begun it"
        return Diagnosis(Cause.EXTERNAL, 0.8, evidence | {"external_period_s": period_s}, reason)
    share = evidence.get("noise_share", 0.0)
    if share < HARDLY_NOISE and estimate.explained >= EXPLAINED:
        reason = "the loop alone explains the record, but what set it in motion came before the record began"
        return Diagnosis(Cause.UNKNOWN, 0.6, evidence, reason)
    if share > NOISY or estimate.noise_std >= estimate.residual_std:
        return Diagnosis(Cause.NOISE, 0.8, evidence, "only noise moves this loop")
    reason = "an unexplained disturbance moves this loop: neither steps nor a regular oscillation explain it"
    return Diagnosis(Cause.UNKNOWN, 0.6, evidence, reason)


HARDLY_NOISE, EXPLAINED = 0.05, 0.95
"""Share of noise, and of pv that a model explains, from which a record without a step is the loop's own motion."""
NOISY = 0.5  # share of white noise in the movement of pv from which noise is what moves it


def weighed(
    estimate: ModelEstimate, gains: PidGains, tuning: RobustTuning, sample_time_s: float, settings: CauseSettings
) -> Diagnosis:
    """The verdict that most of the models share that the record allows. Its confidence is the weight of those that ask
    for the same: gains too high and an integral too strong both ask for less.
    """
    weights: dict[tuple[bool, Cause], float] = defaultdict(float)
    firsts: dict[tuple[bool, Cause], Diagnosis] = {}
    lagged = with_second_lag(estimate.plausible, sample_time_s)
    for p in estimate.plausible:
        model = p.model.seen_by_controller(sample_time_s)
        verdict = tuning_cause(model, gains, tuning.tuning.gains, 0.1, settings, lagged)
        key = asks_for_less(verdict, settings), verdict.cause
        weights[key] += math.exp(-p.excess / 2)
        firsts.setdefault(key, verdict)
    every, less = sum(weights.values()), sum(w for (calms, _), w in weights.items() if calms)
    others = [w for (calms, _), w in weights.items() if not calms]
    calms = less > max(others, default=0.0)
    key = max((one for one in weights if one[0] is calms), key=lambda one: weights[one])
    told = replace(firsts[key], confidence=(less if calms else weights[key]) / every)
    # Without how much faster a robust loop could be, where that depends on a dead time that no model shows
    if told.cause not in TUNING_CAUSES or told.evidence["ms"] > settings.ms_high:
        return told
    least = FEWEST_SAMPLES_IN_THETA * sample_time_s
    if any(without_second_lag(p.model).theta_s >= least for p in estimate.plausible):
        return told
    reason = (
        f"the loop could be faster at Ms {told.evidence['ms']:.2f}; by how much depends on a dead time that no model "
        "of the record shows"
    )
    known = {name: value for name, value in told.evidence.items() if name not in RATIOS}
    return replace(told, reason=reason, evidence=known)
