"""Downhill in damped steps (Levenberg 1944, Marquardt 1963), for misfits that are more than a sum of squares."""

import math
from collections.abc import Callable
from typing import TypeVar

from retuner.adaptive.signals.sample import FloatArray

DAMPING, LESS, MORE = 1e-2, 0.2, 5.0
"""First lambda, and factors on it after a step that helped, and one that did not (Marquardt 1963)."""

Slopes = TypeVar("Slopes")


def descended(
    start: tuple[FloatArray, float],
    slopes_at: Callable[[FloatArray], Slopes | None],
    stepped: Callable[[FloatArray, Slopes, float], FloatArray],
    misfit: Callable[[FloatArray], float],
    limits: tuple[int, int, float],
) -> tuple[FloatArray, float, Slopes] | None:
    """Where it ends, the misfit there and its slopes; None where a place on the way has none.

    Parameters
    ----------
    start : where it begins, and the misfit there. stepped : from a place with its slopes and lambda to the next one.
    limits : most steps; tries of one step, each shorter than the one before; a fall of the misfit that is the end.
    """
    (x, cost), (steps, tries, enough), damping = start, limits, DAMPING
    slopes = slopes_at(x)
    for _ in range(steps):
        if slopes is None:
            return None
        there, ahead = x, math.inf
        for _ in range(tries):
            there = stepped(x, slopes, damping)
            ahead = misfit(there)
            if ahead < cost:
                break
            damping *= MORE
        if not ahead < cost:
            break
        fell, x, cost, damping = cost - ahead, there, ahead, damping * LESS
        slopes = slopes_at(x)
        if fell < enough:
            break
    return None if slopes is None else (x, cost, slopes)
