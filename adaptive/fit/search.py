"""Where to start: a coarse search over lag, dead time and load times.

All lasting failures of output-error fits are local optima, so the starts cover the plane of (T, theta) on a grid, the
integrating process at its edge included; at every node the gain and the other linear unknowns are solved for, and load
steps are added one by one where they take away most of the misfit. The best nodes become starts of the refinement.
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain, product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from retuner.adaptive.fit.dynamics import Dynamics, SamplingInstants
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import LONGEST_LAG, Record, near
from retuner.adaptive.fit.refine import LEAST_TIME, Fit, bounds, refine
from retuner.adaptive.fit.structure import INVERSE, LAG, SECOND, SIZE, SLOPE, THETA, THIRD, dynamics_at, leads
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass, replace

LAG_NODES = 9
THETA_NODES = 9
LOAD_NODES = 48  # Candidates for lag, dead time and the time of a load step
SOON = (0.2, 0.45)  # further candidates for that time before the first of them, as shares of it
MOST_ROWS = 400  # the search looks at no more samples than this; the refinement uses all
LAG_RANGE = (1.5, 3.0)  # lags searched: from this many sampling intervals to this many record lengths
THETA_RANGE = (0.3, 0.3)  # dead times searched: from this many sampling intervals to this share of the record
LOAD_GAIN = 10.0  # A load step must lower the misfit (in units of the noise) by this and more to be a candidate at all


def starts(misfit: Misfit, most_loads: int, count: int) -> dict[int, list[FloatArray]]:
    """The best `count` starting points p for each number of load steps from 0 to most_loads.

    misfit : its type says which structure: first order, or integrating.
    """
    grid = SearchGrid.of(misfit)
    engine = compiled()
    if engine is None or misfit.ramp:  # the engine's search knows no ramp
        nodes = _searched(grid, misfit, most_loads)
    else:
        parts = grid.parts(misfit.record) if misfit.record.barred_s else [grid]
        nodes = chain.from_iterable(engine.searched(part, misfit.sigma, most_loads) for part in parts)
    ranked: dict[int, list[Node]] = {m: [] for m in range(most_loads + 1)}
    for node in nodes:
        ranked[len(node.loads)].append(node)
    return {
        m: [_point(node, misfit.sign) for node in sorted(found, key=lambda n: n.deviance)[:count]]
        for m, found in ranked.items()
    }


@dataclass(frozen=True, slots=True)
class SearchGrid:
    """What is searched: the record thinned, and the nodes. lags_s : infinite for an integrating process.

    at_s : candidates for the time of a load step.
    """

    clock: SamplingInstants
    co: FloatArray
    pv: FloatArray
    lags_s: FloatArray
    thetas_s: FloatArray
    at_s: FloatArray

    @classmethod
    def of(cls, misfit: Misfit) -> "SearchGrid":
        """The grid of a record."""
        t, u, pv = _thinned(misfit)
        record = misfit.record
        lags = np.geomspace(LAG_RANGE[0] * record.sample_time_s, LAG_RANGE[1] * record.span_s, LAG_NODES)
        if misfit.type == ProcessType.INTEGRATING:
            lags = np.array([math.inf])
        longest = max(THETA_RANGE[1] * record.span_s, 2 * record.sample_time_s)
        thetas = np.geomspace(THETA_RANGE[0] * record.sample_time_s, longest, THETA_NODES)
        return cls(SamplingInstants.of(t), u, pv, lags, thetas, instants(record.span_s, LOAD_NODES))

    def barred(self, record: Record, lag_s: float, theta_s: float) -> npt.NDArray[np.bool_]:
        """Which candidates for a load step stand at a setpoint change that is barred to them."""
        counted = min(lag_s, LONGEST_LAG * record.span_s) if math.isfinite(lag_s) else 0.0  # none for an integrator
        return near(self.at_s, record.barred_s, counted, theta_s, record.sample_time_s)

    def parts(self, record: Record) -> Iterator["SearchGrid"]:
        """The nodes of each lag for which the same candidates are barred, without these."""
        for lag in self.lags_s.tolist():
            same: dict[bytes, list[float]] = {}
            for theta in self.thetas_s.tolist():
                same.setdefault(self.barred(record, lag, theta).tobytes(), []).append(theta)
            for mask, thetas in same.items():
                free = self.at_s[~np.frombuffer(mask, dtype=np.bool_)]
                yield replace(self, lags_s=np.array([lag]), thetas_s=np.array(thetas), at_s=free)


@lru_cache(maxsize=16)  # each move of each fit of a record asks
def instants(span_s: float, count: int) -> FloatArray:
    """Where a load step is looked for: evenly along the record, and closer where it begins.

    A record is often cut where something happens, and a step that came before the first even one is no start either.
    """
    even = np.linspace(0.0, span_s, count + 2)[1:-1]
    found = np.concatenate([even[0] * np.array(SOON), even])
    found.flags.writeable = False
    return found


class Node(NamedTuple):
    """A node solved: misfit, slope gain, lag, dead time, and times of the load steps in order."""

    deviance: float
    slope: float
    lag_s: float
    theta_s: float
    loads: list[float]


def load_times(misfit: Misfit, x: FloatArray, most: int) -> list[float]:
    """Times of at most so many load steps that explain best what a known process leaves, ascending.

    x : parameters of the process. misfit : with the start of the record, and no load of its own.
    """
    bare, record = replace(misfit, loads=0, corners=0, rounded=False, harmonics=0), misfit.record
    dynamics, at_s = dynamics_at(misfit.type, x), instants(record.span_s, LOAD_NODES)
    steps = bare.lagged(x, dynamics.step(record.t_s[:, None] - at_s[None, :]))
    steps = steps / np.maximum(np.max(np.abs(steps), axis=0), 1e-300)
    columns, count = bare.columns(x)
    rest, none = bare.rows(columns, count), np.zeros(count)
    free = np.concatenate([bare.whitened(steps), np.zeros((count, len(at_s)))])
    pv, moved = (np.concatenate([bare.whitened(values), none]) for values in (record.pv, bare.moved(x)))
    return _node(pv, moved, rest, free, at_s, misfit.sigma, most)[-1][2]


def _point(node: Node, sign: int) -> FloatArray:
    signed = max(node.slope * sign, 1e-3 * abs(node.slope) + 1e-300)  # a wrong sign starts near zero
    lag = [math.log(node.lag_s)] if math.isfinite(node.lag_s) else []
    return np.array([math.log(signed), math.log(node.theta_s), *lag, *node.loads])


def _searched(grid: SearchGrid, misfit: Misfit, most_loads: int) -> Iterator[Node]:
    """Every node with 0, 1, ... load steps, none at a setpoint change that is barred to them."""
    t, record = grid.clock.t_s, misfit.record
    for lag in grid.lags_s.tolist():
        dynamics = Dynamics(0.0, 1.0 / lag)
        steps = dynamics.step(t[:, None] - grid.at_s[None, :])
        steps /= np.maximum(np.max(np.abs(steps), axis=0), 1e-300)
        start = dynamics.step(t) / max(float(dynamics.step(t)[-1]), 1e-300)
        drift = [(t / record.span_s) ** (1 if misfit.type in LAG else 2)] if misfit.ramp else []
        rest = np.stack([np.ones_like(t), start, *drift], axis=1)
        for theta in grid.thetas_s.tolist():
            x = dynamics.held(grid.clock, grid.co, theta)
            free = steps * ~grid.barred(record, lag, theta)
            for deviance, slope, loads in _node(grid.pv, x, rest, free, grid.at_s, misfit.sigma, most_loads):
                yield Node(deviance, slope, lag, theta, loads)


def _thinned(misfit: Misfit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """t, co, pv of at most MOST_ROWS samples; co averaged over what is left out."""
    record = misfit.record
    u = record.co if misfit.co is None else misfit.co
    n = -(-len(u) // MOST_ROWS)
    if n == 1:
        return record.t_s, np.ascontiguousarray(u), record.pv
    first = np.arange(0, len(u), n)
    held = np.diff(record.t_s, append=2 * record.t_s[-1] - record.t_s[-2])
    averaged = np.add.reduceat(u * held, first) / np.add.reduceat(held, first)
    return record.t_s[first], np.asarray(averaged, dtype=np.float64), np.ascontiguousarray(record.pv[first])


def _node(
    pv: FloatArray, x: FloatArray, rest: FloatArray, steps: FloatArray, at: FloatArray, sigma: float, most: int
) -> list[tuple[float, float, list[float]]]:
    """Misfit, slope gain and load times at one node, with 0, 1, ... load steps."""
    chosen: list[int] = []
    found = []
    scale = max(float(np.max(np.abs(x))), 1e-300)
    while True:
        columns = np.concatenate([x[:, None] / scale, rest, steps[:, chosen]], axis=1)
        q, triangle = np.linalg.qr(columns)
        remainder = pv - q @ (q.T @ pv)
        c = np.linalg.lstsq(triangle, q.T @ pv, rcond=1e-12)[0]
        found.append((float(remainder @ remainder), float(c[0]) / scale, sorted(float(at[j]) for j in chosen)))
        if len(chosen) == most:
            return found
        free = steps - q @ (q.T @ steps)
        size = np.einsum("ij,ij->j", free, free)
        taken = np.where(size > 1e-9 * len(x), (remainder @ free) ** 2 / np.maximum(size, 1e-300), 0.0)
        best = int(np.argmax(taken))
        if taken[best] < LOAD_GAIN * sigma**2:
            return found
        chosen.append(best)


# Starts for the bigger structure from the optimum of the smaller one, so that its cost is never the larger of the two.
#
# Splits the dead time between theta and the second lag, and lets an integrator become a long lag. All lasting failures
# of the estimation study were local optima of the bigger structure, not statistics.


SHARES = (0.3, 0.6, 0.95)  # shares of the dead time that become the second lag
SLOW_LAGS, LEADS = (4.0, 15.0), (0.3, 0.6, 1.5)  # a slow lag over the one found, and a lead over the slow lag
ZERO_STARTS = 2  # starts of a zero that are refined
INVERSE_SHARES = (0.3, 0.7)  # shares of the dead time that become an inverse response
THIRD_SHARES = (0.5, 0.9)  # shares of the dead time that become a third lag
SWINGING_THIRD = 0.5  # c2 over T of a pair of poles (zeta 0.7) that takes the place of a dead time beside a long lag
SWING = (0.25, 1.0)  # c2 over T of equal lags and of a process that swings (zeta 0.5)
INTEGRATOR_LAG_RECORDS = 30.0  # an integrator as a lag: this many record lengths
WORSE = 1.001  # the bigger structure's deviance may exceed the smaller one's by this factor (rounding, its own prior)


def with_second_lag(smaller: Fit, type_: ProcessType, others: list[Fit], count: int = 2) -> Fit:
    """The structure with a second lag, refined from splits of the smaller one's optimum and from `others`.

    smaller : optimum of the structure without it, same record and loads. others : optima of other structures whose
    second lag is a start (integrating with lag for second order). count : refinements.
    """
    misfit = replace(smaller.misfit, type=type_)
    nested = _insert(smaller, type_, smaller.x, LEAST_TIME * 2 * misfit.record.sample_time_s)
    points = [nested, *_splits(smaller, type_), *(long_lag(o, type_) for o in others)]
    order = np.argsort(misfit.costs(points), kind="stable")[:count]
    found = min((refine(misfit, points[i]) for i in order), key=lambda f: f.deviance)
    if found.deviance > smaller.deviance * WORSE:
        found = min(found, refine(misfit, nested), key=lambda f: f.deviance)
    return found


def with_one_more(smaller: Fit, type_: ProcessType) -> Fit:
    """A structure of five numbers, a zero or a third lag in it, refined from what stands for these in a smaller one.

    smaller : optimum of the structure without it, with at least one lag; of second order but for a lead.
    """
    misfit = replace(smaller.misfit, type=type_)
    if type_ in THIRD:  # also a pair of poles that swings in the place of dead time and second lag, behind the long one
        points = [*_out_of_dead_time(smaller, THIRD_SHARES, THIRD[type_]), behind_a_lag(smaller, misfit)]
        fit = refine(misfit, points[int(np.argmin(misfit.costs(points)))])
        # the shortest of three real lags becomes the third, so that records of one process say the same
        x = fit.x
        total, c2, third = (math.exp(x[place[type_]]) for place in (LAG, SECOND, THIRD))
        root = 1 - 4 * c2 / total
        if root < 0:
            return fit
        long = total * (1 + math.sqrt(root)) / 2
        short = total - long
        if third <= short:
            return fit
        pair, p = long + third, fit.p.copy()
        p[SLOPE] += math.log(total / pair)
        p[LAG[type_]], p[SECOND[type_]], p[THIRD[type_]] = (math.log(v) for v in (pair, long * third / pair, short))
        return refine(fit.misfit, np.clip(p, *bounds(fit.misfit)))
    points = _leading(smaller) if leads(type_) else _out_of_dead_time(smaller, INVERSE_SHARES, INVERSE[type_])
    order = np.argsort(misfit.costs(points), kind="stable")[:ZERO_STARTS]
    return min((refine(misfit, points[i]) for i in order), key=lambda f: f.deviance)


def _leading(smaller: Fit) -> list[FloatArray]:
    """Starts p of a lead: a slow lag and its lead beside the lag that was found, or a fast one in the dead time."""
    type_, (slope, theta) = smaller.misfit.type, np.exp(smaller.x[:2])
    lag, points = math.exp(smaller.x[LAG[type_]]), []
    times = [(lag, slow * lag, lead * slow * lag, theta) for slow, lead in product(SLOW_LAGS, LEADS)]
    for fast, slow, lead, dead in [*times, *((theta / 2, lag, lead * lag, theta / 2) for lead in LEADS[:2])]:
        total, same = fast + slow, slow / lead if fast == lag else 1.0  # slope as before at first, or gain
        x = np.log([slope * lag * same / total, dead, total, fast * slow / total, lead])
        points.append(np.concatenate([x, smaller.p[SIZE[type_] :]]))
    return points


def _out_of_dead_time(smaller: Fit, shares: Sequence[float], place: int) -> list[FloatArray]:
    """Starts p of a structure with one time more, at that place of x: none of the dead time, or a share of it."""
    d, loads, theta = SIZE[smaller.misfit.type], smaller.misfit.loads, math.exp(smaller.x[THETA])
    least, points = LEAST_TIME * 2 * smaller.misfit.record.sample_time_s, []
    for share in (0.0, *shares):
        x, time_s = smaller.x.copy(), max(theta * share, least)
        x[THETA] = math.log(theta * (1 - share))
        times = np.maximum(smaller.p[d : d + loads] - time_s, 0.0)
        points.append(np.concatenate([x[:place], [math.log(time_s)], times, smaller.p[d + loads :]]))
    return points


def behind_a_lag(smaller: Fit, misfit: Misfit) -> FloatArray:
    """p of a long lag and a pair of poles that is as late as dead time and second lag together.

    smaller : of first or second order. misfit : of third order.
    """
    d, loads, type_ = SIZE[smaller.misfit.type], smaller.misfit.loads, smaller.misfit.type
    theta, total = math.exp(smaller.x[THETA]), math.exp(smaller.x[LAG[type_]])
    c2 = math.exp(smaller.x[SECOND[type_]]) if type_ in SECOND else 0.0
    pair = min(c2 + theta * THIRD_SHARES[-1], total)
    gain = smaller.x[SLOPE] + math.log(total / pair)
    x = [gain, math.log(theta * (1 - THIRD_SHARES[-1])), *np.log([pair, SWINGING_THIRD * pair, total])]
    times = np.maximum(smaller.p[d : d + loads] - theta * THIRD_SHARES[-1], 0.0)
    low, high = bounds(misfit)
    return np.asarray(np.clip(np.concatenate([x, times, smaller.p[d + loads :]]), low, high), dtype=np.float64)


def _insert(smaller: Fit, type_: ProcessType, x: FloatArray, c2: float) -> FloatArray:
    """p of the bigger structure from x of the smaller one and a second lag.

    What comes through the lag comes later: a load step, whose time is free, must have come as much earlier. Without
    that, every split of the dead time but none at all looks bad beside a load.
    """
    size, loads = SIZE[smaller.misfit.type], smaller.misfit.loads
    times = np.maximum(smaller.p[size : size + loads] - c2, 0.0)
    return np.concatenate([x[: SECOND[type_]], [math.log(c2)], times, smaller.p[size + loads :]])


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
    lag = [math.log(INTEGRATOR_LAG_RECORDS * misfit.record.span_s)]
    second = [float(x[SECOND[misfit.type]])] if misfit.type in SECOND and type_ in SECOND else []
    return np.concatenate([x[: THETA + 1], lag, second, integrating.p[SIZE[misfit.type] :]])
