"""From a start to the optimum: Levenberg-Marquardt inside what the record can show at all.

    (J'J + lambda diag(J'J)) dp = -J'r        (Marquardt 1963), a parameter at its bound held there while it pushes out

Our own, because a fit has thousands of rows and at most a dozen unknowns: on the normal equations an iteration costs no
more than the Jacobian, where the general solver spends as much again on decompositions (and a quarter of a second on a
record is what a supervising thread can spare).
"""

import math
from functools import cached_property, lru_cache

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import Misfit, Projection
from retuner.adaptive.fit.structure import INVERSE, LAG, SECOND, SIZE, SLOPE, THETA, THIRD
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

GAIN_REACH = math.log(1e9)
"""k' is looked for within this distance round (range of pv) / (range of co, length of the record)."""
LEAST_TIME = 0.02  # shortest dead time and second lag, in sampling intervals
LEAST_LAG = 0.3  # shortest sum of lags, in sampling intervals
MOST_INVERSE = 0.25
"""Longest inverse response, in record lengths: beyond it the record shows a process of the other sign."""
LEAST_SECOND = 1.0
"""Shortest second lag of an inverse response, in sampling intervals: a kick within one fits to any dead time."""
MOST_THETA = 0.9  # longest dead time, in record lengths
MOST_LAG = 100.0  # longest sum of lags, in record lengths; longer ones are integrating
LOG_STRIDE = 1.0  # longest step in a logarithm
TIME_STRIDE = 0.1  # longest step of a load time, in record lengths
DAMPING = 1e-2  # first lambda
LESS, MORE = 0.2, 5.0  # factors on lambda after a step that helped, and one that did not
MOST_DAMPING = 1e8
LEAST_DECREASE = 1e-5  # A relative decrease below this, twice, is the end of a fit that is only compared with others
EXACT = 1e-10  # accuracy of fits whose estimate is used
SMALLEST_STEP = 1e-9  # smallest step, in units of the longest one


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of x already, as rows of unit noise: root x = target + noise; shapes (k, d) and (k,)."""

    root: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, mean: FloatArray, covariance: FloatArray) -> "Prior":
        """The prior of a Gaussian: root = L' with P^-1 = L L'."""
        root = np.linalg.cholesky(np.linalg.inv(covariance)).T
        return cls(root, root @ mean)

    @property
    def mean(self) -> FloatArray:
        """The most likely x."""
        return np.asarray(np.linalg.lstsq(self.root, self.target, rcond=None)[0], dtype=np.float64)

    def residuals(self, x: FloatArray) -> FloatArray:
        """How far x is from it, in standard deviations, shape (k,)."""
        return np.asarray(self.root @ x - self.target, dtype=np.float64)


PINNED = 1e4  # weight with which a parameter is held: a ten-thousandth of an e-fold costs one standard deviation


def pinned(size: int, place: int, value: float, prior: Prior | None) -> Prior:
    """A prior that holds one parameter at a value."""
    row = np.zeros((1, size))
    row[0, place] = PINNED
    target = np.array([PINNED * value])
    if prior is None:
        return Prior(row, target)
    return Prior(np.concatenate([prior.root, row]), np.concatenate([prior.target, target]))


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined optimum.

    p : the parameters. deviance : sum of squares there, in units of the misfit's sigma, prior included.
    explained : the fitted pv, shape (n,).
    """

    misfit: Misfit
    p: FloatArray
    deviance: float
    explained: FloatArray

    @cached_property
    def at(self) -> Projection:
        """The linear problem solved there."""
        return self.misfit.solve(self.p)

    @property
    def x(self) -> FloatArray:
        """The process parameters."""
        return self.p[: SIZE[self.misfit.type]]

    @property
    def load_times_s(self) -> tuple[float, ...]:
        """Times of the load steps in record time, ascending."""
        d = SIZE[self.misfit.type]
        return tuple(sorted(float(s) for s in self.p[d : d + self.misfit.loads]))

    @property
    def ramp_s(self) -> float:
        """Time from the first change of the load's slope to the last; 0 where there are no two."""
        d, misfit = SIZE[self.misfit.type], self.misfit
        corners = self.p[d + misfit.loads - misfit.corners : d + misfit.loads]
        return float(np.ptp(corners)) if len(corners) > 1 else 0.0


