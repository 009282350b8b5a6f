"""A proposal without a model: the slow-oscillation rule in its range, else the pattern rule, within what is locked.

    not identifiable -> slow-oscillation rule, where the swing is that of an integrating process
                     -> pattern rule, small clamped steps
                     -> nothing, with the reasons of both

Neither proves anything. The guard lets such a proposal through as a small step at the most, and the trial watches it.

    q = (pi tau_I / P0)^2,   zeta^2 = (1 - sqrt(1 - 4 q))/2,   f = 1/zeta^2,   Kc and tau_I each by sqrt(f)

PI on k'/s has zeta = 0.5 sqrt(k' Kc tau_I) (Skogestad 2003), and swings with P0 = 2 pi/(w0 sqrt(1 - zeta^2)), w0 tau_I
= 2 zeta. Solved for zeta that is the exact need of a damped swing; the printed f = 0.1 (P0/tau_I)^2 is for a weakly
damped one (a third too strong at zeta 0.5). Afterwards k' Kc tau_I = 4. P0 is at least 2 pi tau_I for an integrating
process (zeta = 0.7), and each peak is s = exp(-pi zeta/sqrt(1 - zeta^2)) times the one before; a swing that is shorter
or decays otherwise is another one: a tone from outside (s = 1), or integral action against a dead time.

Both settings grow alike, so Kc/tau_I stays: loads are integrated away as before.
"""

import math
from enum import StrEnum

from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis, Numbers
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.guard.request import NO_LOCKS, Locks
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.slow_oscillation import SHORTEST_PERIOD, slow_oscillation
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.without_model.pattern_rule import PatternAdvice, PatternSettings, pattern_rule
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace

# ---- The slow-oscillation rule on a response: which swing it may be applied to, and what it asks for, without a
# model

MAY_APPLY = frozenset({Cause.SLOW_INTEGRATING, Cause.SLUGGISH, Cause.UNKNOWN})
"""Causes besides no diagnosis under which the rule may speak: too much gain is the contrary."""


class SlowReading(StrEnum):
    """What the rule says; the value is the sentence, with its numbers by name."""

    APPLIES = (
        "by the slow-oscillation rule (period {ratio:.1f} tau_I, zeta {zeta:.2f}): Kc tau_I x {factor:.2f}, "
        "Kc x {kc_factor:.2f}, tau_I x {tau_i_factor:.2f}"
    )
    NO_PI = "the slow-oscillation rule needs proportional and integral action"
    OTHER_CAUSE = "the slow-oscillation rule does not apply: {cause}"
    CUT_SHORT = "the response was cut short: its period is not known"
    NO_SWING = "too few peaks for a period"
    NOT_SLOW = "a period of {ratio:.1f} tau_I is no slow oscillation ({limit:.1f} and more is)"
    NOT_ALIKE = (
        "each peak is {decay:.2f} times the one before; an integrating process would have {expected:.2f} at this period"
    )
    DAMPED = "zeta {zeta:.2f} is damped enough"


@dataclass(frozen=True, slots=True)
class SlowSettings:
    """Settings.

    unlike : how far the decay may lie from that of an integrating process; 0.05 to 0.4, default 0.15.
    damped : zeta from which nothing is done; 0.4 to 0.7, default 0.6 (an overshoot of a tenth after loads).

    Raises ValueError: a number is outside its range.
    """

    unlike: float = 0.15
    damped: float = 0.6

    def __post_init__(self) -> None:
        for name, low, high in (("unlike", 0.05, 0.4), ("damped", 0.4, 0.7)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)} is outside {low} to {high}")


@dataclass(frozen=True, slots=True)
class SlowNumbers(Numbers):
    """What was weighed, as far as the rule came.

    decay : each peak against the one before. ratio : period over tau_I; limit : the least of a slow oscillation.
    zeta : as the period says. expected : the decay that goes with it. factor : on Kc tau_I. printed_factor : by the
    rule as printed. kc_factor, tau_i_factor : how the two share it.
    """

    decay: float | None = None
    period_s: float | None = None
    ratio: float | None = None
    limit: float | None = None
    zeta: float | None = None
    expected: float | None = None
    factor: float | None = None
    printed_factor: float | None = None
    kc_factor: float | None = None
    tau_i_factor: float | None = None


@dataclass(frozen=True, slots=True)
class SlowAdvice:
    """What the rule says. tuning : new settings, None where it does not apply. numbers : what was weighed."""

    reading: SlowReading
    sentence: str
    numbers: SlowNumbers
    tuning: Tuning | None = None


