"""The models that a record still allows, by likelihood.

    axes     x +- s 2 sqrt(lambda_i) v_i      along the axes of the covariance, s <= 1 as far as the record believes
    valley   theta held at other values, everything else fitted anew: one way along the flattest of all valleys, the
             trade of dead time against lags, where the covariance at a boundary (theta -> 0) is nonsense
    rivals   other structures, or other loads, that explain the record nearly as well

Each comes with its excess, the rise of the deviance (or of the criterion) over the best. Gaussian samples of the
posterior did harm in the estimation study. The points are deterministic, so that replay decides alike.
"""

import math

import numpy as np

from retuner.adaptive.fit.misfit import ROUNDING_COST, Misfit
from retuner.adaptive.fit.refine import PINNED, Fit, Prior, bounds, pinned, refine
from retuner.adaptive.fit.search import long_lag
from retuner.adaptive.fit.structure import SECOND, SIZE, THETA, model_at
from retuner.adaptive.identification.candidate import Candidate, Priors
from retuner.adaptive.identification.usual_dead_time import unusual, usual
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass, replace

OUT = 2.0  # how many standard deviations out the points on the axes lie where the Gaussian is right
MOST_EXCESS = 6.0
"""A model whose deviance is larger by this is no longer believed (2.4 standard deviations of one parameter)."""
HALVINGS = 4  # A point that the record does not believe is taken back to 2^-4 of the way at the most
STRIDE = 1.6  # factor of theta from one point of the valley to the next
FIRST_SHARE = 0.2  # the first point up the valley has at least this share of theta + c2 as its dead time
MOST_STEPS = 6  # points of the valley in each direction
ONE = 1.5  # rise of the deviance at one standard deviation (1 by the derivative) up to which an axis is left as it is
WIDE = 0.15  # standard deviation of a logarithm up to which a derivative is believed
SHORTER, SHORTER_STEPS = 0.5, 5  # factor by which an axis is shortened where it rises more, so many times at the most
BOUND_ROOM = 0.5
"""Share of WIDE by which the end of a short step may lie outside the bounds: axes are never quite along a parameter."""
REACH_EVALUATIONS = 6  # evaluations of the misfit at one of its ends
SAME = 1e-3  # two optima of a structure whose logarithms differ by no more are one
VALLEY_EVALUATIONS = 15  # evaluations of the misfit at one point of the valley


@dataclass(frozen=True, slots=True)
class Plausible:
    """A model and how much less the record believes it than the best: excess >= 0 of the deviance."""

    model: ProcessModel
    excess: float


def plausible(found: list[Candidate], covariance: FloatArray, priors: Priors) -> tuple[Plausible, ...]:
    """Models round the winner of `found` (best first), the winner itself first."""
    fit = found[0].fit
    prior = priors.get(fit.misfit.type)
    at = _deviance(fit.misfit, fit.p, prior)
    points = [(fit.x, 0.0), *_axes(fit, covariance, prior, at)]
    own = [Plausible(model_at(fit.misfit.type, x, fit.misfit.sign), max(e, 0.0)) for x, e in points]
    # the other candidates that came close, each optimum once: a model found from two starts is not twice as likely
    best, kept = found[0], found[:1]
    for c in found[1:]:
        kind = (c.fit.misfit.type, c.fit.misfit.sign)
        alike = [k.fit.x for k in kept if (k.fit.misfit.type, k.fit.misfit.sign) == kind]
        if not any(np.max(np.abs(c.fit.x - x)) < SAME for x in alike):
            kept.append(c)
    others = kept[1:]
    n, size = len(best.fit.misfit.record.pv), SIZE[best.fit.misfit.type]
    rounding = 0 if best.fit.misfit.rounded else ROUNDING_COST
    more = [  # those of a larger structure are as likely as what they leave
        (max(SIZE[c.fit.misfit.type] - size, 0) + rounding * int(c.fit.misfit.rounded)) * math.log(n) for c in others
    ]
    excess = [max(c.criterion - best.criterion - price, 0.0) for c, price in zip(others, more, strict=True)]
    rivals = [Plausible(c.model, e) for c, e in zip(others, excess, strict=True) if e < MOST_EXCESS]
    return (*own, *_valley(_opened(fit, priors), priors, at), *rivals)


