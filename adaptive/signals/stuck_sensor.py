"""Did the sensor stand still during a record: the same pv to the last digit, sample after sample?

    at least STOOD samples alike, OVER_OTHERS times as many as anywhere else in the record (but where it stood again)
    and what else is kept of the loop has noise:  median |second difference| > median |first difference| > 0

A pv in coarse steps, or one without noise, also stands still: at rest, and for a dead time. The last line tells them
apart: where a signal moves by steps or smoothly, its second differences are smaller than its first ones; white noise
has them larger by the square root of 3. What looks alike for so long by chance is coloured noise in coarse steps, and
nothing is lost with that record but time.
"""

from itertools import groupby
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
STOOD = 20
OVER_OTHERS = 5


class StoodStill(NamedTuple):
    """samples : how many in a row were alike. pv : what they were."""

    samples: int
    pv: float


def stood_still(pv: FloatArray, recorded: int) -> StoodStill | None:
    """The longest time for which the sensor stood still in a record; None where it did not.

    pv : all that is kept, the newest last. recorded : how many of them are the record.
    """
    before, pv = pv[: len(pv) - recorded], pv[len(pv) - recorded :]
    runs = [len(list(alike)) for _, alike in groupby(pv.tolist())]
    longest = max(runs)
    first = sum(runs[: runs.index(longest)])
    stuck = slice(first, first + longest)
    others = max((n for n in runs if n < STOOD), default=0)
    if longest < max(STOOD, OVER_OTHERS * others):
        return None
    rest = (before, pv[: stuck.start], pv[stuck.stop :])
    return StoodStill(longest, float(pv[first])) if _noisy(rest) else None


def _noisy(rest: tuple[FloatArray, ...]) -> bool:
    """Whether a signal has white noise, seen at its own resolution. rest : pieces of it."""
    parts = [part for part in rest if len(part) > 2]
    if sum(map(len, parts)) < STOOD:
        return False
    once, twice = (np.concatenate([np.abs(np.diff(part, n)) for part in parts]) for n in (1, 2))
    return bool(np.median(twice) > np.median(once) > 0.0)
