"""The windows in which setpoints of loops on one plant moved: what their outputs do to each process value shows there.

records of all loops -> one clock -> moves of any setpoint -> windows from rest -> Moved, for each process value
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from retuner.adaptive.interaction.multivariable_fit import Moved, StepAnswers, answers
from retuner.adaptive.signals.sample import FloatArray

LEAD = 10  # points before a move whose mean is where all stood
POINTS = 120  # most points of a window
FEWEST_POINTS_AFTER_MOVE = 12  # fewest points after a move
NEWEST = 8  # windows that are taken, the newest; an older plant may have been another one
SETTLED, AS_LONG_AGAIN = 0.1, 1.6
"""A move is over when the error stays below this share of its largest; the window is so many times as long."""
AT_REST = 0.1  # most that a process value may move in the lead, as a share of what it moves in the window
SPREAD = 10.0  # A window may be so many times as long as the shortest one
LEFT = 0.1  # share of a process value's variation that may stay unexplained


class OneLoopRecord(NamedTuple):
    """One loop on the common clock, a value a sample time: shape (n,) each."""

    sp: FloatArray
    pv: FloatArray
    co: FloatArray


def seen_in(records: Sequence[OneLoopRecord], dt_s: float) -> tuple[StepAnswers, ...] | None:
    """What each process value of the plant does after each output; None where too few moves have shown it.

    records : of all loops, at the same times, dt_s seconds apart.
    """
    spans = _spans(records)
    if spans is None:
        return None
    thin = max(1, math.ceil(max(len(range(*span)) for span in spans) / POINTS))
    found = []
    for record in records:
        moved = (_moved([one.co for one in records], record.pv, span, thin) for span in spans)
        windows = [one for one in moved if one is not None]
        if not windows:
            return None
        found.append(answers(windows, thin * dt_s))
    return tuple(found) if all(one.left <= LEFT for one in found) else None


def _spans(records: Sequence[OneLoopRecord]) -> list[tuple[int, int]] | None:
    """First move and end of each window; None where a loop's setpoint has not moved."""
    n = len(records[0].sp)
    moves = [np.flatnonzero(np.diff(one.sp)) + 1 for one in records]
    every = np.unique(np.concatenate([[n], *moves]))
    spans: list[tuple[int, int, int]] = []
    for loop, own in enumerate(moves):
        for at in own:
            until = int(every[np.searchsorted(every, at, "right")])
            e = np.abs(records[loop].sp[at:until] - records[loop].pv[at:until])
            out = np.flatnonzero(e > SETTLED * e.max())
            end = min(until, int(at + AS_LONG_AGAIN * (out[-1] + 1)) + FEWEST_POINTS_AFTER_MOVE)
            if end - at >= FEWEST_POINTS_AFTER_MOVE:
                spans.append((int(at), end, loop))
    spans = sorted(spans)[-NEWEST:]
    if {loop for _, _, loop in spans} != set(range(len(records))):
        return None
    longest = SPREAD * min(end - at for at, end, _ in spans)
    return [(at, int(min(end, at + longest))) for at, end, _ in spans]


def _moved(outputs: Sequence[FloatArray], pv: FloatArray, span: tuple[int, int], thin: int) -> Moved | None:
    """A window with one point for `thin` samples; None where the process value was not at rest before."""
    at, end = span
    begin = at - LEAD * thin
    points = (end - at) // thin
    if begin < 0 or points < FEWEST_POINTS_AFTER_MOVE:
        return None
    co = np.array([one[begin : at + points * thin].reshape(-1, thin).mean(axis=1) for one in outputs])
    y = pv[begin : at + points * thin : thin]
    lead, whole = y[:LEAD], float(np.ptp(y))
    if abs(float(np.mean(lead[LEAD // 2 :]) - np.mean(lead[: LEAD // 2]))) > AT_REST * whole:
        return None
    rest = np.mean(co[:, :LEAD], axis=1, keepdims=True)
    return Moved(np.concatenate([rest, co[:, LEAD:]], axis=1), np.concatenate([[np.mean(lead)], y[LEAD:]]))
