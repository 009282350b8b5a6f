"""The pattern rule: gains moved in small steps by what a response looks like, where no model can be had.

    overshoot = -E2/E1,  damping = (E3 - E2)/(E1 - E2),  margin m = min(target - measured)
    lively (m < 0)   the integral's share of the phase decides what gives way, beta(T/tau_I) from 0 to 1:
                     Kc falls by exp(g m (1 - beta)),  tau_I grows by exp(-g m beta)
    calm (m > 0)     Kc grows by exp(g m), or, where tau_I is long against the period, tau_I falls towards T/ratio
    no second peak   carefully faster: tau_I down where the return is long against the rise, else Kc up, and not even
                     that where co shows as much overshoot as it should
    slow             a swing that is slow against how soon pv answers, under a short tau_I: Kc up

Foxboro EXACT's idea: overshoot and damping against targets, settings from the period by ratios of the Ziegler-Nichols
kind (Kraus & Myron 1984, Control Engineering 31, 106; Astrom & Hagglund 1995, PID Controllers, section 6.5). A PI
controller lags by atan(T/(2 pi tau_I)) at the period T: where that is large, the swing is the integral's doing, and
less gain would make it worse (the slow oscillation of an integrating process), so tau_I gives way.

What the original was blamed for is refused here: two upsets read as one oscillation (peaks at uneven times, damping far
from overshoot: for a clean decay both are equal), pulses, responses that were not left alone, swings that do not decay
and may come from outside or from a sticking valve, and large steps. Inside a dead zone about the targets nothing moves.
"""

import math
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Annotated, NamedTuple

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.declared_setting import Setting
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.without_model.pattern_evidence import PatternNumbers, SecondPeak, pattern_numbers
from retuner.schedule.gains import PidGains

# Settings of the pattern rule: see pattern_rule.py.


@dataclass(frozen=True, slots=True)
class PatternSettings:
    """Settings. Where no source is named, the value did best on the batch's first seeds (benchmarks/online).

    gain : g of the rule, ln of a factor per unit of margin; 0.5 to 3, default 1.5.
    urgent_step : factor at once when the swing grows; 1.05 to 4, default 2.
    careful : factor per response without a second peak, at most step_up; 1.02 to 2, default 1.2.
    co_enough : overshoot of co from which a response without a second peak is fast enough; 0 to 0.3, default 0.05.
    fast_ratio, slow_ratio : T/tau_I below which a swing is the gain's doing, and above which it is the integral's;
        defaults 1.5 and 4 (the integral's lag is 13 and 32 degrees there).
    long_ratio : T/tau_I below which tau_I is long; default 1.2 (tau_I = 0.83 T, Ziegler & Nichols 1942 for PI).
    long_tail : return over rise of a load response above which tau_I is too long; default 8 (SIMC's is 4 to 5).
    slow_periods : T over the time of the first tenth above which a swing is slow; default 20 (SIMC's is 7 to 12; two
        equal lags under too much gain have 14 to 17).
    slow_decays : and its overshoot at most; default 0.6.
    riding : damping above overshoot by this: the swing rides on a slow return, so the gain gives way; default 0.1.
    least_bands : least height of a response in noise bands; 3 to 20, default 6 (an overshoot of a sixth shows then).
    gap : damping and overshoot further apart belong to no ordinary response; default 0.35.
    uneven : ratio of the times between the peaks of a load response above which they are two upsets; default 2.5.
    limited : largest share of the upset with co at a limit; 0.01 to 0.5, default 0.1.
    pulse : share of its own travel that co must end away from where it began after a load; default 0.4.
    rested_bands : noise bands that pv may have been off before a load, for a response without a second peak to be
        called slow; default 1.5.
    undying : damping above which a swing may be a valve's or another loop's; default 0.85.
    alone : nothing else looks for such causes: act on an undying swing, too; default no. For comparisons.

    Raises
    ------
    ValueError
        A number is not finite and positive, or a factor is below 1.
    """

    overshoot_target: Annotated[
        float,
        Setting(
            "Overshoot that is aimed at",
            0.05,
            0.5,
            source="below the 0.3 of Astrom & Hagglund 1995, section 6.5: Ms stays below 2",
        ),
    ] = 0.15
    damping_target: Annotated[
        float,
        Setting(
            "Target for the half-cycle decay ratio (0 dead-beat, 1 sustained)",
            0.05,
            0.5,
            source="as the overshoot: for a clean decay both are equal",
        ),
    ] = 0.15
    dead_zone: Annotated[
        float,
        Setting(
            "Distance from the targets within which nothing moves",
            0.02,
            0.2,
            source="what noise makes of an overshoot",
        ),
    ] = 0.05
    gain: float = 1.5
    step_up: Annotated[
        float,
        Setting(
            "Greatest factor per response towards more action",
            1.05,
            2,
            source="a gain margin of 1.9 outlives two of them",
        ),
    ] = 1.3
    step_down: Annotated[
        float,
        Setting(
            "Greatest factor per response towards less action",
            1.05,
            2,
            source="safety is reached faster than speed",
        ),
    ] = 1.5
    urgent_step: float = 2.0
    careful: float = 1.2
    co_enough: float = 0.05
    fast_ratio: float = 1.5
    slow_ratio: float = 4.0
    long_ratio: float = 1.2
    long_tail: float = 8.0
    slow_periods: float = 20.0
    slow_decays: float = 0.6
    riding: float = 0.1
    least_bands: float = 6.0
    gap: float = 0.35
    uneven: float = 2.5
    limited: float = 0.1
    pulse: float = 0.4
    rested_bands: float = 1.5
    undying: float = 0.85
    alone: bool = False

    @property
    def least_up(self) -> float:
        """Factor of a careful step, within step_up."""
        return min(self.careful, self.step_up)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "alone" and not 0 < value < math.inf:
                raise ValueError(f"{field.name} = {value} must be positive and finite")
        for name in ("step_up", "step_down", "urgent_step", "careful"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)} is a factor of at least 1")


