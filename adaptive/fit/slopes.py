"""Derivatives of the responses in dynamics.py by what a fit looks for, in closed form.

    f = sum_j w_j f_0(s_j),   df = sum_j dw_j f_0(s_j) + w_j ds_j f_0'(s_j)

With D = 1 - 4 c2 c0 and r = sqrt D, the rates are the roots of c2 s^2 - s + c0 and their weights +-1/r, so

    by ln T:   ds_j = -+c0 / r,        dw_j = -+2 c2 c0 / r^3
    by ln c2:  ds_j = +-c2 s_j^2 / r,  dw_j = +-2 c2 c0 / r^3

before a zero, which makes w_j (1 + b s_j) of w_j, so by ln b the rates stand and dw_j = +-b s_j / r

and the derivative of h(s) = int_0^x exp(-s y) dy is (x exp(-s x) - h) / s. Near equal lags all this cancels; there the
derivative is that of lags a little further apart (LEAST in D changes it by a millionth).
"""

import cmath
import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from retuner.adaptive.fit.dynamics import STILL, Clock, Dynamics, Reading, apart_from
from retuner.adaptive.signals.recursion import Array, recursion
from retuner.adaptive.signals.sample import FloatArray

LEAST = 1e-5
"""Equal lags are told apart by this much in D when derivatives are asked for."""


class By(IntEnum):
    """The parameter that a derivative is by: ln T, ln c2, ln b."""

    LAG = 0
    SECOND = 1
    INVERSE = 2


def told_apart(dynamics: Dynamics) -> Dynamics:
    """The same dynamics as derivatives see them."""
    return replace(dynamics, least=LEAST)


@dataclass(frozen=True, slots=True)
class ModeSlope:
    """Rate and weight of a mode, and their derivatives. doubled : the mode stands for its conjugate, too."""

    s: complex
    w: complex
    ds: complex
    dw: complex
    doubled: bool

    def summed(self, values: Array) -> FloatArray:
        """Its share of a real sum."""
        return np.asarray((2 if self.doubled else 1) * np.real(values), dtype=np.float64)


def mode_slopes(dynamics: Dynamics, by: By) -> list[ModeSlope]:
    """Every mode with its derivatives; of a conjugate pair the first."""
    modes, c2, c0, b = replace(dynamics, inverse_s=0.0).modes(), dynamics.c2_s, dynamics.c0_per_s, dynamics.inverse_s
    if len(modes) == 1:
        ((s, w),) = modes
        return [ModeSlope(s, w, -s if by == By.LAG else 0j, 0j, doubled=False)]
    d = 1 - 4 * c2 * c0
    root = cmath.sqrt(math.copysign(max(abs(d), dynamics.least), d))
    bend = 2 * c2 * c0 / root**3
    found = []
    for side, (s, w) in zip((1, -1), modes, strict=True):
        ds, dw = (-side * c0 / root, -side * bend) if by == By.LAG else (side * c2 * s**2 / root, side * bend)
        if by == By.INVERSE:
            ds, dw = 0j, 0j
        risen = dw * (1 + b * s) + w * b * (s if by == By.INVERSE else ds)
        found.append(ModeSlope(s, w * (1 + b * s), ds, risen, doubled=bool(s.imag)))
    return found[:1] if found[0].doubled else found


def _held(s: complex, x: Array | np.float64) -> Array:
    """h, see the head of this file."""
    return np.asarray(-np.expm1(-s * x) / s if abs(s) >= STILL else x)


def _held_slope(s: complex, x: Array | np.float64) -> Array:
    """Its derivative by s; a rate of zero has none that is asked for."""
    return np.asarray((x * np.exp(-s * x) - _held(s, x)) / s if abs(s) >= STILL else np.zeros_like(x))


def step_slope(dynamics: Dynamics, since_s: FloatArray, by: By) -> FloatArray:
    """Derivative of Dynamics.step."""
    x = np.maximum(since_s, 0.0)
    found = [m.summed(m.dw * _held(m.s, x) + m.w * m.ds * _held_slope(m.s, x)) for m in mode_slopes(dynamics, by)]
    return np.asarray(sum(found), dtype=np.float64)


def impulse_slope(dynamics: Dynamics, since_s: FloatArray, by: By) -> FloatArray:
    """Derivative of Dynamics.impulse."""
    x = np.maximum(since_s, 0.0)
    found = [m.summed((m.dw - m.w * m.ds * x) * np.exp(-m.s * x)) for m in mode_slopes(dynamics, by)]
    return np.where(since_s >= 0, sum(found), 0.0)


