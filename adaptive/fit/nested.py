"""Starts for the bigger structure from the optimum of the smaller one, so that its cost is never the larger of the two.

Splits the dead time between theta and the second lag, and lets an integrator become a long lag. All lasting failures of
the estimation study were local optima of the bigger structure, not statistics.
"""

import math
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.refine import LEAST_TIME, Fit, refine
from retuner.adaptive.fit.structure import LAG, SECOND, SIZE, THETA
from retuner.adaptive.process import ProcessType
from retuner.adaptive.sample import FloatArray

SHARES = (0.3, 0.6, 0.95)
"""Shares of the dead time that become the second lag."""
SWING = (0.25, 1.0)
"""c2 over T of equal lags and of a process that swings (zeta 0.5)."""
LONG = 30.0
"""An integrator as a lag: this many record lengths."""
WORSE = 1.001
"""The bigger structure's deviance may exceed the smaller one's by this factor (rounding, its own prior)."""


def with_second_lag(smaller: Fit, type_: ProcessType, others: list[Fit], count: int = 2) -> Fit:
    """The structure with a second lag, refined from splits of the smaller one's optimum and from `others`.

    smaller : optimum of the structure without it, same record and loads. others : optima of other structures whose
    second lag is a start (integrating with lag for second order). count : refinements.
    """
    misfit = replace(smaller.misfit, type=type_)
    nested = _insert(smaller, type_, smaller.x, LEAST_TIME * 2 * misfit.record.sample_time_s)
    points = [nested, *_splits(smaller, type_), *(long_lag(o, type_) for o in others)]
    ranked = sorted(points, key=lambda p: float(np.sum(misfit.residuals(p) ** 2)))
    found = min((refine(misfit, p) for p in ranked[:count]), key=lambda f: f.deviance)
    if found.deviance > smaller.deviance * WORSE:
        found = min(found, refine(misfit, nested), key=lambda f: f.deviance)
    return found


def _insert(smaller: Fit, type_: ProcessType, x: FloatArray, c2: float) -> FloatArray:
    """p of the bigger structure from x of the smaller one and a second lag."""
    rest = smaller.p[SIZE[smaller.misfit.type] :]
    return np.concatenate([x[: SECOND[type_]], [math.log(c2)], rest])


def _splits(smaller: Fit, type_: ProcessType) -> list[FloatArray]:
    """The dead time shared out, and pairs of equal lags or swinging poles."""
    theta = math.exp(smaller.x[THETA])
    found = []
    for share in SHARES:
        x = smaller.x.copy()
        x[THETA] = math.log(theta * (1 - share))
        found.append(_insert(smaller, type_, x, theta * share))
    if type_ in LAG:
        for ratio in SWING:
            x = smaller.x.copy()
            c2 = ratio * math.exp(x[LAG[type_]])
            x[THETA] = math.log(max(theta - c2 / 2, theta / 10))
            found.append(_insert(smaller, type_, x, c2))
    return found


def long_lag(integrating: Fit, type_: ProcessType) -> FloatArray:
    """p of the structure with a lag T in place of the integrator."""
    misfit = integrating.misfit
    x = integrating.x
    lag = [math.log(LONG * misfit.record.span_s)]
    second = [float(x[SECOND[misfit.type]])] if misfit.type in SECOND and type_ in SECOND else []
    return np.concatenate([x[: THETA + 1], lag, second, integrating.p[SIZE[misfit.type] :]])
