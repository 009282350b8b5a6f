"""The compiled engine, called with our types: problems are packed into buffers, answers unpacked.

    numbers = (dt or 0, span, sigma, sign, type, loads, harmonics, ramp, rounded, corners, motion, starts, order of
               the filter, the starts, the filter, the weights of the priors)

What each function computes, and why, stands with the numpy engine's function of the same name.
"""

import math
from array import array
from collections.abc import Iterator, Sequence
from itertools import chain, product
from typing import Protocol

import numpy as np

from retuner.adaptive.fit import _engine
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import Prior
from retuner.adaptive.fit.search import Node, SearchGrid
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window

TYPES = (
    ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG,
    ProcessType.SOPDT_INVERSE, ProcessType.TOPDT, ProcessType.SOPDT_LEAD,
)  # fmt: skip
"""Structures in the order of their numbers."""
NOTHING = np.zeros(0)

Packed = tuple[FloatArray, FloatArray, FloatArray, "array[float]"]


def packed(misfit: Misfit) -> Packed:
    """t, pv, co and the numbers of a problem."""
    record = misfit.record
    weights, starts = misfit.prior_weights(), misfit.starts
    numbers = array("d", (
        record.clock.dt_s or 0.0, record.span_s, misfit.sigma, misfit.sign, TYPES.index(misfit.type), misfit.loads,
        misfit.harmonics, misfit.ramp, misfit.rounded, misfit.corners, record.motion_at_start > 0, len(starts),
        len(misfit.ar), *starts, *misfit.ar, *weights,
    ))  # fmt: skip
    return record.clock.t_s, record.pv, misfit.input, numbers


def refined(
    misfit: Misfit, start: FloatArray, limits: tuple[FloatArray, FloatArray, FloatArray], prior: Prior | None,
    evaluations: int, enough: float,
) -> tuple[FloatArray, float, FloatArray]:  # fmt: skip
    """The optimum p, the deviance there, and the pv that it explains. limits : lowest, highest and stride of p."""
    p, explained = np.array(start, dtype=np.float64), np.empty(len(misfit.record.pv))
    root, target = (NOTHING, NOTHING) if prior is None else (np.ascontiguousarray(prior.root), prior.target)
    deviance = _engine.refine(*packed(misfit), p, *limits, root, target, explained, evaluations, enough)
    return p, deviance, explained


def costs(misfit: Misfit, points: Sequence[FloatArray]) -> list[float]:
    """The sum of squares at every point."""
    out = np.empty(len(points))
    _engine.costs(*packed(misfit), np.concatenate(points), out)
    return out.tolist()


def projected(misfit: Misfit, p: FloatArray) -> tuple[FloatArray, ...]:
    """q, r, c, moved, columns and triangle of a Projection."""
    n = len(misfit.record.pv)
    k = misfit.priors + misfit.loads + 2 * misfit.harmonics + 1
    q, columns = np.empty((k, n + misfit.priors)), np.empty((k, n))
    r, c, moved, triangle = np.empty(n + misfit.priors + 1), np.empty(k), np.empty(n), np.empty((k, k))
    _engine.project(*packed(misfit), np.ascontiguousarray(p), q, r, c, moved, columns, triangle)
    return q.T, r, c, moved, columns.T, triangle


def jacobian(misfit: Misfit, p: FloatArray) -> FloatArray:
    """Derivative of the residuals by p, shape (len(residuals), len(p))."""
    out = np.empty((misfit.size, len(misfit.record.pv) + misfit.priors + 1))
    _engine.jacobian(*packed(misfit), np.ascontiguousarray(p), out)
    return out.T


def load_gains(misfit: Misfit, p: FloatArray, instants: FloatArray, *, corner: bool = False) -> FloatArray:
    """What one more load step, or change of the load's slope, at each instant would bring."""
    out = np.empty(len(instants))
    _engine.gains(*packed(misfit), np.ascontiguousarray(p), instants, corner, out)
    return out


def colour(r: FloatArray, least_std: float, most_order: int) -> tuple[float, tuple[float, ...]]:
    """Standard deviation and coefficients of a remainder's filter."""
    return _engine.colour(np.ascontiguousarray(r), least_std, most_order)