def bounds(misfit: Misfit) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest p."""
    record, loads = misfit.record, (misfit.loads, misfit.rounded, misfit.harmonics > 0)
    usual = math.log(record.pv_range / (record.co_range or 1.0) / record.span_s)
    return _bounds(misfit.type, misfit.size, *loads, record.sample_time_s, record.span_s, usual)


@lru_cache(maxsize=128)  # an identification asks for some twenty, a hundred and fifty times
def _bounds(
    type_: ProcessType, size: int, loads: int, rounded: bool, tone: bool, dt: float, span: float, usual: float
) -> tuple[FloatArray, FloatArray]:
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    low[SLOPE], high[SLOPE] = usual - GAIN_REACH, usual + GAIN_REACH
    low[THETA], high[THETA] = math.log(LEAST_TIME * dt), math.log(MOST_THETA * span)
    least_second = (LEAST_SECOND if type_ in INVERSE else LEAST_TIME) * dt
    for places, least, most in (
        (LAG, LEAST_LAG * dt, MOST_LAG * span),
        (SECOND, least_second, span),
        (INVERSE, LEAST_TIME * dt, MOST_INVERSE * span),
        (THIRD, LEAST_TIME * dt, span),
    ):
        if type_ in places:
            low[places[type_]], high[places[type_]] = math.log(least), math.log(most)
    d = SIZE[type_]
    low[d : d + loads], high[d : d + loads] = 0.0, span - dt
    if rounded:
        low[d + loads], high[d + loads] = math.log(LEAST_TIME * dt), math.log(span)
    if tone:
        low[-1], high[-1] = math.log(0.5 * math.pi / span), math.log(math.pi / dt)
    low.flags.writeable = high.flags.writeable = False
    return low, high


def refine(
    misfit: Misfit, start: FloatArray, prior: Prior | None = None, evaluations: int = 60, enough: float = LEAST_DECREASE
) -> Fit:
    """Minimise the misfit (and the prior's share) from a start, until a step lowers it by a share below `enough`."""
    low, high = bounds(misfit)
    stride = np.full(misfit.size, LOG_STRIDE)
    d = SIZE[misfit.type]
    stride[d : d + misfit.loads] = TIME_STRIDE * misfit.record.span_s
    engine = compiled()
    if engine is not None:
        return Fit(misfit, *engine.refined(misfit, start, (low, high, stride), prior, evaluations, enough))
    at = misfit.solve(np.clip(start, low, high))
    cost, damping, ends = _cost(at, d, prior), DAMPING, 0
    normal, gradient = _normal(misfit, at, d, prior)
    for _ in range(evaluations):
        step = _step(normal, gradient, damping, at.p, low, high)
        step *= min(1.0, 1.0 / max(float(np.max(np.abs(step) / stride)), 1e-300))
        ahead = misfit.solve(np.clip(at.p + step, low, high))
        cost_ahead = _cost(ahead, d, prior)
        if not cost_ahead < cost:
            damping *= MORE
            if damping > MOST_DAMPING or float(np.max(np.abs(step) / stride)) < SMALLEST_STEP:
                break
            continue
        ends = ends + 1 if cost - cost_ahead < enough * cost else 0
        at, cost, damping = ahead, cost_ahead, max(damping * LESS, 1e-9)
        if ends > 1:
            break
        normal, gradient = _normal(misfit, at, d, prior)
    return Fit(misfit, at.p, cost, at.explained)


def _cost(at: Projection, d: int, prior: Prior | None) -> float:
    return at.cost + (0.0 if prior is None else float(np.sum(prior.residuals(at.p[:d]) ** 2)))


def _normal(misfit: Misfit, at: Projection, d: int, prior: Prior | None) -> tuple[FloatArray, FloatArray]:
    jacobian = misfit.jacobian(at)
    normal, gradient = jacobian.T @ jacobian, jacobian.T @ at.r
    if prior is not None:
        normal[:d, :d] += prior.root.T @ prior.root
        gradient[:d] += prior.root.T @ prior.residuals(at.p[:d])
    return normal, gradient


def _step(
    normal: FloatArray, gradient: FloatArray, damping: float, p: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    free = ~(((p <= low) & (gradient > 0)) | ((p >= high) & (gradient < 0)))
    step = np.zeros(len(p))
    if not np.any(free):
        return step
    matrix = normal[np.ix_(free, free)]
    diagonal = np.maximum(np.diag(matrix), 1e-12 * max(float(np.max(np.diag(matrix))), 1e-300))
    step[free] = np.linalg.solve(matrix + damping * np.diag(diagonal), -gradient[free])
    return step
