"""Plants by scipy alone: linear ones, static curves before or behind them, and two by their differential equations.

Truth is asked of `Linear`; the others give one for a working point by `local`.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial import polynomial
from scipy.optimize import brentq
from scipy.signal import cont2discrete, tf2ss

Array = npt.NDArray[Any]


def poly(*factors: tuple[float, ...]) -> tuple[float, ...]:
    """Product of polynomials in s, coefficients from s^0 upwards."""
    out = np.array([1.0])
    for factor in factors:
        out = polynomial.polymul(out, factor)
    return tuple(float(c) for c in out)


@dataclass(frozen=True)
class Linear:
    """num(s)/den(s) e^(-theta s), coefficients from s^0 upwards; strictly proper, or of one dead time at least."""

    num: tuple[float, ...]
    den: tuple[float, ...]
    theta: float = 0.0

    def at(self, w: Array) -> Array:
        """Frequency response."""
        s = 1j * w
        return polynomial.polyval(s, self.num) / polynomial.polyval(s, self.den) * np.exp(-s * self.theta)

    def times(self, k: float) -> "Linear":
        """k times the process."""
        return replace(self, num=tuple(k * c for c in self.num))

    def later(self, delay: float) -> "Linear":
        """With more dead time."""
        return replace(self, theta=self.theta + delay)

    def slowed(self, unit: float) -> "Linear":
        """In another unit of time."""
        num, den = (tuple(c * unit**i for i, c in enumerate(part)) for part in (self.num, self.den))
        return Linear(num, den, self.theta * unit)

    def lagged(self, lag: float) -> "Linear":
        """Behind another lag."""
        return replace(self, den=poly(self.den, (1.0, lag))) if lag else self


class LinearLive:
    """A linear process in motion: held input, sampled every h seconds; its dead time is whole steps of h."""

    def __init__(self, process: Linear, h: float) -> None:
        a, b, c, d = tf2ss(process.num[::-1], process.den[::-1])
        self.ad, bd, self.c, *_ = cont2discrete((a, b, c, d), h)
        self.bd, self.c = bd[:, 0], self.c[0]
        self.x = np.zeros(len(self.bd))
        self.queue = deque([0.0] * round(process.theta / h))

    def move(self, u: float, d: float = 0.0) -> float:
        """Hold u for one h, with a load d at the process input (behind the dead time); the output after it."""
        self.queue.append(u)
        self.x = self.ad @ self.x + self.bd * (self.queue.popleft() + d)
        return float(self.c @ self.x)


@dataclass(frozen=True)
class Curved:
    """A curve before a linear process of gain 1 (a valve), and one behind it (pH); in absolute units."""

    linear: Linear
    before: Callable[[float], float]
    behind: Callable[[float], float]
    co_range: tuple[float, float]

    def rest(self, pv: float) -> float:
        """The output that holds pv."""
        return float(brentq(lambda u: self.behind(self.before(u)) - pv, *self.co_range))

    def local(self, pv: float) -> Linear:
        """Linearised where it rests at pv."""
        u, e = self.rest(pv), 1e-4 * (self.co_range[1] - self.co_range[0])
        slope = (self.behind(self.before(u + e)) - self.behind(self.before(u - e))) / (2 * e)
        return self.linear.times(slope)

    def live(self, pv: float, h: float) -> "CurvedLive":
        """At rest at pv."""
        return CurvedLive(self, pv, h)


class CurvedLive:
    """See Curved."""

    def __init__(self, plant: Curved, pv: float, h: float) -> None:
        self.plant, self.base = plant, plant.before(plant.rest(pv))
        self.live = LinearLive(plant.linear, h)

    def move(self, u: float, d: float = 0.0) -> float:
        """As LinearLive, in absolute units; d adds to what leaves the valve, as if co had moved by d at rest."""
        return self.plant.behind(self.base + self.live.move(self.plant.before(u + d) - self.base))


@dataclass(frozen=True)
class Flow:
    """dx/dt = rhs(x, u), pv = x[shown], behind a dead time."""

    rhs: Callable[[Array, float], Array]
    rest_state: Callable[[float], tuple[Array, float]]
    shown: int
    theta: float

    def rest(self, pv: float) -> float:
        """The output that holds pv."""
        return self.rest_state(pv)[1]

    def local(self, pv: float) -> Linear:
        """Linearised where it rests at pv, by differences."""
        x, u = self.rest_state(pv)
        n = len(x)
        a = np.empty((n, n))
        for i in range(n):
            e = np.zeros(n)
            e[i] = 1e-5 * max(1.0, abs(x[i]))
            a[:, i] = (self.rhs(x + e, u) - self.rhs(x - e, u)) / (2 * e[i])
        e = 1e-5 * max(1.0, abs(u))
        b = (self.rhs(x, u + e) - self.rhs(x, u - e)) / (2 * e)
        den = np.poly(a)
        c = np.zeros(n)
        c[self.shown] = 1.0
        num = np.poly(a - np.outer(b, c)) - den
        return Linear(tuple(float(v) for v in num[::-1][:-1]), tuple(float(v) for v in den[::-1]), self.theta)

    def live(self, pv: float, h: float) -> "FlowLive":
        """At rest at pv."""
        return FlowLive(self, pv, h)


class FlowLive:
    """See Flow."""

    def __init__(self, plant: Flow, pv: float, h: float) -> None:
        self.plant, self.h = plant, h
        self.x, u = plant.rest_state(pv)
        self.queue = deque([u] * round(plant.theta / h))

    def move(self, u: float, d: float = 0.0) -> float:
        """As LinearLive, in absolute units."""
        self.queue.append(u)
        v, f, h = self.queue.popleft() + d, self.plant.rhs, self.h
        k1 = f(self.x, v)
        k2 = f(self.x + h / 2 * k1, v)
        k3 = f(self.x + h / 2 * k2, v)
        k4 = f(self.x + h * k3, v)
        self.x = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return float(self.x[self.plant.shown])


def tank(scale: float) -> Flow:
    """A level: the area grows with the level, outflow by its root. Level 5 to 95, u 0 to 100. scale : seconds."""

    def rhs(x: Array, u: float) -> Array:
        level = max(float(x[0]), 0.01)
        return np.array(
            [(float(x[1]) - 10.0 * level**0.5) / (scale * (0.3 + level / 60.0)), (u - x[1]) / (0.05 * scale)]
        )

    return Flow(rhs, lambda pv: (np.array([pv, 10.0 * pv**0.5]), 10.0 * pv**0.5), 0, 0.04 * scale)


def exothermic(scale: float) -> Flow:
    """A stirred tank with a reaction that heats itself; T 300 to 360, u cools. Minutes become `scale` seconds."""
    q, v, k0, er, dh, ua, ca0, t0 = 100.0, 100.0, 7.2e10, 8750.0, 209.2, 5e4 / 239.0, 1.0, 350.0

    def rate(t: float) -> float:
        return float(k0 * np.exp(-er / t))

    def rhs(x: Array, u: float) -> Array:
        ca, t, tc = x
        r = rate(t) * ca
        return np.array([q / v * (ca0 - ca) - r, q / v * (t0 - t) + dh * r + ua / v * (tc - t), (u - tc) / 0.1]) / scale

    def rest_state(pv: float) -> tuple[Array, float]:
        k = rate(pv)
        ca = q / v * ca0 / (q / v + k)
        tc = pv - (q / v * (t0 - pv) + dh * k * ca) / (ua / v)
        return np.array([ca, pv, tc]), tc

    return Flow(rhs, rest_state, 1, 0.05 * scale)
