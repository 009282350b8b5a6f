"""Kurtosis of a signal: how its values are spread.

    kurtosis = E[(x - mean)^4] / E[(x - mean)^2]^2

Square wave 1, sine 1.5, triangle 1.8, Gaussian noise 3; more for rare large excursions.
"""

import numpy as np

from retuner.adaptive.diagnosis.indexes.crossings import detrended
from retuner.adaptive.sample import FloatArray


def kurtosis(x: FloatArray) -> float | None:
    """Kurtosis of a signal without its trend, at least 1; None for a constant. Shape (n,). Source: Pearson (1905)."""
    flat = detrended(x)
    scale = float(np.max(np.abs(flat)))
    if scale <= 1e-12 * float(np.max(np.abs(x))):
        return None
    flat = flat / scale
    return float(np.mean(flat**4) / np.mean(flat**2) ** 2)
