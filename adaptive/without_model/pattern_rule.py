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

What a response looks like, in numbers by name: peaks of the error, and what pv and co did meanwhile.

    height_bands    the largest error
    limited_share   of the time outside the noise band, how long co stood at an extreme: integral action moves it there,
                    unless a limit holds it; besides overshoot, damping, period_s, times between peaks (response.py)
    after a load    rise_s, until the error is largest; tail_s, from there until it stays inside the noise band;
                    rebound, how far it grows again on its way back, as a share of its largest value; left_bands, how
                    far pv was from its setpoint just before (a tail of the last response); co_way, how far co ended
                    from where it began, as a share of its travel; co_overshoot: a load d at the input is answered by
                    co = co_0 - T d, so co overshoots as pv would after a setpoint step, whatever the error's sign
    after a step    tenth_s, until pv has made a tenth of its way from rest: the dead time and a little more (a
                    second-order process takes 0.45 of its radians for that)
"""

import math
from enum import StrEnum

import numpy as np

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, fields, replace

# ---- What a response looks like, in numbers by name

SMOOTHED = 5  # samples of the moving mean before extremes are taken: noise would make them larger
AT_REST_BANDS = 1.5  # pv rested where it stayed within this many noise bands of its median
TENTH, MOVED_BANDS = 0.1, 2.0
"""pv has answered when it is this share of its way from where it rested, and at least so many noise bands."""


@dataclass(frozen=True, slots=True)
class SecondPeak(Numbers):
    """What the second peak shows; period_s is twice the time between the first two while there is no third."""

    overshoot: float
    period_s: float


@dataclass(frozen=True, slots=True)
class ThirdPeak(Numbers):
    """What the third peak shows. first_s, second_s : from the first peak to the second, and on to the third."""

    damping: float
    first_s: float
    second_s: float


@dataclass(frozen=True, slots=True)
class LoadNumbers(Numbers):
    """Numbers of a load response, see the head of this file; co_overshoot : None where co stays or comes back."""

    rise_s: float
    tail_s: float
    rebound: float
    left_bands: float
    co_way: float
    co_overshoot: float | None = None


@dataclass(frozen=True, slots=True)
class PatternNumbers(Numbers):
    """The numbers at the head of this file; None for those that a response does not show."""

    peaks: float
    height_bands: float
    limited_share: float
    second: SecondPeak | None = None
    third: ThirdPeak | None = None
    tenth_s: float | None = None
    after_load: LoadNumbers | None = None


def pattern_numbers(response: Response, window: Window) -> PatternNumbers:
    """The numbers of a response.

    window : the response with some time before it.
    """
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    size = np.abs(window.sp - window.pv)
    height = float(np.max(size[during], initial=0.0))
    co = window.co[during & (size > response.band)]
    still = sum(max(int(np.sum(co == extreme)) - 1, 0) for extreme in (window.co.max(), window.co.min()))
    overshoot, period_s, damping = response.overshoot, response.period_s, response.damping  # None without one
    third = None
    if damping is not None:
        first_s, second_s, third_s = (peak.t_s for peak in response.peaks)
        third = ThirdPeak(damping, second_s - first_s, third_s - second_s)
    return PatternNumbers(
        peaks=float(len(response.peaks)),
        height_bands=height / response.band,
        limited_share=still / co.size if co.size else 0.0,
        second=(None if overshoot is None or period_s is None else SecondPeak(overshoot, period_s)),
        third=third,
        tenth_s=_tenth_s(response, window) if response.sp_changed else None,
        after_load=None if response.sp_changed else _of_load(response, window),
    )


def _tenth_s(response: Response, window: Window) -> float | None:
    """How soon pv answers; None where it did not rest before."""
    t_s = window.t_s - response.t_start_s
    before = window.pv[t_s < 0]
    if not len(before):
        return None
    rest = median(before)
    if np.max(np.abs(before - rest)) > AT_REST_BANDS * response.band:
        return None
    way = abs(float(window.sp[-1]) - rest)
    far = max(TENTH * way, MOVED_BANDS * response.band)
    moved = np.flatnonzero((t_s > 0) & (np.abs(window.pv - rest) > far))
    return float(t_s[moved[0]]) if moved.size else None


def _of_load(response: Response, window: Window) -> LoadNumbers | None:
    """Rise, tail, rebound, and the overshoot of co; None of an error that stays inside the noise band."""
    during = (window.t_s >= response.t_start_s) & (window.t_s <= response.t_end_s)
    t_s, error = window.t_s[during] - response.t_start_s, (window.sp - window.pv)[during]
    outside = np.flatnonzero(np.abs(error) > response.band)
    if not outside.size or len(error) < 3 * SMOOTHED:
        return None
    top = int(np.argmax(np.abs(error)))
    rise_s, tail_s = float(t_s[top]), float(t_s[outside[-1]] - t_s[top])
    before = (window.sp - window.pv)[window.t_s < response.t_start_s][-SMOOTHED:]
    left_bands = abs(float(np.mean(before))) / response.band if before.size else 0.0
    smooth = _smooth(error)
    largest = int(np.argmax(np.abs(smooth)))
    back = smooth[largest:] * np.sign(smooth[largest])  # its way back, and how far it grows again
    growth = float(np.max(back - np.minimum.accumulate(back)))
    rebound = max(growth - response.band / 2, 0.0) / float(back[0]) if back[0] else 0.0  # half a band may be noise
    # how far co ended from where it began, and how far it went beyond
    first, last = (int(i) for i in np.flatnonzero(during)[[0, -1]])
    own = _smooth(window.co[first : last + 1])
    begun = median(window.co[: max(first, SMOOTHED)])
    way = float(np.mean(window.co[last + 1 - 2 * SMOOTHED : last + 1])) - begun
    travel = max(float(np.max(own)), begun) - min(float(np.min(own)), begun)
    of_co = (abs(way) / travel, float(np.max((own - begun) / way)) - 1.0) if way and travel else (0.0, None)
    return LoadNumbers(rise_s, tail_s, rebound, left_bands, *of_co)


def _smooth(values: FloatArray) -> FloatArray:
    return np.asarray(np.convolve(values, np.ones(SMOOTHED) / SMOOTHED, mode="valid"), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class PatternSettings:
    """Settings. Where no source is named, the value did best on the batch's first seeds (benchmarks/online).

    Raises ValueError: a number is outside its range, not finite and positive, or a factor below 1.
    """

    overshoot_target: float = setting(
        0.15,
        "Overshoot that is aimed at",
        "0.05..0.5",
        "below the 0.3 of Astrom & Hagglund 1995, section 6.5: Ms stays below 2",
    )
    damping_target: float = setting(
        0.15,
        "Target for the half-cycle decay ratio (0 dead-beat, 1 sustained)",
        "0.05..0.5",
        "as the overshoot: for a clean decay both are equal",
    )
    dead_zone: float = setting(
        0.05, "Distance from the targets within which nothing moves", "0.02..0.2", "what noise makes of an overshoot"
    )
    gain: float = 1.5  # g of the rule, ln of a factor per unit of margin, 0.5 to 3
    step_up: float = setting(
        1.3, "Greatest factor per response towards more action", "1.05..2", "a gain margin of 1.9 outlives two of them"
    )
    step_down: float = setting(
        1.5, "Greatest factor per response towards less action", "1.05..2", "safety is reached faster than speed"
    )
    urgent_step: float = 2.0  # factor at once when the swing grows, 1.05 to 4
    careful: float = 1.2  # factor per response without a second peak, at most step_up, 1.02 to 2
    co_enough: float = 0.05  # overshoot of co from which a response without a second peak is fast enough, 0 to 0.3
    fast_ratio: float = 1.5  # T/tau_I below which a swing is the gain's doing: the integral's lag is 13 degrees there
    slow_ratio: float = 4.0  # the same above which it is the integral's: 32 degrees
    long_ratio: float = 1.2  # T/tau_I below which tau_I is long (tau_I = 0.83 T, Ziegler & Nichols 1942 for PI)
    long_tail: float = 8.0  # return over rise of a load response above which tau_I is too long (SIMC's is 4 to 5)
    # T over the time of the first tenth above which a swing is slow (SIMC's is 7 to 12; two equal lags under too much
    # gain have 14 to 17)
    slow_periods: float = 20.0
    slow_decays: float = 0.6  # and its overshoot at most
    riding: float = 0.1  # damping above overshoot by this: the swing rides on a slow return, so the gain gives way
    least_bands: float = 6.0  # least height of a response in noise bands, 3 to 20: an overshoot of a sixth shows then
    gap: float = 0.35  # damping and overshoot further apart belong to no ordinary response
    uneven: float = 2.5  # ratio of the times between peaks of a load response above which they are two upsets
    limited: float = 0.1  # largest share of the upset with co at a limit, 0.01 to 0.5
    pulse: float = 0.4  # share of its own travel that co must end away from where it began after a load
    # noise bands that pv may have been off before a load, for a response without a second peak to be called slow
    rested_bands: float = 1.5
    undying: float = 0.85  # damping above which a swing may be a valve's or another loop's
    alone: bool = False  # nothing else looks for such causes: act on an undying swing, too (for comparisons)

    @property
    def least_up(self) -> float:
        """Factor of a careful step, within step_up."""
        return min(self.careful, self.step_up)

    def __post_init__(self) -> None:
        require_in_range(self, "pattern rule")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "alone" and not 0 < value < math.inf:
                raise ValueError(f"{field.name} = {value} must be positive and finite")
        if min(self.urgent_step, self.careful) < 1:
            raise ValueError(f"urgent_step = {self.urgent_step}, careful = {self.careful}: factors of at least 1")


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
MAY_BE_TUNING = TUNING_CAUSES | {Cause.UNKNOWN}  # causes under which a pattern may speak of the tuning
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

    response, window : what was recognised, and its samples with some time before.
    diagnosis : what is known of the cause; None where nobody looked.
    """
    shown = pattern_numbers(response, window)
    refused = _refusal(response, diagnosis, shown, settings)
    reading, move, *weighed = (refused, Move(), None, None) if refused else _reading(gains, shown, settings)
    if diagnosis is not None and move.direction * WANTED.get(diagnosis.cause, 0) < 0:
        reading = PatternReading.CONTRADICTED
    cause = diagnosis.reason if diagnosis else "no diagnosis was made"
    sentence = reading.value.format(cause=cause, seen=seen(shown), moves=move.words, **shown.to_dict())
    numbers = AdviceNumbers(shown, *weighed)
    if reading not in MOVING:
        return PatternAdvice(reading, sentence, numbers)
    numbers = replace(numbers, kc_factor=move.kc, tau_i_factor=move.tau_i)
    return PatternAdvice(reading, sentence, numbers, Tuning("pattern", "ideal", move.of(gains), None, (sentence,)))


