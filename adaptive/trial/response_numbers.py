"""What is read from one response, promised or measured: how it swings, and what it costs.

    overshoot  -E2/E1,   damping  (E3 - E2)/(E1 - E2)                              (Foxboro TI 039-200, 1995, figure 1)
    decay      min(damping, |E3/E2|)
    iae        integral |e| dt per unit of the setpoint's step, or of the load
    travel     total variation of the controller output, per the same unit

All three are the same number, the ratio of successive peaks, for a swing that dies out undisturbed. A trial is judged
by the decay, because a second upset during a response makes one of them large in the calmest loop (a load that comes
and goes makes E2 as large as E1, so the damping is 1/2), but only a loop that swings makes both large. |E2/E1| is no
third one: the error of a load stays on one side while the integral takes it over, and the swing rides on it.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.trial.batch_responses import ClosedLoop, Trace, Upset, traces
from retuner.schedule.late_dataclass import dataclass

SMALL = 0.02  # half waves below this share of the largest error are not counted as peaks of a computed response
TAIL = 4  # A loop whose error in the last quarter is as large as before runs away or swings for ever
AT_REST = 0.05  # the error has settled when it stays below this share of its largest value


@dataclass(frozen=True, slots=True)
class ResponseNumbers:
    """Numbers of one response (see the head of this file); settle_s : until the error stays small, s."""

    overshoot: float
    damping: float
    decay: float
    iae: float
    travel: float
    settle_s: float


def peaks_of(e: FloatArray, most: int = 3) -> list[float]:
    """The extremes of the half waves of an error, in order, at most so many; small ripple is passed over."""
    kept = np.flatnonzero(np.abs(e) > SMALL * np.max(np.abs(e), initial=0.0))
    if not kept.size:
        return []
    signs = np.sign(e[kept])
    starts = np.concatenate([[0], np.flatnonzero(np.diff(signs)) + 1, [kept.size]])
    halves = [e[kept[a:b]] for a, b in pairwise(starts)]
    return [float(half[np.argmax(np.abs(half))]) for half in halves[:most]]


def swing(peaks: list[float], unseen: float = 0.0) -> tuple[float, float, float]:
    """Overshoot, damping and decay of up to three peaks; a peak that was not seen is at most `unseen` large."""
    if len(peaks) < 2:
        return 0.0, 0.0, 0.0
    first, second, third = three(peaks, unseen)
    damping = (third - second) / (first - second)
    return -second / first, damping if len(peaks) > 2 else 0.0, min(damping, abs(third / second))


def three(peaks: list[float], unseen: float) -> tuple[float, float, float]:
    """The first three of at least two peaks; a third one that was not seen is at most `unseen` large."""
    first, second = peaks[0], peaks[1]
    third = peaks[2] if len(peaks) > 2 else math.copysign(min(unseen, abs(second)), first)
    return first, second, third


def shape_of(trace: Trace, ki: float) -> ResponseNumbers:
    """Numbers of a computed response to a unit upset; iae and settle_s are infinite where it never comes to rest.

    ki : of the loop; what the error's integral still has to do after the last point follows from it.
    """
    size, iae = np.abs(trace.e), iae_of(trace, ki)
    overshoot, damping, decay = swing(peaks_of(trace.e))
    travel = abs(float(trace.u[0])) + float(np.sum(np.abs(np.diff(trace.u))))
    if not _comes_to_rest(size):
        return ResponseNumbers(overshoot, damping, max(decay, 1.0), iae, travel, math.inf)
    moving = np.flatnonzero(size > AT_REST * float(np.max(size[: 2 * (len(size) // TAIL)])))
    settle = trace.step_s * float(moving[-1] if moving.size else 0)
    return ResponseNumbers(overshoot, damping, decay, iae, travel, settle)


def iae_of(trace: Trace, ki: float) -> float:
    """IAE of a computed response, see `shape_of`."""
    size = np.abs(trace.e)
    if not _comes_to_rest(size):
        return math.inf
    rest = abs((trace.rest_u - float(trace.u[-1])) / ki) if ki else math.inf
    return trace.step_s * float(np.sum(size)) + rest


def _comes_to_rest(size: FloatArray) -> bool:
    quarter = len(size) // TAIL
    return not float(np.max(size[-quarter:])) >= float(np.max(size[: 2 * quarter])) * (1 - 1e-9)


def shapes(loops: Sequence[ClosedLoop], upsets: Sequence[Upset]) -> list[list[ResponseNumbers]]:
    """The numbers of every loop under every upset: [loop][upset]."""
    rows = zip(loops, traces(loops, upsets), strict=True)
    return [[shape_of(trace, loop.gains.ki) for trace in row] for loop, row in rows]


UPSETS = (Upset(setpoint=1.0), Upset(load_step=1.0))


def iaes(loops: Sequence[ClosedLoop]) -> list[list[float]]:
    """IAE of every loop after a step of the setpoint, and after one of the load: [loop][upset]."""
    rows = zip(loops, traces(loops, UPSETS), strict=True)
    return [[iae_of(trace, loop.gains.ki) for trace in row] for loop, row in rows]


def mean_ratio(now: Sequence[float], then: Sequence[float]) -> float:
    """Mean of the ratios of IAE; 0 where a loop never comes to rest."""
    if not all(map(math.isfinite, (*now, *then))) or not all(then):
        return 0.0
    return sum(a / b for a, b in zip(now, then, strict=True)) / len(now)


def storable(value: float) -> float:
    """A number that JSON can hold: -1 stands for infinite, "unstable" or "never comes to rest"."""
    return value if math.isfinite(value) else -1.0
