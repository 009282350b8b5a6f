"""Auto-covariance of a signal, its regularity and period, and the decay ratio read from it.

    r(k) = sum_i x_i x_(i+k) / (n - k)  /  (sum_i x_i^2 / n)

Regularity (Thornhill, Huang & Zhang 2003, equation 3): the zero crossings of r are evenly spaced when the signal
oscillates; noise is gone from r except at lag 0. With the intervals D between consecutive crossings,

    period = 2 mean(D),    regularity = mean(D) / (3 std(D))

More than 1 means a regular oscillation (the spread is under a third of the mean). The first interval, from lag 0, is
half of one and left out; at most ten are used, as in the paper. Where a slow drift lies under the oscillation the paper
filters; here running means over a third, a tenth and a thirtieth of the record are taken off in turn until the rest is
regular. That alone makes any drift look like an oscillation of once or twice the length of the mean, so a period
counts only when it is a good deal shorter than the mean.

Decay ratio (Miao & Seborg 1999, figure 2): a / b, b the height of the first minimum of r under the line from r(0) to
the first maximum, a the height of that maximum over the line between the first two minima. It is 1 for an undamped
oscillation and e^(-pi zeta / sqrt(1 - zeta^2)) for a free decay; above 0.5 they call a loop excessively oscillatory.
"""

import math
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.diagnosis.indexes.crossings import crossings, detrended
from retuner.adaptive.sample import FloatArray

REGULAR = 1.0
"""Regularity above which a signal oscillates (Thornhill, Huang & Zhang 2003)."""
LEAST_STRENGTH = 0.3
"""Strength from which an oscillation is one: filtered noise and drift stay below."""
MOST_INTERVALS = 10
"""Intervals between zero crossings that are used (Thornhill, Huang & Zhang 2003)."""
FEWEST_INTERVALS = 4
"""Two full periods; the spread of fewer intervals says nothing."""
DRIFT_WINDOWS = (0.3, 0.1, 0.03)
"""Lengths of the running means taken off for slow drifts, as shares of the record."""
WITHIN_WINDOW = 0.6
"""Longest period, as a share of that length, that is not the running mean's own doing."""
FINEST = 0.1
"""Spread of the intervals in samples below which none is believed: crossings are read between samples."""
CONFIDENCE = 2.0
"""Auto-covariances within this many standard deviations of noise, 1 / sqrt(n), count as zero."""


@dataclass(frozen=True, slots=True)
class Regularity:
    """An oscillation seen in the auto-covariance.

    period : in samples. regularity : see the head of this file, more than 1 is regular. cycles : periods in the record.
    strength : median over the intervals of the largest |r| in each, 0 to 1. A lasting oscillation keeps its height in
        r, the share of the signal that oscillates; filtered noise falls to a tenth or two.
    """

    period: float
    regularity: float
    cycles: float
    strength: float

    @property
    def lasting(self) -> bool:
        """Whether it is regular and keeps on."""
        return self.regularity > REGULAR and self.strength > LEAST_STRENGTH


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
    """The oscillation of a signal (the control error or pv), shape (n,); None when r has too few crossings.

    Source: Thornhill, Huang & Zhang (2003), Journal of Process Control 13, 91-100.
    """
    flat = detrended(x)
    best = _of_autocovariance(autocovariance(flat), len(x))
    for share in DRIFT_WINDOWS:
        width = 2 * int(share * len(x) / 2) + 1
        if best is not None and best.lasting:
            break
        found = _of_autocovariance(autocovariance(flat - running_mean(flat, width)), len(x))
        if found is not None and found.lasting and found.period < WITHIN_WINDOW * width:
            best = found
    return best


def running_mean(x: FloatArray, width: int) -> FloatArray:
    """Mean over width samples centred on each (fewer at the ends), shape (n,)."""
    sums = np.concatenate([[0.0], np.cumsum(x)])
    i = np.arange(len(x))
    low, high = np.maximum(i - width // 2, 0), np.minimum(i + width // 2 + 1, len(x))
    return np.asarray((sums[high] - sums[low]) / (high - low), dtype=np.float64)


def _of_autocovariance(r: FloatArray, n: int) -> Regularity | None:
    """Period and regularity of one auto-covariance."""
    at = crossings(r, CONFIDENCE / math.sqrt(n))[: MOST_INTERVALS + 1]
    intervals = np.diff(at)
    if len(intervals) < FEWEST_INTERVALS:
        return None
    mean, spread = float(np.mean(intervals)), float(np.std(intervals, ddof=1))
    heights = np.maximum.reduceat(np.abs(r), at.astype(np.intp))[: len(intervals)]
    regular = mean / (3 * max(spread, FINEST))
    return Regularity(2 * mean, regular, n / (2 * mean), min(float(np.median(heights)), 1.0))


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
