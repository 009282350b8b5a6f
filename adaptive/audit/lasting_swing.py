"""A swing that lasts, looked for at several paces of a long record, dear work only where the spectrum shows a peak.

At the pace of 1, STEP, STEP^2 ... samples the record's means are cut into windows of WINDOW points, at most PARTS of
them, spread over the record. A window is asked for the regularity of its auto-covariance (indexes/autocovariance.py)
only where a band of BAND either side of a frequency stands out of the power above it and beside it: a swing of the
strength that counts has that share of the power (Wiener & Khinchin: the auto-covariance is the spectrum's transform).
"""

from functools import cache

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.autocovariance import DRIFT_WINDOWS, LEAST_STRENGTH, Regularity, regularity
from retuner.adaptive.signals.sample import FloatArray, distinct
from retuner.schedule.late_dataclass import replace

WINDOW = 2_048  # points of a window: some ten cycles of a period of two hundred, and fifty of one of forty
PARTS = 8  # windows at one pace
STEP = 8  # ratio of two paces: a window shows periods of 6 to 400 points
BAND = 1.2  # ratio of the edges of a band to its middle
FEWEST_CYCLES = 8.0  # periods in a window: drift makes a few by chance
FASTEST = 6.0  # shortest period that is looked for, in points
STANDS_OUT = LEAST_STRENGTH  # share of the power above its lower edge from which a band is looked into
PEAK = 2.0  # ratio to the bands beside it from which that is done: drift has no peak


def lasting_swing(error: FloatArray, co: FloatArray) -> tuple[Regularity, float] | None:
    """The strongest lasting swing of the error, else of co, its period in samples, and in which share of the windows
    one lasts; None where there is none. Shapes (n,), n at least 3.
    """
    found, last, paces = [], 1, [1]
    while len(error) / paces[-1] > WINDOW:  # until a window holds the record
        paces.append(STEP * paces[-1])
    for pace in paces:
        error, co, last = _means(error, pace // last), _means(co, pace // last), pace
        # the strongest lasting swing at one pace; error, co : means at it
        rows = _windows(error), _windows(co)
        parts = len(rows[0])
        likely = _stand_out(np.concatenate(rows))
        waves = []
        for i in range(parts):
            signals = (rows[j][i] for j in range(2) if likely[j * parts + i])
            wave = next((w for w in map(regularity, signals) if w is not None and w.lasting), None)
            if wave is not None and wave.cycles >= FEWEST_CYCLES:
                waves.append(replace(wave, period=wave.period * pace))
        best = max(waves, key=lambda w: w.strength, default=None)
        if best is not None:
            found.append((best, len(waves) / parts))
    return max(found, key=lambda swing: swing[0].strength * swing[1], default=None)


def _means(x: FloatArray, many: int) -> FloatArray:
    """Means of so many samples each; what is left over at the end is left out."""
    points = len(x) // many
    return x if many == 1 else np.asarray(x[: points * many].reshape(points, many) @ np.full(many, 1 / many))


def _windows(means: FloatArray) -> FloatArray:
    """Windows of the means, shape (parts, points)."""
    length = min(len(means), WINDOW)
    parts = min(PARTS, len(means) // length)
    begins = np.linspace(0, len(means) - length, parts).astype(int)
    return np.stack([means[begin : begin + length] for begin in begins])


def _stand_out(rows: FloatArray) -> npt.NDArray[np.bool_]:
    """Rows with a band that stands out, shape (rows,)."""
    length = rows.shape[1]
    edges, cuts = _edges(length)
    if len(edges) < 5:
        return np.asarray(np.ptp(rows, axis=1) > 0)
    i = np.arange(length) - (length - 1) / 2
    level = rows - rows.mean(axis=1, keepdims=True)
    flat = level - np.outer(level @ i / float(i @ i), i)
    spectrum = np.fft.rfft(flat.astype(np.float32), 2 * length)  # for the eye of a first look
    power = spectrum.real**2 + spectrum.imag**2
    sums = np.cumsum(power, axis=1, dtype=np.float64)
    bands = sums[:, edges[2:]] - sums[:, edges[:-2]]
    beside = np.maximum(bands[:, :-4], bands[:, 4:])
    peak = bands[:, 2:-2] > PEAK * beside
    left = sums[:, -1:] - sums[:, cuts]
    share = bands[:, 2:-2, None] >= STANDS_OUT * left[:, None, :]
    above = edges[2:-4][None, :, None] >= cuts[None, None, :]
    return np.asarray(np.any(peak & np.any(share & above, axis=2), axis=1) & (np.ptp(rows, axis=1) > 0))


@cache
def _edges(length: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Bins of the bands' edges, and those below which a slow drift is taken off, of a window twice as long."""
    last = 2 * length / FASTEST
    count = max(int(np.log(last / 4) / np.log(BAND)), 0) if last > 4 else 0
    edges = distinct(np.floor(4 * BAND ** np.arange(count + 1))).astype(np.intp)
    return edges, np.array([0, *(bin_ for share in DRIFT_WINDOWS if (bin_ := int(2 / share)) <= length)])
