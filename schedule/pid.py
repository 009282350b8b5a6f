"""The PID law: one pure step in positional parallel form, two degrees of freedom, filtered derivative of the measurement.

    co = kp (b sp - pv) + I + D
    I  <- I + ki (sp - pv) dt                              after the output: forward difference
    D  = -kd (pv - pv_f) / (tau_f + dt)                    before the output: backward difference
    pv_f <- pv_f + dt / (tau_f + dt) (pv - pv_f)

Discretised as in Wittenmark, Astrom & Arzen (2002, section 5): forward for I, so that a change of gains can be exactly
bumpless in the same sample; backward for D, which is stable for every tau_f including 0 (Tustin's rings at -1).

I is kept in output units, so a change of ki alone needs nothing, and ki = 0 leaves I as the bias. Anti-windup is
conditional integration (Astrom & Hagglund 2006, section 3.5): at a limit of range or rate, I does not move further
outward. It needs no tracking time constant, so there is none to go stale when gains change.
"""

import math
from typing import NamedTuple, TypeAlias

from retuner.schedule.gains import PidGains


class PidLaw(NamedTuple):
    """Settings of the law in plain floats; make it with `law`, which checks them.

    kp, ki, kd : parallel gains. b : setpoint weight. tau_f_s : filter time of the derivative, s.
    co_min, co_max : range of the output. co_rate : its largest rate, per second; 0.0 for none.
    """

    kp: float
    ki: float
    kd: float
    b: float
    tau_f_s: float
    co_min: float
    co_max: float
    co_rate: float


PidState: TypeAlias = tuple[float, float, float, int]
"""(integral, pv_f, co, limited): I in output units, filtered measurement, last output, -1 / 0 / +1 at a limit.

A plain tuple and no named one: it is made and read once a sample, and that is a third of the cost of a step.
"""


def law(
    gains: PidGains, *, b: float = 1.0, tau_f_s: float = 0.0, co_min: float = 0.0, co_max: float = 100.0,
    co_rate_per_s: float = math.inf,
) -> PidLaw:  # fmt: skip
    """Checked settings.

    Parameters
    ----------
    gains : parallel gains. b : setpoint weight, 0 to 1 as a rule. tau_f_s : derivative filter, s, >= 0.
    co_min, co_max : output range, co_min < co_max. co_rate_per_s : largest rate of the output, > 0.

    Raises
    ------
    ValueError
        A setting is not finite (the rate may be infinite) or outside its range; it is named.
    """
    for name, value in (("b", b), ("tau_f_s", tau_f_s), ("co_min", co_min), ("co_max", co_max)):
        if not math.isfinite(value):
            raise ValueError(f"{name} = {value} is not a finite number")
    if b < 0 or tau_f_s < 0:
        raise ValueError(f"b = {b} and tau_f_s = {tau_f_s} must not be negative")
    if co_min >= co_max:
        raise ValueError(f"co_min = {co_min} must be below co_max = {co_max}")
    if not co_rate_per_s > 0:
        raise ValueError(f"co_rate_per_s = {co_rate_per_s} must be positive")
    rate = co_rate_per_s if co_rate_per_s < math.inf else 0.0
    numbers = (gains.kp, gains.ki, gains.kd, b, tau_f_s, co_min, co_max, rate)
    return PidLaw(*(float(v) for v in numbers))


def start(settings: PidLaw, sp: float, pv: float, co: float) -> PidState:
    """The state from which the next step continues at this output (held to its range) without a bump.

    Raises
    ------
    ValueError
        A value is not finite.
    """
    _refuse_non_finite(sp, pv, co, 1.0)
    held = min(max(co, settings.co_min), settings.co_max)
    return held - settings.kp * (settings.b * sp - pv), pv, held, _side(settings, held)


def step(settings: PidLaw, state: PidState, sp: float, pv: float, dt_s: float) -> tuple[PidState, float]:
    """One sample in automatic mode.

    Parameters
    ----------
    sp, pv : setpoint and measurement. dt_s : time since the last sample in seconds, > 0.

    Returns
    -------
    The new state, and the output to apply from now on.

    Raises
    ------
    ValueError
        A value is not finite or dt_s is not positive; the old state stays valid.
    """
    kp, ki, kd, b, tau_f_s, low, high, rate = settings
    integral, pv_f, last, _ = state
    more = ki * (sp - pv) * dt_s
    co = kp * (b * sp - pv) + integral
    if kd:
        slope = (pv - pv_f) / (tau_f_s + dt_s)
        co -= kd * slope
        pv_f += dt_s * slope
    else:
        pv_f = pv
    if not ((co + more) * 0.0 == 0.0 < dt_s):
        _refuse_non_finite(sp, pv, last, dt_s)
    if rate:
        low, high = max(low, last - rate * dt_s), min(high, last + rate * dt_s)
    if low <= co <= high:
        return (integral + more, pv_f, co, 0), co
    if co > high:
        return (integral + more if more < 0.0 else integral, pv_f, high, 1), high
    return (integral + more if more > 0.0 else integral, pv_f, low, -1), low


def track(settings: PidLaw, state: PidState, sp: float, pv: float, co: float, dt_s: float) -> tuple[PidState, float]:
    """One sample in manual mode: the output is given (held to its range), I follows so that automatic takes over smoothly.

    Raises
    ------
    ValueError
        A value is not finite or dt_s is not positive; the old state stays valid.
    """
    _refuse_non_finite(sp, pv, co, dt_s)
    pv_f = state[1]
    slope = (pv - pv_f) / (settings.tau_f_s + dt_s)
    held = min(max(co, settings.co_min), settings.co_max)
    integral = held - settings.kp * (settings.b * sp - pv) + settings.kd * slope
    return (integral, pv_f + dt_s * slope, held, _side(settings, held)), held


def change(old: PidLaw, new: PidLaw, state: PidState, sp: float, pv: float, dt_s: float) -> PidState:
    """The state with which the new law gives, at this sp and pv, the very output that the old one would have given.

    I+ = I + kp (b sp - pv) - kp+ (b+ sp - pv) + D - D+; valid in range and at a limit, for every gain, b and tau_f.

    Parameters
    ----------
    old, new : settings before and after. sp, pv, dt_s : what the next `step` will be called with.

    Raises
    ------
    ValueError
        A value is not finite or dt_s is not positive; the old state stays valid.
    """
    integral, pv_f, co, limited = state
    _refuse_non_finite(sp, pv, integral, dt_s)
    moved = pv - pv_f
    before = old.kp * (old.b * sp - pv) - old.kd * moved / (old.tau_f_s + dt_s)
    after = new.kp * (new.b * sp - pv) - new.kd * moved / (new.tau_f_s + dt_s)
    return integral + before - after, pv_f, co, limited


def _side(settings: PidLaw, co: float) -> int:
    """At which limit an output stands."""
    return -1 if co <= settings.co_min else 1 if co >= settings.co_max else 0


def _refuse_non_finite(sp: float, pv: float, co: float, dt_s: float) -> None:
    """Name what is wrong."""
    for name, value in (("sp", sp), ("pv", pv), ("co", co), ("dt_s", dt_s)):
        if not math.isfinite(value):
            raise ValueError(f"{name} = {value} is not a finite number; the state is unchanged")
    if dt_s <= 0:
        raise ValueError(f"dt_s = {dt_s} must be positive; the state is unchanged")
