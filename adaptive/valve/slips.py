"""A valve that sticks over another band at every stop: slips at free times, each towards where co has gone.

    at rest     the valve stands, y constant, however far co goes
    slip        at row t_i it comes loose and goes most of the way to co, the same share of it every time:
                    y_i = (1 - r) u(t_i) + r y_(i-1),      r = f_d / f_s = (S_i - J_i) / (S_i + J_i)
    going on    it follows co at that distance until co stops or turns

Kano's and He's valves (valve/valve_model.py) are special cases: there t_i is when co has gone a fixed band. Here t_i is
free and costs a parameter, so the band S_i = |u(t_i) - y_(i-1)| 2 / (1 + r) may differ from stop to stop, and where a
record holds a dozen slips their times are looked for one by one. A slip away from co is impossible, and its size is not
free: that sets it apart from load steps, which cost more and may do anything.

Where the slips are is first seen from pv alone: as steps through two lags, co left out of it altogether, found one by
one (orthogonal least squares, Chen, Billings & Luo 1989) and refined together with the lags; and from co, which a slip
turns round. Then the law takes the place of free sizes, and times, share and process are refined in turn until nothing
helps.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from retuner.adaptive.fit.dynamics import Dynamics
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import LOAD_COST, Misfit
from retuner.adaptive.fit.refine import Fit, refine
from retuner.adaptive.fit.structure import SLOPE, THETA
from retuner.adaptive.identification.candidate import MODEL_ERROR, Candidate, CandidateList, judged
from retuner.adaptive.identification.loads import improved
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, distinct, median
from retuner.adaptive.valve.plateaus import steps_chosen, through_lag
from retuner.adaptive.valve.valve_fit import bare, with_best_gain
from retuner.schedule.late_dataclass import dataclass, replace

Rows = npt.NDArray[np.int64]

MOST_SLIPS = 24  # more slips than this in one record are a regular cycle, or noise
ROWS_PER_STEP = 4  # samples a step at least: it has two unknowns, and as many samples must be left to speak against it
TURN_SHARE = 0.08  # co turns where it goes back by this share of its range, and by four times its noise
TURN_NOISE = 4.0
SECOND_DIFFERENCE_TO_SIGMA = 1.65
"""Median of the absolute second differences of white noise, over its standard deviation."""
LAGS_PER_PERIOD = (0.03, 0.1, 0.3, 1.0, 10.0)
THETAS_PER_PERIOD = (0.01, 0.05, 0.12, 0.22)
"""Dynamics tried with the turns of co, as shares of the period that they make."""
LATE = (0.0, 0.5, 1.0, 2.0)  # how long after a slip co turns, in units of the dead time and a tenth of the lag
STEP_ROWS = 400  # rows on which the steps are looked for at first
LAGS = tuple(np.geomspace(0.5, 280.0, 9).tolist())  # lags tried there, in rows
SECOND_SHARES = (0.0, 0.2)  # second lags tried, as shares of the sum of both
THETAS = (0.3, 1.0, 2.0, 3.5, 6.0, 10.0, 16.0, 25.0, 40.0)  # dead times tried, in samples
SHARES = (0.0, 0.3, 0.6)  # r tried at first
FINE_SHARES = (-0.15, -0.05, -0.02, 0.02, 0.05, 0.15)  # steps of r
HIGHEST_SHARE, LOWEST_SHARE = 0.98, -0.3
STARTS = tuple(i / 4 for i in range(-4, 5))
"""Places where the valve may stand first, in units of the usual distance that makes it slip."""
MOVES = (-16, -6, -2, -1, 1, 2, 6, 16)  # rows by which a slip is moved
TRIED = 40  # rows at which one more slip is tried
MOST_ROUNDS = 5  # rounds of moving, adding and refining at the most
FEWEST_SLIPS = 3  # fewer tell no law
UNIQUE = 1e-6  # A step of which less than this share is not explained by the others is no further one
LEAST_GAIN_PER_ROUND = 1.0  # A round must lower the criterion by this
SLIP_COST = 2  # A slip counts as so many unknowns: its time, and one for having been looked for everywhere
OWN_UNKNOWNS = 2  # r, and where the valve stands first


@dataclass(frozen=True, slots=True)
class Slips:
    """When a valve slips, and how far. rows : of the slips, ascending. share : r above. first : y before them all."""

    rows: tuple[int, ...]
    share: float
    first: float


@dataclass(frozen=True, slots=True)
class Slipping:
    """A slipping valve that explains a record. criterion : with the slips counted in; fit's own does not know of them.

    travel : of co while the valve stands, in units of co's range. bands : |u - y| before every slip, units of co.
    """

    slips: Slips
    fit: Candidate
    criterion: float
    travel: float
    bands: tuple[float, ...]


class Co:
    """The recorded co, and how long it keeps going from every row."""

    def __init__(self, u: FloatArray) -> None:
        self.u = u
        self._stops: dict[int, list[int]] = {way: _stops(way * np.diff(u)).tolist() for way in (1, -1)}

    def positions(self, each: Sequence[Slips]) -> FloatArray:
        """Where the valve is with slips each, shape (slips, n)."""
        u, parts = self.u.tolist(), list[tuple[int, float, bool]]()
        for slips in each:
            y, rows = slips.first, (*slips.rows, len(u))
            parts.append((rows[0], y, False))
            for at, until in pairwise(rows):
                apart = u[at] - y
                stop = min(self._stops[1 if apart > 0 else -1][at], until)
                y = u[stop - 1] - slips.share * apart
                parts += ((stop - at, -slips.share * apart, True), (until - stop, y, False))
        counts, held, moving = zip(*parts, strict=True)
        u_there = np.where(np.repeat(moving, counts).reshape(-1, len(u)), self.u, 0.0)
        return np.asarray(u_there + np.repeat(held, counts).reshape(-1, len(u)))

    def position(self, slips: Slips) -> FloatArray:
        """Where the valve is, shape (n,)."""
        return np.asarray(self.positions([slips])[0])

    def turns(self) -> list[int]:
        """Rows at which it turns round, and then goes back by more than its noise and a share of its range."""
        u = self.u
        noise = median(np.abs(np.diff(u, 2))) / SECOND_DIFFERENCE_TO_SIGMA
        least = max(TURN_SHARE * float(np.ptp(u)), TURN_NOISE * noise)
        found: list[int] = []
        high = low = 0
        way = 0
        for i, value in enumerate(u.tolist()):
            high, low = (i if value > u[high] else high), (i if value < u[low] else low)
            if way >= 0 and u[high] - value > least:
                found.append(high)
                way, low = -1, i
            elif way <= 0 and value - u[low] > least:
                found.append(low)
                way, high = 1, i
        return [row for row in found if row]

    def bands(self, slips: Slips) -> FloatArray:
        """How far co was from the valve when it slipped."""
        rows = np.array(slips.rows, dtype=np.int64)
        before = self.position(slips)[np.maximum(rows - 1, 0)]
        return np.abs(self.u[rows] - before)


def _stops(rises: FloatArray) -> Rows:
    """The first row after each one at which co no longer goes that way."""
    n = len(rises) + 1
    still = np.append(np.flatnonzero(rises <= 0) + 1, n)
    return np.asarray(still[np.searchsorted(still, np.arange(n), side="right")] if n else still, dtype=np.int64)


def slipping(linear: Candidate, most_loads: int) -> Slipping | None:
    """The best explanation by a slipping valve, load steps beside it; None where pv does not consist of steps.

    linear : the explanation by the loop itself.
    """
    record = linear.fit.misfit.record
    misfit = bare(linear.fit.misfit, ProcessType.FOPDT)
    co, found = Co(record.co), list[Iterator[Start]]()
    if (steps := as_steps(misfit)) is not None:
        found.append(_from_steps(replace(misfit, type=steps.type), co, steps))
    turns = co.turns()
    if FEWEST_SLIPS <= len(turns) <= MOST_SLIPS:
        found.append(_from_turns(misfit, co, turns))
    starts = [min(each, key=lambda start: start.left, default=None) for each in found]
    settled = [_settled(start, co) for start in starts if start is not None]
    best = min(settled, key=lambda s: s.criterion, default=None)
    if best is None:
        return None
    fit = improved(best.fit, most_loads, CandidateList([best.fit]))  # with load steps, where they pay
    return replace(best, fit=fit, criterion=best.criterion + fit.criterion - best.fit.criterion)


@dataclass(frozen=True, slots=True)
class Start:
    """Where a search begins. left : sum of squares there. x : parameters of the process."""

    left: float
    misfit: Misfit
    slips: Slips
    x: FloatArray


def _from_turns(misfit: Misfit, co: Co, turns: Sequence[int]) -> Iterator[Start]:
    """Slips a fixed time before every turn of co, for lags, dead times and shares on a grid."""
    dt = misfit.record.sample_time_s
    period_s = 2 * dt * (turns[-1] - turns[0]) / (len(turns) - 1)
    for lag in (max(part * period_s, dt) for part in LAGS_PER_PERIOD):
        for theta in (max(part * period_s, dt / 2) for part in THETAS_PER_PERIOD):
            for late in sorted({round(part * (theta + 0.1 * lag) / dt) for part in LATE}):
                rows = tuple(sorted({max(turn - late, 1) for turn in turns}))
                yield from _with_shares(misfit, co, rows, np.log([1.0, theta, lag]))


@dataclass(frozen=True, slots=True)
class FreeSteps:
    """pv as steps through one lag or two.

    type : of the process. x : its parameters, gain and dead time without meaning. times_s : of the steps, dead time
    included.
    """

    type: ProcessType
    x: FloatArray
    times_s: FloatArray


def as_steps(misfit: Misfit) -> FreeSteps | None:
    """The best description of pv by steps of a process that co does not move."""
    record = misfit.record
    n = -(-len(record.pv) // STEP_ROWS)
    pv = record.pv[: len(record.pv) // n * n].reshape(-1, n).mean(axis=1)
    dt = n * record.sample_time_s
    found = [(*_greedy(pv, lag, second), lag, second) for lag in LAGS for second in SECOND_SHARES]
    _, rows, lag, second = min(found, key=lambda f: f[0])
    if len(rows) < FEWEST_SLIPS:
        return None
    type_ = ProcessType.SOPDT if second else ProcessType.FOPDT
    x = [0.0, math.log(dt), math.log(lag * dt)] + ([math.log(second * lag * dt)] if second else [])
    free = replace(misfit, type=type_, loads=len(rows), co=np.zeros(len(record.pv)))
    fit = refine(free, np.array(x + [(row + 0.5) * dt for row in sorted(rows)]))
    return FreeSteps(type_, fit.x, np.sort(fit.p[len(fit.x) :]))


def _greedy(pv: FloatArray, lag: float, second: float) -> tuple[float, list[int]]:
    """The criterion, and rows of the steps that pay. lag : in rows. second : share of it that is a second lag."""
    n = len(pv)
    dynamics, middle = Dynamics(second * lag, 1 / lag), np.arange(0.5, n, dtype=np.float64)
    rise = dynamics.step(middle) / lag  # of a gain of one
    rest, _ = np.linalg.qr(np.stack([np.ones(n), rise, dynamics.impulse(middle)][: 3 if second else 2], axis=1))
    form = () if second else through_lag(math.exp(-0.5 / lag), math.exp(-1.0 / lag))
    found, left = steps_chosen(pv, rise, rest, UNIQUE, min(MOST_SLIPS, n // ROWS_PER_STEP), form)
    prices = [n * math.log(max(rss, 1e-300) / n) + LOAD_COST * i * math.log(n) for i, rss in enumerate(left)]
    least = min(prices)
    return least, found[: prices.index(least)]


def _from_steps(misfit: Misfit, co: Co, steps: FreeSteps) -> Iterator[Start]:
    """Slips a dead time before every step of pv, for dead times and shares on a grid."""
    dt, n = misfit.record.sample_time_s, len(misfit.record.pv)
    for theta in (dt * rows for rows in THETAS):
        rows = distinct(np.clip(np.round((steps.times_s - theta) / dt), 1, n - 1)).astype(int)
        x = steps.x.copy()
        x[SLOPE], x[THETA] = 0.0, math.log(theta)
        yield from _with_shares(misfit, co, tuple(rows.tolist()), x)


def _with_shares(misfit: Misfit, co: Co, rows: tuple[int, ...], x: FloatArray) -> Iterator[Start]:
    each = [Slips(rows, share, float(co.u[0])) for share in SHARES]
    for slips, (gain, left) in zip(each, explained_by(misfit, x, co, each), strict=True):
        if gain > 0:
            yield Start(left, misfit, slips, np.concatenate([[x[SLOPE] + math.log(gain)], x[1:]]))


def explained_by(misfit: Misfit, p: FloatArray, co: Co, each: Sequence[Slips]) -> list[tuple[float, float]]:
    """Gain of what each moves, in units of p's, and what it leaves; lags and dead time held."""
    engine = compiled()
    if engine is None:
        return list(with_best_gain(misfit, p, co.positions(each)))
    found: list[tuple[float, float]] = engine.slip_costs(misfit, p, [(s.rows, s.share, s.first) for s in each])
    return found


