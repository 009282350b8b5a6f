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

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, median
from retuner.schedule.late_dataclass import dataclass

# Where a signal passes through zero, noise not counted.
#
# A crossing counts when the signal goes from beyond one side of a band round zero to beyond the other; its place is
# where the straight line from the last sample on the old side to the first on the new one meets zero.


def crossings(x: FloatArray, band: float = 0.0) -> FloatArray:
    """Places of the zero crossings as fractional sample numbers, increasing; shape (m,).

    x : the signal without its level, shape (n,). band : half width of the band that noise may fill, units of x.
    """
    outside = np.flatnonzero(np.abs(x) > band)
    if outside.size < 2:
        return np.zeros(0)
    side = np.sign(x[outside])
    turn = np.flatnonzero(side[1:] != side[:-1])
    before, after = outside[turn], outside[turn + 1]
    share = x[before] / (x[before] - x[after])
    return np.asarray(before + share * (after - before), dtype=np.float64)


def detrended(x: FloatArray) -> FloatArray:
    """The signal without its mean and straight-line trend, shape (n,)."""
    i = np.arange(len(x)) - (len(x) - 1) / 2
    level = x - np.mean(x)
    return np.asarray(level - i * (float(i @ level) / float(i @ i)), dtype=np.float64)


REGULAR = 1.0  # regularity above which a signal oscillates (Thornhill, Huang & Zhang 2003)
LEAST_STRENGTH = 0.3  # strength from which an oscillation is one: filtered noise and drift stay below
MOST_INTERVALS = 10  # intervals between zero crossings that are used (Thornhill, Huang & Zhang 2003)
FEWEST_INTERVALS = 4  # two full periods; the spread of fewer intervals says nothing
DRIFT_WINDOWS = (0.3, 0.1, 0.03)  # lengths of the running means taken off for slow drifts, as shares of the record
WITHIN_WINDOW = 0.6  # longest period, as a share of that length, that is not the running mean's own doing
FINEST = 0.1  # spread of the intervals in samples below which none is believed: crossings are read between samples
CONFIDENCE = 2.0  # Auto-covariances within this many standard deviations of noise, 1 / sqrt(n), count as zero


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
    sums = np.fft.irfft(spectrum.real**2 + spectrum.imag**2)[: n // 2 + 1]
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
    at = crossings(r, CONFIDENCE / math.sqrt(n))[: MOST_INTERVALS + 1]
    intervals = np.diff(at)
    if len(intervals) < FEWEST_INTERVALS:
        return None
    mean, spread = float(np.mean(intervals)), float(np.std(intervals, ddof=1))
    heights = np.maximum.reduceat(np.abs(r), at.astype(np.intp))[: len(intervals)]
    regular = mean / (3 * max(spread, FINEST))
    return Regularity(2 * mean, regular, n / (2 * mean), min(median(heights), 1.0))


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


# Oscillation detection by the integrated error between zero crossings (Hagglund 1995).
#
#     IAE_i = integral of |e| from one zero crossing to the next,   load disturbance when IAE_i > 2 a / w
#
# 2 a / w is the IAE of half a period of a sine of amplitude a at the frequency w; a is the smallest amplitude that
# matters (the paper: 1 % of the range) and w the ultimate frequency or, unknown, 2 pi / tau_I. A detection adds 1 to a
# count that forgets with the supervision time T_sup = 50 periods,
#
#     x := x exp(-dt / T_sup) + detections,
#
# and an oscillation is told when x exceeds 10. One load disturbance is one or two detections; an oscillation is two a
# period.

SUPERVISION_PERIODS = 50.0  # supervision time in periods (Hagglund 1995)


def iae_detection(t_s: FloatArray, e: FloatArray, amplitude: float, w_rad_s: float) -> tuple[int, float]:
    """How many half waves have an IAE over that of half a sine wave, and the largest value of the forgetting count x.

    t_s, e : time in seconds and control error sp - pv, shape (n,).
    amplitude : smallest amplitude of an oscillation that matters, pv units, more than 0.
    w_rad_s : frequency of the fastest oscillation of interest (ultimate frequency, or 2 pi / tau_I), rad/s.

    Raises ValueError: amplitude or w_rad_s is not positive and finite.

    Source: Hagglund (1995), Control Engineering Practice 3, 1543-1551.
    """
    for name, value in (("amplitude", amplitude), ("w_rad_s", w_rad_s)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} = {value} must be positive and finite")
    limit = 2 * amplitude / w_rad_s
    at = np.concatenate([t_s[:1], np.interp(crossings(e), np.arange(len(t_s)), t_s), t_s[-1:]])
    area = np.concatenate([[0.0], np.cumsum((np.abs(e[1:]) + np.abs(e[:-1])) / 2 * np.diff(t_s))])
    iae = np.diff(np.interp(at, t_s, area))
    times = at[1:][iae > limit]
    memory_s = SUPERVISION_PERIODS * 2 * math.pi / w_rad_s
    count = largest = 0.0
    for waited_s in np.diff(times, prepend=times[:1]):
        count = count * math.exp(-waited_s / memory_s) + 1
        largest = max(largest, count)
    return len(times), largest
