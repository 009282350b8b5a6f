"""Which shapes the curves have, weighed by what the stretches say together, and how well they are known in the end.

Every parameter is constant, a line or bent, and so is the installed characteristic of co: the shapes are weighed by
their evidence in Laplace's approximation (MacKay 1992, section 2) on the parabola of agreement.py,

    ln E(S) = 1/2 right_S' normal_S^-1 right_S - 1/2 ln det normal_S - 2 nats for each step from constant to bent

The likeliest are chosen. A band of those alone would be that of somebody who knows the shapes (a line through what is
bent is sure, and wrong at both ends and the middle): so it is that of all of them, each with its weight (Hoeting et al.
1999, equation 4).
"""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from retuner.adaptive.schedule_design.agreement import CurvesAgreement
from retuner.adaptive.schedule_design.joint import CurveForm
from retuner.adaptive.schedule_design.record_stretches import CurveShape
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

SHAPES = (CurveShape.CONSTANT, CurveShape.LINE, CurveShape.BENT)
SIMPLER = 2.0  # Nats that a step from constant to line to bent must bring beyond its evidence


@dataclass(frozen=True, slots=True)
class Weighed:
    """shapes, felt : the likeliest, of the parameters and of the characteristic.

    covariance : of the rich form's z round those. evidence : ln E over that of a process that is the same everywhere.
    second : the likeliest over the second variable. second_evidence : ln E over the best without any of these.
    """

    shapes: tuple[CurveShape, ...]
    felt: CurveShape
    covariance: FloatArray
    evidence: float
    second: tuple[CurveShape, ...] = ()
    second_evidence: float = 0.0


def weighed(form: CurveForm, told: CurvesAgreement) -> Weighed:
    """form : every shape as rich as it may become."""
    n = len(form.shapes)
    most = (*form.shapes, CurveShape.CONSTANT if form.felt is None else form.felt.shape, *form.second_shapes)
    ranked = _ranked(form, told, most, len(most))
    best = max(ranked, key=ranked.__getitem__)
    level = ranked[(CurveShape.CONSTANT,) * len(most)]
    # Round the likeliest shapes' coefficients, over all shapes with their weights
    centre = _solved(_kept(form, best), told)[0]
    total, weights = np.zeros_like(told.normal), 0.0
    for shapes, evidence in ranked.items():
        weight = math.exp(max(evidence - ranked[best], -700.0))
        if weight < LEAST_WEIGHT:
            continue
        z, covariance = _solved(_kept(form, shapes), told)
        total += weight * (covariance + np.outer(z - centre, z - centre))
        weights += weight
    covariance = total / weights
    without = _ranked(form, told, most, n + 1) if form.second_shapes else ranked
    return Weighed(
        best[:n], best[n], covariance, ranked[best] - level, best[n + 1 :], ranked[best] - max(without.values())
    )


FOLLOWED = 12.0  # nats below the best so far within which shapes are followed further: rarer ones weigh nothing


def _ranked(
    form: CurveForm, told: CurvesAgreement, most: tuple[CurveShape, ...], free: int
) -> dict[tuple[CurveShape, ...], float]:
    """ln E of the shapes that weigh anything, by a search from nothing and from everything, a step at a time.

    most : the richest. free : how many of the first may be other than constant.
    """
    allowed = tuple(shape if i < free else CurveShape.CONSTANT for i, shape in enumerate(most))
    ranked: dict[tuple[CurveShape, ...], float] = {}
    waiting = [(CurveShape.CONSTANT,) * len(most), allowed]
    top = -math.inf
    while waiting:
        for shapes in waiting:
            kept = _kept(form, shapes)
            sub, right = told.normal[np.ix_(kept, kept)], told.right[kept]
            gained = float(right @ np.linalg.solve(sub, right))
            ranked[shapes] = (
                0.5 * gained - 0.5 * float(np.linalg.slogdet(sub)[1]) - SIMPLER * sum(SHAPES.index(s) for s in shapes)
            )
            top = max(top, ranked[shapes])
        best = max(waiting, key=ranked.__getitem__)
        near = [s for s in waiting if ranked[s] >= top - FOLLOWED or s is best]
        fresh: set[tuple[CurveShape, ...]] = set()
        for shapes, i, step in product(near, range(len(most)), (-1, 1)):  # one of them a step simpler or richer
            place = SHAPES.index(shapes[i]) + step
            if 0 <= place < len(SHAPES) and SHAPES[place] <= allowed[i]:
                fresh.add((*shapes[:i], SHAPES[place], *shapes[i + 1 :]))
        waiting = sorted(fresh - ranked.keys())
    return ranked


def _kept(form: CurveForm, shapes: Sequence[CurveShape]) -> list[int]:
    n = len(form.shapes)
    places = [*form.places, form.felt_place, *form.second_places]
    sizes = [*map(int, shapes[:n]), *(int(shape) - 1 for shape in shapes[n:])]
    return [row for p, n in zip(places, sizes, strict=True) for row in range(p.start, p.start + n)]


LEAST_WEIGHT = 1e-4  # share of the likeliest shape's weight below which shapes say nothing


def _solved(kept: list[int], told: CurvesAgreement) -> tuple[FloatArray, FloatArray]:
    """z and covariance where only some coefficients are kept; zero for the others."""
    z, covariance = np.zeros_like(told.right), np.zeros_like(told.normal)
    inverse = np.linalg.inv(told.normal[np.ix_(kept, kept)])
    z[kept] = inverse @ told.right[kept]
    covariance[np.ix_(kept, kept)] = inverse
    return z, covariance
