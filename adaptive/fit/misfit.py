"""Output-error misfit of a record for one structure: what every fit minimises.

    pv = bias + k' (g * co)(t - theta) + sum_j a_j h(t - s_j) + start + ramp + tones + noise

g and h are the impulse and step response of dynamics.py. The recorded co is the input (output error: measurement noise
does not bias the fit, unlike ARX). The load steps a_j come at unknown times s_j. `start` is a state that was not rest,
an input at rest that is not the resting co, and the unknown co of one dead time before: responses to a step and an
impulse at the first sample, to a step one dead time later and to a ramp until then (and again at the end of each gap in
time), with a prior, because nobody starts far from where he is; a ramp (drift) may be asked for in the same way, which
an integrating process turns into a parabola (a load that drifts; a lag only delays it, as the start can do). Loads
may be rounded: seen through a lag tau_d of their own, one for all; or corners, where the load's slope changes (h is
then the response to a ramp): two of them are a load that moves from one place to another. `tones` are a sinusoid and
its harmonics from outside. All linear unknowns are projected out (variable projection, Golub & Pereyra 1973; Jacobian
after Kaufman 1975); what is left is

    p = (x of structure.py, s_1 ... s_m [, ln tau_d] [, ln w of the tones])

Where the remainder is coloured (a drifting load, an unmodelled disturbance), both sides are filtered to whiteness first
(generalised least squares), which also keeps the fit unbiased in closed loop, where co follows the disturbance.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from retuner.adaptive.fit.dynamics import (
    By,
    Dynamics,
    LateMode,
    held_by_theta,
    held_slope,
    impulse_slope,
    late_modes,
    ramp_slope,
    rounded_by_lag,
    rounded_rise,
    rounded_slope,
    step_slope,
    through_lag,
    told_apart,
)
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.structure import INVERSE, LAG, SECOND, SIZE, SLOPE, THETA, THIRD, dynamics_at, swing_excess
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

# What a fit leaves: is it white, and if not, which filter makes it so?
#
# The remainder of a good fit is white noise. A drifting load, an unmodelled disturbance or a missing lag leave a
# coloured one. It is described as autoregressive, r_i + a_1 r_(i-1) + ... = e_i (Yule-Walker equations with the biased
# autocovariance, so the filter is always stable), its order chosen by the information criterion of Schwarz (1978).


MOST_ORDER = 4  # highest order: a random walk through two lags with white noise on top needs no more
WHITE = 0  # filter order where causes are compared: a filter would whiten any slow oscillation without naming its cause
LEAST_SAMPLES = 12  # below this many samples colour is not told from white


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
    engine = compiled()
    if engine is not None:
        std, ar = engine.colour(r, least_std, most_order)
        return Colour(ar, std)
    n = len(r)
    white = max(float(np.sqrt(np.mean(r**2))), least_std)
    best, lowest = Colour((), white), n * math.log(white**2)
    if n < LEAST_SAMPLES or white <= least_std:
        return best
    covariance = np.array([float(r[: n - k] @ r[k:]) / n for k in range(most_order + 1)])
    for order in range(1, most_order + 1):
        lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
        a = np.linalg.solve(covariance[lags], -covariance[1 : order + 1])
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
ROUNDING_COST = 3
"""A lag of the loads' own counts as so many: beside a load it does what a second lag of the process does, and processes
have one. At the price of one unknown it took the second lag's place in a tenth of the records of loads, and settings
went wrong both ways; with loads that did come through a lag, naming the other one costs little."""
AT_REST = 1e-4
"""A start_spread of zero (a record known to begin at rest) counts as this, so that its weight stays finite."""
RAMP_SPREAD = 0.5  # prior standard deviation of a drift over the whole record, as a share of pv's range
PARABOLA_SPREAD = 30.0
"""Spread for an integrating process: what a drifting load would do to it is large, for the loop takes it back."""
USEFUL = 1e-10  # A column of which less than this share is its own, against the largest, says nothing
SWING_WEIGHT = 30.0
"""Residual, in standard deviations, per e-fold beyond the least damping: a wall, but one with a slope."""


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
    rounded : whether the loads come through a lag of their own. corners : how many of the loads, the last ones, are
        changes of the load's slope and no steps; these come through no lag.
    most_order : highest order of a whitening filter for what is left.
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
    corners: int = 0
    most_order: int = MOST_ORDER
    co: FloatArray | None = None

    @property
    def size(self) -> int:
        """Length of p."""
        return SIZE[self.type] + self.loads + int(self.rounded) + int(self.harmonics > 0)

    def is_corner(self, j: int) -> bool:
        """Whether load j is a change of slope."""
        return j >= self.loads - self.corners

    @property
    def unknowns(self) -> int:
        """What is fitted, as the information criterion counts it."""
        more = ROUNDING_COST - 1 if self.rounded else 0
        return self.size + (LOAD_COST - 1) * self.loads + more + 2 * self.harmonics + int(self.ramp)

    @property
    def input(self) -> FloatArray:
        """What moves the process."""
        return self.record.co if self.co is None else self.co

    def moved(self, p: FloatArray) -> FloatArray:
        """What co explains of pv, shape (n,)."""
        dynamics = dynamics_at(self.type, p)
        held = dynamics.held(self.record.clock, self.input, math.exp(p[THETA]))
        return self.sign * math.exp(p[SLOPE]) * self.lagged(p, held)

    def lagged(self, p: FloatArray, values: FloatArray) -> FloatArray:
        """Through the third lag, where the structure has one; shape (n,) or (n, columns)."""
        if self.type not in THIRD:
            return values
        if values.ndim > 1:
            return np.stack([self.lagged(p, column) for column in values.T], axis=1)
        return through_lag(self.record.clock, values, math.exp(p[THIRD[self.type]]))

    @property
    def starts(self) -> list[float]:
        """Instants from which the process moves by what is not in the record: its beginning, and the ends of gaps."""
        return [0.0, *self.record.gaps_s]

    @property
    def priors(self) -> int:
        """Number of columns with a prior: the first ones."""
        kinds = 1 + int(self.type in SECOND) + 2 * int(self.record.motion_at_start > 0)
        return kinds * len(self.starts) + int(self.ramp)

    @property
    def has_room(self) -> bool:
        """Whether the record has more samples than there are unknowns: else nothing is left to speak against it."""
        return len(self.record.pv) > self.priors + self.loads + 2 * self.harmonics + 1 + self.size

    def columns(self, p: FloatArray) -> tuple[FloatArray, int]:
        """Columns of the linear unknowns, shape (n, c), each about one in size; the first `count` have a prior."""
        t, dynamics = self.record.t_s, dynamics_at(self.type, p)
        theta = math.exp(p[THETA])
        found = [dynamics.step(t - at) for at in self.starts]
        if dynamics.c2_s:
            found += [dynamics.impulse(t - at) for at in self.starts]
        for at in self.starts if self.record.motion_at_start else ():
            since = t - at
            found.append(dynamics.step(since - theta))
            found.append(dynamics.ramp(since) - dynamics.ramp(since - theta))
        found = [_unit(self.lagged(p, column)) for column in found]
        if self.ramp:
            found.append((t / self.record.span_s) ** (1 if self.type in LAG else 2))
        found += [_unit(self.lagged(p, self._load(p, dynamics, j))) for j in range(self.loads)]
        if self.harmonics:
            w = math.exp(p[-1])
            found += [f(i * w * t) for i in range(1, self.harmonics + 1) for f in (np.cos, np.sin)]
        return np.stack([*found, np.ones_like(t)], axis=1), self.priors

    def _load(self, p: FloatArray, dynamics: Dynamics, j: int) -> FloatArray:
        d = SIZE[self.type]
        since = self.record.t_s - p[d + j]
        if self.is_corner(j):
            return dynamics.ramp(since)
        return dynamics.rounded_step(since, math.exp(p[d + self.loads])) if self.rounded else dynamics.step(since)

    def solve(self, p: FloatArray) -> Projection:
        """The linear unknowns solved for; residuals in units of sigma, prior rows at the end."""
        engine = compiled()
        if engine is not None:
            q, r, c, moved, columns, triangle = engine.projected(self, p)
            return Projection(p, q, r, c, moved, columns, self.priors, triangle)
        columns, count = self.columns(p)
        moved = self.moved(p)
        basis = self.rows(columns, count)
        target = np.concatenate([self.whitened(self.record.pv - moved), np.zeros(count)])
        q, triangle = np.linalg.qr(basis)
        inside = q.T @ target
        size = np.abs(np.diag(triangle))
        if np.min(size) > USEFUL * np.max(size):
            c = np.linalg.solve(triangle, inside)
        else:  # columns that say nothing get zero
            c = np.linalg.lstsq(triangle, inside, rcond=USEFUL)[0]
        swing = SWING_WEIGHT * swing_excess(self.type, p)
        r = np.append((target - q @ inside) / self.sigma, swing)
        return Projection(p, q, r, np.asarray(c, dtype=np.float64), moved, columns, count, triangle)

    def costs(self, points: Sequence[FloatArray]) -> list[float]:
        """Sum of squares at every point."""
        engine = compiled()
        return engine.costs(self, points) if engine is not None else [self.solve(p).cost for p in points]

    def jacobian(self, at: Projection) -> FloatArray:
        """Derivative of the residuals by p (Kaufman's approximation), shape (len(residuals), len(p))."""
        engine = compiled()
        if engine is not None:
            slopes: FloatArray = engine.jacobian(self, at.p)
            return slopes
        p, n = at.p, len(self.record.pv)
        changes = np.zeros((len(at.r) - 1, len(p)))
        changes[:n] = self.whitened(np.stack(changes_of(self, at), axis=1))
        found = np.zeros((len(at.r), len(p)))
        found[:-1] = (at.q @ (at.q.T @ changes) - changes) / self.sigma
        if swing_excess(self.type, p) > 0:
            found[-1, LAG[self.type]], found[-1, SECOND[self.type]] = -SWING_WEIGHT, SWING_WEIGHT
        return found

    def whitened(self, values: FloatArray) -> FloatArray:
        """Through the whitening filter, along the first axis."""
        if not self.ar:
            return values
        found = values.copy()
        for lag, a in enumerate(self.ar, 1):
            found[lag:] += a * values[:-lag]
        return found

    def prior_weights(self) -> list[float]:
        """Weights of the columns with a prior: what one of its size counts, in pv units."""
        starts, spread = len(self.starts), max(self.start_spread, AT_REST)
        spreads = [spread] * (starts * (1 + int(self.type in SECOND)))
        if self.record.motion_at_start:
            spreads += [max(self.start_spread * self.record.motion_at_start, AT_REST)] * (2 * starts)
        if self.ramp:
            spreads.append(RAMP_SPREAD if self.type in LAG else PARABOLA_SPREAD)
        return [self.sigma / (spread * self.record.pv_range) for spread in spreads]

    def rows(self, columns: FloatArray, count: int) -> FloatArray:
        """The columns whitened, with a row for every prior."""
        priors = np.zeros((count, columns.shape[1]))
        priors[np.arange(count), np.arange(count)] = self.prior_weights()
        return np.concatenate([self.whitened(columns), priors])


def _unit(column: FloatArray) -> FloatArray:
    """Scaled to a largest value of one."""
    largest = float(np.max(np.abs(column)))
    return column / largest if largest > 0 else column


# How the fitted pv moves with each parameter while the linear unknowns are held: what the Jacobian is made of.

Change = tuple[int, FloatArray, FloatArray]
"""Place of a column, the column before it was scaled to one, and its derivative."""


def changes_of(misfit: "Misfit", at: "Projection") -> list[FloatArray]:
    """Derivative of the fitted pv by every p[j], shape (n,) each."""
    p, d = at.p, SIZE[misfit.type]
    dynamics = told_apart(dynamics_at(misfit.type, p))
    late = late_modes(dynamics, misfit.record.clock, misfit.input, math.exp(p[THETA]))
    theta = math.exp(at.p[THETA])
    moved = misfit.lagged(at.p, held_by_theta(dynamics, late, theta))
    changes = list(_late_by_theta(misfit, dynamics, theta))
    found = [at.moved, (misfit.sign * math.exp(at.p[SLOPE]) * moved + _summed(misfit, at, changes))]
    if misfit.type in LAG:
        found.append(_by_dynamics(misfit, at, dynamics, late, By.LAG))
    if misfit.type in SECOND:
        found.append(_by_dynamics(misfit, at, dynamics, late, By.SECOND))
    if misfit.type in INVERSE:
        found.append(_by_dynamics(misfit, at, dynamics, late, By.INVERSE))
    if misfit.type in THIRD:
        # by ln d: a lag takes away what it would take away once more, -d s / (1 + d s) of what came through
        places = [*range(at.priors - int(misfit.ramp)), *range(at.priors, at.priors + misfit.loads)]
        slope = misfit.lagged(at.p, at.moved) - at.moved
        for place in places:
            column = at.columns[:, place]
            change = misfit.lagged(at.p, column) - column
            peak = int(np.argmax(np.abs(column)))
            if column[peak]:
                slope += at.c[place] * (change - change[peak] / column[peak] * column)
        found.append(slope)
    found += [_summed(misfit, at, [_load_change(misfit, at, dynamics, j)]) for j in range(misfit.loads)]
    if misfit.rounded:
        lag = math.exp(p[d + misfit.loads])
        since = [misfit.record.t_s - p[d + j] for j in range(misfit.loads)]
        found.append(
            _summed(misfit, at, [(at.priors + j, dynamics.rounded_step(s, lag), rounded_by_lag(dynamics, s, lag))
                                 for j, s in enumerate(since) if not misfit.is_corner(j)])
        )  # fmt: skip
    if misfit.harmonics:
        # by the logarithm of the tones' frequency
        t, w, place = misfit.record.t_s, math.exp(at.p[-1]), at.priors + misfit.loads
        slope = np.zeros(len(t))
        for i in range(1, misfit.harmonics + 1):
            cosine, sine = at.columns[:, place], at.columns[:, place + 1]
            slope += i * w * t * (at.c[place + 1] * cosine - at.c[place] * sine)
            place += 2
        found.append(slope)
    return found


def _summed(misfit: "Misfit", at: "Projection", changes: list[Change]) -> FloatArray:
    """The derivatives of columns that were scaled to one, times their coefficients."""
    found = np.zeros(len(at.moved))
    for place, before, rising in changes:
        column, change = misfit.lagged(at.p, before), misfit.lagged(at.p, rising)
        peak = int(np.argmax(np.abs(column)))
        if column[peak]:
            size, rise = abs(column[peak]), change[peak] / column[peak]
            found += at.c[place] * (change - rise * column) / size
    return found


def _late_by_theta(misfit: "Misfit", dynamics: Dynamics, theta: float) -> Iterator[Change]:
    """The columns of a start in motion, which know the dead time."""
    if not misfit.record.motion_at_start:
        return
    place = len(misfit.starts) * (1 + int(misfit.type in SECOND))
    for at in misfit.starts:
        since = misfit.record.t_s - at
        late = since - theta
        yield place, dynamics.step(late), -theta * dynamics.impulse(late)
        yield place + 1, dynamics.ramp(since) - dynamics.ramp(late), theta * dynamics.step(late)
        place += 2


def _by_dynamics(misfit: "Misfit", at: "Projection", dynamics: Dynamics, late: list[LateMode], by: By) -> FloatArray:
    """Slopes by ln T, ln c2 or ln b."""
    moved = misfit.lagged(at.p, held_slope(dynamics, late, by))
    changes = list(_columns_by_dynamics(misfit, at.p, dynamics, by))
    return misfit.sign * math.exp(at.p[SLOPE]) * moved + _summed(misfit, at, changes)


def _columns_by_dynamics(misfit: "Misfit", p: FloatArray, dynamics: Dynamics, by: By) -> Iterator[Change]:
    t, theta, place = misfit.record.t_s, math.exp(p[THETA]), 0
    for at in misfit.starts:
        yield place, dynamics.step(t - at), step_slope(dynamics, t - at, by)
        place += 1
    for at in misfit.starts if misfit.type in SECOND else ():
        yield place, dynamics.impulse(t - at), impulse_slope(dynamics, t - at, by)
        place += 1
    for at in misfit.starts if misfit.record.motion_at_start else ():
        since, late = t - at, t - at - theta
        yield place, dynamics.step(late), step_slope(dynamics, late, by)
        ramp = dynamics.ramp(since) - dynamics.ramp(late)
        yield place + 1, ramp, ramp_slope(dynamics, since, by) - ramp_slope(dynamics, late, by)
        place += 2
    d = SIZE[misfit.type]
    for j in range(misfit.loads):
        since = t - p[d + j]
        if misfit.is_corner(j):
            yield misfit.priors + j, dynamics.ramp(since), ramp_slope(dynamics, since, by)
        elif misfit.rounded:
            lag = math.exp(p[d + misfit.loads])
            yield misfit.priors + j, dynamics.rounded_step(since, lag), rounded_slope(dynamics, since, lag, by)
        else:
            yield misfit.priors + j, dynamics.step(since), step_slope(dynamics, since, by)


def _load_change(misfit: "Misfit", at: "Projection", dynamics: Dynamics, j: int) -> Change:
    d = SIZE[misfit.type]
    since = misfit.record.t_s - at.p[d + j]
    if misfit.is_corner(j):
        return at.priors + j, dynamics.ramp(since), -dynamics.step(since)
    if misfit.rounded:
        lag = math.exp(at.p[d + misfit.loads])
        return at.priors + j, dynamics.rounded_step(since, lag), -rounded_rise(dynamics, since, lag)
    return at.priors + j, dynamics.step(since), -dynamics.impulse(since)
