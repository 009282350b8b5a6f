"""Noise level of a signal from the record itself.

    sigma = 1.4826 median |d| / sqrt(6),   d_i = y_i - 2 y_(i+1) + y_(i+2)

Second differences remove level and slope, so what is left of a smooth response is small against the noise; the median
(1.4826 makes it a standard deviation for Gaussian noise) ignores the few samples where the process does jump. Where the
signal is quantised the differences may all be zero: then the quantum q counts as noise, q / sqrt(12) (Widrow 1956).

The streaming form follows the same median with one comparison a sample (stochastic approximation of a quantile,
Robbins & Monro 1951, in the multiplicative form): m grows by a factor when |d| > m and shrinks by it otherwise.
"""

import math
from typing import NamedTuple

import numpy as np

from retuner.adaptive.signals.sample import FloatArray

MEDIAN_TO_SIGMA = 1.4826 / math.sqrt(6.0)
QUANTUM_TO_SIGMA = 1.0 / math.sqrt(12.0)
LAGS = 10
"""So many lags must fit into a stretch for its noise to be told at that lag."""
COLOURED = 1.25
"""Ratio from which noise is no longer taken for white: estimates of white noise scatter by a tenth."""
FEW_LEVELS = 0.5
"""A signal with more different values than this share of its samples is not quantised in any way that matters."""
AGAIN = 5
"""Samples that must show the same level, for levels that are no whole quanta apart to be a sensor's and no motion's."""
QUANTUM_TOLERANCE = 0.02
"""All levels of a quantised signal lie whole quanta apart, to this share of a quantum."""
QUANTUM_ROUNDING = 1e-9
"""Steps below this share of the largest are rounding, no quantum."""
ADAPT_FACTOR = 1.02
"""Growth per sample of the streaming median: settles from a factor 50 in about 400 samples, scatters by 5 %."""


def noise_sigma(pv: FloatArray) -> float:
    """Standard deviation of the noise on pv, in pv units; pv has shape (n,), n >= 3. Zero for a constant signal."""
    d = np.abs(pv[:-2] - 2 * pv[1:-1] + pv[2:])
    return max(MEDIAN_TO_SIGMA * float(np.median(d)), quantum_sigma(pv))


def quantum_sigma(pv: FloatArray) -> float:
    """Standard deviation that quantisation alone gives, q / sqrt(12); zero where the signal is not quantised."""
    ordered = np.sort(pv)  # not np.unique, which loads numpy.ma: a tenth of the time that `identify` takes to start
    steps = np.diff(ordered)
    apart = steps[steps > QUANTUM_ROUNDING * (ordered[-1] - ordered[0])]
    if not apart.size or 1 + np.count_nonzero(steps) > FEW_LEVELS * len(pv):
        return 0.0
    quantum = float(np.min(apart))
    whole = np.abs(apart / quantum - np.round(apart / quantum)) < QUANTUM_TOLERANCE
    if not np.all(whole):
        quantum = _usual_jump(pv, ordered, steps)
    return quantum * QUANTUM_TO_SIGMA


def _usual_jump(pv: FloatArray, ordered: FloatArray, steps: FloatArray) -> float:
    """Median jump from one level to another, of levels that come again and again; zero where most do not.

    They lie no whole quanta apart where the end of a range cuts one off, or a converter is not even.
    """
    ends = np.flatnonzero(np.append(steps > QUANTUM_ROUNDING * (ordered[-1] - ordered[0]), True))
    visits = np.diff(ends, prepend=-1)
    if np.median(visits) < AGAIN:
        return 0.0
    jumps = np.abs(np.diff(pv))
    return float(np.median(jumps[jumps > QUANTUM_ROUNDING * (ordered[-1] - ordered[0])]))


def coloured_sigma(pv: FloatArray, longest: int) -> float:
    """Standard deviation of noise that wanders, on pv at rest; zero where it is white, for then `noise_sigma` tells it.

        sigma_k = 1.4826 median |y_i - 2 y_(i+k) + y_(i+2k)| / sqrt(6),   k = 1, 2, 4, ...

    Values next to each other are alike where the noise is coloured: of an autoregressive one with rho = 0.9 the first
    differences show a third. From k on that is longer than its memory they show all of it.

    pv : shape (n,), of a loop at rest. longest : largest k, samples; what is slower is no noise to who asks.
    """
    first, most, k = noise_sigma(pv), 0.0, 2
    while k <= min(longest, len(pv) // LAGS):
        d = np.abs(pv[: -2 * k] - 2 * pv[k:-k] + pv[2 * k :])
        most, k = max(most, MEDIAN_TO_SIGMA * float(np.median(d))), 2 * k
    return most if most > COLOURED * first else 0.0


class NoiseState(NamedTuple):
    """Streaming estimate: median of |second difference|, and the last two values."""

    median: float
    last: float
    before: float


def noise_start(sigma: float) -> float:
    """The median to start from; sigma : a first guess in pv units (for example 0.1 % of span)."""
    return sigma / MEDIAN_TO_SIGMA


def noise_step(median: float, d: float) -> float:
    """The next median; d : second difference, pv - 2 last + before. Scalars, because a tuple a sample is dear."""
    return median * ADAPT_FACTOR if d > median or -d > median else median / ADAPT_FACTOR


def noise_at_least(state: NoiseState, value: float, least: float) -> NoiseState:
    """The next state for a signal that mostly stands still, as a setpoint does: its median never falls below `least`.

    At every value that repeats the ones before the median would shrink, for hours, and noise that came later would be
    seen only after as long a climb.
    """
    median = noise_step(state.median, value - 2.0 * state.last + state.before)
    return NoiseState(max(median, least), value, state.last)
