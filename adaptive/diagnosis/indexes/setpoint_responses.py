"""Overshoot and damping of the responses to setpoint steps.

    overshoot = -E2 / E1,   damping = (E3 - E2) / (E1 - E2)          as in response.py (Foxboro TI 039-200, 1995)

with E1 the error right after the step and E2, E3 the next extremes on either side. Medians over the steps of a record
are given. The relative damping of a second-order loop is zeta = -ln(o) / sqrt(pi^2 + ln(o)^2), o the overshoot.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.noise import noise_sigma
from retuner.adaptive.sample import FloatArray

STEP_BAND = 6.0
"""A setpoint change counts as a step when it exceeds this many standard deviations of pv's noise."""
PEAK_BAND = 3.0
"""Extremes within this many standard deviations of noise are none."""
FEWEST_SAMPLES = 8
"""Samples that a response needs to have peaks."""
AT_REST = 0.3
"""The error before a step, as a share of the step, up to which the loop was at rest enough."""
MOST_STEPS = 0.05
"""When the setpoint changes in a larger share of the samples it moves all the time and has no steps."""


@dataclass(frozen=True, slots=True)
class SetpointResponses:
    """Medians over the setpoint responses of a record.

    steps : how many could be read. overshoot : share of the step, 0 when none stands out of the noise.
    damping : 0 dead-beat to 1 undamped; None where no response has a third peak out of the noise.
    """

    steps: int
    overshoot: float
    damping: float | None


def setpoint_responses(sp: FloatArray, pv: FloatArray) -> SetpointResponses | None:
    """Read the responses of a record, shapes (n,); None when there is no readable setpoint step."""
    sigma = noise_sigma(pv)
    changes = np.flatnonzero(np.diff(sp)) + 1
    if not changes.size or changes.size > max(MOST_STEPS * len(sp), 1.0):
        return None
    read = []
    for start, end in zip(changes, [*changes[1:], len(sp)], strict=True):
        step = float(sp[start] - sp[start - 1])
        rest = abs(float(sp[start - 1] - pv[start - 1])) - PEAK_BAND * sigma
        if abs(step) > STEP_BAND * sigma and end - start >= FEWEST_SAMPLES and rest <= AT_REST * abs(step):
            read.append(_response((sp[start:end] - pv[start:end]) / step, PEAK_BAND * sigma / abs(step)))
    if not read:
        return None
    damped = [d for _, d in read if d is not None]
    return SetpointResponses(len(read), float(np.median([o for o, _ in read])),
                             float(np.median(damped)) if damped else None)  # fmt: skip


def _response(e: FloatArray, band: float) -> tuple[float, float | None]:
    """Overshoot and damping of one normalised error, 1 at the step."""
    below = np.flatnonzero(e < 0)
    if not below.size:
        return 0.0, None
    back = below[0] + np.flatnonzero(e[below[0] :] > band)
    until = int(back[0]) if back.size else len(e)
    second = int(below[0] + np.argmin(e[below[0] : until])) if until > below[0] else int(below[0])
    e2 = float(e[second])
    if -e2 <= band:
        return 0.0, None
    above = second + np.flatnonzero(e[second:] > band)
    if not above.size:
        return -e2, None
    ends = above[0] + np.flatnonzero(e[above[0] :] < -band)
    e3 = float(np.max(e[above[0] : int(ends[0]) if ends.size else len(e)]))
    return -e2, (e3 - e2) / (1.0 - e2)
