"""Does a valve between co and the process make records likelier, with a load that wanders on top?

    l(x) = max over processes and loads of ln L(pv | x through the process)             (wandering_load.py)
    ln B = ln mean over valves of e^(l(valve's position) - l(co))

A valve that sticks moves in jumps, and a jump through the process is what no walk makes. The mean over valves is the
price of their numbers; process and load have the same freedom on both sides, so they have no price. Half of the valves
have play or follow after a slip, on a coarse grid; the other half slip all the way to co (He et al. 2007, J = S). There
each slip decides when the next one comes, so a band that is off by a hundredth may make another movement altogether:
240 bands are screened, 1,600 behind likely processes, and the likeliest compared closely.

What the grid of processes lacks passes for a valve, or hides one, the more so the less noise there is: under a setpoint
step of twelve standard deviations a quarter of a sample of dead time was e^230. So where a valve is in question both
sides have the process that suits them best, between the points of the grid (process_grid.py), and a walk that goes
through one lag or both. Of several records the grid tells which valve is one and the same.

A record begins anywhere in a valve's band, and shows one or two slips of one whose band is wider than co's range there:
so bands go to 1.6 ranges, and not all valves begin in the middle. Records of one loop have one and the same valve: its
band is the same in all of them, in units of co, or each has a band of its own. A setpoint step moves co by many bands,
and loads alone by one or two: neither shows by itself what both together do.
"""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from retuner.adaptive.explanations.jumping_load import JUMP_PRICE, MOST_JUMPS, delayed, shocks_that_pay
from retuner.adaptive.explanations.process_grid import DEAD_TIMES as OF_GRID
from retuner.adaptive.explanations.process_grid import ENOUGH, Nearest, likeliest, nearest, second_lags
from retuner.adaptive.explanations.tone import ToneColumns
from retuner.adaptive.explanations.wandering_load import (
    BOTH,
    FINE,
    SLOPE,
    T_SETPOINT,
    TEMPER,
    VALUE,
    Prepared,
    impulse_response,
    load_models,
    responses,
    under_loads,
)
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.valve.valve_model import Family, StuckValve
from retuner.schedule.late_dataclass import dataclass, replace

