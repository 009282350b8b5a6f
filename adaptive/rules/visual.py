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

from retuner.schedule.gains import PidGains

HALF_PERIOD, PERIOD = 0.5, 1.0  # limits of tau_I over the oscillation period
POLLS_PER_TIME_CONSTANT = 10.0
FILTER_SHARE = 0.2


class VisualAdvice(StrEnum):
    """What to do first."""

    LENGTHEN_INTEGRAL_TIME = "lengthen the integral time"
    LOWER_GAIN = "lower the gain"
    REMOVE_INTEGRAL_ACTION = "take out integral action as far as possible"


def oscillating_loop(period_s: float, tau_i_s: float | None, *, integrating: bool = False) -> VisualAdvice | None:
    """First step for a loop that oscillates with this period, None where the rule has none.

    tau_i_s : None for no integral action.

    Raises ValueError: a time is not positive and finite.
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
    return VisualAdvice.LOWER_GAIN if tau_i_s > PERIOD * period_s else None


def oscillation_by_eye(period_s: float, gains: PidGains | None, *, integrating: bool, tuning: bool) -> list[str]:
    """What an experienced eye says of an oscillation: where to begin, and how to find out where it comes from.

    period_s : of the oscillation. gains : in force, None where not known. integrating : the process has no level of
        its own. tuning : whether the tuning may be the cause; where it is not, changing it is no beginning.
    """
    lines = []
    if tuning and gains is not None and gains.kp:
        tau_i_s = gains.kp / gains.ki if gains.ki else None
        shown = "no integral action" if tau_i_s is None else f"tau_I {tau_i_s:.3g} s"
        advice = oscillating_loop(period_s, tau_i_s, integrating=integrating)
        lines += [f"{shown} with a period of {period_s:.3g} s: {advice}"] if advice else []
    by_manual = "stops if the tuning is the cause, and continues if it is something outside the loop"
    return [*lines, f"in manual the oscillation {by_manual}"]


def sampling_by_eye(time_constant_s: float, sample_time_s: float) -> list[str]:
    """What is wrong with how often a process of this time constant is looked at; nothing where it is often enough."""
    most = time_constant_s / POLLS_PER_TIME_CONSTANT
    if sample_time_s <= most:
        return []
    return [
        f"sampled every {sample_time_s:.3g} s: a time constant of {time_constant_s:.3g} s needs at most {most:.3g} s, "
        f"and a measurement filter below {FILTER_SHARE * time_constant_s:.3g} s"
    ]
