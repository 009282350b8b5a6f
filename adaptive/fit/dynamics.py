"""Exact responses of the one family of processes that every fit works with.

    G(s) = k' e^(-theta s) (1 - b s) / (c2 s^2 + s + c0)
    k' the slope gain, T = 1/c0 the sum of the lags, c2 = tau1 tau2 / T, b an inverse response (second order only)

first order (c2 = 0), second order with real or complex poles, integrating (c0 = 0) and integrating with lag are all in
it, so that one fit can go from one to the other without a jump. In partial fractions, with D = 1 - 4 c2 c0,

    1/(c2 s^2 + s + c0) = (1/(s + s1) - 1/(s + s2)) / sqrt(D),  s1 = 2 c0/(1 + sqrt D),  s2 = (1 + sqrt D)/(2 c2)

two first-order modes, real or complex, and the response of a mode to a held input is exact at and between the samples.
A zero changes their weights alone, by 1 + b s1 and 1 + b s2.
So the dead time only moves the instants at which the modes are read, and may be any real number.
"""

import cmath
import math
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.recursion import Array, recursion
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass, replace

EVEN = 1e-6  # sampling intervals that differ by less than this fraction of the interval count as equal (the fast path)
LEAST_DISCRIMINANT = 1e-8
"""Equal lags are told apart by this much, or the partial fractions would cancel; the response changes by 1e-9."""
SERIES = 1e-4  # below this s t the integral of a mode is computed from its series; the next term is (s t)^2 / 12
STILL = 1e-200  # A rate below this is none: products with it would lose their digits
LEAST_APART = 1e-5  # least distance of a load's lag from one of the process that it equals


@dataclass(frozen=True, slots=True)
class SamplingInstants:
    """Sampling instants with what the fast path needs to know of them.

    t_s : shape (n,), exactly even where it is nearly so. dt_s : the common interval where it is even, else None.
    """

    t_s: FloatArray
    dt_s: float | None

    @classmethod
    def of(cls, t_s: FloatArray) -> "SamplingInstants":
        """Look at the intervals once."""
        dt = np.diff(t_s)
        mean = float((t_s[-1] - t_s[0]) / len(dt))
        grid = t_s[0] + mean * np.arange(len(t_s))
        even = float(np.max(np.abs(grid - t_s))) <= EVEN * mean * math.sqrt(len(dt))
        return cls(np.ascontiguousarray(grid if even else t_s), mean if even else None)


@dataclass(frozen=True, slots=True)
class Dynamics:
    """The delay-free part 1 / (c2 s^2 + s + c0): unit slope at first.

    c2_s : second lag tau1 tau2 / (tau1 + tau2) in seconds, >= 0. c0_per_s : 1 / (tau1 + tau2), >= 0.
    least : equal lags are told apart by this much in D. inverse_s : b, s, >= 0; counts only with a second lag.
    """

    c2_s: float
    c0_per_s: float
    least: float = LEAST_DISCRIMINANT
    inverse_s: float = 0.0

    def modes(self) -> tuple[tuple[complex, complex], ...]:
        """(rate s_j, weight) of the modes; one for first order and integrating."""
        if self.c2_s == 0:
            return ((complex(self.c0_per_s), 1.0 + 0j),)
        d = 1 - 4 * self.c2_s * self.c0_per_s
        if abs(d) < self.least:
            d = math.copysign(self.least, d)
        root = cmath.sqrt(d)
        s1, s2 = 2 * self.c0_per_s / (1 + root), (1 + root) / (2 * self.c2_s)
        weight = 1 / (self.c2_s * (s2 - s1))  # 1/root, and still right where the discriminant was moved
        return (s1, weight * (1 + self.inverse_s * s1)), (s2, -weight * (1 + self.inverse_s * s2))

    def step(self, since_s: FloatArray) -> FloatArray:
        """Unit step response at the times since the step (zero before it); any shape."""
        t = np.maximum(since_s, 0.0)
        return _summed([w * _held(s, t) for s, w in self.modes()])

    def ramp(self, since_s: FloatArray) -> FloatArray:
        """Response to a unit ramp: the integral of the step response; any shape."""
        t = np.maximum(since_s, 0.0)
        return _summed([w * _held_twice(s, t) for s, w in self.modes()])

    def rounded_step(self, since_s: FloatArray, lag_s: float) -> FloatArray:
        """Response to a unit step that comes through a lag of its own; any shape."""
        t = np.maximum(since_s, 0.0)
        rate = 1 / lag_s
        slow = _held(complex(rate), t)
        found = []
        for s, w in self.modes():
            apart = apart_from(s, rate)
            found.append(w * rate * (_held(rate - apart, t) - slow) / apart)
        return _summed(found)

    def impulse(self, since_s: FloatArray) -> FloatArray:
        """Response to a unit impulse: the derivative of the step response; any shape."""
        t = np.maximum(since_s, 0.0)
        inside = _summed([w * np.exp(-s * t) for s, w in self.modes()])
        return np.where(since_s >= 0, inside, 0.0)

    def held(self, clock: SamplingInstants, u: FloatArray, theta_s: float) -> FloatArray:
        """Response to the input u, held between samples, after the dead time; zero input before the first sample.

        theta_s : dead time in seconds, >= 0, any real number.
        """
        modes = self.modes()
        if modes[0][0].imag:
            return 2 * np.real(modes[0][1] * moved_mode(clock, u, modes[0][0], theta_s))  # the other is its conjugate
        return _summed([w.real * moved_mode(clock, u, s.real, theta_s) for s, w in modes])


