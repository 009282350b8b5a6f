"""Does a gain that changes along pv make the records likelier than a linear process, with a load that wanders on top?

    dx = h(pv) dco        h: r^(u - 1/2), or sqrt(r) above a pv and 1/sqrt(r) below it;  u: pv in its range, 0 to 1
    ln B = ln mean over h of Z(h)  -  ln Z(1),      Z(h) = mean over processes of the product over windows of L(h)

x takes co's place in the likelihood of wandering_load.py. Only what co does from where it is counts, so no resting
point has to be known, and a self-regulating process and a tank are told by the same series. A linear loop whose load
wanders has little to gain from h: of 88 in the world of benchmarks/world two had a B over e, the largest 11. One
process explains all windows and records: a range of pv that one window alone visits says nothing, two ranges do. The
mean over h is the price of its numbers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.explanations.process_grid import GAINS, INTEGRATING
from retuner.adaptive.explanations.valve_under_load import DEAD_TIMES, LAGS, LOADS, log_mean
from retuner.adaptive.explanations.wandering_load import Prepared, under_loads
from retuner.adaptive.signals.sample import FloatArray

RATIOS = (0.2, 0.4, 2.5, 5.0)
"""Gain at the top of pv's range over that at the bottom, where it changes evenly."""
STEP_RATIOS, STEPS_AT = (0.3, 3.0), (0.35, 0.5, 0.65)
"""The same where it changes at one pv; where in the range that is."""
TAILS = 0.01
"""Share of the samples at either end that the range of pv leaves out."""


@dataclass(frozen=True, slots=True)
class GainAlongPv:
    """What records say for a gain that changes along pv.

    log_bayes : tempered ln B. ratio : gain at the top of the range over that at the bottom, by the likeliest h.
    low, high : that range, pv units.
    """

    log_bayes: float
    ratio: float
    low: float
    high: float


def gain_along_pv(records: Sequence[Prepared], direction: int, weights: Sequence[float]) -> GainAlongPv:
    """Weigh a gain that changes along pv against one that does not, over all records and windows of a loop.

    records : on one interval. direction : sign of the process gain. weights : power of each record's
    likelihood, by how far the setpoint moves it.
    """
    pv = np.concatenate([record.first + record.pv for record in records])
    low, high = (float(x) for x in np.quantile(pv, [TAILS, 1.0 - TAILS]))
    curves = [*((ratio, None) for ratio in RATIOS), *((ratio, at) for ratio in STEP_RATIOS for at in STEPS_AT)]
    moved = sum(float(np.var(record.co)) for record in records)
    unit = direction * math.sqrt(sum(float(np.var(record.pv)) for record in records) / moved)
    total = np.zeros((1 + len(curves), len(LAGS), len(DEAD_TIMES), len(GAINS)))
    for record, weight in zip(records, weights, strict=True):
        along = np.clip((record.first + record.pv - low) / max(high - low, LEAST_RANGE), 0.0, 1.0)
        steps = np.diff(record.co, prepend=record.co[0])
        inputs = np.array([record.co, *(np.cumsum(_held(_slope(along, *curve)) * steps) for curve in curves)])
        for i, lag in enumerate(LAGS):
            gains = np.tile(unit * GAINS / (INTEGRATING if math.isinf(lag) else 1.0), (len(inputs), 1, 1))
            fits = under_loads(record, inputs, lag, LOADS, DEAD_TIMES, first_only=True)
            total[:, i] += weight * fits.mixed(gains)
    each = [log_mean(of_curve) for of_curve in total]
    likeliest = curves[int(np.argmax(each[1:]))][0]
    return GainAlongPv(log_mean(np.array(each[1:])) - each[0], likeliest, low, high)


LEAST_RANGE = 1e-300


def _slope(along: FloatArray, ratio: float, at: float | None) -> FloatArray:
    """h: of the head of this file, at places in the range of pv. at : where it changes; None for evenly."""
    share = along - 0.5 if at is None else np.where(along > at, 0.5, -0.5)
    return np.asarray(ratio**share, dtype=np.float64)


def _held(h: FloatArray) -> FloatArray:
    """The value of the sample before: co moves on the pv that was read."""
    return np.concatenate([h[:1], h[:-1]])
