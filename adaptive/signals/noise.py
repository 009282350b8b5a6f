"""Noise level of a signal from the record itself.

    sigma = 1.4826 median |d| / sqrt(6),   d_i = y_i - 2 y_(i+1) + y_(i+2)

Second differences remove level and slope, so what is left of a smooth response is small against the noise; the median
(1.4826 makes it a standard deviation for Gaussian noise) ignores the few samples where the process does jump. Where the
signal is quantised the differences may all be zero: then the quantum q counts as noise, q / sqrt(12) (Widrow 1956).

The streaming form follows the same median with one comparison a sample (stochastic approximation of a quantile,
Robbins & Monro 1951, in the multiplicative form): m grows by a factor when |d| > m and shrinks by it otherwise.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from retuner.adaptive.signals.recogniser import START_BANDS
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import FloatArray, LoopSample, kept_of_signal, median

MEDIAN_TO_SIGMA = 1.4826 / math.sqrt(6.0)
QUANTUM_TO_SIGMA = 1.0 / math.sqrt(12.0)
LAGS = 10  # Lags that must fit into a stretch for its noise to be told at that lag
COLOURED = 1.25  # ratio from which noise is no longer taken for white: estimates of white noise scatter by a tenth
FEW_LEVELS = 0.5
"""A signal with more different values than this share of its samples is not quantised in any way that matters."""
QUANTUM_TOLERANCE = 0.02  # all levels of a quantised signal lie whole quanta apart, to this share of a quantum
FEWEST_MOVES = 3  # different moves, in whole quanta, by which a grid shows where few values come twice
QUANTUM_ROUNDING = 1e-9  # steps below this share of the largest are rounding, no quantum
ADAPT_FACTOR = 1.02
"""Growth per sample of the streaming median: settles from a factor 50 in about 400 samples, scatters by 5 %."""


@kept_of_signal
def noise_sigma(pv: FloatArray) -> float:
    """Standard deviation of the noise on pv, in pv units; pv has shape (n,), n >= 3. Zero for a constant signal."""
    d = np.abs(pv[:-2] - 2 * pv[1:-1] + pv[2:])
    return max(MEDIAN_TO_SIGMA * median(d), quantum_sigma(pv))


@kept_of_signal
def quantum_sigma(pv: FloatArray) -> float:
    """Standard deviation that quantisation alone gives, q / sqrt(12); zero where the signal is not quantised.

    A grid shows by repetition, and in a short record by its moves: they are one, two, three and more whole quanta.
    """
    ordered = np.sort(pv)
    steps = np.diff(ordered)
    apart = steps[steps > QUANTUM_ROUNDING * (ordered[-1] - ordered[0])]
    if not apart.size:
        return 0.0
    if 1 + np.count_nonzero(steps) > FEW_LEVELS * len(pv) and not _moves_by_quanta(pv, float(np.min(apart))):
        return 0.0
    for inside in (apart, apart[1:-1]):  # the end of a range may cut off the lowest or the highest level
        quantum = float(np.min(inside, initial=math.inf))
        if inside.size and np.all(np.abs(inside / quantum - np.round(inside / quantum)) < QUANTUM_TOLERANCE):
            return quantum * QUANTUM_TO_SIGMA
    return 0.0


def _moves_by_quanta(pv: FloatArray, quantum: float) -> bool:
    """Whether a signal goes by whole quanta from sample to sample, by several different numbers of them.

    A straight line lies on a grid as well, but all its moves are alike.
    """
    moves = np.abs(np.diff(pv)) / quantum
    whole = np.round(moves)
    several = len(set(whole[whole > 0].tolist())) >= FEWEST_MOVES
    return several and bool(np.all(np.abs(moves - whole) < QUANTUM_TOLERANCE))


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
        most, k = max(most, MEDIAN_TO_SIGMA * median(d)), 2 * k
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


# What pv did while nothing happened before a response: noise that wanders, which differences of neighbours do not see.
#
# The streaming estimate of noise.py sees a third of noise with a memory of ten samples. A band made of it is too
# narrow: noise passes for responses, a loop at rest for a restless one, and what a good model leaves for another
# cause. So with every response the samples before it are looked at once more, at longer lags.


FEWEST_SAMPLES_AT_REST = 60  # samples at rest of which noise that wanders is told
OUTSIDE = 0.05  # share of them that may lie outside of what begins a response: the band is too narrow for such noise
PARTS = 8  # what is slower than this part of a response is a load to it, and no noise


def wander_before(samples: Sequence[LoopSample], response: Response) -> float:
    """Standard deviation of noise that wanders, pv units; zero where it is white, or the loop was not at rest for long.

    samples : kept, the newest last, with the response at their end.
    """
    # pv from the last motion on, or the last change of setpoint or gains, until the response
    near, outside, found = START_BANDS * response.band, 0, list[float]()
    before = [sample for sample in samples if sample.t_s < response.t_start_s]
    for sample in reversed(before):
        outside += abs(sample.sp - sample.pv) > near
        same = sample.sp == before[-1].sp and sample.revision == before[-1].revision
        if not same or outside > max(OUTSIDE * len(found), 1):
            break
        found.append(sample.pv)
    rest = np.array(found)
    if len(rest) < FEWEST_SAMPLES_AT_REST:
        return 0.0
    length = sum(sample.t_s >= response.t_start_s for sample in samples)
    return coloured_sigma(rest, length // PARTS)
