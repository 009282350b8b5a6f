"""Stiction or an oscillation from outside, where one of them explains a record clearly better than the loop by itself.

A tone that leaves nothing but noise has explained it, whatever a valve does: no limit cycle is as regular. Where it
leaves more, a valve may leave somewhat more still, because its stick band differs from stop to stop.
"""

import math

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.sticking import Sticking
from retuner.adaptive.fit.candidate import Candidate


def rival_verdict(
    best: Candidate, tone: Candidate, valve: Sticking, evidence: dict[str, float], settings: DiagnosisSettings
) -> Diagnosis | None:
    """Stiction or external, where one of them explains the record clearly better than the loop by itself."""
    needed = max(settings.least_lead, settings.lead_per_sample * len(best.fit.misfit.record.pv))
    leads = {Cause.EXTERNAL: evidence["external_lead"], Cause.STICTION: evidence["stuck_lead"]}
    tone_left, stuck_left = evidence["external_left"], evidence["stuck_left"]
    allowed = handicap(evidence, settings)
    if tone_left <= settings.tone_explains and tone_left < stuck_left:
        cause = Cause.EXTERNAL
    elif stuck_left < settings.stuck_helps * evidence["linear_left"] and stuck_left < allowed * tone_left:
        cause = Cause.STICTION
    else:
        cause = Cause.EXTERNAL
    if leads[cause] < needed:
        return None
    if tone_left > settings.rival_explains and cause == Cause.EXTERNAL:
        return _neither(evidence, settings)
    apart = abs(math.log(stuck_left / tone_left / (1 if cause == Cause.EXTERNAL else allowed)))
    confidence = 0.5 + 0.5 * math.tanh(min(leads[cause] / needed / 2, 4 * apart))
    return Diagnosis(cause, confidence, evidence, _reason(cause, tone, valve, evidence))


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
            f"co goes in triangles and pv in jumps: a valve that sticks, over another band at every stop "
            f"(no single band explains the record: {left:.1f} times the noise is left)"
        )
        return Diagnosis(Cause.STICTION, 0.6, evidence, reason)
    reason = (
        f"something swings here that is neither the loop's own doing nor a regular tone nor a valve of one stick band: "
        f"{left:.1f} times the noise is left at best"
    )
    return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)


def _reason(cause: Cause, tone: Candidate, valve: Sticking, evidence: dict[str, float]) -> str:
    """The sentence; what it tells goes into the evidence, too."""
    before = evidence["linear_left"]
    if cause == Cause.STICTION:
        stick, jump = valve.valve.stick, valve.valve.jump
        evidence |= {"stick": stick, "slip_jump": jump}
        return (
            f"a valve that sticks over {stick:.3g} of co and jumps by {jump:.3g} explains the record; "
            f"without it {before:.1f} times the noise is left, with it {evidence['stuck_left']:.1f}"
        )
    period = 2 * math.pi / math.exp(float(tone.fit.p[-1]))
    evidence["external_period_s"] = period
    return (
        f"an oscillation from outside with a period of {period:.3g} s explains the record; without it "
        f"{before:.1f} times the noise is left, with it {evidence['external_left']:.1f}"
    )
