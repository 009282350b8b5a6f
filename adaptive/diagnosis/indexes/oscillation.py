"""Oscillation detection by the integrated error between zero crossings (Hagglund 1995).

    IAE_i = integral of |e| from one zero crossing to the next,   load disturbance when IAE_i > 2 a / w

2 a / w is the IAE of half a period of a sine of amplitude a at the frequency w; a is the smallest amplitude that
matters (the paper: 1 % of the range) and w the ultimate frequency or, unknown, 2 pi / tau_I. A detection adds 1 to a
count that forgets with the supervision time T_sup = 50 periods,

    x := x exp(-dt / T_sup) + detections,

and an oscillation is told when x exceeds 10. One load disturbance is one or two detections; an oscillation is two a
period.
"""

import math
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.diagnosis.indexes.crossings import crossings
from retuner.adaptive.sample import FloatArray

SUPERVISION_PERIODS = 50.0
"""Supervision time in periods (Hagglund 1995)."""
DETECTIONS_LIMIT = 10.0
"""Count above which the loop oscillates (Hagglund 1995)."""


@dataclass(frozen=True, slots=True)
class IaeDetection:
    """Outcome of the detector.

    loads : half waves whose IAE exceeds the limit. count : largest value of the forgetting count x.
    iae_limit : the limit in pv units times seconds.
    """

    loads: int
    count: float
    iae_limit: float

    @property
    def oscillates(self) -> bool:
        """Whether the count passed the limit of ten."""
        return self.count > DETECTIONS_LIMIT


def iae_detection(t_s: FloatArray, e: FloatArray, amplitude: float, w_rad_s: float) -> IaeDetection:
    """Run the detector over a record.

    Parameters
    ----------
    t_s, e : time in seconds and control error sp - pv, shape (n,).
    amplitude : smallest amplitude of an oscillation that matters, pv units, more than 0.
    w_rad_s : frequency of the fastest oscillation of interest (ultimate frequency, or 2 pi / tau_I), rad/s.

    Raises
    ------
    ValueError
        amplitude or w_rad_s is not positive and finite.

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
    return IaeDetection(len(times), largest, limit)
