"""Which co holds each place, as the records show it: a smooth curve through the ends of the stretches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.schedule_design.stretches import Stretch
from retuner.adaptive.signals.sample import FloatArray

END = 4
"""The last one in so many rows of a stretch is its end."""
MOST_ORDER = 3
FOR_EACH = 3
"""Stretches for each further power."""


@dataclass(frozen=True, slots=True)
class Rest:
    """co = polynomial of (x - middle) / half. std : of the stretches round it, as loads have it, in co units."""

    coefficients: tuple[float, ...]
    middle: float
    half: float
    std: float

    def co(self, x: FloatArray) -> FloatArray:
        """That holds the process at x; outside of what was visited, that of the end."""
        inside = np.clip((x - self.middle) / self.half, -1.0, 1.0)
        return np.asarray(np.polyval(self.coefficients, inside), dtype=np.float64)

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> "Rest":
        """From where each stretch ends."""
        x, co = np.array([_end(s) for s in stretches]).T
        middle, half = (float(np.max(x) + np.min(x)) / 2, max(float(np.ptp(x)) / 2, 1e-12))
        order = min(MOST_ORDER, max(len(stretches) // FOR_EACH, 1), len(np.unique(x)) - 1)
        coefficients = np.polyfit((x - middle) / half, co, order)
        left = co - np.polyval(coefficients, (x - middle) / half)
        return cls(tuple(coefficients.tolist()), middle, half, float(np.median(np.abs(left))) * 1.5)


def _end(stretch: Stretch) -> tuple[float, float]:
    """Means of the variable and of co there."""
    last = max(len(stretch) // END, 2)
    t = stretch.t_s[[-last, -1]]
    fired = stretch.fired(t)
    return float(np.mean(stretch.x[-last:])), float((fired[1] - fired[0]) / (t[1] - t[0]))
