"""What a historian makes of a signal: exception reporting, compression, and gaps that were filled.

exception reporting   a value is sent on where it differs from the last one by a dead band, else nothing is
compression           a swinging door (Bristol 1990): of what is sent on, only the corners are kept
given back            the last value, or a straight line between those kept
gaps                  pv and co keep the last value together
"""

from itertools import pairwise

import numpy as np

from world.process import FloatArray


def exceptions(x: FloatArray, band: float) -> list[int]:
    """Samples that are sent on: the first, and each that is a band away from the last one."""
    sent = [0]
    for i in range(1, len(x)):
        if abs(x[i] - x[sent[-1]]) > band:
            sent.append(i)
    return sent


def corners(x: FloatArray, sent: list[int], band: float) -> list[int]:
    """Of the samples that were sent on, those from which no straight line leads past all others within a band."""
    found, high, low = [sent[0]], np.inf, -np.inf
    for before, i in pairwise(sent):
        first = found[-1]
        high = min(high, (x[i] + band - x[first]) / (i - first))
        low = max(low, (x[i] - band - x[first]) / (i - first))
        if low > high:
            found.append(before)
            high, low = (x[i] + band - x[before]) / (i - before), (x[i] - band - x[before]) / (i - before)
    return found if found[-1] == sent[-1] else [*found, sent[-1]]


def kept(rng: np.random.Generator, pv: FloatArray, co: FloatArray) -> tuple[FloatArray, FloatArray]:
    """pv and co as they are given back: whole, as they were sent on, or between the corners of a swinging door.

    Rows that were lost are filled with the row before, one or a few at a time; from a thousandth of the rows to half.
    """
    n, found = len(pv), []
    way = rng.choice(["whole", "exceptions", "compressed"], p=[0.35, 0.05, 0.6])
    for x in (pv, co):
        band = float(np.ptp(x) * np.exp(rng.uniform(np.log(0.0005), np.log(0.01))))
        sent = list(range(n)) if way == "whole" else exceptions(x, band / 2)
        if way == "compressed":
            at = corners(x, sent, band)
            found.append(np.interp(np.arange(n), at, x[at]))
        else:
            last = np.searchsorted(sent, np.arange(n), side="right") - 1
            found.append(x[np.array(sent)[last]])
    lost, length = (
        float(np.exp(rng.uniform(np.log(0.0005), np.log(0.6)))),
        rng.choice([1.0, 2.0, 10.0], p=[0.5, 0.4, 0.1]),
    )
    gone, left = np.zeros(n, dtype=bool), 0
    for i in range(1, n):
        if not left and rng.random() < lost / length:
            left = 1 + int(rng.poisson(length - 1))
        gone[i], left = left > 0, max(left - 1, 0)
    row = np.maximum.accumulate(np.where(gone, 0, np.arange(n)))
    return found[0][row], found[1][row]