Valve = tuple[Family, float, float, float]
"""Band as a share of co's range, jump of the band, and where it stands in its band at first, -1 to 1."""
BANDS = (0.08, 0.12, 0.17, 0.24, 0.33, 0.45, 0.6, 0.8, 1.1, 1.6)
# Play comes to rest at an end of its band
MOVING: list[Valve] = [(Family.KANO, band, jump, 0.0) for band in BANDS for jump in (0.0, 0.5)]
MOVING += [(Family.KANO, band, 0.0, end) for band in (0.3, 0.7, 1.6) for end in (-1.0, 1.0)]
"""Play, and valves that follow after a slip (Kano et al. 2004)."""
SLIPPING: list[Valve] = [(Family.HE, float(band), 1.0, 0.0) for band in np.geomspace(0.05, 0.9, 160)]
SPREAD = math.sqrt(5.0) - 1.0  # its multiples, round and round from -1 to 1, are even over any stretch of the bands
SLIPPING += [
    (Family.HE, float(band), 1.0, i * SPREAD % 2.0 - 1.0) for i, band in enumerate(np.geomspace(0.05, 1.6, 80))
]
"""Valves that slip all the way."""
KINDS = (MOVING, SLIPPING)
FINER: list[Valve] = [(Family.HE, float(band), 1.0, 0.0) for band in np.geomspace(0.05, 0.9, 1600)]
"""Those again, behind likely processes: of seventeen slips the last ones are at other rows half a hundredth further."""
AROUND = np.arange(-2.0, 3.0)  # dead times beside that of a likely process
WEIGHT = TEMPER / T_SETPOINT
"""A valve's jump owes nothing to loads, as what a setpoint does: its likelihood is tempered as that is."""
LIKELIEST = 8  # valves of each kind out of those that are compared with second lags and under more loads
SCREENED, CLOSER_LOADS, CLOSER, CLOSELY = 2, 4, 2, 2
"""Likeliest loads under which all valves are compared, and those likeliest; starts of a search between the points of
the grid, and likeliest valves of each kind that have one."""
IN_QUESTION = -1.0
"""ln Bayes factor on the grid from which a valve is compared more closely. Not where the grid speaks against one:
behind a lag of half a sample any dead time fits, and co gains by that too. Both sides are compared so, or neither:
co's nearest process beside the grid's of a valve took e^0.7 to e^1.5 from valves that a tenth more had shown."""
STARTS = (-1.0, -0.5, 0.0, 0.5, 1.0)  # Where a valve that another record shows may stand first
LAGS = (1.0, 3.0, 7.0, 15.0, 33.0, 80.0, math.inf)
LATEST = 40.0  # dead time, samples: a slip that comes later than so is as likely to meet a jump of the load by chance
DEAD_TIMES = tuple(one for one in OF_GRID if one <= LATEST)
COARSE = (*DEAD_TIMES[::2], LATEST)
EVERY_DEAD = tuple(sorted({*DEAD_TIMES, *np.arange(LATEST + 1.0).tolist()}))
"""With next to no noise, or a valve that slips, a dead time that is a sample off hides a process."""
NO_TONE = ToneColumns(np.zeros((0, 0)), (0,), (0.0,))
Loads = Sequence[tuple[float, int]]
LOADS: Loads = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.2, 0.8, math.inf))
"""Bandwidth and order of the loads that are tried."""
FREE_LAGS = (0.5, *LAGS)
JUMPING: Loads = (
    *((one, VALUE) for one in (0.02, 0.1, 0.4, 0.8, math.inf)),
    *((math.inf, order) for order in (BOTH, SLOPE)),
    (0.1, SLOPE),
)
"""Loads that jump, or turn a corner, besides."""
TRIED, BEHIND = 4, 7.0
"""Pairs of load and lag beside whose first jump the process is looked for again, and how far behind a valve counts."""
LATE = 20
"""Rows after a change of the setpoint in which a jump comes with it."""
NEAR_LOADS: Loads = tuple((bandwidth, order) for order in (VALUE, SLOPE) for bandwidth in FINE)
EVERY_LOAD: Loads = (*NEAR_LOADS, *((bandwidth, BOTH) for bandwidth in FINE))
OCTAVES: Loads = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.1, 0.2, 0.4, 0.8, math.inf))
"""Those beside a valve, which takes the place of a lag or an octave that is missing."""


def positions(co: FloatArray, valves: Sequence[Valve]) -> tuple[list[int], FloatArray]:
    """Which valves move at all, and what each of these makes of co, from its first value; shape (valves, n)."""
    travel = float(np.ptp(co))
    each = [StuckValve(family, b * travel, j * b * travel, start).position(co) for family, b, j, start in valves]
    which = [i for i, position in enumerate(each) if np.ptp(position) > 0]
    return which, np.array([each[i] - each[i][0] for i in which])


