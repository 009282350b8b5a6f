"""Auto-covariance of a signal, its regularity and period, and the decay ratio read from it.

    r(k) = sum_i x_i x_(i+k) / (n - k)  /  (sum_i x_i^2 / n)

Regularity (Thornhill, Huang & Zhang 2003, equation 3): the zero crossings of r are evenly spaced when the signal
oscillates; noise is gone from r except at lag 0. With the intervals D between consecutive crossings,

    period = 2 mean(D),    regularity = mean(D) / (3 std(D))

More than 1 means a regular oscillation (the spread is under a third of the mean). The first interval, from lag 0, is
half of one and left out; at most ten are used, as in the paper. Where a slow drift lies under the oscillation the paper
filters; here the mean over a few window lengths is taken off as well and the most regular result counts.

Decay ratio (Miao & Seborg 1999, figure 2): a / b, b the height of the first minimum of r under the line from r(0) to
the first maximum, a the height of that maximum over the line between the first two minima. It is 1 for an undamped
oscillation and e^(-pi zeta / sqrt(1 - zeta^2)) for a free decay; above 0.5 they call a loop excessively oscillatory.
"""

import math
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.diagnosis.indexes.crossings import crossings, detrended
from retuner.adaptive.sample import FloatArray

MOST_INTERVALS = 10
"""Intervals between zero crossings that are used (Thornhill, Huang & Zhang 2003)."""
FEWEST_INTERVALS = 4
"""Two full periods; the spread of fewer intervals says nothing."""
DRIFT_WINDOWS = (0.3, 0.15, 0.075)
"""Lengths of the running means taken off for slow drifts, as shares of the record."""
CONFIDENCE = 2.0
"""Auto-covariances within this many standard deviations of noise, 1 / sqrt(n), count as zero."""


@dataclass(frozen=True, slots=True)
class Regularity:
    """An oscillation seen in the auto-covariance.

    period : in samples. regularity : see the head of this file, more than 1 is regular. cycles : periods in the record.
    strength : the largest |r| between the first and the third crossing, 0 to 1: share of the signal that oscillates.
    """

    period: float
    regularity: float
    cycles: float
    strength: float


def autocovariance(x: FloatArray) -> FloatArray:
    """Normalised auto-covariance at lags 0 to n/2, shape (n // 2 + 1,); zeros for a constant signal."""
    n = len(x)
    level = x - np.mean(x)
    spectrum = np.fft.rfft(level, 1 << (2 * n - 1).bit_length())
    sums = np.fft.irfft((spectrum * spectrum.conj()).real)[: n // 2 + 1]
    if sums[0] <= 0:
        return np.zeros(n // 2 + 1)
    return np.asarray(sums / (n - np.arange(n // 2 + 1)) * (n / sums[0]), dtype=np.float64)


def regularity(x: FloatArray) -> Regularity | None:
    """The most regular oscillation of a signal (the control error or pv), shape (n,); None when there is none.

    Source: Thornhill, Huang & Zhang (2003), Journal of Process Control 13, 91-100.
    """
    flat = detrended(x)
    found = [_of_autocovariance(autocovariance(flat), len(x))]
    for share in DRIFT_WINDOWS:
        width = 2 * int(share * len(x) / 2) + 1
        if width >= 2 * FEWEST_INTERVALS:
            found.append(_of_autocovariance(autocovariance(flat - running_mean(flat, width)), len(x)))
    there = [f for f in found if f is not None]
    if not there:
        return None
    plain = found[0]
    if plain is not None and plain.regularity > 1:
        return plain
    return max(there, key=lambda f: f.regularity)


def running_mean(x: FloatArray, width: int) -> FloatArray:
    """Mean over width samples centred on each (fewer at the ends), shape (n,)."""
    sums = np.concatenate([[0.0], np.cumsum(x)])
    i = np.arange(len(x))
    low, high = np.maximum(i - width // 2, 0), np.minimum(i + width // 2 + 1, len(x))
    return np.asarray((sums[high] - sums[low]) / (high - low), dtype=np.float64)


def _of_autocovariance(r: FloatArray, n: int) -> Regularity | None:
    """Period and regularity of one auto-covariance."""
    at = crossings(r, CONFIDENCE / math.sqrt(n))[: MOST_INTERVALS + 1]
    if len(at) <= FEWEST_INTERVALS:
        return None
    intervals = np.diff(at)
    mean, spread = float(np.mean(intervals)), float(np.std(intervals, ddof=1))
    strength = float(np.max(np.abs(r[int(at[0]) : int(at[2]) + 1])))
    # crossings are read between samples: no spread under a tenth of a sample is believed
    return Regularity(2 * mean, mean / (3 * max(spread, 0.1)), n / (2 * mean), min(strength, 1.0))


def decay_ratio(x: FloatArray) -> float | None:
    """Decay ratio per half period, 0 to 1; None when the auto-covariance has no minimum, maximum and minimum.

    x : the control error or pv, shape (n,). Source: Miao & Seborg (1999), IEEE Conference on Control Applications.
    """
    r = autocovariance(detrended(x))
    at = crossings(r, CONFIDENCE / math.sqrt(len(x)))
    if len(at) < 3:
        return None
    edges = [math.ceil(c) for c in at[:4]] + ([len(r)] if len(at) == 3 else [])
    first, top, second = (edges[i] + int(np.argmax(np.abs(r[edges[i] : edges[i + 1]]))) for i in range(3))
    b = r[0] + (r[top] - r[0]) * first / top - r[first]
    a = r[top] - (r[first] + (r[second] - r[first]) * (top - first) / (second - first))
    return float(min(max(a / b, 0.0), 1.0)) if b > 0 else None
