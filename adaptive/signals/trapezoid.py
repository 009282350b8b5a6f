"""The trapezoidal rule: numpy calls it trapezoid from 2.0 on and trapz before, and either may be installed."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.sample import FloatArray

Number = TypeVar("Number", np.float64, np.complex128)


def trapezoid(values: npt.NDArray[Number], t: FloatArray) -> Number:
    """Integral of values over t, which increases; both of shape (n,). In units of values times those of t."""
    areas: npt.NDArray[Number] = np.diff(t) * (values[1:] + values[:-1]) / 2.0
    area: Number = areas.sum()
    return area
