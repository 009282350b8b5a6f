"""Does a valve that slips at times of its own make a record likelier, with a load that wanders on top?

    y_i = (1 - r) u(t_i) + r y_(i-1) at row t_i, and stands until the next one         (valve/slips.py)
    ln B = max over slips of [ln L(y | process, load) - price]  -  ln L(co itself | process, load that jumps as well)

Valves of a fixed band (valve_odds.py) are compared on a grid of bands; one that differs from stop to stop is in none,
and of a fixed one a hundredth too much ends in another movement altogether. Here every slip has a time of its own, and
its size follows from co. What a time costs is what the bands say of it: with bands that scatter by s about their median
S, a slip is somewhere in the rows in which co was about S from the valve,
    price = sum of [z^2/2 + ln sum over the rows of its stand of exp(-z_row^2/2)] + 2 ln n,    z = ln(|u - y|/S)/s
so that even bands cost next to nothing, and a staircase that merely follows co costs a time for each stair.

Where the slips are is first seen from pv alone: as steps of free sizes through a process, whitened for a load that
wanders, one by one (orthogonal least squares, Chen, Billings & Luo 1989); and from the turns of co, which a slip turns
round. Then they are moved, dropped and joined by others while that pays.

A load may jump as well, or turn a corner (jumping_load.py). A slow triangle of a load under a fast loop looks like a
valve here: pv is a square under a triangle of co. Its rival is periodic_load.py.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from retuner.adaptive.explanations.jumping_load import shocks
from retuner.adaptive.explanations.process_grid import Nearest
from retuner.adaptive.explanations.valve_odds import COARSE, EVERY_DEAD, EVERY_LOAD, LAGS, NO_TONE, Given, Loads
from retuner.adaptive.explanations.wandering_load import SLOPE, T_SETPOINT, TEMPER, VALUE, Prepared, under_loads
from retuner.adaptive.signals.sample import FloatArray, median
from retuner.adaptive.valve.slips import Co, Slips, TriedSlips, one_moved, with_one_more
from retuner.schedule.late_dataclass import replace

SHOCK_LAGS, SECONDS, LONGEST = (2.0, 6.0, 15.0, 40.0, 120.0, math.inf), (0.0, 0.3), 20.0
"""First lags behind which steps are looked for, samples; second ones as shares of these, or of the longest."""
BESIDE: Loads = tuple((bandwidth, order) for order in (VALUE, SLOPE) for bandwidth in (0.05, 0.2, 0.8, math.inf))
STEPPING: Loads = ((0.1, VALUE), (0.8, VALUE))  # Bandwidths and orders of loads beside slips and co, and beside steps
MOST_STEPS, STEP_PRICE, LEAST_PRICE = 40, 5.0, 3.0
"""Steps at the most, the price of one that is a start only, and of one in the bound on slips. The bound is found by
trial: of 35 valves that were told, 34 have free steps at 3 each that are likelier than co itself by 15 or more, and one
has as many as are looked for."""
STARTS, POLISHED, ROUNDS = 12, 2, 3
"""Sets of steps that are tried as slips, those that are moved about, and how often at the most."""
LATE = (0, 1, 2, 4, 7, 12, 20)  # Samples between a slip and the step that it makes, or the turn of co
SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # r tried; every third at first
MOVES = (-12, -4, -1, 1, 4, 12)  # Rows by which a slip is moved
TRIED, PLACES, FEWEST, MOST_TURNS = 25, 7, 2, 40
"""Rows at which one more slip is tried; places where the valve may stand first; slips that make a law; turns of co."""
MOST_ROWS = 512  # Rows in which a record is looked at
Costs = Callable[[Sequence[Slips]], FloatArray]
OWN_NUMBERS = 4
"""Numbers of such a valve, at half of ln n each: middle and scatter of the bands, r, and where it stands first."""
EVEN, LEAST = 0.05, 1e-9
"""Scatter of the logarithms of bands that no valve is below; a band, and a share of rows, that is none."""


def log_odds_of_slips(record: Prepared, direction: int) -> float:
    """Tempered logarithm of the Bayes factor of a valve with slips of its own; -inf where none is nearly as likely.

    direction : sign of the process gain.
    """
    if not (np.ptp(record.co) > 0 and np.ptp(record.pv) > 0):
        return -math.inf
    record = record.coarser(MOST_ROWS)
    co = Co(record.co)
    by_co = alone(record, direction)
    seen, most = _steps_seen(record)
    if most < by_co:
        return -math.inf
    trials = [_settled(trial, co) for trial in _starts(record, direction, co, seen)]
    slips = min(trials, key=lambda trial: trial.cost, default=None)
    if slips is None:
        return -math.inf
    given = Given(record, direction, NO_TONE, BESIDE)
    told, at = _nearest(given, co, slips.at)
    if told <= by_co:
        return -math.inf
    told = max(told, _nearest(given, co, _settled(TriedSlips(_behind(given, co, slips.at, at), slips.at), co).at)[0])
    (own,) = given.on_grid(record.co[None])
    walk = given.nearest(record.co, own)
    by_co = max(T_SETPOINT * walk.told, given.with_jumps(record.co, (walk, *own)).told)
    return (told - by_co) / TEMPER


def alone(record: Prepared, direction: int) -> float:
    """The largest ln L of co itself."""
    return _through(record, direction, record.co, EVERY_DEAD)


def _through(record: Prepared, direction: int, moved: FloatArray, dead: Sequence[float]) -> float:
    """The largest ln L of an input behind a first lag and under a load."""
    return max(float(np.max(_told(record, direction, moved[None], lag, BESIDE, dead))) for lag in LAGS)


def _told(
    record: Prepared, direction: int, inputs: FloatArray, lag: float, loads: Loads, dead: Sequence[float]
) -> FloatArray:
    """ln L of inputs, each with its best second lag, dead time and gain of the right sign, shape (loads, inputs)."""
    fits = under_loads(record, inputs, lag, loads, dead)
    told = TEMPER * fits.in_direction(direction).max(axis=2)
    return np.asarray(told.reshape(len(loads), -1, len(inputs)).max(axis=1))


def _placed(co: Co, each: Sequence[Slips]) -> tuple[FloatArray, FloatArray]:
    """Where the valve is with slips each, from its first value, shape (slips, n); and their prices as in the head of
    this file.
    """
    u, n, position = co.u, len(co.u), co.positions(each)
    least, many = LEAST * float(np.ptp(u)), [len(slips.rows) for slips in each]
    of, rows = np.repeat(np.arange(len(each)), many), np.concatenate([slips.rows for slips in each])
    before = position[of, rows - 1]
    bands = np.log(np.maximum(np.abs(u[rows] - before), least))
    ends = list(pairwise(np.cumsum([0, *many]).tolist()))
    middles = np.array([sorted(bands[a:b].tolist())[(b - a) // 2] for a, b in ends])
    apart = bands - middles[of]
    squares = np.array([float(apart[a:b] @ apart[a:b]) for a, b in ends])
    scatters = np.maximum(np.sqrt(squares / many), EVEN)
    # rows of each slip's stand, and those from it to the next one
    firsts, lasts = [0, *(first for first, _ in ends[1:])], [last - 1 for _, last in ends]
    since, until = np.append(0, rows[:-1]), np.append(rows[1:], n)
    since[firsts], until[lasts] = 0, n
    counts = until - since
    begun = np.append(0, np.cumsum(counts)[:-1])
    away = np.abs(u[np.arange(counts.sum()) - np.repeat(begun - since, counts)] - np.repeat(before, counts))
    z = (np.log(np.maximum(away, least)) - np.repeat(middles[of], counts)) / np.repeat(scatters[of], counts)
    might = np.add.reduceat(np.exp(-0.5 * z * z), np.column_stack([begun, begun + rows - since]).ravel())
    might = np.log(might[::2] + might[1::2])
    times = np.array([float(np.sum(might[a:b])) for a, b in ends])
    return position - position[:, :1], times + squares / (2.0 * scatters**2) + OWN_NUMBERS / 2.0 * math.log(n)


def _costs(
    record: Prepared, direction: int, co: Co, lag: float, load: tuple[float, int], each: Sequence[Slips]
) -> FloatArray:
    """What slips behind one first lag under one load tell, with the sign turned and their price added."""
    if not each:
        return np.zeros(0)
    moved, prices = _placed(co, each)
    return np.asarray(prices - _told(record, direction, moved, lag, (load,), COARSE)[0])


def _nearest(given: Given, co: Co, slips: Slips) -> tuple[float, Nearest]:
    """ln L of slips with their price, behind the process that suits them best."""
    (position,), (price,) = _placed(co, [slips])
    (starts,) = given.on_grid(position[None])
    at = given.nearest(position, starts)
    return T_SETPOINT * at.told - float(price), at


def _behind(given: Given, co: Co, slips: Slips, at: Nearest) -> Costs:
    """What slips behind one process tell, under the load that is likeliest there; as of `_costs`."""
    (position, *_), _ = _placed(co, [slips])
    loads = given.weighed(position[None], at.lag, EVERY_LOAD, (at.dead,), seconds=(at.second,))
    load, dead = EVERY_LOAD[int(np.argmax(loads))], [max(at.dead + late, 0.0) for late in (-1.0, 0.0, 1.0)]

    def costs(each: Sequence[Slips]) -> FloatArray:
        if not each:
            return np.zeros(0)
        moved, prices = _placed(co, each)
        told = given.weighed(moved, at.lag, (load,), dead, seconds=(at.second,))[0, 0].max(axis=1)
        return np.asarray(prices - T_SETPOINT * told)

    return costs


def _steps_seen(record: Prepared) -> tuple[list[list[int]], float]:
    """Sets of rows at which pv steps, the likeliest first; and ln L that a valve which slips is not taken to pass.

    Its slips are steps whose sizes are not free. Where steps are as many as are looked for, there is no bound.
    """
    found, most = [], -math.inf
    for lag in SHOCK_LAGS:
        for second in (share * min(lag, LONGEST) for share in SECONDS):
            for load in STEPPING:
                rows, told = shocks(record, lag, second, load, MOST_STEPS)
                counts = np.arange(len(told))
                free, priced = told - LEAST_PRICE * counts, told - STEP_PRICE * counts
                most = math.inf if np.argmax(free) == MOST_STEPS else max(most, float(np.max(free)))
                found.append((float(np.max(priced)), sorted(rows[: int(np.argmax(priced))])))
    return [rows for _, rows in sorted(found, key=lambda one: -one[0])[:STARTS]], most


def _starts(record: Prepared, direction: int, co: Co, seen: list[list[int]]) -> Iterator[TriedSlips]:
    """The likeliest slips as they are first seen. seen : sets of rows of steps of pv."""
    seen = [*seen, *([turns] if len(turns := co.turns()) <= MOST_TURNS else [])]
    each = dict.fromkeys(
        Slips(tuple(sorted({max(row - late, 1) for row in rows})), share, float(co.u[0]))
        for rows in seen
        if len(rows) >= FEWEST
        for late in LATE
        for share in SHARES[::3]
    )
    if not each:
        return
    moved, prices = _placed(co, list(each))
    behind = [(lag, load) for lag in LAGS for load in STEPPING]
    told = np.concatenate([_told(record, direction, moved, lag, STEPPING, EVERY_DEAD) for lag in LAGS]) - prices
    taken: set[tuple[int, ...]] = set()
    for i, slips in sorted(enumerate(each), key=lambda one: -float(told[:, one[0]].max())):
        if slips.rows not in taken and len(taken) < POLISHED:
            taken.add(slips.rows)
            yield TriedSlips(partial(_costs, record, direction, co, *behind[int(np.argmax(told[:, i]))]), slips)


def _settled(trial: TriedSlips, co: Co) -> TriedSlips:
    """Shares, starts and times in turn, slips less and one more, until nothing pays."""
    n = len(co.u)
    for _ in range(ROUNDS):
        before = trial.cost
        trial.better([replace(trial.at, share=share) for share in SHARES])
        typical = median(co.bands(trial.at))
        firsts = float(co.u[0]) + typical * np.linspace(-1.0, 1.0, PLACES)
        trial.better([replace(trial.at, first=first) for first in firsts.tolist()])
        i = 0
        while i < len(trial.at.rows):
            trial.better(_moved(trial.at, i, n))
            i += 1
        while len(trial.at.rows) < MOST_STEPS and trial.better(with_one_more(trial.at, n, TRIED)):
            pass
        if trial.cost > before - 1.0:
            break
    return trial


def _moved(at: Slips, which: int, n: int) -> list[Slips]:
    """One slip earlier or later, between its neighbours; or left out, alone and with the next one."""
    without = [at.rows[:which] + at.rows[which + count :] for count in (1, 2)]
    return one_moved(at, which, n) + [replace(at, rows=one) for one in without if len(one) >= FEWEST]