class PatternReading(StrEnum):
    """What a pattern says; the value is the sentence, with its numbers by name."""

    LIVELY = "from the response pattern ({seen}): less action, {moves}"
    CALM = "from the response pattern ({seen}): more action, {moves}"
    OVERDAMPED = "from the response pattern ({seen}): slightly faster, {moves}"
    SLOW = (
        "from the response pattern ({seen}): slow oscillation, though pv responds within {tenth_s:.3g} s; "
        "more gain, {moves}"
    )
    ON_TARGET = "the response pattern is near its targets ({seen})"
    OTHER_CAUSE = "the response pattern does not reflect the tuning here: {cause}"
    CONTRADICTED = "the response pattern ({seen}) contradicts the diagnosis: {cause}"
    CUT_SHORT = "the response was cut short by the next setpoint change, before its pattern was complete"
    NO_ORDINARY = "half-cycle decay ratio {damping:.2f} and overshoot {overshoot:.2f} disagree: not a simple response"
    UNEVEN = "peaks {first_s:.3g} s and {second_s:.3g} s apart: two disturbances, not one oscillation"
    WEAK = "the response is {height_bands:.1f} noise bands high: too small for a response pattern"
    LIMITED = "co was at a limit for {limited_share:.0%} of the response: its pattern does not reflect the tuning"
    PULSE = "co returned to its start: the load was a pulse, which causes overshoot by itself"
    UNRESTED = "no second peak, and the response before it had not come to rest: too little for more action"
    UNDYING = "lasting oscillation (half-cycle decay ratio {damping:.2f}): stiction or another loop is not ruled out"


MOVING = frozenset({PatternReading.LIVELY, PatternReading.CALM, PatternReading.OVERDAMPED, PatternReading.SLOW})
"""Readings that change gains."""
MAY_BE_TUNING = TUNING_CAUSES | {Cause.UNKNOWN}
"""Causes under which a pattern may speak of the tuning."""
WANTED = {Cause.AGGRESSIVE: -1, Cause.SLUGGISH: 1}
"""Direction that a cause asks for; an integral that is too strong may ask for either."""


@dataclass(frozen=True, slots=True)
class Move:
    """Factors on Kc and tau_I of the ideal form; tau_D goes with tau_I, so that their ratio stays."""

    kc: float = 1.0
    tau_i: float = 1.0

    @property
    def words(self) -> str:
        """What moves by how much."""
        parts = [f"{name} x {f:.2f}" for name, f in (("Kc", self.kc), ("tau_I", self.tau_i)) if f != 1]
        return ", ".join(parts) or "no change"

    @property
    def direction(self) -> int:
        """+1 towards more action, -1 towards less, 0 where both or nothing."""
        more, less = self.kc > 1 or self.tau_i < 1, self.kc < 1 or self.tau_i > 1
        return int(more) - int(less)

    def of(self, gains: PidGains) -> PidGains:
        """The gains moved; a pure integral controller has its ki moved."""
        return PidGains(gains.kp * self.kc, gains.ki * self.kc / self.tau_i, gains.kd * self.kc * self.tau_i)


