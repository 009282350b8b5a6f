"""Does pv move in jumps while co moves steadily, or stand still while co moves? Both are a sticking valve's doing.

    jump share = (travel of pv in its largest increments) / (all its travel)  -  the same of co
    flat share = (travel of co while pv stands) / (all travel of co)

travel: sum of |increments|; the largest increments: the largest twentieth of them. The same number of co is taken off
because setpoint steps and disturbances make both jump. Gaussian increments hold 0.147 of their travel in their largest
twentieth, a ramp 0.05, a square wave nearly all. No published index: the diagnosis study found the first the best
addition to fitted hypotheses on real records. The second takes up the flat stretches of Yamashita (2006) for slower
sampling; pv stands where it changes by less than its noise band over a stretch in which co moves out of its own.
"""

import numpy as np

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray

LARGEST = 0.05
"""Share of the increments that counts as jumps."""
FEWEST_INCREMENTS = 40
"""Increments needed: two jumps in a twentieth."""
NOISE_BAND = 3.0
"""Standard deviations of the difference of two means within which a signal stands still."""


def jump_share(pv: FloatArray, co: FloatArray, width: int = 1) -> float | None:
    """Jump share of pv over that of co, -1 to 1; None for short or constant signals.

    pv, co : shape (n,). width : samples over which increments are taken.
    """
    own = [_in_largest(x, width) for x in (pv, co)]
    return None if own[0] is None or own[1] is None else own[0] - own[1]


def _in_largest(x: FloatArray, width: int) -> float | None:
    """Share of the travel in the largest increments."""
    steps = np.sort(np.abs(np.diff(x[::width])))
    travel = float(np.sum(steps))
    if len(steps) < FEWEST_INCREMENTS or travel <= 0:
        return None
    return float(np.sum(steps[len(steps) - round(LARGEST * len(steps)) :])) / travel


def flat_share(pv: FloatArray, co: FloatArray, width: int) -> float | None:
    """Share of co's travel during which pv stands still, 0 to 1; None when co never moves out of its noise.

    pv, co : shape (n,). width : samples per stretch; about a twentieth of the oscillation's period.
    """
    if len(pv) < 3 * width:
        return None
    means = [_means(x, width) for x in (pv, co)]
    moves = []
    for x, mean in zip((pv, co), means, strict=True):
        steps = np.abs(np.diff(mean))
        moves.append((steps, NOISE_BAND * noise_sigma(x) * (2.0 / width) ** 0.5))
    (d_pv, band_pv), (d_co, band_co) = moves
    moving = d_co > max(band_co, 0.1 * float(np.mean(d_co)))
    travel = float(np.sum(d_co[moving]))
    # without noise "standing" needs a scale: a tenth of pv's mean movement
    still = d_pv <= max(band_pv, 0.1 * float(np.mean(d_pv)))
    return float(np.sum(d_co[moving & still])) / travel if travel > 0 else None


def _means(x: FloatArray, width: int) -> FloatArray:
    """Means of consecutive stretches of width samples."""
    kept = len(x) // width * width
    return np.asarray(x[:kept].reshape(-1, width).mean(axis=1), dtype=np.float64)
