"""The visual rules: what an oscillation seen on a trend says, without algebra (lecture slides, Putra, "visual loop
tuning").

    self-regulating  tau_I < P/2     lengthen the integral time first
                     tau_I > P       it is safe to lower the gain
    integrating      take out integral action as far as possible; only if that does not help lower the gain
    in manual        the oscillation stops: the tuning is the cause; it goes on: something outside is
    polling          at least ten times per time constant; measurement filter below a fifth of it

They say which way to go, not how far; between P/2 and P the slides are silent and so is the answer here.
"""

import math
from enum import StrEnum

HALF_PERIOD, PERIOD = 0.5, 1.0
"""Limits of tau_I over the oscillation period."""
POLLS_PER_TIME_CONSTANT = 10.0
FILTER_SHARE = 0.2


class VisualAdvice(StrEnum):
    """What to do first."""

    LENGTHEN_INTEGRAL_TIME = "lengthen the integral time"
    LOWER_GAIN = "lower the gain"
    REMOVE_INTEGRAL_ACTION = "take out integral action as far as possible"
    UNDECIDED = "the rule does not say: the integral time is between half the period and the period"


class OscillationCause(StrEnum):
    """Where an oscillation comes from."""

    TUNING = "the tuning"
    OUTSIDE = "something outside the loop"


def oscillating_loop(period_s: float, tau_i_s: float | None, *, integrating: bool = False) -> VisualAdvice:
    """First step for a loop that oscillates with this period; tau_i_s None for no integral action.

    Raises
    ------
    ValueError
        A time is not positive and finite.
    """
    for name, value in (("period", period_s), ("tau_I", tau_i_s)):
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"{name} = {value} must be positive and finite")
    if tau_i_s is None:
        return VisualAdvice.LOWER_GAIN
    if integrating:
        return VisualAdvice.REMOVE_INTEGRAL_ACTION
    if tau_i_s < HALF_PERIOD * period_s:
        return VisualAdvice.LENGTHEN_INTEGRAL_TIME
    return VisualAdvice.LOWER_GAIN if tau_i_s > PERIOD * period_s else VisualAdvice.UNDECIDED


def cause_by_manual(*, stops_in_manual: bool) -> OscillationCause:
    """The oscillation's origin by the test of putting the loop in manual."""
    return OscillationCause.TUNING if stops_in_manual else OscillationCause.OUTSIDE


def longest_poll_s(time_constant_s: float) -> float:
    """Longest time between samples for a process with this time constant.

    Raises
    ------
    ValueError
        The time constant is not positive and finite.
    """
    return _share(time_constant_s, 1 / POLLS_PER_TIME_CONSTANT)


def longest_filter_s(time_constant_s: float) -> float:
    """Longest filter time of the measurement for a process with this time constant.

    Raises
    ------
    ValueError
        The time constant is not positive and finite.
    """
    return _share(time_constant_s, FILTER_SHARE)


def _share(time_constant_s: float, share: float) -> float:
    if not 0 < time_constant_s < math.inf:
        raise ValueError(f"time constant = {time_constant_s} s must be positive and finite")
    return share * time_constant_s
