"""A plant given by its differential equations, with a dead time before it; rest and linearisation found numerically.

    dx/dt = f(x, u(t - theta), w),   y = h(x)

Integrated by the classic Runge-Kutta method in equal parts of a sample; the input is held over a sample, its delay is
rounded to a part. The linearisation's poles and zeros are those of the central differences of f at rest.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import eig
from scipy.optimize import root

from retuner.adaptive.process.model import LinearProcess

State = Sequence[float]
TRIM = 4096  # Samples of the input's past that are kept at least
SAME = 0.01  # A pole and a zero that differ by less than this share cancel
FASTEST = 1e-3  # Lags and leads below this share of the longest lag are left out
REAL = 1e-6  # Imaginary parts below this share are rounding


@dataclass(frozen=True)
class Equations:
    """slope : f(x, u, w). output : h(x). guess : a state and an input near rest at (y, w), for the search.
    theta : dead time in s at (y, w). parts : integration steps a sample.
    """

    slope: Callable[[State, float, float], Sequence[float]]
    output: Callable[[State], float]
    guess: Callable[[float, float], tuple[list[float], float]]
    theta: Callable[[float, float], float]
    parts: int = 4

    def rest(self, y: float, w: float) -> tuple[list[float], float]:
        """State and input that hold y.

        Raises ArithmeticError: the search found none.
        """
        return _rest(self, y, w)

    def linear(self, y: float, w: float) -> LinearProcess:
        """The linearisation at rest there."""
        x0, u0 = self.rest(y, w)
        n = len(x0)
        a, b, c = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        for j in range(n + 1):
            value = x0[j] if j < n else u0
            step = 1e-5 * max(abs(value), 1e-3)
            ends = []
            for sign in (1, -1):
                x, u = list(x0), u0
                if j < n:
                    x[j] += sign * step
                else:
                    u += sign * step
                ends.append((np.asarray(self.slope(x, u, w), dtype=float), self.output(x)))
            column = (ends[0][0] - ends[1][0]) / (2 * step)
            if j < n:
                a[:, j], c[j] = column, (ends[0][1] - ends[1][1]) / (2 * step)
            else:
                b = column
        return transfer(a, b, c, self.theta(y, w))


@lru_cache(maxsize=4096)
def _rest(equations: Equations, y: float, w: float) -> tuple[list[float], float]:
    x0, u0 = equations.guess(y, w)
    scale = np.array([max(abs(v), 1e-3) for v in (*x0, u0)])

    def missing(z: np.ndarray) -> np.ndarray:
        x = list(z[:-1] * scale[:-1])
        slope = np.asarray(equations.slope(x, float(z[-1] * scale[-1]), w), dtype=float)
        return np.append(slope, equations.output(x) - y)

    found = root(missing, np.array([*x0, u0]) / scale, method="lm", options={"xtol": 1e-13, "ftol": 1e-13})
    if not np.all(np.abs(missing(found.x)) < 1e-6 * np.append(scale[:-1], max(abs(y), 1.0))):
        raise ArithmeticError(f"no rest at {y} (place {w})")
    z = found.x * scale
    return [float(v) for v in z[:-1]], float(z[-1])


def transfer(a: np.ndarray, b: np.ndarray, c: np.ndarray, theta_s: float) -> LinearProcess:
    """Poles, zeros and gain of c (s - a)^-1 b, pairs that cancel and what is very fast left out.

    Raises ArithmeticError: it is unstable, or its zeros are complex.
    """
    n = len(b)
    poles = [complex(p) for p in np.linalg.eigvals(a)]
    pencil = np.block([[a, b[:, None]], [c[None, :], np.zeros((1, 1))]])
    mass = np.zeros((n + 1, n + 1))
    mass[:n, :n] = np.eye(n)
    fastest = 1e4 * max(abs(p) for p in poles)
    zeros = [complex(z) for z in eig(pencil, mass, right=False) if np.isfinite(z) and abs(z) < fastest]
    for zero in list(zeros):
        near = min(poles, key=lambda p, zero=zero: abs(p - zero))
        if abs(near - zero) < SAME * abs(near):
            poles.remove(near)
            zeros.remove(zero)
    gain = float(-(c @ np.linalg.solve(a, b)))
    if any(p.real >= 0 for p in poles):
        raise ArithmeticError("unstable at rest")
    if any(abs(z.imag) > REAL * abs(z) for z in zeros):
        raise ArithmeticError("a pair of zeros")
    slow = max(-1 / p.real for p in poles)
    lags = [-1 / p.real for p in poles if abs(p.imag) <= REAL * abs(p) and -1 / p.real > FASTEST * slow]
    pairs = [(-2 * p.real / abs(p) ** 2, 1 / abs(p) ** 2) for p in poles if p.imag > REAL * abs(p)]
    leads = [-1 / z.real for z in zeros if abs(1 / z.real) > FASTEST * slow]
    return LinearProcess(gain, tuple(sorted(lags, reverse=True)), tuple(leads), theta_s, 0, tuple(pairs))


class InMotion:
    """The plant from rest at (y, w). inside : the place is pv, else the signal that `move` is given."""

    def __init__(self, equations: Equations, dt_s: float, y: float, w: float, *, inside: bool) -> None:
        self._f, self._dt_s, self._inside = equations, dt_s, inside
        self._x, u = equations.rest(y, w)
        self._times, self._inputs = [-math.inf], [u]
        self._t, self._y = 0.0, y

    def move(self, co: float, place: float) -> float:
        """See Live."""
        f, h = self._f, self._dt_s / self._f.parts
        w = self._y if self._inside else place
        late = f.theta(self._y, w)
        self._times.append(self._t)
        self._inputs.append(co)
        for _ in range(f.parts):
            u = self._inputs[bisect_right(self._times, self._t - late + h / 2) - 1]
            k1 = f.slope(self._x, u, w)
            k2 = f.slope([a + h / 2 * b for a, b in zip(self._x, k1, strict=True)], u, w)
            k3 = f.slope([a + h / 2 * b for a, b in zip(self._x, k2, strict=True)], u, w)
            k4 = f.slope([a + h * b for a, b in zip(self._x, k3, strict=True)], u, w)
            self._x = [a + h / 6 * (p + 2 * (q + r) + s) for a, p, q, r, s in zip(self._x, k1, k2, k3, k4, strict=True)]
            self._t += h
        if len(self._times) > 2 * TRIM:
            del self._times[:TRIM], self._inputs[:TRIM]
        self._y = float(f.output(self._x))
        return self._y
