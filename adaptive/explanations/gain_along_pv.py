"""Does a gain that changes along pv make the records likelier than a linear process, with a load that wanders on top?

    dx = h(pv) dco,  dz = dpv/h(pv)    h: r^(u - 1/2), or sqrt(r) above the middle and 1/sqrt(r) below; u: pv in its
                                       range, 0 to 1
    ln B = ln mean over h of Z(h)  -  ln Z(1),      Z(h) = mean over processes of the product over windows of L(h)

x takes co's place in the likelihood of wandering_load.py, or z that of pv, times dz/dpv (Box & Cox 1964). With x noise
is as large everywhere, with z loads go through the same gain as co: the one holds where noise makes most of what no
model foretells, the other where loads do. Only what co does from where it is counts, so no resting point has to be
known, and a self-regulating process and a tank are told by the same series. A linear loop has little to gain from h:
of 120 in the world of benchmarks/world none had a B over 0.7, of 80 that bend 22 over e (17 with x alone). One
process explains all windows and records: a range of pv that one window alone visits says nothing, two ranges do. The
mean over h is the price of its numbers.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.explanations.valve_odds import DEAD_TIMES, LAGS, LOADS, lags_of, log_mean, through_lag
from retuner.adaptive.explanations.wandering_load import TEMPER, Prepared, UnderLoads, under_loads
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import FloatArray, quantile
from retuner.schedule.late_dataclass import dataclass, replace

RATIOS = (0.2, 0.4, 2.5, 5.0)  # gain at the top of pv's range over that at the bottom, where it changes evenly
STEP_RATIOS = (1.0 / 3.0, 3.0)  # ratios where the gain changes in the middle of the range
TAILS = 0.01  # share of the samples at either end that the range of pv leaves out


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


def gain_along_pv(
    records: Sequence[Prepared], direction: int, weights: Sequence[float], fitted: ProcessModel | None = None
) -> GainAlongPv:
    """Weigh a gain that changes along pv against one that does not, over all records and windows of a loop.

    records : on one interval. direction : sign of the process gain. weights : power of each record's
    likelihood, by how far the setpoint moves it. fitted : a process, by a fit: what the lags here lack bends as well.
    """
    pv = np.concatenate([record.first + record.pv for record in records])
    low, high = (quantile(pv, share) for share in (TAILS, 1.0 - TAILS))
    each = []
    for record in records:
        along = np.clip((record.first + record.pv - low) / max(high - low, LEAST_RANGE), 0.0, 1.0) - 0.5
        slopes = [*(ratio**along for ratio in RATIOS), *(ratio ** (0.5 * np.sign(along)) for ratio in STEP_RATIOS)]
        steps = np.diff(record.co, prepend=record.co[0])
        inputs = np.array([record.co, *(np.cumsum(np.concatenate([h[:1], h[:-1]]) * steps) for h in slopes)])
        each.append([(record, inputs, 0.0), *(_straightened(record, slope) for slope in slopes[: len(RATIOS)])])
    behind: list[tuple[float, float, tuple[float, ...]]] = [(lag, 0.0, DEAD_TIMES) for lag in LAGS]
    if fitted is not None:
        lag, second, late = lags_of(fitted, records[0])
        behind.append((lag, second, (late,)))
    total = []
    for lag, second, dead in behind:
        told = []
        for side in zip(*each, strict=True):
            fits = [under_loads(one, through_lag(rows, second), lag, LOADS, dead) for one, rows, _ in side]
            more = sum(weight * jacobian for weight, (_, _, jacobian) in zip(weights, side, strict=True))
            joint = _of_one_gain(fits, weights, direction) + more
            told.append(joint.reshape(-1, len(side[0][1]), len(dead)))
        total.append(np.concatenate(told, axis=1))
    ratios = (*RATIOS, *STEP_RATIOS, *RATIOS)
    alone, *bent = (
        log_mean(np.concatenate([of_lag[:, i].ravel() for of_lag in total])) for i in range(1 + len(ratios))
    )
    return GainAlongPv(log_mean(np.array(bent)) - alone, ratios[int(np.argmax(bent))], low, high)


def _of_one_gain(fits: Sequence[UnderLoads], weights: Sequence[float], direction: int) -> FloatArray:
    """Tempered log-likelihood of records together at the gain that is best for all, shape (inputs, dead times).

    That of each record is tried, and their mean by what each says. A grid of gains was too coarse where next to no
    noise hides one: what bends had a gain nearer to it.
    """
    gains, precise = [], []
    for fit, weight in zip(fits, weights, strict=True):
        load = np.argmax(fit.tempered(fit.gain[..., None])[..., 0], axis=0)[None]
        gains.append(np.take_along_axis(fit.gain, load, axis=0)[0])
        known = weight * fit.information * fit.freedom[:, None, None] / fit.left
        precise.append(np.take_along_axis(known, load, axis=0)[0])
    middle = np.average(gains, axis=0, weights=precise)
    tried = direction * np.maximum(direction * np.stack([*gains, middle], axis=-1), 0.0)
    told = sum(
        weight * np.logaddexp.reduce(fit.tempered(tried), axis=0) for fit, weight in zip(fits, weights, strict=True)
    )
    return np.asarray(np.max(told, axis=-1) - sum(weights) * math.log(len(LOADS)))


def _straightened(record: Prepared, slope: FloatArray) -> tuple[Prepared, FloatArray, float]:
    """z of the head of this file, its input, and the tempered logarithm of dz/dpv: likelihoods count in var(z).

    What pv cannot show is larger in z where that rises faster: else a record at rest there was likelier for nothing.
    """
    order = np.argsort(record.pv)
    rise = 1.0 / slope[order]
    z = np.empty_like(record.pv)
    z[order] = np.cumsum(np.append(0.0, (rise[1:] + rise[:-1]) / 2 * np.diff(record.pv[order])))
    narrower = 0.5 * math.log(float(np.var(record.pv) / np.var(z)))
    hidden = record.resolution * math.sqrt(float(np.mean(slope**-2.0)))
    one = replace(record, pv=z - z[0], resolution=hidden)
    return one, record.co[None], (len(z) * narrower - float(np.sum(np.log(slope)))) / TEMPER


LEAST_RANGE = 1e-300  # A range of pv is at least this
