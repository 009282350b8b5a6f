"""Reading levels, crossings and peaks off a record that is noisy: what the graphical methods do with ruler and eye."""

import math

import numpy as np

from retuner.adaptive.noise import noise_sigma
from retuner.adaptive.sample import FloatArray

CLEAR = 4.0
"""A move of this many standard deviations of the noise is one; 1 in 16000 samples of noise alone is further out."""
SMOOTHED = 0.02
"""A smoothed record's noise is brought down to this share of the move that is looked for."""


def crossing(t_s: FloatArray, values: FloatArray, level: float, rising: bool) -> float:
    """When a signal passes a level: the middle between its first and its last crossing, each interpolated.

    Parameters
    ----------
    t_s, values : shape (n,). rising : from below to above; else from above to below.

    Raises
    ------
    ValueError
        It never does.
    """
    above = values >= level if rising else values <= level
    ups = np.flatnonzero(~above[:-1] & above[1:])
    if above[0]:
        return float(t_s[0])
    if not ups.size:
        raise ValueError(f"pv never passes {level:g}")
    first, last = int(ups[0]), int(ups[-1])
    return (_between(t_s, values, level, first) + _between(t_s, values, level, last)) / 2


def _between(t_s: FloatArray, values: FloatArray, level: float, i: int) -> float:
    """Linear interpolation of the crossing between samples i and i + 1."""
    share = (level - values[i]) / (values[i + 1] - values[i])
    return float(t_s[i] + share * (t_s[i + 1] - t_s[i]))


def smoothed(values: FloatArray, move: float) -> tuple[FloatArray, float]:
    """The record with its noise averaged away over just enough samples (centred), and the noise that is left.

    move : the change that is looked for, in the unit of values. At most a twentieth of the record is averaged over.
    """
    sigma = noise_sigma(values)
    if sigma == 0 or move == 0:
        return values, sigma
    wanted = (sigma / (SMOOTHED * abs(move))) ** 2
    half = int(min(math.ceil(wanted), len(values) // 20)) // 2
    if half < 1:
        return values, sigma
    n = 2 * half + 1
    padded = np.concatenate([np.full(half, values[0]), values, np.full(half, values[-1])])
    return np.convolve(padded, np.full(n, 1 / n), mode="valid"), sigma / math.sqrt(n)


def peak(t_s: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Time and value of the largest value, by a parabola through it and its neighbours."""
    i = int(np.argmax(values))
    if i in {0, len(values) - 1}:
        return float(t_s[i]), float(values[i])
    a, b, c = (float(values[j]) for j in (i - 1, i, i + 1))
    bend = a - 2 * b + c
    shift = 0.5 * (a - c) / bend if bend else 0.0
    step = float(t_s[i + 1] - t_s[i - 1]) / 2
    return float(t_s[i]) + shift * step, b - 0.25 * (a - c) * shift