class TriedSlips:
    """Slips tried with the process held. at : the best so far. cost : of it, by what tells those of several."""

    def __init__(self, costs: Callable[[Sequence[Slips]], Iterable[float]], at: Slips) -> None:
        self._costs, self.at, self.cost = costs, at, math.inf
        self.better([at])

    def better(self, each: Sequence[Slips]) -> bool:
        """Whether one of them is, which is kept then."""
        before = self.cost
        for slips, tried in zip(each, self._costs(each), strict=True):
            if tried < self.cost - 1e-9:
                self.at, self.cost = slips, tried
        return self.cost < before


def _costs(fit: Fit, co: Co, each: Sequence[Slips]) -> Iterator[float]:
    """The criterion, up to a constant, price of the slips included."""
    n, error = len(co.u), (MODEL_ERROR * fit.misfit.record.pv_range) ** 2
    for slips, (gain, left) in zip(each, explained_by(fit.misfit, fit.p, co, each), strict=True):
        price = SLIP_COST * len(slips.rows) * math.log(n)
        yield n * math.log(max(left, 0.0) / n + error) + price if gain > 0 else math.inf


def _settled(start: Start, co: Co) -> Slipping:
    """Slips and process refined in turn, until neither helps."""
    best = _explained(start.misfit, co, start.slips, start.x)
    for _ in range(MOST_ROUNDS):
        slips = _varied(TriedSlips(partial(_costs, best.fit.fit, co), best.slips), co)
        after = _explained(best.fit.fit.misfit, co, slips, best.fit.fit.p)
        if after.criterion > best.criterion - LEAST_GAIN_PER_ROUND:
            break
        best = after
    return best


