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
