"""Where a signal passes through zero, noise not counted.

A crossing counts when the signal goes from beyond one side of a band round zero to beyond the other; its place is where
the straight line from the last sample on the old side to the first on the new one meets zero.
"""

import numpy as np

from retuner.adaptive.sample import FloatArray


def crossings(x: FloatArray, band: float = 0.0) -> FloatArray:
    """Places of the zero crossings as fractional sample numbers, increasing; shape (m,).

    Parameters
    ----------
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
