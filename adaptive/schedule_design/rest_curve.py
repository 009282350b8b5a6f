"""Which co holds each place, as the records show it: a smooth curve through the ends of the stretches."""

from collections.abc import Sequence

import numpy as np

from retuner.adaptive.schedule_design.record_stretches import LEAD_ROWS, Stretch
from retuner.adaptive.signals.sample import FloatArray, median
from retuner.schedule.late_dataclass import dataclass

END = 4  # the last one in so many rows of a stretch is its end
MOST_ORDER = 3
FOR_EACH = 3  # Stretches for each further power


@dataclass(frozen=True, slots=True)
class RestCurve:
    """co = polynomial of (x - middle) / half. std : of the stretches round it, as loads have it, in co units."""

    coefficients: tuple[float, ...]
    middle: float
    half: float
    std: float

    def co(self, x: FloatArray) -> FloatArray:
        """The co that holds the process at x; outside of what was visited, that of the end."""
        inside = np.clip((x - self.middle) / self.half, -1.0, 1.0)
        return np.asarray(np.polyval(self.coefficients, inside), dtype=np.float64)

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> "RestCurve":
        """The curve of rest from where each stretch ends."""
        x, co = np.array([_end(s) for s in stretches]).T
        middle, half = (float(np.max(x) + np.min(x)) / 2, max(float(np.ptp(x)) / 2, 1e-12))
        order = min(MOST_ORDER, max(len(stretches) // FOR_EACH, 1), len(np.unique(x)) - 1)
        coefficients = np.polyfit((x - middle) / half, co, order)
        left = co - np.polyval(coefficients, (x - middle) / half)
        return cls(tuple(coefficients.tolist()), middle, half, median(np.abs(left)) * 1.5)

    @classmethod
    def on_the_way(cls, stretch: Stretch) -> "RestCurve":
        """The rest of one stretch: a straight line from where it begins to where it ends."""
        changes = stretch.signals.changes
        lead = max(changes[0] - stretch.first, 2) if changes else LEAD_ROWS
        t, x = stretch.t_s[[0, lead]], stretch.x
        fired = stretch.fired(t)
        begun = float(np.mean(x[:lead])), float((fired[1] - fired[0]) / (t[1] - t[0]))
        (x0, co0), (x1, co1) = begun, _end(stretch)
        return cls(((co1 - co0) / 2, (co0 + co1) / 2), (x0 + x1) / 2, (x1 - x0) / 2 or 1.0, 0.0)


def _end(stretch: Stretch) -> tuple[float, float]:
    """Means of the variable and of co there."""
    last = max(len(stretch) // END, 2)
    t = stretch.t_s[[-last, -1]]
    fired = stretch.fired(t)
    return float(np.mean(stretch.x[-last:])), float((fired[1] - fired[0]) / (t[1] - t[0]))
