"""What a historian makes of a signal: exception reporting, compression, and gaps that were filled.

exception reporting   a value is sent on where it differs from the last one by a dead band, else nothing is
compression           a swinging door (Bristol 1990): of what is sent on, only the corners are kept
given back            the last value, or a straight line between those kept
gaps                  pv and co keep the last value together
"""

import numpy as np
from cases.signals import corners, exceptions, held

from world.process import FloatArray


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
            at = np.array(sent)[corners(np.array(sent), x[sent], band)]
            found.append(np.interp(np.arange(n), at, x[at]))
        else:
            found.append(held(x, sent))
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
