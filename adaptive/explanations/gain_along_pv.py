"""Does a gain that changes along pv make the records likelier than a linear process, with a load that wanders on top?

    dx = h(pv) dco,  dz = dpv/h(pv)    h: r^(u - 1/2), or sqrt(r) above the middle and 1/sqrt(r) below; u: pv in its
                                       range, 0 to 1
    ln B = ln mean over h of Z(h)  -  ln Z(1),      Z(h) = mean over processes of the product over windows of L(h)

x takes co's place in the likelihood of wandering_load.py, or z that of pv, times dz/dpv (Box & Cox 1964). With x noise
is as large everywhere, with z loads go through the same gain as co: the one holds where noise makes most of what no
model foretells, the other where loads do. Only what co does from where it is counts, so no resting point has to be
known, and a self-regulating process and a tank are told by the same series. A linear loop has little to gain from h: of
120 in the world of benchmarks/world none had a B over 0.7, of 80 that bend 22 over e (17 with x alone). One process
explains all windows and records: a range of pv that one window alone visits says nothing, two ranges do. The mean over
h is the price of its numbers. Where the grid says that a record bends, both sides have the process that suits them best
(process_grid.py), and a load that jumps a few times: rows of one setpoint step that no process makes would be bent into
place. As many as pay make a bend at every step. Where z bends, its rival has loads alone that change along pv: x of
dco/h.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.explanations.process_grid import ENOUGH, likeliest, nearest, second_lags
from retuner.adaptive.explanations.valve_odds import (
    CLOSER,
    CLOSER_LOADS,
    COARSE,
    LAGS,
    LATEST,
    LOADS,
    NEAR_LOADS,
    NO_TONE,
    Given,
    Loads,
    log_mean,
)
from retuner.adaptive.explanations.wandering_load import TEMPER, Prepared, UnderLoads, under_loads
from retuner.adaptive.signals.sample import FloatArray, quantile
from retuner.schedule.late_dataclass import dataclass, replace

RATIOS = (0.2, 0.4, 2.5, 5.0)  # gain at the top of pv's range over that at the bottom, where it changes evenly
STEP_RATIOS = (1.0 / 3.0, 3.0)  # ratios where the gain changes in the middle of the range
FEW_JUMPS = 3  # of a load, beside either side
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

    def sentence(self) -> str:
        """That it changes, and what to do."""
        at, other = (self.high, self.low) if self.ratio > 1.0 else (self.low, self.high)
        times = max(self.ratio, 1.0 / self.ratio)
        return (
            f"the process gain changes along pv: about {times:.2g} times as large at {at:.4g} as at {other:.4g}; one "
            "set of gains is too fast at one end or too slow at the other. "
            "Schedule them: retuner schedule RECORD --by pv"
        )


def gain_along_pv(records: Sequence[Prepared], direction: int, weights: Sequence[float]) -> GainAlongPv:
    """Weigh a gain that changes along pv against one that does not, over all records and windows of a loop.

    records : on one interval. direction : sign of the process gain. weights : power of each record's
    likelihood, by how far the setpoint moves it.
    """
    pv = np.concatenate([record.first + record.pv for record in records])
    low, high = (quantile(pv, share) for share in (TAILS, 1.0 - TAILS))
    each, slopes = [], []
    for record in records:
        along = np.clip((record.first + record.pv - low) / max(high - low, LEAST_RANGE), 0.0, 1.0) - 0.5
        slopes.append([*(r**along for r in RATIOS), *(r ** (0.5 * np.sign(along)) for r in STEP_RATIOS)])
        inputs = np.array([record.co, *(_scaled(record.co, h) for h in slopes[-1])])
        straight = ((*_straightened(record, h), record.co[None]) for h in slopes[-1][: len(RATIOS)])
        each.append([(record, 0.0, inputs), *straight])
    sides = list(zip(*each, strict=True))
    total = []
    for lag in LAGS:
        told = (_told(side, weights, direction, (LOADS,) * len(side), lag, second_lags(lag), COARSE) for side in sides)
        total.append(np.concatenate(list(told), axis=1))
    ratios = (*RATIOS, *STEP_RATIOS, *RATIOS)
    by_grid = [log_mean(np.concatenate([of_lag[:, i].ravel() for of_lag in total])) for i in range(1 + len(ratios))]
    most, said = int(np.argmax(by_grid[1:])), log_mean(np.array(by_grid[1:])) - by_grid[0]
    if said > 0.0:
        of_h = [[(r, more, u[i : i + 1]) for r, more, u in side] for side in sides for i in range(len(side[0][2]))]
        alone, found = (_closely(of_h[i], weights, direction) for i in (0, 1 + most))
        if (k := most - len(RATIOS) - len(STEP_RATIOS)) >= 0:
            scaled = [
                (z, more, _scaled(u[0], 1.0 / h[k])[None])
                for (z, more, u), h in zip(of_h[1 + most], slopes, strict=True)
            ]
            alone = np.logaddexp(alone, _closely(scaled, weights, direction) - math.log(len(RATIOS))) - math.log(2.0)
        said = found - float(alone) - math.log(len(ratios))
    return GainAlongPv(said, ratios[most], low, high)


def _scaled(co: FloatArray, h: FloatArray) -> FloatArray:
    """What steps of co are, each times h where it is made, all together; shape (n,)."""
    return np.asarray(np.cumsum(np.append(h[:1], h[:-1]) * np.diff(co, prepend=co[0])))


Side = Sequence[tuple[Prepared, float, FloatArray]]
"""Each record as one h makes it, the logarithm of dz/dpv, and its inputs."""


def _closely(side: Side, weights: Sequence[float], direction: int) -> float:
    """Tempered log-likelihood of records behind the process that suits them best, where loads wander and may jump."""
    starts = []
    for lag in LAGS:
        of_lag = _told(side, weights, direction, (LOADS,) * len(side), lag, second_lags(lag), COARSE)[:, 0]
        starts.append(likeliest(of_lag, lag, second_lags(lag), COARSE))
    found = []
    for start in sorted(starts, key=lambda one: -one.told)[:CLOSER]:
        at = [under_loads(r, u, start.lag, NEAR_LOADS, (start.dead,), seconds=(start.second,)) for r, _, u in side]
        of_load = [np.max(fit.tempered(fit.gain[..., None]), axis=(1, 2, 3)) for fit in at]
        likely = [[NEAR_LOADS[i] for i in np.argsort(-one, kind="stable")[:CLOSER_LOADS]] for one in of_load]

        def told(
            lag: float, seconds: tuple[float, ...], dead: Sequence[float], loads: Sequence[Loads] = likely
        ) -> FloatArray:
            return _told(side, weights, direction, loads, lag, seconds, dead)[:, 0]

        found.append(nearest(told, start, ENOUGH / TEMPER, LATEST))
    more = 0.0
    for (record, _, rows), weight in zip(side, weights, strict=True):
        walks = [under_loads(record, rows, o.lag, NEAR_LOADS, (o.dead,), seconds=(o.second,)) for o in found]
        walk = max(float(np.max(fit.tempered(fit.gain[..., None]))) for fit in walks)
        jumping = Given(record, direction, NO_TONE).with_jumps(rows[0], found, FEW_JUMPS).told / TEMPER
        more += weight * float(np.logaddexp(0.0, jumping - walk))
    return max(one.told for one in found) + more


def _told(
    side: Side, weights: Sequence[float], direction: int, loads: Sequence[Loads],
    lag: float, seconds: tuple[float, ...], dead: Sequence[float],
) -> FloatArray:  # fmt: skip
    """Tempered log-likelihood of records together, shape (second lags, inputs, dead times). loads : of each record."""
    each = zip(side, loads, strict=True)
    fits = [under_loads(one, rows, lag, its, dead, seconds=seconds) for (one, _, rows), its in each]
    more = sum(weight * jacobian for weight, (_, jacobian, _) in zip(weights, side, strict=True))
    return (_of_one_gain(fits, weights, direction) + more).reshape(len(seconds), -1, len(dead))


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


def _straightened(record: Prepared, slope: FloatArray) -> tuple[Prepared, float]:
    """z of the head of this file, and the tempered logarithm of dz/dpv: likelihoods count in var(z).

    What pv cannot show is larger in z where that rises faster: else a record at rest there was likelier for nothing.
    """
    order = np.argsort(record.pv)
    rise = 1.0 / slope[order]
    z = np.empty_like(record.pv)
    z[order] = np.cumsum(np.append(0.0, (rise[1:] + rise[:-1]) / 2 * np.diff(record.pv[order])))
    narrower = 0.5 * math.log(float(np.var(record.pv) / np.var(z)))
    hidden = record.resolution * math.sqrt(float(np.mean(slope**-2.0)))
    one = replace(record, pv=z - z[0], resolution=hidden)
    return one, (len(z) * narrower - float(np.sum(np.log(slope)))) / TEMPER


LEAST_RANGE = 1e-300  # A range of pv is at least this
