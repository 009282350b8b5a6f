"""Downhill in damped steps (Levenberg 1944, Marquardt 1963), for misfits that are more than a sum of squares."""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from retuner.adaptive.signals.sample import FloatArray

LESS, MORE = 0.2, 5.0  # factors on lambda after a step that helped, and one that did not (Marquardt 1963)


class Limits(NamedTuple):
    """steps : at the most. tries : of one step, each shorter than the one before. fall : of the misfit that is the end.
    damping, least : the first and the smallest lambda. in_all : tries of all steps together.
    """

    steps: int
    tries: int
    fall: float
    damping: float = 1e-2
    least: float = 0.0
    in_all: int = 1000


Slopes = TypeVar("Slopes")


def descended(
    start: tuple[FloatArray, float],
    slopes_at: Callable[[FloatArray], Slopes | None],
    stepped: Callable[[FloatArray, Slopes, float], FloatArray],
    misfit: Callable[[FloatArray], float],
    limits: Limits,
) -> tuple[FloatArray, float, Slopes] | None:
    """Where it ends, the misfit there and its slopes; None where a place on the way has none.

    start : where it begins, and the misfit there. stepped : from a place with its slopes and lambda to the next one.
    """
    (x, cost), damping = start, limits.damping
    slopes, left = slopes_at(x), limits.in_all
    for _ in range(limits.steps):
        if slopes is None:
            return None
        there, ahead = x, math.inf
        for _ in range(min(limits.tries, left)):
            there = stepped(x, slopes, damping)
            ahead, left = misfit(there), left - 1
            if ahead < cost:
                break
            damping *= MORE
        if not ahead < cost:
            break
        fell, x, cost, damping = cost - ahead, there, ahead, max(damping * LESS, limits.least)
        slopes = slopes_at(x)
        if fell < limits.fall:
            break
    return None if slopes is None else (x, cost, slopes)
