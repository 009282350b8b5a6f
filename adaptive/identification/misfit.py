"""Output-error misfit of a record for one structure: what every fit minimises.

    pv = bias + k' (g * co)(t - theta) + sum_j a_j h(t - s_j) + start + ramp + tones + noise

g and h are the impulse and step response of dynamics.py. The recorded co is the input (output error: measurement noise
does not bias the fit, unlike ARX). The load steps a_j come at unknown times s_j. `start` is a state that was not rest,
an input at rest that is not the resting co, and the unknown co of one dead time before: responses to a step and an
impulse at the first sample, to a step one dead time later and to a ramp until then (and again at the end of each gap in
time), with a prior, because nobody starts far from where he is; a ramp (drift) may be asked for in the same way. Loads
may be rounded: seen through a lag tau_d of their own, one for all. `tones` are a sinusoid and its harmonics from
outside. All linear unknowns are projected out (variable projection, Golub & Pereyra 1973; Jacobian after Kaufman 1975);
what is left is

    p = (x of structure.py, s_1 ... s_m [, ln tau_d] [, ln w of the tones])

Where the remainder is coloured (a drifting load, an unmodelled disturbance), both sides are filtered to whiteness first
(generalised least squares), which also keeps the fit unbiased in closed loop, where co follows the disturbance.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from retuner.adaptive.identification.dynamics import Dynamics
from retuner.adaptive.identification.record import Record
from retuner.adaptive.identification.structure import LAG, SECOND, SIZE, SLOPE, THETA, dynamics_at, swing_excess
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray

# What a fit leaves: is it white, and if not, which filter makes it so?
#
# The remainder of a good fit is white noise. A drifting load, an unmodelled disturbance or a missing lag leave a
# coloured one. It is described as autoregressive, r_i + a_1 r_(i-1) + ... = e_i (Yule-Walker equations with the biased
# autocovariance, so the filter is always stable), its order chosen by the information criterion of Schwarz (1978).


MOST_ORDER = 4
"""Highest order: a random walk through two lags with white noise on top needs no more."""
LEAST_SAMPLES = 12
"""Below this many samples colour is not told from white."""


@dataclass(frozen=True, slots=True)
class Colour:
    """The whitening filter of a remainder.

    ar : its coefficients. std : of what is left after it, in the remainder's unit.
    """

    ar: tuple[float, ...]
    std: float


def colour(r: FloatArray, least_std: float, most_order: int = MOST_ORDER) -> Colour:
    """The filter for a remainder.

    least_std : no remainder is taken to be smaller than this (the resolution of the record).
    """
    n = len(r)
    white = max(float(np.sqrt(np.mean(r**2))), least_std)
    best, lowest = Colour((), white), n * math.log(white**2)
    if n < LEAST_SAMPLES or white <= least_std:
        return best
    covariance = np.array([float(r[: n - k] @ r[k:]) / n for k in range(most_order + 1)])
    for order in range(1, most_order + 1):
        a = solve_toeplitz(covariance[:order], -covariance[1 : order + 1])
        variance = max(float(covariance[0] + a @ covariance[1 : order + 1]), least_std**2)
        criterion = n * math.log(variance) + order * math.log(n)
        if criterion < lowest:
            best, lowest = Colour(tuple(float(v) for v in a), math.sqrt(variance)), criterion
    return best


def criterion(found: Colour, n: int, unknowns: int, model_error: float) -> float:
    """Schwarz's criterion of a fit that leaves this: n ln sigma^2 + (unknowns + order of the filter) ln n.

    model_error : what any structure leaves of a real process, rms in the remainder's unit. It is added to the
    remainder's variance, or fake load steps would be taken for evidence because they cover it.
    """
    return n * math.log(found.std**2 + model_error**2) + (unknowns + len(found.ar)) * math.log(n)


LOAD_COST = 3
"""A load step counts as so many unknowns: its size and its time, and one for having been looked for everywhere."""
AT_REST = 1e-4
"""A start_spread of zero (a record known to begin at rest) counts as this, so that its weight stays finite."""
RAMP_SPREAD = 0.5
"""Prior standard deviation of a drift over the whole record, as a share of pv's range."""
SWING_WEIGHT = 30.0
"""Residual, in standard deviations, per e-fold beyond the least damping: a wall, but one with a slope."""
LOG_STEP = 1e-6
"""Step of the numerical derivative by a logarithm."""
TIME_STEP = 1e-4
"""Step of the numerical derivative by a load time, in sampling intervals."""