def log_odds_of_valve(records: Sequence[Prepared], direction: int, tone: ToneColumns = NO_TONE) -> float:
    """Tempered logarithm of the Bayes factor of a valve that sticks or has play; 0 where no valve moves.

    records : of one loop. direction : sign of the process gain. tone : that every load may hold.
    """
    each = [one for record in records if (one := _compared(record, direction, tone)) is not None]
    alone = sum(one.odds for one in each)
    if len(each) < 2:
        return alone
    said = []
    for kind in range(len(KINDS)):
        valves = [valve for one in each for valve in one.likeliest[kind][: max(LIKELIEST // len(each), 1)]]
        together = np.sum([one.beside(valves) + one.odds - one.on_grid for one in each], axis=0)
        said.append(log_mean(together) + math.log(len(valves) / sum(one.among[kind] for one in each)))
    return log_mean(np.array([alone, log_mean(np.array(said))]))


@dataclass(frozen=True, slots=True)
class Given:
    """A record, the sign of the process gain, the tone that every load may hold, and the likeliest loads."""

    record: Prepared
    direction: int
    tone: ToneColumns
    loads: Loads = ()

    def weighed(
        self, rows: FloatArray, lag: float, loads: Loads, dead: Sequence[float], *,
        seconds: tuple[float, ...] | None = None,
    ) -> FloatArray:  # fmt: skip
        """Tempered log-likelihoods, shape (loads, second lags, rows, dead times); no gain of the wrong sign."""
        both = np.array([order == BOTH for _, order in loads])
        if seconds and len(seconds) > 1 and both.any():  # only a walk through both lags differs from one to the next
            found = np.empty((len(loads), len(seconds), len(rows), len(dead)))
            other, same = ([load for load in loads if (load[1] == BOTH) is of] for of in (True, False))
            if same:
                found[~both] = self.weighed(rows, lag, same, dead, seconds=seconds)
            for i, second in enumerate(seconds):
                found[both, i] = self.weighed(rows, lag, other, dead, seconds=(second,))[:, 0]
            return found
        given, tone = (self.record, rows, lag, loads, dead), self.tone
        fits = under_loads(*given, seconds=seconds, tones=tone.columns, ends=tone.taken)
        told = WEIGHT * fits.in_direction(self.direction).reshape(len(loads), len(tone.taken), -1, len(rows), len(dead))
        if len(tone.taken) == 1:
            return np.asarray(told[:, 0])
        return np.asarray(np.max(told - WEIGHT * np.array(tone.prices)[:, None, None, None] / TEMPER, axis=1))

    def screened(self, rows: FloatArray, loads: Loads, dead: Sequence[float]) -> FloatArray:
        """Tempered log-likelihood of rows behind one lag, the likeliest; shape (loads, rows)."""
        each = [self.weighed(rows, lag, loads, dead, seconds=(0.0,)) for lag in FREE_LAGS]
        return np.asarray(np.max(each, axis=(0, 2, 4)))

    def on_grid(self, rows: FloatArray) -> list[list[Nearest]]:
        """The likeliest points of the grid for each row, the likeliest first, one of each first lag."""
        found: list[list[Nearest]] = [[] for _ in rows]
        for lag in FREE_LAGS:
            each = self.weighed(rows, lag, self.loads, EVERY_DEAD).max(axis=0)
            for i, of_lag in enumerate(found):
                of_lag.append(likeliest(each[:, i], lag, second_lags(lag), EVERY_DEAD))
        return [sorted(of_lag, key=lambda one: -one.told) for of_lag in found]

    def finer(self, behind: Sequence[Nearest]) -> list[tuple[FloatArray, list[Nearest], float]]:
        """The likeliest of FINER behind some processes, with points of the grid, and ln of the share of each."""
        rows = positions(self.record.co, FINER)[1]
        firsts = np.flatnonzero(np.append(True, np.any(np.diff(rows, axis=0), axis=1)))
        many, rows = np.diff(np.append(firsts, len(rows))), rows[firsts]
        told = np.full(len(rows), -math.inf)
        for at in behind:
            dead = tuple(one for one in (at.dead + AROUND).tolist() if 0.0 <= one <= LATEST)
            each = self.weighed(rows, at.lag, self.loads[:SCREENED], dead, seconds=(at.second,))
            told = np.maximum(told, each.max(axis=(0, 1, 3)))
        more = np.log(many * (len(SLIPPING) / len(FINER)))
        best = np.argsort(-told - more, kind="stable")[:CLOSELY]
        return list(zip(rows[best], self.on_grid(rows[best]), more[best].tolist(), strict=True))

    def near(self, row: FloatArray, start: Nearest) -> Nearest:
        """The likeliest process between the points of the grid, near a start."""
        at = self.weighed(row[None], start.lag, EVERY_LOAD, (start.dead,), seconds=(start.second,))[:, 0, 0, 0]
        likely = [EVERY_LOAD[i] for i in np.argsort(-at, kind="stable")[:CLOSER_LOADS]]

        def told(lag: float, seconds: tuple[float, ...], dead: Sequence[float]) -> FloatArray:
            return np.asarray(self.weighed(row[None], lag, likely, dead, seconds=seconds)[:, :, 0].max(axis=0))

        return nearest(told, start, WEIGHT / TEMPER * ENOUGH, LATEST)

    def nearest(self, row: FloatArray, starts: Sequence[Nearest], known: Nearest | None = None) -> Nearest:
        """The likeliest near the first few of starts (known: near the very first)."""
        first, *others = starts[:CLOSER]
        return max(known or self.near(row, first), *(self.near(row, one) for one in others), key=lambda one: one.told)

    def with_jumps(self, row: FloatArray, tried: Sequence[Nearest], most: int = MOST_JUMPS) -> "Jumping":
        """An input under a load that jumps or turns corners, behind the process that suits it best then.

        tried : processes behind which jumps are looked for: a walk that leaves jumps over is likeliest behind another.
        """
        each = [self._jumps(row, at, load, most) for at in dict.fromkeys(tried) for load in JUMPING]
        each.sort(key=lambda one: -one.told)
        starts = []
        for one in each[:TRIED]:
            if one.rows:
                first, seconds = one.rows[0], second_lags(one.at.lag)
                told = self._beside(row, one.under, first, one.at.lag, seconds, EVERY_DEAD)
                starts.append((likeliest(told, one.at.lag, seconds, EVERY_DEAD), one.under, first))
        if not starts:
            return each[0]
        start, load, first = max(starts, key=lambda one: one[0].told)
        at = nearest(partial(self._beside, row, load, first), start, ENOUGH, LATEST)
        return max(each[0], self._jumps(row, at, load, most), key=lambda one: one.told)

    def _jumps(self, row: FloatArray, at: Nearest, load: tuple[float, int], most: int = MOST_JUMPS) -> "Jumping":
        """Jumps that pay behind a process."""
        moved = delayed(responses(row, at.lag, (at.second,))[0], at.dead)
        rows, told = shocks_that_pay(self.record, at.lag, load, moved, at.second * (load[1] == BOTH), most)
        return Jumping(told, rows, at, load)

    def temper_of(self, jumping: "Jumping") -> float:
        """What the lead of jumps beside co counts by: as a valve's slips do. But as loads do where one comes with a
        change of the setpoint, or several leave co less to do than one of them costs: then a valve may as well stand.
        """
        late = any(0 <= row - step < LATE for row in jumping.rows for step in self.record.stepped)
        none = self._jumps(np.zeros_like(self.record.co), jumping.at, jumping.under).told
        idle = len(jumping.rows) > 1 and jumping.told - none <= JUMP_PRICE * math.log(len(self.record.co))
        return TEMPER if late or idle else T_SETPOINT

    def _beside(
        self, row: FloatArray, load: tuple[float, int], jump: int, lag: float, seconds: tuple[float, ...],
        dead: Sequence[float],
    ) -> FloatArray:  # fmt: skip
        """ln L of an input beside a jump at this row, shape (second lags, dead times); not priced."""
        n, each = len(row), []
        for some in ((one,) for one in seconds) if load[1] == BOTH else (seconds,):
            (model,) = load_models(lag, load[:1], *((VALUE, some[0]) if load[1] == BOTH else load[1:]))
            jumped = delayed(impulse_response((1.0,), model.c, n), jump + 1)[None]
            fits = under_loads(self.record, row[None], lag, (load,), dead, seconds=some, tones=jumped, ends=(1,))
            each.append(TEMPER * fits.in_direction(self.direction)[0])
        return np.concatenate(each)


@dataclass(frozen=True, slots=True)
class Jumping:
    """told : ln L of an input under a load that jumps or turns corners at these rows, priced. at : the process. under :
    bandwidth and order of the load.
    """

    told: float
    rows: list[int]
    at: Nearest
    under: tuple[float, int]


@dataclass(frozen=True, slots=True)
class _Compared:
    """A record beside valves. free : tempered log-likelihood of co itself on the grid. odds, on_grid : ln Bayes factor,
    tempered, as closely as it was asked and on the grid. likeliest : valves of each kind, bands in co units, out of so
    many that move (among).
    """

    given: Given
    free: float
    odds: float
    on_grid: float
    likeliest: list[list[Valve]]
    among: list[int]

    def beside(self, valves: Sequence[Valve]) -> FloatArray:
        """ln Bayes factor of each valve on the grid, wherever it stood first; tempered."""
        given, co = self.given, self.given.record.co
        rows = np.array([[StuckValve(f, b, j * b, start).position(co) for start in STARTS] for f, b, j, _ in valves])
        rows -= rows[..., :1]
        found = given.screened(rows.reshape(-1, len(co)), given.loads[:SCREENED], EVERY_DEAD)
        at = np.argmax(found.max(axis=0).reshape(len(valves), -1), axis=1)
        told = [starts[0].told for starts in given.on_grid(rows[np.arange(len(valves)), at])]
        return np.array(told) - self.free


def _compared(record: Prepared, direction: int, tone: ToneColumns) -> _Compared | None:
    """A record beside all valves; None where co or every valve stands still."""
    travel = float(np.ptp(record.co))
    moved = [positions(record.co, valves) for valves in KINDS] if travel > 0 else [([], record.co)]
    if not all(which for which, _ in moved):
        return None
    given, co = Given(record, direction, tone), record.co
    sides = [given.screened(rows, OCTAVES, DEAD_TIMES).max(axis=1) for rows in (co[None], moved[0][1])]
    by_load = np.maximum(*(side - side.max() for side in sides))  # either side is compared under its own likeliest ones
    given = replace(given, loads=[OCTAVES[i] for i in np.argsort(-by_load, kind="stable")[:CLOSER_LOADS]])
    (own,), each, likeliest, leads = given.on_grid(co[None]), [], [], []
    screened_co = float(given.screened(co[None], given.loads[:SCREENED], EVERY_DEAD).max())
    for valves, (which, rows) in zip(KINDS, moved, strict=True):
        screened = given.screened(rows, given.loads[:SCREENED], EVERY_DEAD).max(axis=0)
        order = np.argsort(-screened, kind="stable")
        leads.append(screened[order] - screened_co)
        first = order[:LIKELIEST]
        by_grid = sorted(zip(first, given.on_grid(rows[first]), strict=True), key=lambda one: -one[1][0].told)
        each.append([(rows[i], starts, 0.0) for i, starts in by_grid])
        best = [valves[which[i]] for i, _ in by_grid]
        likeliest.append([(family, travel * band, jump, start) for family, band, jump, start in best])
    among, free, walk = [len(which) for which, _ in moved], own[0].told, own[0]
    by, told = free, [[starts[0].told for _, starts, _ in kind] for kind in each]
    on_grid = _odds(by, told, among, leads)
    if _odds(by, told, among) > IN_QUESTION:
        walk = given.near(co, own[0])
        finer = given.finer((walk, *(starts[0] for kind in each for _, starts, _ in kind[:CLOSELY])))
        each[1] = sorted([*finer, *each[1]], key=lambda one: -one[1][0].told - one[2])
        walk = given.nearest(co, own, walk)
        near = [[(*one, given.nearest(*one[:2])) for one in kind[:CLOSELY]] for kind in each]
        by, told = walk.told, [[one.told + more for *_, more, one in kind] for kind in near]
        if _odds(by, told, among) > 0.0 and not len(tone.columns):  # free jumps of a load explain what slips do
            least = max(one for of in told for one in of) - BEHIND
            near = [[one for one in kind if one[-1].told + one[2] >= least] for kind in near]
            by_co = given.with_jumps(co, (walk, *own))
            half = partial(_in_half, temper=given.temper_of(by_co))
            told = [
                [half(one, given.with_jumps(row, (one, *starts)).told) + more for row, starts, more, one in kind]
                for kind in near
            ]
            by = half(walk, by_co.told)
    return _Compared(given, free, _odds(by, told, among, leads), on_grid, likeliest, among)


def _in_half(walk: Nearest, told: float, temper: float) -> float:
    """Tempered log-likelihood of an input where in one half of cases the load jumps or turns corners besides.

    walk : the process where it only wanders. told : of with_jumps.
    """
    return walk.told + float(np.logaddexp(0.0, (told - T_SETPOINT * walk.told) / temper)) - math.log(2.0)


def _odds(
    by_co: float, told: Sequence[Sequence[float]], among: Sequence[int], leads: Sequence[FloatArray] = ()
) -> float:
    """ln Bayes factor of a valve, tempered. told : of the likeliest of each kind, out of so many.

    leads : of all valves of each kind over co as they were screened, the likeliest first. Those that were not compared
    closely keep behind the likeliest, and speak for no valve. Without them a record that shows none spoke against every
    one (ln B -1.5 to -2.9 where all valves are as likely as co).
    """
    each = [one - by_co - math.log(many * len(among)) for of, many in zip(told, among, strict=True) for one in of]
    for of, many, lead in zip(told, among, leads, strict=False):
        if of:
            rest = np.minimum(lead[len(of) :] + min(max(of) - by_co - float(lead[0]), 0.0), 0.0)
            each += (rest - math.log(many * len(among))).tolist()
    return float(np.logaddexp.reduce(each))


def log_mean(values: FloatArray) -> float:
    """Logarithm of the mean of exp(values)."""
    top = float(values.max())
    return top + math.log(float(np.mean(np.exp(values - top))))
