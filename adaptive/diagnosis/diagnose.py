"""From a record to a cause: explain the record in rival ways, then look at what the best explanation means.

    no loop at work in the record (dead, manual, no response, ...)   unknown, said in words
    co switches between two values                                   unknown: no PID controller moves it
    the error runs away with co pushing it on                        unknown: the controller acts the wrong way
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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis, counted
from retuner.adaptive.diagnosis.enough_data import FEWEST_SAMPLES
from retuner.adaptive.diagnosis.rival_fits import amplitude, external, linear, moves_pv, room_for_a_tone, sharper
from retuner.adaptive.diagnosis.settings import DiagnosisSettings
from retuner.adaptive.diagnosis.slipping_valve import Slipping, slipping
from retuner.adaptive.diagnosis.standing_valve import Standing, stand_still, standing_verdict
from retuner.adaptive.diagnosis.stretches import over_time, stretches
from retuner.adaptive.diagnosis.tuning_verdict import Found, linear_verdict
from retuner.adaptive.diagnosis.wrong_way import acts_wrong_way
from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.identification.structure_choice import too_few
from retuner.adaptive.indexes.condition import Condition
from retuner.adaptive.indexes.limits import switches_between
from retuner.adaptive.indexes.recording_quality import held_together
from retuner.adaptive.indexes.screening import Screening, screen
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.valve.fit import Sticking, sticking, turns_s
from retuner.schedule.gains import PidGains

# Stiction or an oscillation from outside, where one of them explains a record clearly better than the loop by itself.
#
# A tone that leaves nothing but noise has explained it, whatever a valve does: no limit cycle is as regular. Where it
# leaves more, a valve may leave somewhat more still, because its stick band differs from stop to stop.


def rival_verdict(
    best: Candidate,
    tone: Candidate,
    valve: Sticking,
    evidence: dict[str, float],
    settings: DiagnosisSettings,
    changes: int = 0,
) -> Diagnosis | None:
    """Stiction or external, where one of them explains the record clearly better than the loop by itself.

    changes : of the setpoint. A valve that turns no more than so many times for each of them goes where it is sent.
    """
    needed = max(settings.least_lead, settings.lead_per_sample * len(best.fit.misfit.record.pv))
    leads = {Cause.EXTERNAL: evidence["external_lead"], Cause.STICTION: evidence["stuck_lead"]}
    tone_left, stuck_left = evidence["external_left"], evidence["stuck_left"]
    allowed = handicap(evidence, settings)
    turns = len(turns_s(valve))
    sent = turns < max(settings.turns_per_change * changes + 1, settings.fewest_turns)
    sent |= valve.valve.stick >= valve.fit.fit.misfit.record.co_range  # a valve that never moves explains nothing
    if sent or (tone_left <= settings.tone_explains and tone_left < stuck_left):
        cause = Cause.EXTERNAL
    elif stuck_left < settings.stuck_helps * evidence["linear_left"] and stuck_left < allowed * tone_left:
        cause = Cause.STICTION
    else:
        cause = Cause.EXTERNAL
    repeats = tone.fit.misfit.record.span_s >= settings.tone_cycles * _period_s(
        tone
    )  # else it is a load like any other
    if leads[cause] < needed or (cause == Cause.EXTERNAL and not repeats):
        return None
    if tone_left > settings.rival_explains and cause == Cause.EXTERNAL:
        return _neither(evidence, settings)
    # what wanders always holds some sinusoid that takes two percent of it (real flow loops: 1.30 times the noise, 1.33)
    helps = tone_left <= settings.tone_explains or tone_left < settings.tone_as_good * evidence["linear_left"]
    if cause == Cause.EXTERNAL and not (helps and moves_pv(tone, evidence, settings)):
        return None
    apart = abs(math.log(stuck_left / tone_left / (1 if cause == Cause.EXTERNAL else allowed)))
    confidence = 0.5 + 0.5 * math.tanh(min(leads[cause] / needed / 2, 4 * apart))
    return Diagnosis(cause, confidence, evidence, _reason(cause, tone, valve, evidence))


def _period_s(tone: Candidate) -> float:
    """Of a tone from outside."""
    return 2 * math.pi / math.exp(float(tone.fit.p[-1]))


def handicap(evidence: dict[str, float], settings: DiagnosisSettings) -> float:
    """How many times as much as a tone a stuck valve may leave, by the shape of co's half waves.

    The limits of the triangle index are those of He et al. (2007): 0.6 and above stiction, 0.4 and below not.
    """
    shape = evidence.get("triangle_co", 0.5)
    if shape >= TRIANGLE:
        return settings.stuck_handicap_triangle
    return 1.0 if shape <= SINE else settings.stuck_handicap


TRIANGLE, SINE = 0.6, 0.4


def _neither(evidence: dict[str, float], settings: DiagnosisSettings) -> Diagnosis:
    """Neither a tone nor a valve of one stick band: shapes may still tell an irregular valve."""
    left = min(evidence["external_left"], evidence["stuck_left"])
    if evidence.get("triangle_co", 0.0) >= TRIANGLE and evidence.get("jump_share", 0.0) >= settings.jump_share:
        reason = (
            "co is a triangle wave and pv moves in jumps: a sticking valve with a varying stiction band; "
            f"no single band explains the record (residual {left:.1f} times the noise)"
        )
        return Diagnosis(Cause.STICTION, 0.6, evidence, reason)
    reason = (
        "what moves pv is explained neither by the loop, nor by an external sinusoid, nor by a sticking valve; "
        f"the residual is at least {left:.1f} times the noise"
    )
    return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)


def _reason(cause: Cause, tone: Candidate, valve: Sticking, evidence: dict[str, float]) -> str:
    """The sentence; what it tells goes into the evidence, too."""
    before = evidence["linear_left"]
    if cause == Cause.STICTION:
        stick, jump = valve.valve.stick, valve.valve.jump
        evidence |= {"stick": stick, "slip_jump": jump}
        return (
            f"a sticking valve explains the record (stiction band {stick:.3g} of co, slip jump {jump:.3g}); "
            f"residual {evidence['stuck_left']:.1f} times the noise with it, {before:.1f} without"
        )
    period = _period_s(tone)
    evidence["external_period_s"] = period
    return (
        f"an external oscillation with a period of {period:.3g} s explains the record; "
        f"{_with_and_without(evidence['external_left'], before, evidence['loads'])}"
    )


def _with_and_without(tone_left: float, loop_left: float, loads: float) -> str:
    """What a tone leaves, and what the loop by itself leaves with so many load steps.

    Where both leave the noise alone, what the loop needs for it is the difference.
    """
    digits = 1 if f"{tone_left:.1f}" != f"{loop_left:.1f}" else 2
    needed = f", with {loads:.0f} load step{'s' * (loads != 1)}" if loads else ""
    return f"residual {tone_left:.{digits}f} times the noise with it, {loop_left:.{digits}f} without{needed}"


PADDED = 4
"""Zero padding of the spectrum: peaks to a quarter of a line."""
FEWEST_CYCLES = 2
"""Cycles in the record of a tone that is looked for."""
SEVERAL_LOADS = 2
"""Load steps beside setpoint steps from which the rivals are asked as well: a slipping valve looks like loads."""
SAME_TONE = 0.03
"""Two frequencies closer than this (in logarithms) lead to the same fit."""


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
    found = _as_recorded(window, _diagnosed(window, gains, (co_min, co_max), settings, direction), settings)
    return replace(found, diagnosis=_with_period(counted(found.diagnosis)))


def _with_period(told: Diagnosis) -> Diagnosis:
    """The sentence of a swing with the period that was seen, where it does not stand in it."""
    period_s = told.evidence.get("period_s")
    weighed = "linear_left" in told.evidence and told.cause in {Cause.STICTION, Cause.EXTERNAL, Cause.UNKNOWN}
    if period_s is None or not weighed or " period " in told.reason:
        return told
    return replace(told, reason=f"{told.reason}; it swings at about {float(f'{period_s:.3g}'):g} s")


def _as_recorded(window: Window, found: Found, settings: DiagnosisSettings) -> Found:
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
UNDECIDED = 0.5
"""Confidence of an answer that leaves the cause open."""


def _diagnosed(
    window: Window,
    gains: PidGains | None,
    limits: tuple[float | None, float | None],
    settings: DiagnosisSettings,
    direction: int | None,
) -> Found:
    """The same with the confidence that a verdict has among those that were weighed."""
    seen = screen(window, gains, *limits, in_auto=settings.in_auto)
    obvious = _switched(window, seen) or _obvious(seen, settings)
    sign = gains.direction if gains else direction
    if sign and (obvious is None or obvious.cause == Cause.SATURATION):
        wrong = acts_wrong_way(window, sign, settings.fit)
        obvious = obvious if wrong is None else replace(wrong, evidence=dict(seen.evidence) | wrong.evidence)
    if obvious is not None:
        return Found(obvious)
    parts = stretches(window, seen.period_s, settings.fit.choice.most_samples)
    if parts:
        each = [_diagnosed(part, gains, limits, settings, direction) for part in parts]
        return over_time(parts, each)
    if short := too_few(window):
        return Found(Diagnosis(Cause.UNKNOWN, 0.9, dict(seen.evidence), short))
    signs = (sign,) if sign else (1, -1)
    found = linear(window, signs, settings.fit.choice, settings.fit.most_samples)
    told = _compared(window, gains, found, seen, settings)
    return _in_parts(window, gains, limits, told, settings) or told


def _in_parts(
    window: Window,
    gains: PidGains | None,
    limits: tuple[float | None, float | None],
    whole: Found,
    settings: DiagnosisSettings,
) -> Found | None:
    """What parts of a record show that has too many loads as a whole, where it swings as slowly as a level loop does.

    Only too little k' Kc tau_I makes so slow a swing. Two parts, each explained to the noise with few loads, must show
    an integrating process of one slope, which no rival would; the one with most loads is told of.
    """
    best, most = whole.fits.get("linear"), settings.fit.choice.most_loads
    if best is None or whole.diagnosis.cause is not Cause.UNKNOWN or best.fit.misfit.loads < most:
        return None
    error = window.sp - window.pv
    swing_s = 2 * math.pi / _peak(error, window.sample_time_s)
    if gains is None or not gains.ki or swing_s < SLOW_SWING * abs(gains.kp / gains.ki):
        return None
    length, shown = len(error) // PARTS, list[tuple[float, Window, list[Candidate]]]()
    for i in range(PARTS):
        part = window.part(slice(i * length, (i + 1) * length))
        found = linear(part, (gains.direction,), settings.fit.choice, settings.fit.most_samples)
        fit = found[0].fit
        if fit.misfit.type in INTEGRATES and fit.misfit.loads < most and _left(found[0]) <= settings.tone_explains:
            shown.append((float(fit.x[0]), part, found))
    alike = [one for one in shown if any(abs(one[0] - two[0]) < SAME_SLOPE for two in shown if two is not one)]
    if not alike:
        return None
    _, part, found = max(alike, key=lambda one: one[2][0].fit.misfit.loads)
    seen = screen(part, gains, *limits, in_auto=settings.in_auto)
    evidence = dict(seen.evidence) | {"linear_left": _left(found[0]), "loads": float(found[0].fit.misfit.loads)}
    told = linear_verdict(part, gains, found, evidence, {"linear": found[0]}, False, settings)
    return told if told.diagnosis.cause in {Cause.SLOW_INTEGRATING, Cause.SLUGGISH} else None


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
    """What needs no fit."""
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


def _compared(
    window: Window, gains: PidGains | None, found: list[Candidate], seen: Screening, settings: DiagnosisSettings
) -> Found:
    """The linear explanation against its rivals, where they are worth asking."""
    best = found[0]
    evidence = dict(seen.evidence) | {"linear_left": _left(best), "loads": float(best.fit.misfit.loads)}
    fits = {"linear": best}
    stood = _stood(window, gains, best, settings)
    loads = best.fit.misfit.loads
    by_loads = loads >= SEVERAL_LOADS or (loads > 0 and not seen.evidence.get("setpoint_steps"))
    if seen.oscillates or by_loads or _left(best) > settings.oscillating_residual:
        if not room_for_a_tone(best):
            return Found(Diagnosis(Cause.UNKNOWN, 0.9, evidence, TOO_SHORT.format(samples=len(window.t_s))), fits=fits)
        against = against_rivals(best, seen, settings, len(setpoint_changes(window)))
        evidence, fits = against.evidence, against.fits
        verdict = against.verdict
        if _of_setpoint(window, against.fits["external"]):
            verdict = None if verdict is not None and verdict.cause == Cause.EXTERNAL else verdict
            evidence.pop("external_lead")
            fits.pop("external")
        if verdict is not None and (stood is None or _outweighs(verdict, seen, stood, settings)):
            return Found(verdict, fits=fits)
    if stood is not None:
        return Found(standing_verdict(stood, evidence), fits=fits)
    told = linear_verdict(window, gains, found, evidence, fits, seen.oscillates, settings)
    tone = fits.get("external")
    return told if tone is None else _by_tone(told, tone, settings)


def _by_tone(told: Found, tone: Candidate, settings: DiagnosisSettings) -> Found:
    """External, where the loop by itself leaves the cause open and a tone that goes on explains the record as well."""
    record = tone.fit.misfit.record
    period_s = _period_s(tone)
    if told.diagnosis.cause != Cause.UNKNOWN or _left(tone) > settings.tone_explains:
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
    period_s = _period_s(tone)
    if not np.ptp(window.sp):  # a mean of equal numbers is not always that number
        return False
    moves = window.sp - float(np.mean(window.sp))
    t = window.t_s - window.t_s[0]
    turns = [f(2 * math.pi * i * t / period_s) for i in range(1, SETPOINT_HARMONICS + 1) for f in (np.cos, np.sin)]
    q, _ = np.linalg.qr(np.stack([np.ones_like(t), *turns], axis=1))
    left = moves - q @ (q.T @ moves)
    return float(left @ left) < SETPOINT_LEFT * float(moves @ moves)


SETPOINT_HARMONICS = 5
SETPOINT_LEFT = 0.2
"""A setpoint of which its own harmonics leave less than this share repeats; steps to and fro leave a tenth."""


def _outweighs(verdict: Diagnosis, seen: Screening, stood: Standing, settings: DiagnosisSettings) -> bool:
    """Whether a rival's verdict counts for more than that pv stands: a valve of one band, or a regular oscillation.

    Squares under triangles for a few slow rounds are a valve of one band, or a load that ramps under a fast loop.
    """
    if verdict.cause == Cause.STICTION and stood.sticks:
        return verdict.confidence > settings.standing.sure
    if verdict.cause == Cause.STICTION:
        confirmed = verdict.evidence.get("valve_turns", 0.0) >= settings.confirming_turns
        return confirmed or stood.dwell < settings.slow_rounds
    return verdict.cause == Cause.EXTERNAL and seen.oscillates


def _stood(window: Window, gains: PidGains | None, best: Candidate, settings: DiagnosisSettings) -> Standing | None:
    """What the plateaus of a record show, where pv stands or does not answer; None otherwise.

    best : the linear explanation; where it is by far the likelier one, plateaus are what a slow loop leaves.
    """
    found = stand_still(window, gains, settings.standing)
    if found is None or not (found.stands or found.dead):
        return None
    record = best.fit.misfit.record
    left = float(np.mean((record.pv - best.fit.at.explained) ** 2))
    lead = found.lead_of(left, best.fit.misfit.loads)
    return None if lead > settings.standing.likelier else found


@dataclass(frozen=True, slots=True)
class Against:
    """The linear explanation beside its rivals. verdict : when a rival wins. fits : explanations by name."""

    verdict: Diagnosis | None
    evidence: dict[str, float]
    fits: dict[str, Candidate]


def against_rivals(best: Candidate, seen: Screening, settings: DiagnosisSettings, changes: int = 0) -> Against:
    """Does a tone from outside, or a valve that sticks, explain a record better than the loop by itself?

    best : the linear explanation. seen : the record's screening. changes : of the setpoint in it. A record with fewer
    samples than a tone beside a process has unknowns (many gaps are many starts) has no rivals.
    """
    if not room_for_a_tone(best):
        alone = {"linear_left": _left(best), "loads": float(best.fit.misfit.loads)}
        return Against(None, dict(seen.evidence) | alone, {"linear": best})
    record = best.fit.misfit.record
    moves = record.co - np.linspace(record.co[0], record.co[-1], len(record.co))
    period_s = seen.period_s or seen.evidence.get("period_s") or 2 * math.pi / _peak(moves, record.sample_time_s)
    most = settings.fit.choice.most_loads
    valve = sticking(best, period_s, most)
    tone = external(best, _frequencies(best, _periods(valve, period_s)), most)
    if valve.fit.criterion < best.criterion and _left(tone) > settings.tone_explains:
        tone = sharper(tone)
    evidence = dict(seen.evidence) | {
        "linear_left": _left(best),
        "loads": float(best.fit.misfit.loads),
        "external_left": _left(tone),
        "stuck_left": _left(valve.fit),
        "valve_turns": float(len(turns_s(valve))),
        "external_lead": best.criterion - tone.criterion,
        "stuck_lead": best.criterion - valve.fit.criterion,
    }
    fits = {"linear": best, "external": tone, "stuck": valve.fit}
    verdict = rival_verdict(best, tone, valve, evidence, settings, changes)
    unexplained = _left(best) > settings.oscillating_residual and _left(tone) > settings.slips_asked
    if (verdict is None or verdict.cause != Cause.STICTION) and unexplained:
        slips = slipping(best, most)
        told = None if slips is None else slipping_verdict(best, tone, slips, evidence, settings, changes)
        if slips is not None and told is not None:
            return Against(told, told.evidence, fits | {"stuck": slips.fit})
    return Against(verdict, evidence, fits)


def slipping_verdict(
    best: Candidate,
    tone: Candidate,
    slips: Slipping,
    evidence: Mapping[str, float],
    settings: DiagnosisSettings,
    changes: int = 0,
) -> Diagnosis | None:
    """Stiction, where a valve that slips at its own times explains the record better than loop and tone.

    changes : of the setpoint. What slips no more than twice for each of them goes where it is sent.
    """
    n, left = len(slips.fit.fit.misfit.record.pv), _left(slips.fit)
    lead = min(best.criterion, tone.criterion) - slips.criterion
    needed = max(settings.least_lead, settings.lead_per_sample * n)
    count = len(slips.bands)
    fewest = max(settings.turns_per_change * changes + 1, settings.fewest_slips)
    if lead < needed or left > settings.slips_explain or count < fewest or slips.travel < settings.slips_travel:
        return None
    told = dict(evidence) | {"slips": float(count), "slips_left": left, "stand_travel": slips.travel}
    told["valve_turns"] = float(count)
    narrow, wide = np.quantile(slips.bands, [0.1, 0.9])
    reason = (
        f"a sticking valve explains the record: {count} slips, each after co moved by {narrow:.3g} to {wide:.3g}; "
        f"residual {left:.1f} times the noise with it, {evidence['linear_left']:.1f} without"
    )
    confidence = 0.5 + 0.5 * math.tanh(lead / needed / 2)
    return Diagnosis(Cause.STICTION, confidence, told, reason)


def _left(candidate: Candidate) -> float:
    """What a fit leaves, in standard deviations of the noise."""
    return candidate.colour.std / candidate.fit.misfit.record.noise_std


def _peak(x: FloatArray, sample_time_s: float) -> float:
    """Frequency at which a signal moves most, rad/s, of those with two cycles in the record."""
    power = np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(len(x)), PADDED * len(x))) ** 2
    first = FEWEST_CYCLES * PADDED
    return 2 * math.pi * (first + int(np.argmax(power[first:]))) / (PADDED * len(x) * sample_time_s)


def _periods(valve: Sticking, period_s: float) -> list[float]:
    """Periods of which a tone may be: the record's, and that of the valve's turns, two to a round."""
    turns = turns_s(valve)
    if len(turns) < 2 * FEWEST_CYCLES:
        return [period_s]
    return [period_s, 2 * float(turns[-1] - turns[0]) / (len(turns) - 1)]


def _frequencies(best: Candidate, periods_s: Sequence[float]) -> list[float]:
    """Where to look for a tone, rad/s: at periods that were seen, and at the peak of what the linear fit leaves."""
    record = best.fit.misfit.record
    found: list[float] = []
    for w in (*(2 * math.pi / p for p in periods_s), _peak(record.pv - best.fit.explained, record.sample_time_s)):
        if all(abs(math.log(w / other)) > SAME_TONE for other in found):
            found.append(w)
    return found