@dataclass(frozen=True, slots=True)
class AdviceNumbers(Numbers):
    """What was weighed. shown : by the response. margin : to the targets, the least; None where nothing is concluded.

    period_over_tau_i : of a swing. kc_factor, tau_i_factor : what is to be moved by how much, None for nothing.
    """

    shown: PatternNumbers
    margin: float | None = None
    period_over_tau_i: float | None = None
    kc_factor: float | None = None
    tau_i_factor: float | None = None


@dataclass(frozen=True, slots=True)
class PatternAdvice:
    """What the rule says. tuning : new settings, None where nothing is to be moved. numbers : what was weighed."""

    reading: PatternReading
    sentence: str
    numbers: AdviceNumbers
    tuning: Tuning | None = None


def pattern_rule(
    response: Response, window: Window, gains: PidGains, diagnosis: Diagnosis | None, settings: PatternSettings
) -> PatternAdvice:
    """What a response asks of the gains that were in force during it.

    Parameters
    ----------
    response, window : what was recognised, and its samples with some time before.
    diagnosis : what is known of the cause; None where nobody looked.
    """
    shown = pattern_numbers(response, window)
    refused = _refusal(response, diagnosis, shown, settings)
    read = _Read(refused, Move()) if refused else _reading(gains, shown, settings)
    reading, move = read.reading, read.move
    if diagnosis is not None and move.direction * WANTED.get(diagnosis.cause, 0) < 0:
        reading = PatternReading.CONTRADICTED
    cause = diagnosis.reason if diagnosis else "no diagnosis was made"
    sentence = reading.value.format(cause=cause, seen=seen(shown), moves=move.words, **shown.to_dict())
    numbers = AdviceNumbers(shown, read.margin, read.period_over_tau_i)
    if reading not in MOVING:
        return PatternAdvice(reading, sentence, numbers)
    numbers = replace(numbers, kc_factor=move.kc, tau_i_factor=move.tau_i)
    return PatternAdvice(reading, sentence, numbers, Tuning("pattern", "ideal", move.of(gains), None, (sentence,)))


class _Read(NamedTuple):
    """A reading, what it moves, and the numbers that it rests on (AdviceNumbers)."""

    reading: PatternReading
    move: Move
    margin: float | None = None
    period_over_tau_i: float | None = None


def seen(shown: PatternNumbers) -> str:
    """The numbers that a person compares with the targets."""
    said = shown.to_dict()
    named = {
        "overshoot": "overshoot",
        "damping": "half-cycle decay ratio",
        "co_overshoot": "overshoot of co",
        "rebound": "rebound",
    }
    parts = [f"{word} {said[name]:.2f}" for name, word in named.items() if name in said]
    return ", ".join(parts if shown.second else ["no second peak", *parts])


def _refusal(
    response: Response, diagnosis: Diagnosis | None, shown: PatternNumbers, settings: PatternSettings
) -> PatternReading | None:
    """Why nothing may be concluded, if so."""
    if diagnosis is not None and diagnosis.cause not in MAY_BE_TUNING:
        return PatternReading.OTHER_CAUSE
    if response.ending == Ending.SETPOINT and (len(response.peaks) > 1 or not _is_long(shown, settings)):
        return PatternReading.CUT_SHORT
    if shown.height_bands < settings.least_bands:
        return PatternReading.WEAK
    if shown.limited_share > settings.limited:
        return PatternReading.LIMITED
    if shown.after_load is not None and shown.after_load.co_way < settings.pulse:
        return PatternReading.PULSE
    if shown.second is None or shown.third is None:
        return None
    damping, first, second = shown.third.damping, shown.third.first_s, shown.third.second_s
    if abs(damping - shown.second.overshoot) > settings.gap:
        return PatternReading.NO_ORDINARY
    if not response.sp_changed and max(first, second) > settings.uneven * min(first, second):
        return PatternReading.UNEVEN
    ruled_out = settings.alone or (diagnosis is not None and diagnosis.cause in TUNING_CAUSES)
    return PatternReading.UNDYING if damping > settings.undying and not ruled_out else None