@dataclass(frozen=True, slots=True)
class Projection:
    """The linear problem solved at one p.

    q : orthonormal basis of the nuisances. r : residuals. c : coefficients of the columns. moved : what co explains.
    columns : of the linear unknowns, the first `priors` have a prior. triangle : of the decomposition, columns = q R.
    """

    p: FloatArray
    q: FloatArray
    r: FloatArray
    c: FloatArray
    moved: FloatArray
    columns: FloatArray
    priors: int
    triangle: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.r @ self.r)

    @property
    def explained(self) -> FloatArray:
        """The fitted pv, shape (n,)."""
        return np.asarray(self.moved + self.columns @ self.c, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Misfit:
    """The misfit of one record for one structure.

    record : the record. type : structure. sign : of k'. loads : number of load steps.
    sigma : what residuals are counted in, pv units. start_spread : prior standard deviation of the start, as a share
        of pv's range. ar : coefficients a_1.. of the whitening filter 1 + a_1 z^-1 + ..., empty for white.
    harmonics : number of harmonics of the tone from outside, 0 for none. ramp : whether pv drifts along a ramp.
    rounded : whether the loads come through a lag of their own. most_order : highest order of a whitening filter for
        what is left.
    co : another input than the recorded one (a stuck valve's output), shape (n,), or None.
    """

    record: Record
    type: ProcessType
    sign: int
    loads: int
    sigma: float
    start_spread: float
    ar: tuple[float, ...] = ()
    harmonics: int = 0
    ramp: bool = False
    rounded: bool = False
    most_order: int = MOST_ORDER
    co: FloatArray | None = None

    @property
    def size(self) -> int:
        """Length of p."""
        return SIZE[self.type] + self.loads + int(self.rounded) + int(self.harmonics > 0)

    @property
    def unknowns(self) -> int:
        """What is fitted, as the information criterion counts it."""
        return self.size + (LOAD_COST - 1) * self.loads + 2 * self.harmonics + int(self.ramp)

    @property
    def input(self) -> FloatArray:
        """What moves the process."""
        return self.record.co if self.co is None else self.co

    def moved(self, p: FloatArray) -> FloatArray:
        """What co explains of pv, shape (n,)."""
        dynamics = dynamics_at(self.type, p)
        return self.sign * math.exp(p[SLOPE]) * dynamics.held(self.record.clock, self.input, math.exp(p[THETA]))

    def columns(self, p: FloatArray) -> tuple[FloatArray, int]:
        """Columns of the linear unknowns, shape (n, c), each about one in size; the first `count` have a prior."""
        t, dynamics = self.record.t_s, dynamics_at(self.type, p)
        starts = [0.0, *self.record.gaps_s]
        theta = math.exp(p[THETA])
        found = [_unit(dynamics.step(t - at)) for at in starts]
        if dynamics.c2_s:
            found += [_unit(dynamics.impulse(t - at)) for at in starts]
        for at in starts if self.record.motion_at_start else ():
            since = t - at
            found.append(_unit(dynamics.step(since - theta)))
            found.append(_unit(dynamics.ramp(since) - dynamics.ramp(since - theta)))
        if self.ramp:
            found.append(t / self.record.span_s)
        count = len(found)
        found += [self._load(p, dynamics, j) for j in range(self.loads)]
        if self.harmonics:
            w = math.exp(p[-1])
            found += [f(i * w * t) for i in range(1, self.harmonics + 1) for f in (np.cos, np.sin)]
        return np.stack([*found, np.ones_like(t)], axis=1), count

    def _load(self, p: FloatArray, dynamics: Dynamics, j: int) -> FloatArray:
        """The column of one load step."""
        d = SIZE[self.type]
        since = self.record.t_s - p[d + j]
        if self.rounded:
            return _unit(dynamics.rounded_step(since, math.exp(p[d + self.loads])))
        return _unit(dynamics.step(since))

    def solve(self, p: FloatArray) -> Projection:
        """The linear unknowns solved for; residuals in units of sigma, prior rows at the end."""
        columns, count = self.columns(p)
        moved = self.moved(p)
        basis = self._rows(columns, count)
        target = np.concatenate([self.whitened(self.record.pv - moved), np.zeros(count)])
        q, triangle = np.linalg.qr(basis)
        inside = q.T @ target
        swing = SWING_WEIGHT * swing_excess(self.type, p)
        r = np.append((target - q @ inside) / self.sigma, swing)
        return Projection(p, q, r, _back(triangle, inside), moved, columns, count, triangle)

    def residuals(self, p: FloatArray) -> FloatArray:
        """Residuals in units of sigma: n samples, the priors of the start, the wall of the least damping."""
        return self.solve(p).r

    def jacobian(self, at: Projection) -> FloatArray:
        """Derivative of the residuals by p (Kaufman's approximation), shape (len(residuals), len(p))."""
        p, n = at.p, len(self.record.pv)
        changes = np.zeros((len(at.r) - 1, len(p)))
        changes[:n] = self.whitened(np.stack([self._change(at, j) for j in range(len(p))], axis=1))
        found = np.zeros((len(at.r), len(p)))
        found[:-1] = (at.q @ (at.q.T @ changes) - changes) / self.sigma
        for j in (LAG.get(self.type), SECOND.get(self.type)):
            if j is not None:
                rise = swing_excess(self.type, _ahead(p, j, LOG_STEP)) - swing_excess(self.type, p)
                found[-1, j] = SWING_WEIGHT * rise / LOG_STEP
        return found

    def whitened(self, values: FloatArray) -> FloatArray:
        """Through the whitening filter, along the first axis."""
        if not self.ar:
            return values
        found = values.copy()
        for lag, a in enumerate(self.ar, 1):
            found[lag:] += a * values[:-lag]
        return found

    def _change(self, at: Projection, j: int) -> FloatArray:
        """Derivative of the fitted pv by p[j] with the linear unknowns held, shape (n,)."""
        p, d = at.p, SIZE[self.type]
        if j == SLOPE:
            return at.moved
        if d <= j < d + self.loads:
            h = TIME_STEP * self.record.sample_time_s
            column = at.priors + j - d
            change = self._load(_ahead(p, j, h), dynamics_at(self.type, p), j - d) - at.columns[:, column]
            return np.asarray(at.c[column] * change / h, dtype=np.float64)
        ahead = _ahead(p, j, LOG_STEP)
        columns = self.columns(ahead)[0]
        if j >= d:
            return (columns - at.columns) @ at.c / LOG_STEP
        return (self.moved(ahead) - at.moved + (columns - at.columns) @ at.c) / LOG_STEP

    def _rows(self, columns: FloatArray, count: int) -> FloatArray:
        """The columns whitened, with a row for every prior."""
        spread = np.full(count, max(self.start_spread, AT_REST))
        starts = 1 + len(self.record.gaps_s)
        last = count - int(self.ramp)
        if self.record.motion_at_start:
            spread[last - 2 * starts : last] = max(self.start_spread * self.record.motion_at_start, AT_REST)
        if self.ramp:
            spread[-1] = RAMP_SPREAD
        priors = np.zeros((count, columns.shape[1]))
        priors[np.arange(count), np.arange(count)] = self.sigma / (spread * self.record.pv_range)
        return np.concatenate([self.whitened(columns), priors])


def _ahead(p: FloatArray, j: int, h: float) -> FloatArray:
    """p with one component moved."""
    ahead = p.copy()
    ahead[j] += h
    return ahead


def _unit(column: FloatArray) -> FloatArray:
    """Scaled to a largest value of one."""
    largest = float(np.max(np.abs(column)))
    return column / largest if largest > 0 else column


def _back(triangle: FloatArray, inside: FloatArray) -> FloatArray:
    """Coefficients from the triangle; columns that say nothing get zero."""
    size = np.abs(np.diag(triangle))
    if np.min(size) > 1e-10 * np.max(size):
        return np.asarray(np.linalg.solve(triangle, inside), dtype=np.float64)
    return np.asarray(np.linalg.lstsq(triangle, inside, rcond=1e-10)[0], dtype=np.float64)