def slow_oscillation_online(
    response: Response, gains: PidGains, diagnosis: Diagnosis | None, settings: SlowSettings, locks: Locks = NO_LOCKS
) -> SlowAdvice:
    """What the rule asks for after a response under these gains.

    diagnosis : what is known of the cause; None where nobody looked. locks : where one of Kc and tau_I is locked, the
    other takes the whole factor.
    """
    reading, numbers = _reading(response, gains, diagnosis, settings, locks)
    sentence = reading.value.format(cause=diagnosis.reason if diagnosis else "", **numbers.to_dict())
    kc, tau_i = numbers.kc_factor, numbers.tau_i_factor
    if kc is None or tau_i is None:
        return SlowAdvice(reading, sentence, numbers)
    moved = PidGains(gains.kp * kc, gains.ki * kc / tau_i, gains.kd * kc)  # the rule does not speak of tau_D: it stays
    return SlowAdvice(reading, sentence, numbers, Tuning("slow-oscillation", "ideal", moved, None, (sentence,)))


def _reading(
    response: Response, gains: PidGains, diagnosis: Diagnosis | None, settings: SlowSettings, locks: Locks
) -> tuple[SlowReading, SlowNumbers]:
    """What the conditions at the head of this file say, in order, and what was weighed."""
    nothing = SlowNumbers()
    if not (gains.kp and gains.ki):
        return SlowReading.NO_PI, nothing
    if diagnosis is not None and diagnosis.cause not in MAY_APPLY:
        return SlowReading.OTHER_CAUSE, nothing
    if response.ending == Ending.SETPOINT:
        return SlowReading.CUT_SHORT, nothing
    if len(response.peaks) < (3 if response.sp_changed else 2):  # the first peak of a setpoint step is its beginning
        return SlowReading.NO_SWING, nothing
    before, last = response.peaks[-2:]
    decay, period_s, tau_i_s = -last.e / before.e, 2 * (last.t_s - before.t_s), gains.kp / gains.ki
    ratio, limit = period_s / tau_i_s, max(2 * math.pi, SHORTEST_PERIOD)
    swing = SlowNumbers(decay, period_s, ratio, limit)
    if ratio < limit:
        return SlowReading.NOT_SLOW, swing
    zeta = zeta_of(ratio)
    expected = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    swing = replace(swing, zeta=zeta, expected=expected)
    if abs(decay - expected) > settings.unlike:
        return SlowReading.NOT_ALIKE, swing
    if zeta >= settings.damped:
        return SlowReading.DAMPED, swing
    printed = slow_oscillation(period_s, tau_i_s)
    # How Kc and tau_I share the factor on their product
    factor = 1 / zeta**2
    kc = 1.0 if locks.kc else factor if locks.tau_i else math.sqrt(factor)
    tau_i = 1.0 if locks.tau_i else factor if locks.kc else math.sqrt(factor)
    cure = replace(swing, factor=factor, printed_factor=printed, kc_factor=kc, tau_i_factor=tau_i)
    return SlowReading.APPLIES, cure


def zeta_of(ratio: float) -> float:
    """Damping of PI on an integrating process by its period over tau_I (2 pi and more), 0.71 at most."""
    q = min((math.pi / ratio) ** 2, 0.25)
    return math.sqrt((1 - math.sqrt(1 - 4 * q)) / 2)


@dataclass(frozen=True, slots=True)
class WithoutModelSettings:
    """Settings of both rules. allowed : whether gains may be moved without a model at all; default yes."""

    pattern: PatternSettings = field(default_factory=PatternSettings)
    slow: SlowSettings = field(default_factory=SlowSettings)
    allowed: bool = True


@dataclass(frozen=True, slots=True)
class Proposed:
    """What is proposed. tuning and basis : None where nothing is. code : name of the reading that decided.

    sentence : why or why not. numbers : what was weighed.
    """

    code: str
    sentence: str
    numbers: Numbers
    tuning: Tuning | None = None
    basis: Basis | None = None


def step_without_model(
    response: Response,
    window: Window,
    gains: PidGains,
    diagnosis: Diagnosis | None,
    settings: WithoutModelSettings,
    locks: Locks = NO_LOCKS,
) -> Proposed:
    """What to try after a response from which no process can be identified.

    response, window : what was recognised, and its samples with some time before.
    gains : in force during it. diagnosis : what is known of the cause; None where nobody looked.
    """
    if not settings.allowed:
        return Proposed("not_allowed", "changes without a model are switched off", NO_NUMBERS)
    slow = slow_oscillation_online(response, gains, diagnosis, settings.slow, locks)
    advice: SlowAdvice | PatternAdvice = slow
    if slow.tuning is None:
        advice = pattern_rule(response, window, gains, diagnosis, settings.pattern)
    code, tuning = advice.reading.name.lower(), advice.tuning
    if tuning is None:
        return Proposed(code, advice.sentence, advice.numbers)
    kept = locks.keep(tuning.gains, gains)
    if kept == gains:
        return Proposed(code, f"{advice.sentence}; but that parameter is locked", advice.numbers)
    basis = Basis.SLOW_OSCILLATION if advice is slow else Basis.PATTERN
    return Proposed(code, advice.sentence, advice.numbers, replace(tuning, gains=kept), basis)
