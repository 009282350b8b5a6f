"""Shape of the curve that pv draws over co: an ellipse in a linear oscillation, a parallelogram with a sticking valve.

Yamashita (2006) reads both signals as rising, steady or falling in each sample. With a sticking valve pv stands while
co moves (IS, DS; the first letter is co's) and then moves on:

    rho1 = (t_IS + t_DS) / (t_all - t_SS)
    rho3 = rho1 - (t_ISDD + t_ISDI + t_ISSD + t_ISID + t_DSDI + t_DSSI + t_DSID + t_DSII) / (t_all - t_SS)

the second without the standing samples that are followed by a movement that no valve would make. By chance rho1 is
0.25; well above it they speak for a sticking valve. Made for flow loops, where pv is the valve's flow. Increments count
as steady within 0.43 of their standard deviation: noise then is rising, steady and falling equally often, which is what
makes 0.25 the value of chance.

Ellipse (Choudhury, Shah & Thornhill 2008, section 8.3): with correlation c of pv and co the ellipse of their covariance
is 2 sqrt(2) std(co) sqrt(1 - c^2) wide along co: about the stick band when the valve is what makes the curve.
`roundness` is half the standard deviation of the whitened squared radius: 0 on an ellipse, 0.22 to 0.45 on a
parallelogram (even speed along its sides, or one signal a square wave), 1 for Gaussian noise.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.diagnosis.indexes.crossings import detrended
from retuner.adaptive.sample import FloatArray

STEADY = 0.4307
"""Increments within this many of their standard deviations are steady: a third of those of Gaussian noise."""
LEAST_SPREAD = 1e-9
"""Determinant of the correlation matrix below which the curve is a straight line."""


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Ellipse of pv over co. stick_band : its width along co, co units. roundness : see the head of this file."""

    stick_band: float
    roundness: float


def ellipse(pv: FloatArray, co: FloatArray) -> Ellipse | None:
    """Ellipse of the curve; None when pv or co stands still or the curve is a straight line. Shapes (n,)."""
    x, y = detrended(co), detrended(pv)
    s_x, s_y = float(np.std(x)), float(np.std(y))
    if s_x <= 0 or s_y <= 0:
        return None
    x, y = x / s_x, y / s_y
    c = float(np.mean(x * y))
    if 1 - c * c < LEAST_SPREAD:
        return None
    radius2 = (x * x - 2 * c * x * y + y * y) / (1 - c * c)
    return Ellipse(2 * (2 * (1 - c * c)) ** 0.5 * s_x, float(np.std(radius2)) / 2)


def yamashita(pv: FloatArray, co: FloatArray) -> tuple[float, float] | None:
    """rho1 and rho3, each about -0.5 to 1; None when nothing moves.

    Parameters
    ----------
    pv, co : shape (n,), sampled so that an oscillation has some 10 to 40 samples.

    Source: Yamashita (2006), Control Engineering Practice 14, 503-510.
    """
    c, p = _symbols(co), _symbols(pv)
    moving = (c != 0) | (p != 0)
    count = int(np.sum(moving))
    if not count:
        return None
    standing = (c != 0) & (p == 0)
    last, before = slice(1, None), slice(None, -1)
    up, c2, p2 = c[before], c[last], p[last]
    follows = standing[before] & ((p2 == -up) | ((c2 == -up) & (p2 != 0)))
    return float(np.sum(standing)) / count, float(np.sum(standing) - np.sum(follows)) / count


def _symbols(x: FloatArray) -> FloatArray:
    """+1 rising, 0 steady, -1 falling, per increment."""
    steps = np.diff(x)
    return np.asarray(np.where(np.abs(steps) > STEADY * float(np.std(steps)), np.sign(steps), 0.0), dtype=np.float64)
