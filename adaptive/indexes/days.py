"""A record of several days: nights without samples, or with a controller that is off, are no work of the loop."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.output_limits import at_limits
from retuner.adaptive.indexes.recording_quality import runs
from retuner.adaptive.signals.sample import Window, median

GAP = 60.0  # sampling intervals without a sample, from which the record goes on as another one
NIGHT = 0.04  # share of the record in which co stands still without a break, from which it is off
OFF = 0.3  # share of the record that it must be off in all; a shorter stand-still is a loop's own
FEWEST_ROWS = 60  # rows of a day at the least
MOST_DAYS = 8  # most days that are read; of more, the newest


def days_of(window: Window, most: int = MOST_DAYS) -> list[Window]:
    """The stretches in which a loop was at work, each a record of its own; the record itself where it is only one."""
    n = len(window.t_s)
    step = np.diff(window.t_s)
    cut = (step > GAP * median(step)) | (np.diff(off_in(window).astype(np.int8)) != 0)
    if not cut.any():
        return [window]
    edges = [0, *(np.flatnonzero(cut) + 1).tolist(), n]
    parts = [slice(a, b) for a, b in pairwise(edges) if b - a >= FEWEST_ROWS]
    days = [window.part(rows) for rows in parts if np.ptp(window.co[rows]) > 0 and np.ptp(window.pv[rows]) > 0]
    return days[-most:] if len(days) > 1 else [window]


def off_in(window: Window) -> npt.NDArray[np.bool_]:
    """Samples in which the controller is off, shape (n,): co stands still for long. None where that is rare.

    co that stands still at a limit is at work: the error pushes it there (output_limits.py).
    """
    limits = at_limits(window.co, error=window.sp - window.pv)
    ends = [float(f(window.co)) for share, f in ((limits.low, np.min), (limits.high, np.max)) if share > 0]
    still = (np.diff(window.co) == 0) & ~np.isin(window.co[1:], ends)
    off = np.zeros(len(window.co), dtype=bool)
    for a, b in runs(still):
        off[a : b + 1] = b - a >= max(NIGHT * len(window.co), FEWEST_ROWS)
    return off & (np.mean(off) >= OFF)


def at_gaps(window: Window) -> list[slice]:
    """The rows of a record between gaps in its time, none left out; all in one where a part of it would be short."""
    step = np.diff(window.t_s)
    edges = [0, *(np.flatnonzero(step > GAP * median(step)) + 1).tolist(), len(window.t_s)]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    return parts if min(part.stop - part.start for part in parts) >= FEWEST_ROWS else [slice(0, len(window.t_s))]