def seen(shown: PatternNumbers) -> str:
    """The numbers that a person compares with the targets."""
    said = shown.to_dict()
    words = {"damping": "half-cycle decay ratio", "co_overshoot": "overshoot of co"}
    names = ("overshoot", "damping", "co_overshoot", "rebound")
    parts = [f"{words.get(name, name)} {said[name]:.2f}" for name in names if name in said]
    return ", ".join(parts if shown.second else ["no second peak", *parts])


def _refusal(
    response: Response, diagnosis: Diagnosis | None, shown: PatternNumbers, settings: PatternSettings
) -> PatternReading | None:
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


def _reading(
    gains: PidGains, shown: PatternNumbers, settings: PatternSettings
) -> tuple[PatternReading, Move, float, float | None]:
    """The reading, what it moves, and what it rests on: the margin to the targets, and the period over tau_I."""
    second, load = shown.second, shown.after_load
    damping = shown.third.damping if shown.third else 0.0
    overshoots = second.overshoot if second else 0.0, (load.co_overshoot or 0.0) if load else 0.0
    room = settings.overshoot_target - max(overshoots)
    rebound = load.rebound if load else 0.0
    m = min(room, settings.damping_target - max(damping, rebound))
    if second is None:
        if m < -settings.dead_zone and rebound > settings.damping_target:
            reading, move = PatternReading.LIVELY, _calmer(m, 0.0, 0.0, settings)
        elif load and load.left_bands > settings.rested_bands:
            reading, move = PatternReading.UNRESTED, Move()
        elif gains.ki and _is_long(shown, settings):
            reading, move = PatternReading.OVERDAMPED, Move(tau_i=1 / settings.least_up)
        elif room <= settings.overshoot_target - settings.co_enough:
            reading, move = PatternReading.ON_TARGET, Move()
        else:
            reading, move = PatternReading.OVERDAMPED, Move(kc=settings.least_up)
        return reading, move, m, None
    ratio = gains.ki / gains.kp * second.period_s if gains.kp else math.inf
    # a swing that decays, under a short integral time, with a period that is long against how soon pv answers
    decays = second.overshoot < settings.slow_decays and settings.fast_ratio < ratio < math.inf
    slow = decays and shown.tenth_s is not None and second.period_s > settings.slow_periods * shown.tenth_s
    if m < settings.dead_zone and slow:
        reading, move = PatternReading.SLOW, Move(kc=settings.least_up)
    elif abs(m) <= settings.dead_zone:
        reading, move = PatternReading.ON_TARGET, Move()
    elif m > 0:
        size = math.exp(min(settings.gain * m, math.log(settings.step_up)))
        shorter = 0 < ratio < settings.long_ratio
        move = Move(tau_i=max(1 / size, ratio / settings.long_ratio)) if shorter else Move(kc=size)
        reading = PatternReading.CALM
    else:
        riding = damping - second.overshoot > settings.riding
        reading, move = PatternReading.LIVELY, _calmer(m, 0.0 if riding else ratio, damping, settings)
    return reading, move, m, ratio if gains.kp else None


def _calmer(m: float, ratio: float, damping: float, settings: PatternSettings) -> Move:
    """Less gain or a longer integral time, by the integral's share of the phase; a growing swing loses gain at once."""
    share = (ratio - settings.fast_ratio) / (settings.slow_ratio - settings.fast_ratio)
    beta = min(max(share, 0.0), 1.0)
    if damping >= 1:
        return Move(1 / settings.urgent_step, settings.urgent_step if beta else 1.0)
    size = math.exp(min(-settings.gain * m, math.log(settings.step_down)))
    return Move(size ** -(1 - beta), size**beta)
