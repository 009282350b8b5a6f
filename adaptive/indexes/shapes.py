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
from typing import NamedTuple

import numpy as np

from retuner.adaptive.indexes.autocovariance import crossings, detrended
from retuner.adaptive.signals.sample import FloatArray

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


# Cross-correlation of co and pv round lag 0 (Horch 1999): odd for a sticking valve, even for other oscillations.
#
#     r(k) = sum_i co_i pv_(i+k),     t_l, t_r   lags of the first zero crossings left and right of lag 0,
#     dtau = |t_l - t_r| / (t_l + t_r),
#     drho = |r(0) - r_opt| / |r(0) + r_opt|,   r_opt = sign(r(0)) max |r(k)|,  -t_l <= k <= t_r
#
# Both lie in 0 to 1: above 2/3 the correlation is odd (a sticking valve in a self-regulating loop with PI control),
# below 1/3 it is even (aggressive tuning, outside oscillation). Not for integrating processes: there both cases look
# alike.


class CrossCorrelation(NamedTuple):
    """Horch's two measures, 0 even to 1 odd."""

    dtau: float
    drho: float


def cross_correlation(pv: FloatArray, co: FloatArray, band: float = 0.02) -> CrossCorrelation | None:
    """Horch's measures; None where the correlation does not cross zero on both sides of lag 0.

    Parameters
    ----------
    pv, co : an oscillating record, shape (n,). band : correlations within +-band of the largest one count as zero.

    Source: Horch (1999), Control Engineering Practice 7, 1221-1231.
    """
    n = len(pv)
    length = 1 << (2 * n - 1).bit_length()
    product = np.fft.rfft(detrended(pv), length) * np.fft.rfft(detrended(co), length).conj()
    circular = np.fft.irfft(product)
    reach = n // 2
    r = np.concatenate([circular[-reach:], circular[: reach + 1]])
    largest = float(np.max(np.abs(r)))
    if largest <= 0:
        return None
    at = crossings(r, band * largest) - reach
    left, right = at[at < 0], at[at >= 0]
    if not left.size or not right.size:
        return None
    t_l, t_r = -float(left[-1]), float(right[0])
    part = r[reach + int(np.ceil(-t_l)) : reach + int(t_r) + 1]
    r0 = float(r[reach])
    sign = 1.0 if r0 >= 0 else -1.0
    r_opt = sign * float(np.max(np.abs(part), initial=abs(r0)))
    drho = abs(r0 - r_opt) / abs(r0 + r_opt) if r0 + r_opt else 1.0
    return CrossCorrelation(abs(t_l - t_r) / (t_l + t_r), drho)


# Kurtosis of a signal: how its values are spread.
#
#     kurtosis: fourth central moment over the squared variance, E[(x - m)^4] over E[(x - m)^2] squared
#
# Square wave 1, sine 1.5, triangle 1.8, Gaussian noise 3; more for rare large excursions.


def kurtosis(x: FloatArray) -> float | None:
    """Kurtosis of a signal without its trend, at least 1; None for a constant. Shape (n,). Source: Pearson (1905)."""
    flat = detrended(x)
    scale = float(np.max(np.abs(flat)))
    if scale <= 1e-12 * float(np.max(np.abs(x))):
        return None
    flat = flat / scale
    return float(np.mean(flat**4) / np.mean(flat**2) ** 2)
