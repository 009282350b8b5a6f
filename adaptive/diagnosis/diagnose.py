"""From a record to a cause: explain the record in rival ways, then look at what the best explanation means.

    no loop at work in the record (dead, manual, no response, ...)   unknown, said in words
    co switches between two values                                   unknown: no PID controller moves it
    the error runs away with co pushing it on                        unknown: the controller acts the wrong way
    co at its limits for much of the time                            saturation; aggressive where it goes from end to
                                                                     end and the loop by itself explains that (off line)
    nothing but noise                                                noise
    sticking_valve.py: linear, external tone, stuck valve            compared by the information criterion per record
        a stuck valve wins                                           stiction
        a tone wins                                                  external
        linear wins, the loop was excited, the record explained      the margins decide (tuning_verdict.py)
        linear wins otherwise                                        unknown: an unexplained disturbance

Shapes and classic indexes (indexes/) screen and are evidence; they do not decide where the fits can. A verdict that may
change gains must hold on the models that the record allows, weighted by their likelihood.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis, counted
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.enough_data import FEWEST_SAMPLES
from retuner.adaptive.diagnosis.rival_fits import (
    amplitude,
    linear,
    peak_frequency,
    residual,
    room_for_a_tone,
    tone_period_s,
)
from retuner.adaptive.diagnosis.sticking_valve import (
    outweighs_standing_pv,
    pv_stands,
    pv_stands_verdict,
    stiction_or_tone,
)
from retuner.adaptive.diagnosis.stretches import over_time, stretches
from retuner.adaptive.diagnosis.tuning_verdict import UNSTABLE, RecordVerdict, linear_verdict
from retuner.adaptive.diagnosis.wrong_way import acts_wrong_way
from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.fit.structure import leads
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.identification.structure_choice import too_few
from retuner.adaptive.indexes.condition import Condition
from retuner.adaptive.indexes.output_limits import switches_between
from retuner.adaptive.indexes.recording_quality import held_together
from retuner.adaptive.indexes.screening import Screening, screen
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import Window, least_squares
from retuner.schedule.gains import PidGains

SEVERAL_LOADS = 2
"""Load steps beside setpoint steps from which the rivals are asked as well: a slipping valve looks like loads."""


NOT_AT_WORK = frozenset(
    {Condition.DEAD_PV, Condition.DEAD_CO, Condition.NO_RESPONSE, Condition.MANUAL, Condition.NOT_CONTROLLING}
)
"""Conditions in which no loop is at work."""


def unknown_law(window: Window) -> PidGains | None:
    """No gains: nobody reads them off a record."""
    del window
    return None


def diagnose_window(
    window: Window,
    gains: PidGains | None,
    co_min: float | None = None,
    co_max: float | None = None,
    settings: DiagnosisSettings | None = None,
    *,
    direction: int | None = None,
    rough_law: Callable[[Window], PidGains | None] = unknown_law,
) -> RecordVerdict:
    """Name the cause of a loop's behaviour in a record.

    window : the record. gains : in force; without them nothing can be said of the tuning.
    co_min, co_max : limits of co where known. direction : sign of the controller's gain where no more is known.
    rough_law : gains by the record itself, where none are given: whether pv stands is asked with them.
    """
    settings = settings or DiagnosisSettings()
    found = _as_recorded(window, _diagnosed(window, gains, (co_min, co_max), settings, direction, rough_law), settings)
    told = counted(found.diagnosis)
    period_s = told.evidence.get("period_s")
    weighed = "linear_left" in told.evidence and told.cause in {Cause.STICTION, Cause.EXTERNAL, Cause.UNKNOWN}
    if period_s is not None and weighed and " period " not in told.reason:
        told = replace(told, reason=f"{told.reason}; it swings at about {float(f'{period_s:.3g}'):g} s")
    return replace(found, diagnosis=told)


def _as_recorded(window: Window, found: RecordVerdict, settings: DiagnosisSettings) -> RecordVerdict:
    """Undecided, where a record has too few samples to be called noise, or too much of it was filled with the last
    values for a verdict on the tuning.
    """
    told = found.diagnosis
    if told.cause == Cause.NOISE and len(window.t_s) < FEWEST_SAMPLES:
        reason = TOO_FEW.format(samples=len(window.t_s), fewest=FEWEST_SAMPLES)
        return replace(found, diagnosis=replace(told, cause=Cause.UNKNOWN, confidence=0.9, reason=reason))
    decided = told.cause == Cause.UNKNOWN and told.confidence > UNDECIDED
    if decided or told.cause not in TUNING_CAUSES | {Cause.OK, Cause.UNKNOWN}:
        return found
    holds = held_together(window.pv, window.co)
    if holds is None or holds.share < settings.held_share:
        return found
    reason = (
        f"pv and co stand still together for {holds.samples * window.sample_time_s:.3g} s again and again, "
        f"{holds.share:.0%} of the record: gaps that were filled with the last values; their content is lost"
    )
    verdict = replace(told, cause=Cause.UNKNOWN, confidence=0.9, reason=reason)
    return replace(found, diagnosis=verdict, tuning=None, aim=None)


TOO_FEW = "{samples} samples are too few to separate movement from noise: {fewest} or more are needed"
TOO_SHORT = "{samples} samples are fewer than a process and a tone beside it have unknowns"
UNDECIDED = 0.5  # Confidence of an answer that leaves the cause open


def _diagnosed(
    window: Window,
    gains: PidGains | None,
    limits: tuple[float | None, float | None],
    settings: DiagnosisSettings,
    direction: int | None,
    rough_law: Callable[[Window], PidGains | None],
) -> RecordVerdict:
    """The diagnosis with the confidence that a verdict has among those that were weighed."""
    seen = screen(window, gains, *limits, in_auto=settings.in_auto)
    obvious = _switched(window, seen) or _obvious(seen, settings)
    sign = gains.direction if gains else direction
    if sign and (obvious is None or obvious.cause == Cause.SATURATION):
        wrong = acts_wrong_way(window, sign, settings.fit)
        obvious = obvious if wrong is None else replace(wrong, evidence=dict(seen.evidence) | wrong.evidence)
    from_end_to_end = settings.by_odds and min(seen.limits.low, seen.limits.high) > BOTH_ENDS
    if obvious is not None and not (from_end_to_end and obvious.cause == Cause.SATURATION):
        return RecordVerdict(obvious)
    parts = [] if obvious is not None else stretches(window, seen.period_s, settings.fit.choice.most_samples)
    if parts:
        each = [_diagnosed(part, gains, limits, settings, direction, rough_law) for part in parts]
        return over_time(parts, each)
    if short := too_few(window):
        return RecordVerdict(Diagnosis(Cause.UNKNOWN, 0.9, dict(seen.evidence), short))
    signs = (sign,) if sign else (1, -1)
    found = linear(window, signs, settings.fit.choice, settings.fit.most_samples)
    told = _loop_or_tone_or_valve(window, gains, found, seen, settings, rough_law)
    if obvious is not None and told.diagnosis.cause != Cause.AGGRESSIVE and UNSTABLE not in told.diagnosis.reason:
        return RecordVerdict(obvious)
    return _in_parts(window, gains, limits, told, settings) or told


def _in_parts(
    window: Window,
    gains: PidGains | None,
    limits: tuple[float | None, float | None],
    whole: RecordVerdict,
    settings: DiagnosisSettings,
) -> RecordVerdict | None:
    """What parts of a record show that has too many loads as a whole, where it swings as slowly as a level loop does.

    Only too little k' Kc tau_I makes so slow a swing. Two parts, each explained to the noise with few loads, must show
    an integrating process of one slope, which no rival would; the one with most loads is told of.
    """
    best, most = whole.fits.get("linear"), settings.fit.choice.most_loads
    if best is None or whole.diagnosis.cause is not Cause.UNKNOWN or best.fit.misfit.loads < most:
        return None
    error = window.sp - window.pv
    swing_s = 2 * math.pi / peak_frequency(error, window.sample_time_s)
    if gains is None or not gains.ki or swing_s < SLOW_SWING * abs(gains.kp / gains.ki):
        return None
    length, shown = len(error) // PARTS, list[tuple[float, Window, list[Candidate]]]()
    for i in range(PARTS):
        part = window.part(slice(i * length, (i + 1) * length))
        if not (np.ptp(part.pv) > 0 and np.ptp(part.co) > 0):  # at rest, without any noise
            continue
        found = linear(part, (gains.direction,), settings.fit.choice, settings.fit.most_samples)
        fit = found[0].fit
        if fit.misfit.type in INTEGRATES and fit.misfit.loads < most and residual(found[0]) <= settings.tone_explains:
            shown.append((float(fit.x[0]), part, found))
    alike = [one for one in shown if any(abs(one[0] - two[0]) < SAME_SLOPE for two in shown if two is not one)]
    if not alike:
        return None
    _, part, found = max(alike, key=lambda one: one[2][0].fit.misfit.loads)
    seen = screen(part, gains, *limits, in_auto=settings.in_auto)
    evidence = dict(seen.evidence) | {"linear_left": residual(found[0]), "loads": float(found[0].fit.misfit.loads)}
    told = linear_verdict(part, gains, found, evidence, {"linear": found[0]}, False, settings)
    return told if told.diagnosis.cause in {Cause.SLOW_INTEGRATING, Cause.SLUGGISH} else None


BOTH_ENDS = 0.05
"""Share of the record at either end of co from which the loop's own swing may be what takes it there: too small an
actuator ends at one of them."""
PARTS, SLOW_SWING, SAME_SLOPE = 4, 4.0, 0.1
"""Parts of such a record; its period in integral times in force (k' Kc tau_I under 2.5); how far the logarithms of two
slopes may lie apart."""
INTEGRATES = frozenset({ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG})


def _switched(window: Window, seen: Screening) -> Diagnosis | None:
    """No PID controller moves a co that knows two values only."""
    values = switches_between(window.co)
    if values is None or seen.condition.condition in NOT_AT_WORK:
        return None
    low, high = values
    reason = (
        f"co switches between {low:.4g} and {high:.4g}: an on-off controller, a relay test, or a gain so large that co "
        "goes from limit to limit"
    )
    return Diagnosis(Cause.UNKNOWN, 0.95, dict(seen.evidence), reason)


def _obvious(seen: Screening, settings: DiagnosisSettings) -> Diagnosis | None:
    condition, evidence = seen.condition.condition, dict(seen.evidence)
    share = seen.limits.low + seen.limits.high
    if condition in NOT_AT_WORK and condition != Condition.NOT_CONTROLLING:
        return Diagnosis(Cause.UNKNOWN, 1.0, evidence, seen.condition.sentence)
    if share > settings.saturated_share:
        reason = f"the controller output is at a limit for {share:.0%} of the record"
        return Diagnosis(Cause.SATURATION, min(1.0, 0.5 + share), evidence, reason)
    if condition in {Condition.NOT_CONTROLLING, Condition.MOVING_SETPOINT}:
        return Diagnosis(Cause.UNKNOWN, 1.0, evidence, seen.condition.sentence)
    if condition == Condition.QUIET:
        return Diagnosis(Cause.NOISE, 0.9, evidence, seen.condition.sentence)
    return None


def _loop_or_tone_or_valve(
    window: Window,
    gains: PidGains | None,
    found: list[Candidate],
    seen: Screening,
    settings: DiagnosisSettings,
    rough_law: Callable[[Window], PidGains | None],
) -> RecordVerdict:
    """The linear explanation against its rivals, where they are worth asking.

    For a record that oscillates, structures with a lead are left out: a lead and a tone together explain what a valve
    does.
    """
    found = [c for c in found if not (seen.oscillates and leads(c.fit.misfit.type))]
    best = found[0]
    evidence = dict(seen.evidence) | {"linear_left": residual(best), "loads": float(best.fit.misfit.loads)}
    fits = {"linear": best}
    stood = pv_stands(window, gains or rough_law(window), best, settings)
    if stood is not None:
        evidence["stand_degree"] = stood.degree * (1.0 + stood.quick)
        stood = stood if stood.stands or stood.dead else None
    loads = best.fit.misfit.loads
    by_loads = loads >= SEVERAL_LOADS or (loads > 0 and not seen.evidence.get("setpoint_steps"))
    if seen.oscillates or by_loads or residual(best) > settings.oscillating_residual:
        if not room_for_a_tone(best):
            return RecordVerdict(
                Diagnosis(Cause.UNKNOWN, 0.9, evidence, TOO_SHORT.format(samples=len(window.t_s))), fits=fits
            )
        against = stiction_or_tone(best, seen, settings, len(setpoint_changes(window)))
        evidence, fits = evidence | against.evidence, against.fits
        verdict = against.verdict
        if _of_setpoint(window, against.fits["external"]):
            verdict = None if verdict is not None and verdict.cause == Cause.EXTERNAL else verdict
            evidence.pop("external_lead")
            fits.pop("external")
        if verdict is not None and (stood is None or outweighs_standing_pv(verdict, seen, stood, settings)):
            return RecordVerdict(verdict, fits=fits)
    if stood is not None:
        return RecordVerdict(pv_stands_verdict(stood, evidence), fits=fits)
    told = linear_verdict(window, gains, found, evidence, fits, seen.oscillates, settings)
    tone = fits.get("external")
    if tone is None:
        return told
    # External, where the loop by itself leaves the cause open and a tone that goes on explains the record as well
    record = tone.fit.misfit.record
    period_s = tone_period_s(tone)
    if told.diagnosis.cause != Cause.UNKNOWN or residual(tone) > settings.tone_explains:
        return told
    small = amplitude(tone) < settings.tone_size * float(np.std(record.pv))
    if record.span_s < settings.tone_cycles * period_s or small:
        return told
    reason = (
        f"an external oscillation with a period of {period_s:.3g} s explains the record; the loop by itself, with "
        f"load steps, does so too, but then: {told.diagnosis.reason}"
    )
    evidence = told.diagnosis.evidence | {"external_period_s": period_s}
    return replace(told, diagnosis=Diagnosis(Cause.EXTERNAL, 0.6, evidence, reason))


def _of_setpoint(window: Window, tone: Candidate) -> bool:
    """Whether a tone is the setpoint's own: it repeats with the same period, and so does what it moves."""
    period_s = tone_period_s(tone)
    if not np.ptp(window.sp):  # a mean of equal numbers is not always that number
        return False
    moves = window.sp - float(np.mean(window.sp))
    t = window.t_s - window.t_s[0]
    turns = [f(2 * math.pi * i * t / period_s) for i in range(1, SETPOINT_HARMONICS + 1) for f in (np.cos, np.sin)]
    columns = np.stack([np.ones_like(t), *turns], axis=1)
    left = moves - np.einsum("ij,j->i", columns, least_squares(columns, moves))
    return float(left @ left) < SETPOINT_LEFT * float(moves @ moves)


SETPOINT_HARMONICS = 5
SETPOINT_LEFT = 0.2
"""A setpoint of which its own harmonics leave less than this share repeats; steps to and fro leave a tenth."""
