"""What historians do to a signal before they store it, and give back between the stored points."""

import numpy as np

from cases.case import FloatArray, Record


def swinging_door(t: FloatArray, x: FloatArray, deviation: float) -> FloatArray:
    """Straight lines through the points that a swinging door of that half-width keeps (Bristol 1990)."""
    kept = [0]
    low, high = -np.inf, np.inf
    for i in range(1, len(x)):
        span = t[i] - t[kept[-1]]
        upper, lower = (x[i] + deviation - x[kept[-1]]) / span, (x[i] - deviation - x[kept[-1]]) / span
        low, high = max(low, lower), min(high, upper)
        if low > high:
            kept.append(i - 1)
            span = t[i] - t[i - 1]
            low, high = (x[i] - deviation - x[i - 1]) / span, (x[i] + deviation - x[i - 1]) / span
    kept.append(len(x) - 1)
    return np.interp(t, t[kept], x[kept])


def boxcar(x: FloatArray, deviation: float) -> FloatArray:
    """The last stored value until the signal leaves it by the deviation."""
    out = np.empty_like(x)
    held = x[0]
    for i, value in enumerate(x.tolist()):
        if abs(value - held) > deviation:
            held = value
        out[i] = held
    return out


def compressed(rng: np.random.Generator, record: Record) -> Record:
    """pv and co through one of the two, with deviations of 0.5 to 2 % of their ranges."""
    doors = rng.uniform() < 0.6
    pv, co = (
        swinging_door(record.t, x, d) if doors else boxcar(x, d)
        for x, d in ((x, float(rng.uniform(0.005, 0.02)) * float(np.ptp(x))) for x in (record.pv, record.co))
    )
    return Record(record.t, record.sp, pv, co)