def searched(grid: SearchGrid, sigma: float, most_loads: int) -> Iterator[Node]:
    """Every node of the coarse search with 0, 1, ... load steps."""
    lags, thetas = grid.lags_s, grid.thetas_s
    most_loads = min(most_loads, len(grid.at_s))  # changes of the setpoint may bar all but a few places
    shape = (len(lags) * len(thetas), most_loads + 1)
    deviance, slope, chosen = np.empty(shape), np.empty(shape), np.zeros((shape[0], most_loads))
    span = float(grid.clock.t_s[-1] - grid.clock.t_s[0])
    numbers = array("d", (grid.clock.dt_s or 0.0, span, sigma, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    _engine.search(
        grid.clock.t_s, grid.pv, grid.co, numbers, lags, thetas, grid.at_s, most_loads, deviance, slope, chosen
    )
    at_s = grid.at_s[chosen.astype(int)]
    times = [np.sort(at_s[:, :m], axis=1).tolist() for m in range(most_loads + 1)]
    pairs = product(lags.tolist(), thetas.tolist())
    for (lag, theta), left, gains, *loads in zip(pairs, deviance.tolist(), slope.tolist(), *times, strict=True):
        for m in range(most_loads + 1):
            if math.isfinite(left[m]):
                yield Node(left[m], gains[m], lag, theta, loads[m])


Valve = tuple[float, float, float, float]  # family (0 Kano, 1 He), stick, jump and start


class ScanNodes(Protocol):
    """Dynamics of a scan over valves: lags and dead times, the rows looked at, what is projected out."""

    @property
    def lags_s(self) -> FloatArray:
        """Lags, s; every pair with a dead time is a node."""

    @property
    def seconds_s(self) -> FloatArray:
        """A second lag for each of them, s, 0 for none."""

    @property
    def thetas_s(self) -> FloatArray:
        """Dead times, s."""

    @property
    def rows(self) -> slice:
        """The rows of the record that the scan looks at."""

    @property
    def basis(self) -> FloatArray:
        """Orthonormal columns of bias, start and trend, shape (lags, 3, rows)."""

    @property
    def free(self) -> FloatArray:
        """pv without them, shape (lags, rows)."""


def valve_travel(valve: Valve, co: FloatArray) -> FloatArray:
    """Position of a sticking valve, counted from its first value."""
    out = np.empty(len(co))
    _engine.position(array("d", valve), np.ascontiguousarray(co), out)
    return out


def valves_scanned(record: Record, valves: Sequence[Valve], nodes: ScanNodes) -> tuple[FloatArray, FloatArray]:
    """Sum of squares and slope gain with every valve's position as input, shape (valves, nodes)."""
    numbers = array("d", (record.clock.dt_s or 0.0, record.span_s, record.noise_std, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    shape = (len(valves), len(nodes.lags_s) * len(nodes.thetas_s))
    left, gain = np.empty(shape), np.empty(shape)
    _engine.scan(
        record.clock.t_s, record.pv, record.co, numbers, array("d", chain.from_iterable(valves)), nodes.lags_s,
        nodes.seconds_s, nodes.thetas_s, nodes.basis, nodes.free, nodes.rows.start, nodes.rows.step, left, gain,
    )  # fmt: skip
    return left, gain


def valve_costs(misfit: Misfit, p: FloatArray, valves: Sequence[Valve]) -> list[float]:
    """Sum of squares with every valve, lags and dead time held, the gain free."""
    t, pv, _, numbers = packed(misfit)
    out = np.empty(len(valves))
    _engine.valve_costs(
        t, pv, misfit.record.co, numbers, np.ascontiguousarray(p), array("d", chain.from_iterable(valves)), out
    )
    return out.tolist()


def slip_costs(
    misfit: Misfit, p: FloatArray, slips: Sequence[tuple[tuple[int, ...], float, float]]
) -> list[tuple[float, float]]:
    """Gain, and sum of squares with it, for slips each; they are rows, share and first of Slips."""
    t, pv, _, numbers = packed(misfit)
    each = array("d", chain.from_iterable((len(rows), share, first) for rows, share, first in slips))
    at, out = array("d", chain.from_iterable(rows for rows, _, _ in slips)), np.empty((len(slips), 2))
    _engine.slip_costs(t, pv, misfit.record.co, numbers, np.ascontiguousarray(p), each, at, out)
    return [(gain, left) for gain, left in out.tolist()]


def screened(record: Window, by: tuple[float, float, float, int], numbers: int) -> FloatArray:
    """The sums over a whole record (record_sums.py); by : of a Measure. numbers : of sums."""
    out = np.empty(numbers)
    t_s, sp, pv, co = (np.ascontiguousarray(x) for x in (record.t_s, record.sp, record.pv, record.co))
    _engine.screen(t_s, sp, pv, co, *by, out)
    return out


def walks(
    pv: FloatArray, inputs: FloatArray, lag: float, loads: FloatArray, seconds: FloatArray,
    falls: Sequence[float], dead_times: Sequence[float], noise: float, smoothing: float, tones: FloatArray,
    ends: Sequence[int],
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """gain, information and left of UnderLoads. loads : rows of degree, roots of A and coefficients of C (walk.h).

    seconds, falls : poles. noise : variance of what pv cannot show. smoothing : of Prepared. tones, ends : see
    under_loads; each load comes with each number of tones.
    """
    pole = 1.0 if math.isinf(lag) else math.exp(-1.0 / lag)
    shape = (len(loads) * len(ends), len(seconds) * len(inputs), len(dead_times))
    gain, information, left = (np.empty(shape) for _ in range(3))
    rise = 1.0 if math.isinf(lag) else abs(1.0 - pole)
    _engine.walk(
        np.ascontiguousarray(pv), np.ascontiguousarray(inputs), loads, seconds, array("d", falls),
        array("d", dead_times), array("d", (pole, rise, noise, smoothing)), np.ascontiguousarray(tones),
        array("d", ends), gain, information, left,
    )  # fmt: skip
    return gain, information, left


def whitened(
    pv: FloatArray, beside: FloatArray, load: FloatArray, smoothing: float, second: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """pv, basis and response of `whitened` of jumping_load.py. load : as of walks. second : pole of the further lag."""
    out = np.empty((7, len(pv)))
    columns = _engine.whiten(pv, np.ascontiguousarray(beside), load, np.array((smoothing, second, second)), out)
    return out[0], out[2 : 2 + columns].T, out[1]


def walks_mixed(
    fits: tuple[FloatArray, FloatArray, FloatArray], half: FloatArray, gains: FloatArray, groups: FloatArray,
    spans: FloatArray, size: float,
) -> FloatArray:  # fmt: skip
    """UnderLoads.mixed. fits : gain, information and left. half : exponents of the loads. gains : (inputs, gains)."""
    _, rows, deads = fits[0].shape
    out = np.empty((len(groups), rows, deads, gains.shape[1]))
    _engine.mix(*fits, half, np.ascontiguousarray(gains), groups, np.ascontiguousarray(spans), size, rows, out)
    return out


def any_load(
    pv: FloatArray, co: FloatArray, lags: tuple[float, float], dead_times: FloatArray, gains: FloatArray,
    spans: FloatArray, order: int, noise: float,
) -> FloatArray:  # fmt: skip
    """What an autoregression leaves of pv - K x (explanations/any_load.py), shape (dead times, gains).

    lags : of the process, the second 0 for none. spans : the first gain that is asked for and the one after the last.
    """
    left = np.empty((len(dead_times), len(gains)))
    pole, second = (math.exp(-1.0 / lag) if lag else 0.0 for lag in lags)
    numbers = np.array((pole, 1.0 if math.isinf(lags[0]) else abs(1.0 - pole), second, noise))
    pv, co = (np.ascontiguousarray(one) for one in (pv, co))
    _engine.any_load(pv, co, dead_times, gains, spans, numbers, order, left)
    return left


def steps_chosen(
    pv: FloatArray, response: FloatArray, rest: FloatArray, unique: float, most: int, form: Sequence[float]
) -> tuple[list[int], FloatArray]:
    """Steps of pv through one response, each where it takes away most: their columns, and sums of squares before and
    after each. rest : orthonormal columns of what is there without any, shape (n, number). form : of
    the response, see steps_chosen of valve/plateaus.py.
    """
    rows, left, numbers = np.empty(most), np.empty(most + 1), np.array((unique, *form))
    pv, response, columns = (np.ascontiguousarray(x) for x in (pv, response, rest.T))
    count = _engine.steps(pv, response, columns, numbers, rows, left)
    return rows[:count].astype(int).tolist(), left[: count + 1]


def steps_moved(
    pv: FloatArray, response: FloatArray, rest: FloatArray, unique: float, chosen: Sequence[int], reach: int,
    passes: int, form: Sequence[float],
) -> tuple[list[int], float]:  # fmt: skip
    """Every step at its best column within reach, so many times; and the sum of squares that is left."""
    rows, numbers = np.array(chosen, dtype=np.float64), np.array((unique, *form))
    pv, response, columns = (np.ascontiguousarray(x) for x in (pv, response, rest.T))
    left = _engine.move_steps(pv, response, columns, numbers, rows, reach, passes)
    return rows.astype(int).tolist(), left


def closed(
    spaces: tuple[FloatArray, FloatArray, FloatArray, FloatArray], each: FloatArray, most: float, points: int
) -> tuple[FloatArray, FloatArray]:
    """Errors and outputs of many loops, shape (points, lanes). spaces : Phi (states, states, lanes), Gamma, C and the
    first states (states, lanes). each : kp, ki, kd, follow, b, setpoint, load, whole and part of the delay, (lanes, 9).
    most : u at most.
    """
    e, u = (np.empty((len(each), points)) for _ in range(2))
    phi, gamma, c, x = (np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in spaces)
    _engine.closed(phi, gamma, c, x, np.ascontiguousarray(each), most, e, u)
    return e.T, u.T


def held(numbers: Sequence[float], n: int) -> FloatArray:
    """pv at n samples of a loop whose process may run away; not finite from where it has. numbers : as in closed.h."""
    pv = np.full(n, math.nan)
    _engine.held(array("d", numbers), pv)
    return pv
