"""Overshoot and damping of the responses to setpoint steps.

    overshoot = -E2 / E1,   damping = (E3 - E2) / (E1 - E2)          as in response.py (Foxboro TI 039-200, 1995)

with E1 the error right after the step and E2, E3 the next extremes on either side. Medians over the steps of a record
are given. The relative damping of a second-order loop is zeta = -ln(o) / sqrt(pi^2 + ln(o)^2), o the overshoot.
"""

import numpy as np

from retuner.adaptive.indexes.autocovariance import running_mean
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, median
from retuner.schedule.late_dataclass import dataclass

STEP_BAND = 6.0  # A setpoint change counts as a step when it exceeds this many standard deviations of pv's noise
PEAK_BAND = 3.0  # extremes within this many standard deviations of noise are none
FEWEST_SAMPLES = 8  # samples that a response needs to have peaks
AT_REST = 0.3  # the error before a step, as a share of the step, up to which the loop was at rest enough
RAMP, RAMP_GAP = 6, 2
"""Rows of a step that a historian has interpolated, at the most, and from one row that changes to the next."""
MOST_STEPS = 0.05  # when the setpoint changes in a larger share of the samples it moves all the time and has no steps


@dataclass(frozen=True, slots=True)
class SetpointResponses:
    """Medians over the setpoint responses of a record.

    steps : how many could be read. overshoot : share of the step, 0 when none stands out of the noise.
    damping : 0 dead-beat to 1 undamped; None where no response has a third peak out of the noise. size : of the steps,
    pv units.
    """

    steps: int
    overshoot: float
    damping: float | None
    size: float


def setpoint_responses(sp: FloatArray, pv: FloatArray) -> SetpointResponses | None:
    """Read the responses of a record, shapes (n,); None when there is no readable setpoint step."""
    sigma = noise_sigma(pv)
    # First and last row of each step: rows of one direction that follow within RAMP rows are one step, as
    # historians interpolate it
    moves = np.diff(sp)
    changes: list[tuple[int, int]] = []
    for row in (np.flatnonzero(moves) + 1).tolist():
        joined = changes and row - changes[-1][1] <= RAMP_GAP and row - changes[-1][0] < RAMP
        if joined and moves[row - 1] * moves[changes[-1][0] - 1] > 0:
            changes[-1] = (changes[-1][0], row)
        else:
            changes.append((row, row))
    if not changes or len(changes) > max(MOST_STEPS * len(sp), 1.0):
        return None
    read = []
    for (start, last), end in zip(changes, [*(first for first, _ in changes[1:]), len(sp)], strict=True):
        step = float(sp[last] - sp[start - 1])
        rest = abs(float(sp[start - 1] - pv[start - 1])) - PEAK_BAND * sigma
        if abs(step) > STEP_BAND * sigma and end - last >= FEWEST_SAMPLES and rest <= AT_REST * abs(step):
            error = (sp[last:end] - pv[last:end]) / step
            if np.any(error < AT_REST):  # else it ends before pv has come near its setpoint
                read.append((*_response(error, PEAK_BAND * sigma / abs(step)), abs(step)))
    if not read:
        return None
    damped = [d for _, d, _ in read if d is not None]
    overshoot, size = median([one[0] for one in read]), median([one[2] for one in read])
    return SetpointResponses(len(read), overshoot, median(damped) if damped else None, size)


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


# Idle index: does the controller wait for the process? (Hagglund 1999)
#
#     idle index: (t_pos - t_neg) / (t_pos + t_neg)
#
# t_pos is the time during which the increments of co and pv have the same sign, t_neg that of opposite signs, for a
# process of positive gain. After a load disturbance a sluggish loop moves co and pv together for a long time (near 1);
# a well tuned one is around -0.5 to 0; an oscillating one is near -1 to 0. So a low value does not praise a loop. As in
# Kuehl & Horch (2005) the signals are smoothed, and increments within the noise count for neither side.

NOISE_BAND = 3.0  # standard deviations of noise within which an increment has no sign
FEWEST_INCREMENTS = 10  # increments with a sign that are needed


def idle_index(pv: FloatArray, co: FloatArray, direction: int, width: int) -> float | None:
    """Idle index, -1 to 1; None when fewer than ten increments stand out of the noise.

    pv, co : process value and controller output, shape (n,), setpoint constant. direction : sign of the process gain.
    width : samples over which is smoothed and over which increments are taken; about a twentieth of the loop's period.

    Source: Hagglund (1999), Control Engineering Practice 7, 1505-1511.
    """
    moves = []
    for x in (pv, co):  # increments of the smoothed signal; those within the noise are zero
        smooth = running_mean(x, width)
        step = smooth[width:] - smooth[:-width]
        band = NOISE_BAND * noise_sigma(x) * (2.0 / width) ** 0.5
        moves.append(np.where(np.abs(step) > band, step, 0.0))
    d_pv, d_co = moves
    counted = (np.sign(d_pv * d_co) * direction)[(d_pv != 0) & (d_co != 0)]
    return float(np.mean(counted)) if counted.size >= FEWEST_INCREMENTS else None