def _axes(fit: Fit, covariance: FloatArray, prior: Prior | None, at: float) -> list[tuple[FloatArray, float]]:
    """Steps both ways along every axis of the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    jacobian = fit.misfit.jacobian(fit.at)
    limits = bounds(fit.misfit)
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        for side in (1.0, -1.0):
            step = _with_loads(jacobian, side * OUT * math.sqrt(max(float(value), 0.0)) * vector)
            for halving in range(HALVINGS + 1):
                p = np.clip(fit.p + step / 2**halving, *limits)
                excess = _deviance(fit.misfit, p, prior) - at
                if excess <= MOST_EXCESS:
                    found.append((p[: SIZE[fit.misfit.type]], excess))
                    break
    return found


def within_reach(fit: Fit, covariance: FloatArray, prior: Prior | None, inflation: float) -> FloatArray:
    """The covariance with no axis longer than what the record believes: one standard deviation costs one.

    Where three lags are nearly equal, or the dead time nearly nothing, a derivative says that all goes. It does not:
    the misfit rises with the second power of what the derivative leaves free. inflation : as for the residuals.

    A side that leads out of what is fitted at all is not asked: a dead time of nothing cannot be less, and may be more.
    To count it as a wall made such a dead time "known to 15 %", and every later record was held to it.
    """
    values, vectors = np.linalg.eigh(covariance)
    at = _deviance(fit.misfit, fit.p, prior)
    for axis, vector in enumerate(vectors.T):
        std = math.sqrt(max(float(values[axis]), 0.0))
        if std > WIDE:
            open_ = [side * std * vector for side in (1.0, -1.0) if _within_bounds(fit, side * WIDE * vector)]
            share = min((_reach(fit, step, prior, at + ONE * inflation**2) for step in open_), default=1.0)
            values[axis] = max(share * std, WIDE) ** 2
    return np.asarray(vectors * values @ vectors.T, dtype=np.float64)


def _within_bounds(fit: Fit, step: FloatArray) -> bool:
    """Whether a step of x stays within what is fitted."""
    low, high = bounds(fit.misfit)
    d = len(step)
    there = fit.x + step
    room = BOUND_ROOM * WIDE
    return bool(np.all(there >= low[:d] - room) and np.all(there <= high[:d] + room))


def _reach(fit: Fit, step: FloatArray, prior: Prior | None, most: float) -> float:
    """The share of a step that costs no more, everything else fitted anew."""
    d, size = len(step), float(np.linalg.norm(step))
    row, limits, share = PINNED * step[None, :] / size, bounds(fit.misfit), 1.0
    root = row if prior is None else np.concatenate([prior.root, row])
    for _ in range(SHORTER_STEPS):
        start = np.clip(fit.p + np.pad(share * step, (0, len(fit.p) - d)), *limits)
        held = row @ (fit.x + share * step)
        target = held if prior is None else np.concatenate([prior.target, held])
        found = refine(fit.misfit, start, Prior(root, target), REACH_EVALUATIONS)
        if _deviance(fit.misfit, found.p, prior) <= most:
            break
        share *= SHORTER
    return share


def _opened(fit: Fit, priors: Priors) -> Fit:
    """An integrating process as one with a lag that is long: with more dead time, the lag may turn out short."""
    misfit = fit.misfit
    type_ = {ProcessType.INTEGRATING: ProcessType.FOPDT, ProcessType.INTEGRATING_LAG: ProcessType.SOPDT}.get(
        misfit.type
    )
    if type_ is None:
        return fit
    return refine(replace(misfit, type=type_), long_lag(fit, type_), priors.get(type_), VALLEY_EVALUATIONS)


def _valley(fit: Fit, priors: Priors, at: float) -> list[Plausible]:
    """Shorter and longer dead times with everything else fitted anew, as far as the record believes."""
    type_, sign = fit.misfit.type, fit.misfit.sign
    d, prior = SIZE[type_], priors.get(type_)
    theta = math.exp(fit.p[THETA])
    whole = theta + (math.exp(fit.p[SECOND[fit.misfit.type]]) if fit.misfit.type in SECOND else 0.0)
    low, high = bounds(fit.misfit)
    found: list[Plausible] = []
    for factor, first in ((STRIDE, max(STRIDE * theta, FIRST_SHARE * whole)), (1 / STRIDE, theta / STRIDE)):
        p = fit.p
        for step in range(MOST_STEPS):
            value = first * factor**step
            if not low[THETA] < math.log(value) < high[THETA] or value < FIRST_SHARE * whole / STRIDE:
                break
            start = p.copy()
            start[THETA] = math.log(value)
            held = pinned(d, THETA, math.log(value), usual(type_, start) if prior is None else prior)
            p = refine(fit.misfit, start, held, VALLEY_EVALUATIONS).p
            excess = _deviance(fit.misfit, p, prior) - at
            if excess > MOST_EXCESS:
                break
            found.append(Plausible(model_at(type_, p[:d], sign), max(excess, 0.0)))
    return found


def _with_loads(jacobian: FloatArray, step: FloatArray) -> FloatArray:
    """A step of x, with the step of the load times that keeps the misfit smallest."""
    d = len(step)
    loads = jacobian[:, d:]
    if not loads.shape[1]:
        return step
    follow = np.linalg.lstsq(loads, -jacobian[:, :d] @ step, rcond=None)[0]
    return np.concatenate([step, follow])


def _deviance(misfit: Misfit, p: FloatArray, prior: Prior | None) -> float:
    x = p[: SIZE[misfit.type]]
    known = float(np.sum(prior.residuals(x) ** 2)) if prior is not None else unusual(misfit.type, x) ** 2
    return misfit.costs([p])[0] + known