def _is_long(shown: PatternNumbers, settings: PatternSettings) -> bool:
    """Whether a load response comes back long after it rose: its integral time is too long."""
    return shown.after_load is not None and shown.after_load.tail_s > settings.long_tail * shown.after_load.rise_s


def _reading(gains: PidGains, shown: PatternNumbers, settings: PatternSettings) -> _Read:
    """The rule at the head of this file."""
    second, load = shown.second, shown.after_load
    damping = shown.third.damping if shown.third else 0.0
    overshoots = second.overshoot if second else 0.0, (load.co_overshoot or 0.0) if load else 0.0
    room = settings.overshoot_target - max(overshoots)
    rebound = load.rebound if load else 0.0
    m = min(room, settings.damping_target - max(damping, rebound))
    if second is None:
        return _Read(*_without_second_peak(gains, room, m, shown, settings), m)
    ratio = gains.ki / gains.kp * second.period_s if gains.kp else math.inf
    reading, move = _with_second_peak(second, damping, m, ratio, shown.tenth_s, settings)
    return _Read(reading, move, m, ratio if gains.kp else None)


def _with_second_peak(
    second: SecondPeak, damping: float, m: float, ratio: float, tenth_s: float | None, settings: PatternSettings
) -> tuple[PatternReading, Move]:
    """Slow, near its targets, calm or lively. m : margin. ratio : period over tau_I."""
    if m < settings.dead_zone and _is_slow(second, ratio, tenth_s, settings):
        return PatternReading.SLOW, Move(kc=settings.least_up)
    if abs(m) <= settings.dead_zone:
        return PatternReading.ON_TARGET, Move()
    if m > 0:
        return PatternReading.CALM, _faster(m, ratio, settings)
    riding = damping - second.overshoot > settings.riding
    return PatternReading.LIVELY, _calmer(m, 0.0 if riding else ratio, damping, settings)


def _without_second_peak(
    gains: PidGains, room: float, m: float, shown: PatternNumbers, settings: PatternSettings
) -> tuple[PatternReading, Move]:
    """Overdamped, or a swing that rides on a slow return."""
    rebound = shown.after_load.rebound if shown.after_load else 0.0
    if m < -settings.dead_zone and rebound > settings.damping_target:
        return PatternReading.LIVELY, _calmer(m, 0.0, 0.0, settings)
    if shown.after_load and shown.after_load.left_bands > settings.rested_bands:
        return PatternReading.UNRESTED, Move()
    if gains.ki and _is_long(shown, settings):
        return PatternReading.OVERDAMPED, Move(tau_i=1 / settings.least_up)
    if room <= settings.overshoot_target - settings.co_enough:
        return PatternReading.ON_TARGET, Move()
    return PatternReading.OVERDAMPED, Move(kc=settings.least_up)


def _is_slow(second: SecondPeak, ratio: float, tenth_s: float | None, settings: PatternSettings) -> bool:
    """A swing that decays, under a short integral time, with a period that is long against how soon pv answers."""
    decays = second.overshoot < settings.slow_decays
    slow = tenth_s is not None and second.period_s > settings.slow_periods * tenth_s
    return slow and decays and settings.fast_ratio < ratio < math.inf


def _calmer(m: float, ratio: float, damping: float, settings: PatternSettings) -> Move:
    """Less gain or a longer integral time, by the integral's share of the phase; a growing swing loses gain at once."""
    share = (ratio - settings.fast_ratio) / (settings.slow_ratio - settings.fast_ratio)
    beta = min(max(share, 0.0), 1.0)
    if damping >= 1:
        return Move(1 / settings.urgent_step, settings.urgent_step if beta else 1.0)
    size = math.exp(min(-settings.gain * m, math.log(settings.step_down)))
    return Move(size ** -(1 - beta), size**beta)


def _faster(m: float, ratio: float, settings: PatternSettings) -> Move:
    """More gain, or a shorter integral time where it is long against the period."""
    size = math.exp(min(settings.gain * m, math.log(settings.step_up)))
    if 0 < ratio < settings.long_ratio:
        return Move(tau_i=max(1 / size, ratio / settings.long_ratio))
    return Move(kc=size)