def _summed(modes: list[Array]) -> FloatArray:
    """Real part of the sum: what is left imaginary is rounding, the conjugate mode takes it away."""
    return np.asarray(np.real(modes[0] if len(modes) == 1 else modes[0] + modes[1]), dtype=np.float64)


def apart_from(s: complex, rate: float) -> complex:
    """How far a load's own lag lies from a mode; never nothing, or the partial fractions would cancel."""
    return rate - s if abs(rate - s) >= LEAST_APART * rate else complex(LEAST_APART * rate)


def _held(s: complex, t: FloatArray | np.float64) -> Array:
    """Integral of exp(-s x) from 0 to t."""
    rate = s.real if s.imag == 0 else s
    if abs(rate) < STILL:
        return np.asarray(t)
    return np.asarray(-np.expm1(-rate * t) / rate)


def _held_twice(s: complex, t: FloatArray) -> Array:
    """Integral of _held from 0 to t; a series where the difference would cancel."""
    own = s.real if s.imag == 0 else s  # half the work where the mode is real
    small = abs(own) * t < SERIES
    rate = own if abs(own) >= STILL else 1.0
    return np.where(small, t**2 / 2 * (1 - own * t / 3), (t - _held(s, t)) / rate)


def through_lag(clock: SamplingInstants, values: FloatArray, lag_s: float) -> FloatArray:
    """Values, shape (n,), straight from sample to sample, through a lag that begins at rest.

        y_(i+1) = e y_i + (r - e) x_i + (1 - r) x_(i+1),   e = exp(-h / d),  r = (1 - e) d / h

    What moves along a second order bends little within an interval, so this is a third order to a share of (h / d)^2.
    """
    h: Array = np.asarray(clock.dt_s) if clock.dt_s is not None else np.diff(clock.t_s)
    decay = np.exp(-h / lag_s)
    kept = -np.expm1(-h / lag_s) * lag_s / h
    return np.asarray(recursion(decay, (kept - decay) * values[:-1] + (1 - kept) * values[1:]), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Reading:
    """Where a record is read theta late: nothing before sample `first`; from there, since_s after the samples `at`."""

    first: int
    at: slice | npt.NDArray[np.intp]
    since_s: FloatArray | np.float64

    @classmethod
    def of(cls, clock: SamplingInstants, theta_s: float) -> "Reading":
        """theta_s : dead time, >= 0."""
        n = len(clock.t_s)
        if clock.dt_s is not None:
            first = min(math.ceil(min(theta_s / clock.dt_s - 1e-12, n)), n)
            return cls(first, slice(0, n - first), np.float64(max(first * clock.dt_s - theta_s, 0.0)))
        read_at = clock.t_s - theta_s
        at = np.searchsorted(clock.t_s, read_at, side="right") - 1
        first = int(np.searchsorted(at, 0))
        return cls(first, at[first:], np.maximum(read_at[first:] - clock.t_s[at[first:]], 0.0))


def moved_mode(clock: SamplingInstants, u: FloatArray, s: complex, theta_s: float) -> Array:
    """Response of 1/(s' + s) to the held input, read theta_s late."""
    x, late = run_mode(clock, u, s), Reading.of(clock, theta_s)
    out = np.zeros_like(x)
    out[late.first :] = x[late.at] * np.exp(-s * late.since_s) + u[late.at] * _held(s, late.since_s)
    return out


def run_mode(clock: SamplingInstants, u: FloatArray, s: complex) -> Array:
    """A mode at the samples, without dead time."""
    dt = np.float64(clock.dt_s) if clock.dt_s is not None else np.diff(clock.t_s)
    return recursion(np.exp(-s * dt), _held(s, dt) * u[:-1])


# ---- Derivatives of the responses in dynamics.py by what a fit looks for, in closed form.
#
#     f = sum_j w_j f_0(s_j),   df = sum_j dw_j f_0(s_j) + w_j ds_j f_0'(s_j)
#
# With D = 1 - 4 c2 c0 and r = sqrt D, the rates are the roots of c2 s^2 - s + c0 and their weights +-1/r, so
#
#     by ln T:   ds_j = -+c0 / r,        dw_j = -+2 c2 c0 / r^3
#     by ln c2:  ds_j = +-c2 s_j^2 / r,  dw_j = +-2 c2 c0 / r^3
#
# before a zero, which makes w_j (1 + b s_j) of w_j, so by ln b the rates stand and dw_j = +-b s_j / r
#
# and the derivative of h(s) = int_0^x exp(-s y) dy is (x exp(-s x) - h) / s. Near equal lags all this cancels;
# there the derivative is that of lags a little further apart (LEAST_LAG_DIFFERENCE in D changes it by a millionth).

LEAST_LAG_DIFFERENCE = 1e-5  # equal lags are told apart by this much in D when derivatives are asked for


class By(IntEnum):
    """The parameter that a derivative is by: ln T, ln c2, ln b."""

    LAG = 0
    SECOND = 1
    INVERSE = 2


def told_apart(dynamics: Dynamics) -> Dynamics:
    """The dynamics as derivatives see them."""
    return replace(dynamics, least=LEAST_LAG_DIFFERENCE)


@dataclass(frozen=True, slots=True)
class ModeSlope:
    """Rate and weight of a mode, and their derivatives. doubled : the mode stands for its conjugate, too."""

    s: complex
    w: complex
    ds: complex
    dw: complex
    doubled: bool

    def summed(self, values: Array) -> FloatArray:
        """The mode's share of a real sum."""
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


def _held_slopes(s: complex, x: Array | np.float64) -> Array:
    """h, see the head of this file."""
    return np.asarray(-np.expm1(-s * x) / s if abs(s) >= STILL else x)


def _held_slope(s: complex, x: Array | np.float64) -> Array:
    """Derivative of a held mode by s; a rate of zero has none that is asked for."""
    return np.asarray((x * np.exp(-s * x) - _held_slopes(s, x)) / s if abs(s) >= STILL else np.zeros_like(x))


def step_slope(dynamics: Dynamics, since_s: FloatArray, by: By) -> FloatArray:
    """Derivative of Dynamics.step."""
    x = np.maximum(since_s, 0.0)
    found = [
        m.summed(m.dw * _held_slopes(m.s, x) + m.w * m.ds * _held_slope(m.s, x)) for m in mode_slopes(dynamics, by)
    ]
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
        ramp = (x - _held_slopes(m.s, x)) / m.s
        found.append(m.summed(m.dw * ramp - m.w * m.ds * (ramp + _held_slope(m.s, x)) / m.s))
    return np.asarray(sum(found), dtype=np.float64)


def rounded_slope(dynamics: Dynamics, since_s: FloatArray, lag_s: float, by: By) -> FloatArray:
    """Derivative of Dynamics.rounded_step by a parameter of the process."""
    x, rate, found = np.maximum(since_s, 0.0), 1 / lag_s, []
    for m in mode_slopes(dynamics, by):
        apart = apart_from(m.s, rate)
        s = rate - apart
        over = _held_slopes(s, x) - _held_slopes(complex(rate), x)
        by_rate = m.w * m.ds * (_held_slope(s, x) + over / apart)
        found.append(m.summed((m.dw * over + by_rate) * rate / apart))
    return np.asarray(sum(found), dtype=np.float64)


def rounded_by_lag(dynamics: Dynamics, since_s: FloatArray, lag_s: float) -> FloatArray:
    """Derivative of Dynamics.rounded_step by the logarithm of the loads' own lag."""
    x, rate, found = np.maximum(since_s, 0.0), 1 / lag_s, []
    slow, slow_slope = _held_slopes(complex(rate), x), _held_slope(complex(rate), x)
    for m in mode_slopes(dynamics, By.LAG):
        apart = apart_from(m.s, rate)
        s = rate - apart
        by_rate = -m.w * (s * (_held_slopes(s, x) - slow) / apart + rate * slow_slope) / apart
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
    def of(cls, s: complex, clock: SamplingInstants, u: FloatArray, theta_s: float) -> "LateMode":
        """s : rate of the mode. theta_s : the dead time."""
        rate = s if s.imag else s.real
        dt: Array = np.asarray(clock.dt_s) if clock.dt_s is not None else np.diff(clock.t_s)
        decay, late = np.exp(-rate * dt), Reading.of(clock, theta_s)
        x = recursion(decay, _held_slopes(rate, dt) * u[:-1])
        slope = recursion(decay, -dt * decay * x[:-1] + _held_slope(rate, dt) * u[:-1])
        since: Array = np.asarray(late.since_s)
        e = np.exp(-rate * since)
        found = cls(np.zeros_like(x), np.zeros_like(x), np.zeros(len(u)))
        found.value[late.first :] = x[late.at] * e + u[late.at] * _held_slopes(rate, since)
        found.slope[late.first :] = (slope[late.at] - since * x[late.at]) * e + u[late.at] * _held_slope(rate, since)
        found.read[late.first :] = u[late.at]
        return found


def late_modes(dynamics: Dynamics, clock: SamplingInstants, u: FloatArray, theta_s: float) -> list[LateMode]:
    """The response of every mode that has derivatives (mode_slopes)."""
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
