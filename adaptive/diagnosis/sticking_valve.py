"""Does a valve stick? Three tests, each against a tone from outside. diagnose.py asks them; what a user is told weighs
them against all other causes (cause_odds/odds.py), and on line confirmation.py and by_all_samples.py ask as well.

    it swings        the record through a valve of one stick band (valve/valve_fit.py), against the loop by itself and a
                     tone: by information criterion, and by what each leaves
    it slips         at times of its own, over another band at every stop (valve/slips.py)
    pv stands        on plateaus while co travels, once or twice a record (valve/stand_still.py)

A tone that leaves nothing but noise has explained a record, whatever a valve does: no limit cycle is as regular. Where
it leaves more, a valve may leave somewhat more still, because its stick band differs from stop to stop.
"""

import math
from collections.abc import Mapping

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.rival_fits import (
    FEWEST_CYCLES,
    external,
    moves_pv,
    peak_frequency,
    residual,
    room_for_a_tone,
    sharper,
    tone_period_s,
)
from retuner.adaptive.explanations.wandering_load import block_means
from retuner.adaptive.identification.candidate import Candidate
from retuner.adaptive.indexes.screening import Screening
from retuner.adaptive.signals.sample import Window, quantile
from retuner.adaptive.valve.slips import Slipping, slipping
from retuner.adaptive.valve.stand_still import MOST_TOLD, StandStill, stand_still
from retuner.adaptive.valve.valve_fit import Sticking, sticking, turns_s
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

SAME_TONE = 0.03  # two frequencies closer than this (in logarithms) lead to the same fit
TRIANGLE, SINE = 0.6, 0.4
"""Triangle index from which a swing has a valve's shape, and up to which a sine's (He et al. 2007)."""


@dataclass(frozen=True, slots=True)
class Rivals:
    """The linear explanation beside its rivals. verdict : when a rival wins. fits : explanations by name."""

    verdict: Diagnosis | None
    evidence: dict[str, float]
    fits: dict[str, Candidate]


def stiction_or_tone(best: Candidate, seen: Screening, settings: DiagnosisSettings, changes: int = 0) -> Rivals:
    """Does a tone from outside, or a valve that sticks, explain a record better than the loop by itself?

    best : the linear explanation. seen : the record's screening. changes : of the setpoint in it. A record with fewer
    samples than a tone beside a process has unknowns (many gaps are many starts) has no rivals.
    """
    if not room_for_a_tone(best):
        alone = {"linear_left": residual(best), "loads": float(best.fit.misfit.loads)}
        return Rivals(None, dict(seen.evidence) | alone, {"linear": best})
    record = best.fit.misfit.record
    moves = record.co - np.linspace(record.co[0], record.co[-1], len(record.co))
    period_s = (
        seen.period_s or seen.evidence.get("period_s") or 2 * math.pi / peak_frequency(moves, record.sample_time_s)
    )
    most = settings.fit.choice.most_loads
    valve = sticking(best, period_s, most)
    # Where to look for a tone, rad/s: at periods that were seen, and at the peak of what the linear fit leaves
    record = best.fit.misfit.record
    found: list[float] = []
    for w in (
        *(2 * math.pi / p for p in _periods(valve, period_s)),
        peak_frequency(record.pv - best.fit.explained, record.sample_time_s),
    ):
        if all(abs(math.log(w / other)) > SAME_TONE for other in found):
            found.append(w)
    tone = external(best, found, most)
    if valve.fit.criterion < best.criterion and residual(tone) > settings.tone_explains:
        tone = sharper(tone)
    evidence = dict(seen.evidence) | {
        "linear_left": residual(best),
        "loads": float(best.fit.misfit.loads),
        "external_left": residual(tone),
        "stuck_left": residual(valve.fit),
        "valve_turns": float(len(turns_s(valve))),
        "external_lead": best.criterion - tone.criterion,
        "stuck_lead": best.criterion - valve.fit.criterion,
    }
    fits = {"linear": best, "external": tone, "stuck": valve.fit}
    verdict = regular_stiction_verdict(best, tone, valve, evidence, settings, changes)
    unexplained = residual(best) > settings.oscillating_residual and residual(tone) > settings.slips_asked
    if (verdict is None or verdict.cause != Cause.STICTION) and unexplained:
        slips = slipping(best, most)
        told = None if slips is None else irregular_stiction_verdict(best, tone, slips, evidence, settings, changes)
        if slips is not None and told is not None:
            return Rivals(told, told.evidence, fits | {"stuck": slips.fit})
    return Rivals(verdict, evidence, fits)


