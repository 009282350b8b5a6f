"""Shapes of a parameter over the scheduling variable, and what is thought of them before any record.

    ln p(x) = m + 3 z_0 + 0.7 z_1 xi(x) + 0.35 sum_j z_j e_j(x),    z ~ N(0, 1),    xi from -1 to 1 over the range

Level, slope, and bends: e_j are the principal components of a straight-line-free integrated Wiener process on a few
knots (the prior of the smoothing spline, Wahba 1978). With the bends left out it is a line in ln p, with the slope left
out as well a constant; which of the three holds, the evidence decides for each parameter by itself.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from retuner.adaptive.signals.sample import FloatArray

LEVEL_STD, SLOPE_STD, BEND_STD = 3.0, 0.7, 0.35
"""Of ln p: whole level; either end against the middle (a factor of 4 over the range is one); departure from a line."""
BENDS = 6
"""Principal components of a bend."""
KNOTS = 13


class Shape(IntEnum):
    """How many coefficients a parameter has."""

    CONSTANT = 1
    LINE = 2
    BENT = 2 + BENDS


@dataclass(frozen=True, slots=True)
class Axis:
    """Where the curves live: low to high of the scheduling variable.

    by_ratio : whether a straight line is one over ln x, a power law, as gain, lag and delay over a flow are.
    """

    low: float
    high: float
    by_ratio: bool = False

    def columns(self, x: FloatArray, shape: Shape) -> FloatArray:
        """d ln p(x) / dz, shape (*x.shape, shape). Outside low..high it is what it is at the end."""
        inside = np.clip(x, self.low, self.high)
        share = (inside - self.low) / (self.high - self.low)
        if self.by_ratio:
            share = np.log(inside / self.low) / np.log(self.high / self.low)
        xi = 2 * share - 1
        found = [np.full(x.shape, LEVEL_STD), SLOPE_STD * xi]
        found += [np.interp(xi, _PLACES, bend) for bend in _BENT.T]
        return np.stack(found[: int(shape)], axis=-1)

    def grid(self, n: int) -> FloatArray:
        """n places from low to high."""
        return np.linspace(self.low, self.high, n)


@dataclass(frozen=True, slots=True)
class Second:
    """A second variable beside the first: ln p(x, x2) is the curve over x and one over x2 without a level of its own.

    So every parameter is a product k(x) f(x2): both may matter, and neither bends the other's curve.

    axis : of x2. shapes : of each parameter over it. pushed : it comes from outside and moves pv by itself.
    """

    axis: Axis
    shapes: tuple[Shape, ...]
    pushed: bool = False

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of coefficients of each parameter."""
        return tuple(int(shape) - 1 for shape in self.shapes)

    def columns(self, x2: FloatArray, i: int) -> FloatArray:
        """d ln p_i / dz at x2, shape (*x2.shape, sizes[i])."""
        return self.axis.columns(x2, self.shapes[i])[..., 1:]


def _bends() -> FloatArray:
    """The bends at the knots, shape (KNOTS, BENDS), scaled by BEND_STD."""
    t = np.linspace(0.0, 1.0, KNOTS)
    early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
    wiener = early**2 * (3 * late - early) / 6
    line = np.stack([np.ones(KNOTS), t], axis=1)
    q = np.linalg.qr(line)[0]
    free = np.eye(KNOTS) - q @ q.T
    values, vectors = np.linalg.eigh(free @ wiener @ free)
    bends = vectors[:, ::-1][:, :BENDS] * np.sqrt(values[::-1][:BENDS])
    typical = np.sqrt(np.mean(np.sum(bends**2, axis=1)))
    return np.asarray(bends * BEND_STD / typical, dtype=np.float64)


_PLACES = np.linspace(-1.0, 1.0, KNOTS)
_BENT = _bends()