def _varied(trial: TriedSlips, co: Co) -> Slips:
    """Shares, starts and times in turn, then a slip less and one more where they pay."""
    at, n = trial.at, len(co.u)
    typical = median(co.bands(at)) if at.rows else 0.0
    shares = [at.share + step for step in FINE_SHARES if LOWEST_SHARE <= at.share + step <= HIGHEST_SHARE]
    trial.better([replace(at, share=share) for share in shares])
    trial.better([replace(trial.at, first=float(co.u[0]) + part * typical) for part in STARTS])
    for i in range(len(at.rows)):
        trial.better(one_moved(trial.at, i, n))
    for row in trial.at.rows:
        trial.better([replace(trial.at, rows=tuple(r for r in trial.at.rows if r != row))])
    while len(trial.at.rows) < MOST_SLIPS and trial.better(with_one_more(trial.at, n, TRIED)):
        pass
    return trial.at


def one_moved(at: Slips, which: int, n: int) -> list[Slips]:
    """One slip of n rows earlier or later, between its neighbours."""
    before, row, after = (0, *at.rows, n)[which : which + 3]
    moved = [row + move for move in MOVES if before < row + move < after]
    return [replace(at, rows=(*at.rows[:which], row, *at.rows[which + 1 :])) for row in moved]


def with_one_more(at: Slips, n: int, tried: int) -> list[Slips]:
    """One slip more, at so many rows of n."""
    places = [row for row in np.linspace(1, n - 1, tried).astype(int).tolist() if row not in at.rows]
    return [replace(at, rows=tuple(sorted((*at.rows, row)))) for row in places]


def _explained(misfit: Misfit, co: Co, slips: Slips, p: FloatArray) -> Slipping:
    position = co.position(slips)
    found = judged(refine(replace(misfit, co=position), p))
    price = (OWN_UNKNOWNS + SLIP_COST * len(slips.rows)) * math.log(len(position))
    stands = np.diff(position) == 0
    travel = float(np.sum(np.abs(np.diff(co.u))[stands])) / (misfit.record.co_range or 1.0)
    return Slipping(slips, found, found.criterion + price, travel, tuple(co.bands(slips).tolist()))