def regular_stiction_verdict(
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
    repeats = tone.fit.misfit.record.span_s >= settings.tone_cycles * tone_period_s(
        tone
    )  # else it is a load like any other
    if leads[cause] < needed or (cause == Cause.EXTERNAL and not repeats):
        return None
    if tone_left > settings.rival_explains and cause == Cause.EXTERNAL:
        # Neither a tone nor a valve of one stick band: shapes may still tell an irregular valve
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
    # what wanders always holds some sinusoid that takes two percent of it (real flow loops: 1.30 times the noise, 1.33)
    helps = tone_left <= settings.tone_explains or tone_left < settings.tone_as_good * evidence["linear_left"]
    if cause == Cause.EXTERNAL and not (helps and moves_pv(tone, evidence, settings)):
        return None
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
    period = tone_period_s(tone)
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


def irregular_stiction_verdict(
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
    n, left = len(slips.fit.fit.misfit.record.pv), residual(slips.fit)
    lead = min(best.criterion, tone.criterion) - slips.criterion
    needed = max(settings.least_lead, settings.lead_per_sample * n)
    count = len(slips.bands)
    fewest = max(settings.turns_per_change * changes + 1, settings.fewest_slips)
    if lead < needed or left > settings.slips_explain or count < fewest or slips.travel < settings.slips_travel:
        return None
    told = dict(evidence) | {"slips": float(count), "slips_left": left, "stand_travel": slips.travel}
    told["valve_turns"] = float(count)
    narrow, wide = (quantile(slips.bands, share) for share in (0.1, 0.9))
    reason = (
        f"a sticking valve explains the record: {count} slips, each after co moved by {narrow:.3g} to {wide:.3g}; "
        f"residual {left:.1f} times the noise with it, {evidence['linear_left']:.1f} without"
    )
    confidence = 0.5 + 0.5 * math.tanh(lead / needed / 2)
    return Diagnosis(Cause.STICTION, confidence, told, reason)


def pv_stands_verdict(found: StandStill, evidence: Mapping[str, float]) -> Diagnosis:
    """The cause, for what stands or does not answer."""
    evidence = {
        **evidence,
        "stand_travel": found.idle,
        "stand_dwell": found.dwell,
        "stands": float(len(found.legs)),
        "slips": float(len(found.slips_s)),
        "slips_agreed": float(found.agreed),
    }
    seen = ", ".join(f"{leg.start_s:.5g} to {leg.end_s:.5g} s" for leg in found.legs[:MOST_TOLD])
    if found.dead:
        reason = (
            f"pv does not respond ({seen}) to nearly the whole range of co: a closed valve or line, a failed sensor"
        )
        return Diagnosis(Cause.UNKNOWN, 0.7, evidence, reason)
    slips = ", ".join(f"{t:.5g}" for t in found.ends_s[:MOST_TOLD])
    told = f"pv does not move while co moves ({seen})" + f", then follows in steps (at {slips} s)" * bool(slips)
    if found.sticks:
        return Diagnosis(Cause.STICTION, 0.8, evidence, f"{told}: a sticking valve with a varying stiction band")
    return Diagnosis(Cause.UNKNOWN, 0.6, evidence, f"{told}: a sticking valve, or a load that drifts with co")


def pv_stands(
    window: Window, gains: PidGains | None, best: Candidate, settings: DiagnosisSettings
) -> StandStill | None:
    """What the plateaus of a record show, where pv stands to some degree or does not answer; None otherwise.

    best : the linear explanation; where it is by far the likelier one, plateaus are what a slow loop leaves.
    """
    found = stand_still(window, gains, settings.standing) if gains is not None else None
    if found is None or not (found.degree > 0.0 or found.stands or found.dead):
        return None
    record, likelier = best.fit.misfit.record, settings.standing.likelier
    left = block_means(record.pv - best.fit.at.explained, max(len(record.pv) // found.rows, 1))  # rows like those
    lead = found.lead_of(float(np.mean(left**2)), best.fit.misfit.loads)
    left_over = min(max(CONTESTED - 2.0 * lead / likelier, 0.0), 1.0)  # 1 up to three quarters of the lead that counts
    known = lead <= likelier
    return replace(
        found,
        degree=found.degree * left_over,
        stands=found.stands and known,
        sticks=found.sticks and known,
        dead=found.dead and known,
    )


CONTESTED = 2.5
"""How far pv stands falls from all to nothing as the linear explanation's lead goes from 3/4 of `likelier` to 5/4."""


def outweighs_standing_pv(verdict: Diagnosis, seen: Screening, stood: StandStill, settings: DiagnosisSettings) -> bool:
    """Whether a rival's verdict counts for more than that pv stands: a valve of one band, or a regular oscillation.

    Squares under triangles for a few slow rounds are a valve of one band, or a load that ramps under a fast loop.
    """
    if verdict.cause == Cause.STICTION and stood.sticks:
        return verdict.confidence > settings.standing.sure
    if verdict.cause == Cause.STICTION:
        confirmed = verdict.evidence.get("valve_turns", 0.0) >= settings.confirming_turns
        return confirmed or stood.dwell < settings.slow_rounds
    return verdict.cause == Cause.EXTERNAL and seen.oscillates


def _periods(valve: Sticking, period_s: float) -> list[float]:
    """Periods of which a tone may be: the record's, and that of the valve's turns, two to a round."""
    turns = turns_s(valve)
    if len(turns) < 2 * FEWEST_CYCLES:
        return [period_s]
    return [period_s, 2 * float(turns[-1] - turns[0]) / (len(turns) - 1)]
