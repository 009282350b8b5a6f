"""Idle index: does the controller wait for the process? (Hagglund 1999)

    idle = (t_pos - t_neg) / (t_pos + t_neg)

t_pos is the time during which the increments of co and pv have the same sign, t_neg that of opposite signs, for a
process of positive gain. After a load disturbance a sluggish loop moves co and pv together for a long time (near 1);
a well tuned one is around -0.5 to 0; an oscillating one is near -1 to 0. So a low value does not praise a loop. As in
Kuehl & Horch (2005) the signals are smoothed, and increments within the noise count for neither side.
"""

import numpy as np

from retuner.adaptive.diagnosis.indexes.autocovariance import running_mean
from retuner.adaptive.noise import noise_sigma
from retuner.adaptive.sample import FloatArray

NOISE_BAND = 3.0
"""Standard deviations of noise within which an increment has no sign."""
FEWEST_INCREMENTS = 10
"""Increments with a sign that are needed."""


def idle_index(pv: FloatArray, co: FloatArray, direction: int, width: int) -> float | None:
    """Idle index, -1 to 1; None when fewer than ten increments stand out of the noise.

    Parameters
    ----------
    pv, co : process value and controller output, shape (n,), setpoint constant. direction : sign of the process gain.
    width : samples over which is smoothed and over which increments are taken; about a twentieth of the loop's period.

    Source: Hagglund (1999), Control Engineering Practice 7, 1505-1511.
    """
    d_pv, d_co = (_increments(x, width) for x in (pv, co))
    sign = np.sign(d_pv * d_co) * direction
    counted = sign[(d_pv != 0) & (d_co != 0)]
    return float(np.mean(counted)) if counted.size >= FEWEST_INCREMENTS else None


def _increments(x: FloatArray, width: int) -> FloatArray:
    """Increments of the smoothed signal over width samples; those within the noise are zero."""
    smooth = running_mean(x, width)
    step = smooth[width:] - smooth[:-width]
    band = NOISE_BAND * noise_sigma(x) * (2.0 / width) ** 0.5
    return np.where(np.abs(step) > band, step, 0.0)
