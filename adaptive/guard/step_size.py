"""Gains as the limits see them: kc, tau_I, tau_D and the integral action kc/tau_I, in magnitude.

    kc = |kp|,   tau_I = kp/ki,   tau_D = kd/kp,   kc/tau_I = |ki|          (ideal form; it exists for every kp but 0)

More action is a larger kc, tau_D or kc/tau_I and a shorter tau_I.
"""

import math
from collections.abc import Callable
from enum import StrEnum

from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GAIN_NAMES


class Parameter(StrEnum):
    """The four that have limits; the value is what people call them."""

    KC = "kc"
    TAU_I = "tau_I"
    TAU_D = "tau_D"
    INTEGRAL = "kc/tau_I"


MORE_WHEN_LARGER = {Parameter.KC: True, Parameter.TAU_I: False, Parameter.TAU_D: True, Parameter.INTEGRAL: True}
"""Whether a larger value is more action."""
ROUNDING = 1e-12  # difference up to which a parameter counts as unchanged


def logs(gains: PidGains) -> dict[Parameter, float]:
    """Natural logarithms of those that the controller has."""
    kp, ki, kd = (math.log(abs(g)) if g else None for g in (gains.kp, gains.ki, gains.kd))
    found = {}
    if kp is not None:
        found[Parameter.KC] = kp
        if ki is not None:
            found[Parameter.TAU_I] = kp - ki
        if kd is not None:
            found[Parameter.TAU_D] = kd - kp
    if ki is not None:
        found[Parameter.INTEGRAL] = ki
    return found


def step_limit(parameter: Parameter, *, more: bool, settings: GuardSettings, alone: bool = False) -> float:
    """Largest factor of one change of a parameter, towards more or less action.

    kc/tau_I has no limit of its own upwards unless one is given, because kc and tau_I each keep theirs; it has one
    where it stands alone: in a controller without kc before or after the change, or where tau_I is free.
    """
    s = settings
    more_own, less_own = {
        Parameter.KC: (s.kc_up_max, s.kc_down_max),
        Parameter.TAU_I: (s.tau_i_shorter_max, s.tau_i_longer_max),
        Parameter.TAU_D: (s.tau_d_up_max, s.tau_d_down_max),
        Parameter.INTEGRAL: (s.integral_up_max, s.integral_down_max),
    }[parameter]
    own, general = (more_own, s.step_up_max) if more else (less_own, s.step_down_max)
    if own is None and more and parameter is Parameter.INTEGRAL and not alone:
        return (s.kc_up_max or s.step_up_max) * (s.tau_i_shorter_max or s.step_up_max)
    return general if own is None else own


def within_limits(
    old: PidGains, new: PidGains, share: float, settings: GuardSettings, *, less_unlimited: bool = False
) -> tuple[PidGains, float] | None:
    """The point on the way from old to new that the limits per change allow, and its share of the way.

    The way is straight in the logarithms, so every parameter goes the same share of its own way and none passes its
    goal; a gain that comes or goes has no logarithm and goes its share of the way itself. None when kc lies outside its
    absolute limits there, and no nearer to them than before.

    share : of what the limits allow, above 0, at most 1. less_unlimited : no limit per change towards less action, nor
        on a tau_I that shortens because kc falls: kc, kc/tau_I and tau_D still grow no faster than they may.
    """

    def room(parameter: Parameter, more: bool) -> float:
        if less_unlimited and (not more or parameter is Parameter.TAU_I):
            return math.inf
        alone = less_unlimited or not (old.kp and new.kp)
        return math.log(step_limit(parameter, more=more, settings=settings, alone=alone))

    share *= _share(old, new, room)
    moved = along(old, new, share)
    kc, now = abs(moved.kp), abs(old.kp)
    least, most = min(settings.kc_min, now) * (1 - ROUNDING), max(settings.kc_max, now) * (1 + ROUNDING)
    return (moved, share) if least <= kc <= most else None


def within_factor(old: PidGains, new: PidGains, factor: float) -> PidGains:
    """The point on the way that one limit for every parameter allows."""
    return along(old, new, _share(old, new, lambda _parameter, _more: math.log(factor)))


def _share(old: PidGains, new: PidGains, room: Callable[[Parameter, bool], float]) -> float:
    """Share of the way that leaves every parameter within its room (logarithm of its factor)."""
    share = 1.0
    start, goal = logs(old), logs(new)
    for parameter in start.keys() & goal.keys():
        way = goal[parameter] - start[parameter]
        if way:
            share = min(share, room(parameter, (way > 0) == MORE_WHEN_LARGER[parameter]) / abs(way))
    return share


def along(old: PidGains, new: PidGains, share: float) -> PidGains:
    """The point after this share of the way, straight in the logarithms."""
    if share >= 1.0:
        return new
    found = []
    for name in GAIN_NAMES:
        o, n = getattr(old, name), getattr(new, name)
        straight = (
            math.copysign(math.exp((1 - share) * math.log(abs(o)) + share * math.log(abs(n))), n) if o and n else 0.0
        )
        found.append(straight or (1 - share) * o + share * n)
    return PidGains(*found)


SAME_GAINS = 1.00001  # gains closer than this factor are one set: float32 on the wire rounds by 1.0000001


def change_factor(old: PidGains, new: PidGains) -> float:
    """Largest factor by which one of the gains differs (infinite when one appears, goes, or acts the other way)."""
    factors = [
        max(n / o, o / n) if o and n and (o > 0) == (n > 0) else math.inf
        for o, n in ((old.kp, new.kp), (old.ki, new.ki), (old.kd, new.kd))
        if o or n
    ]
    return max(factors, default=1.0)


def extent(old: PidGains, new: PidGains) -> float:
    """Natural logarithm of the largest factor among the parameters that both have."""
    start, goal = logs(old), logs(new)
    return max((abs(goal[p] - start[p]) for p in start.keys() & goal.keys()), default=0.0)


def less_of_everything(old: PidGains, new: PidGains) -> bool:
    """Whether no gain grows and tau_I does not shorten: less action for certain."""
    pairs = ((abs(getattr(old, name)), abs(getattr(new, name))) for name in GAIN_NAMES)
    if any(after > before for before, after in pairs):
        return False
    if not new.ki or not old.ki:
        return True
    return abs(new.kp * old.ki) >= abs(old.kp * new.ki) * (1 - ROUNDING)