def ramp_slope(dynamics: Dynamics, since_s: FloatArray, by: By) -> FloatArray:
    """Derivative of Dynamics.ramp."""
    x, found = np.maximum(since_s, 0.0), []
    for m in mode_slopes(dynamics, by):
        if abs(m.s) < STILL:
            found.append(m.summed(m.dw * x**2 / 2))
            continue
        ramp = (x - _held(m.s, x)) / m.s
        found.append(m.summed(m.dw * ramp - m.w * m.ds * (ramp + _held_slope(m.s, x)) / m.s))
    return np.asarray(sum(found), dtype=np.float64)


def rounded_slope(dynamics: Dynamics, since_s: FloatArray, lag_s: float, by: By) -> FloatArray:
    """Derivative of Dynamics.rounded_step by a parameter of the process."""
    x, rate, found = np.maximum(since_s, 0.0), 1 / lag_s, []
    for m in mode_slopes(dynamics, by):
        apart = apart_from(m.s, rate)
        s = rate - apart
        over = _held(s, x) - _held(complex(rate), x)
        by_rate = m.w * m.ds * (_held_slope(s, x) + over / apart)
        found.append(m.summed((m.dw * over + by_rate) * rate / apart))
    return np.asarray(sum(found), dtype=np.float64)


def rounded_by_lag(dynamics: Dynamics, since_s: FloatArray, lag_s: float) -> FloatArray:
    """Derivative of Dynamics.rounded_step by the logarithm of the loads' own lag."""
    x, rate, found = np.maximum(since_s, 0.0), 1 / lag_s, []
    slow, slow_slope = _held(complex(rate), x), _held_slope(complex(rate), x)
    for m in mode_slopes(dynamics, By.LAG):
        apart = apart_from(m.s, rate)
        s = rate - apart
        by_rate = -m.w * (s * (_held(s, x) - slow) / apart + rate * slow_slope) / apart
        found.append(m.summed(-rate * by_rate))
    return np.asarray(sum(found), dtype=np.float64)


def rounded_rise(dynamics: Dynamics, since_s: FloatArray, lag_s: float) -> FloatArray:
    """Derivative of Dynamics.rounded_step by time."""
    x, rate, found = np.maximum(since_s, 0.0), 1 / lag_s, []
    for m in mode_slopes(dynamics, By.LAG):
        apart = apart_from(m.s, rate)
        found.append(m.summed(m.w * rate * (np.exp((apart - rate) * x) - np.exp(-rate * x)) / apart))
    return np.where(since_s >= 0, sum(found), 0.0)


@dataclass(frozen=True, slots=True)
class LateMode:
    """A mode's response to the held input after the dead time, its derivative by s, and the input as it was read."""

    value: Array
    slope: Array
    read: FloatArray

    @classmethod
    def of(cls, s: complex, clock: Clock, u: FloatArray, theta_s: float) -> "LateMode":
        """s : rate of the mode. theta_s : the dead time."""
        rate = s if s.imag else s.real
        dt: Array = np.asarray(clock.dt_s) if clock.dt_s is not None else np.diff(clock.t_s)
        decay, late = np.exp(-rate * dt), Reading.of(clock, theta_s)
        x = recursion(decay, _held(rate, dt) * u[:-1])
        slope = recursion(decay, -dt * decay * x[:-1] + _held_slope(rate, dt) * u[:-1])
        since: Array = np.asarray(late.since_s)
        e = np.exp(-rate * since)
        found = cls(np.zeros_like(x), np.zeros_like(x), np.zeros(len(u)))
        found.value[late.first :] = x[late.at] * e + u[late.at] * _held(rate, since)
        found.slope[late.first :] = (slope[late.at] - since * x[late.at]) * e + u[late.at] * _held_slope(rate, since)
        found.read[late.first :] = u[late.at]
        return found


def late_modes(dynamics: Dynamics, clock: Clock, u: FloatArray, theta_s: float) -> list[LateMode]:
    """Of every mode that has derivatives (mode_slopes)."""
    return [LateMode.of(m.s, clock, u, theta_s) for m in mode_slopes(dynamics, By.LAG)]


def held_slope(dynamics: Dynamics, late: list[LateMode], by: By) -> FloatArray:
    """Derivative of Dynamics.held by a parameter of the process. late : of late_modes."""
    found = [
        m.summed(m.dw * x.value + m.w * m.ds * x.slope) for m, x in zip(mode_slopes(dynamics, by), late, strict=True)
    ]
    return np.asarray(sum(found), dtype=np.float64)


def held_by_theta(dynamics: Dynamics, late: list[LateMode], theta_s: float) -> FloatArray:
    """Derivative of Dynamics.held by ln theta. late : of late_modes."""
    found = [m.summed(m.w * (m.s * x.value - x.read)) for m, x in zip(mode_slopes(dynamics, By.LAG), late, strict=True)]
    return np.asarray(theta_s * sum(found), dtype=np.float64)
