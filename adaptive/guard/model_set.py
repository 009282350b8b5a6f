"""The models that the records still allow, by likelihood, and farther apart the older they are.

    x_i = x + (p_i - p_0) sqrt(1 + s^2 q / |p_i - p_0|^2),     s = 2

p_0 is the best model of the last record and p_i the others that it allows (plausible.py: each at about s standard
deviations, or where the likelihood ends), x the region's model now, q the variance that time has added since. Where the
record allowed no point of the leading structure (a restart from an old memory), the corners of the covariance stand in,
cut off where a parameter has changed by a factor of two: beyond that a Gaussian at a boundary has no meaning.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.fit.structure import model_at, parameters_of
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.identification.estimate import MOST_LOG_STEP, LogModel, spread
from retuner.adaptive.identification.plausible import OUT, Plausible
from retuner.adaptive.signals.sample import FloatArray


def allowed(
    log: LogModel, around: Sequence[Plausible], extra_variance: float, settings: GuardSettings
) -> tuple[Plausible, ...]:
    """The models to prove a change on, the region's own first.

    log : the region's model now, with a covariance that has grown with time.
    around : what the last record allowed, best first; may be empty.
    extra_variance : variance of the log-parameters that time has added since that record.

    Raises ValueError: extra_variance is negative or not finite.
    """
    if not 0 <= extra_variance < math.inf:
        raise ValueError(f"extra_variance = {extra_variance} must be a finite number, 0 or more")
    best = Plausible(log.model(), 0.0)
    believed = [p for p in around[1:] if p.excess <= settings.believed]
    same = [p for p in believed if p.model.type == log.type] if around and around[0].model.type == log.type else []
    others = [p for p in believed if p not in same]
    if not same:
        return (*spread(log, settings.corner_std), *others)
    start = parameters_of(around[0].model)
    moved = [(_apart(parameters_of(p.model) - start, extra_variance), p.excess) for p in same]
    own = [Plausible(model_at(log.type, log.x + step, log.sign), excess) for step, excess in moved]
    return (best, *own, *others)


def _apart(step: FloatArray, extra_variance: float) -> FloatArray:
    """A deviation grown by age; what age adds ends at MOST_LOG_STEP in any parameter."""
    size = float(np.max(np.abs(step)))
    if size == 0.0:
        return step
    grown = math.sqrt(1.0 + OUT**2 * extra_variance / float(step @ step))
    return step * max(1.0, min(grown, MOST_LOG_STEP / size))
