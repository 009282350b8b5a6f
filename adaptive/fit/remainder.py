"""What a fit leaves: is it white, and if not, which filter makes it so?

The remainder of a good fit is white noise. A drifting load, an unmodelled disturbance or a missing lag leave a coloured
one. It is described as autoregressive, r_i + a_1 r_(i-1) + ... = e_i (Yule-Walker equations with the biased
autocovariance, so the filter is always stable), its order chosen by the information criterion of Schwarz (1978).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from retuner.adaptive.sample import FloatArray

MOST_ORDER = 4
"""Highest order: a random walk through two lags with white noise on top needs no more."""
LEAST_SAMPLES = 12
"""Below this many samples colour is not told from white."""


@dataclass(frozen=True, slots=True)
class Colour:
    """The whitening filter of a remainder.

    ar : its coefficients. std : of what is left after it, in the remainder's unit.
    """

    ar: tuple[float, ...]
    std: float


def colour(r: FloatArray, least_std: float, most_order: int = MOST_ORDER) -> Colour:
    """The filter for a remainder.

    least_std : no remainder is taken to be smaller than this (the resolution of the record).
    """
    n = len(r)
    white = max(float(np.sqrt(np.mean(r**2))), least_std)
    best, lowest = Colour((), white), n * math.log(white**2)
    if n < LEAST_SAMPLES or white <= least_std:
        return best
    covariance = np.array([float(r[: n - k] @ r[k:]) / n for k in range(most_order + 1)])
    for order in range(1, most_order + 1):
        a = solve_toeplitz(covariance[:order], -covariance[1 : order + 1])
        variance = max(float(covariance[0] + a @ covariance[1 : order + 1]), least_std**2)
        criterion = n * math.log(variance) + order * math.log(n)
        if criterion < lowest:
            best, lowest = Colour(tuple(float(v) for v in a), math.sqrt(variance)), criterion
    return best


def criterion(found: Colour, n: int, unknowns: int, model_error: float) -> float:
    """Schwarz's criterion of a fit that leaves this: n ln sigma^2 + (unknowns + order of the filter) ln n.

    model_error : what any structure leaves of a real process, rms in the remainder's unit. It is added to the
    remainder's variance, or fake load steps would be taken for evidence because they cover it.
    """
    return n * math.log(found.std**2 + model_error**2) + (unknowns + len(found.ar)) * math.log(n)
