"""Does a valve between co and the process make records likelier, with a load that wanders on top?

    l(x) = max over processes and loads of ln L(pv | x through the process)             (wandering_load.py)
    ln B = ln mean over valves of e^(l(valve's position) - l(co))

A valve that sticks moves in jumps, and a jump through the process is what no walk makes. The mean over valves is the
price of their numbers; process and load have the same freedom on both sides, so they have no price. Half of the valves
have play or follow after a slip, on a coarse grid; the other half slip all the way to co (He et al. 2007, J = S). There
each slip decides when the next one comes, so a band that is off by a hundredth may make another movement altogether:
240 bands are screened, the likeliest compared closely.

What the grid of processes lacks passes for a valve, or hides one, the more so the less noise there is: under a setpoint
step of twelve standard deviations a quarter of a sample of dead time was e^230. So both sides have dead times of an
eighth of a sample, and co itself may go through one short lag besides, or through the process that a fit found.

A record begins anywhere in a valve's band, and shows one or two slips of one whose band is wider than co's range there:
so bands go to 1.6 ranges, and not all valves begin in the middle. Records of one loop have one and the same valve: its
band is the same in all of them, in units of co, or each has a band of its own. A setpoint step moves co by many bands,
and loads alone by one or two: neither shows by itself what both together do.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.explanations.jumping_load import delayed, shocks_that_pay
from retuner.adaptive.explanations.process_grid import DEAD_TIMES as EVERY_DEAD_TIME
from retuner.adaptive.explanations.tone import ToneColumns
from retuner.adaptive.explanations.wandering_load import (
    SLOPE,
    T_SETPOINT,
    TEMPER,
    VALUE,
    Prepared,
    filtered,
    impulse_response,
    pole_of,
    responses,
    spectrum,
    under_loads,
)
from retuner.adaptive.process.model import ProcessModel
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
WEIGHT = TEMPER / T_SETPOINT
"""A valve's jump owes nothing to loads, as what a setpoint does: its likelihood is tempered as that is."""
LIKELIEST = 8  # valves of each kind out of those that are compared with second lags and under more loads
SCREENED, CLOSER_LOADS, CLOSER_LAGS = 2, 4, 2
"""Likeliest loads under which all valves are compared, and those likeliest; first lags that get finer dead times."""
STARTS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Where a valve that another record shows may stand first."""
LAGS = (1.0, 3.0, 7.0, 15.0, 33.0, 80.0, math.inf)
SHORT = (1.0, 2.0, 4.0)
"""Lags, samples, one of which co itself may go through besides."""
DEAD_TIMES = (0.0, 1.0, 2.0, 4.0, 7.0, 12.0)
FREE_DEAD_TIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.0, 9.0, 12.0)
FINER = tuple((np.arange(-8, 9) / 8).tolist())
"""Dead times, and those beside the likeliest: half a sample that a grid lacks was taken for a valve, where the noise is
small."""
NO_TONE = ToneColumns(np.zeros((0, 0)), (0,), (0.0,))
Loads = Sequence[tuple[float, int]]
LOADS: Loads = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.2, 0.8, math.inf))
"""Bandwidth and order of the loads that are tried."""
FREE_LAGS = (0.5, *LAGS)
JUMPING: Loads = ((0.1, VALUE), (0.8, VALUE), (0.1, SLOPE))  # those that jump besides
JUMPED, SEARCHED = 2, 4  # likeliest valves of each kind that are compared beside such a load, and pairs of lags of each
OCTAVES: Loads = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.1, 0.2, 0.4, 0.8, math.inf))
"""Those beside a valve, which takes the place of a lag or an octave that is missing."""


def positions(co: FloatArray, valves: Sequence[Valve]) -> tuple[list[int], FloatArray]:
    """Which valves move at all, and what each of these makes of co, from its first value; shape (valves, n)."""
    travel = float(np.ptp(co))
    each = [StuckValve(family, b * travel, j * b * travel, start).position(co) for family, b, j, start in valves]
    which = [i for i, position in enumerate(each) if np.ptp(position) > 0]
    return which, np.array([each[i] - each[i][0] for i in which])


def log_odds_of_valve(
    records: Sequence[Prepared], direction: int, tone: ToneColumns = NO_TONE, fitted: ProcessModel | None = None
) -> float:
    """Tempered logarithm of the Bayes factor of a valve that sticks or has play; 0 where no valve moves.

    records : of one loop. direction : sign of the process gain. tone : that every load may hold. fitted : the process
    by a fit to one of them.
    """
    each = [one for record in records if (one := _compared(record, direction, tone, fitted)) is not None]
    alone = sum(one.odds for one in each)
    if len(each) < 2:
        return alone
    said = []
    for kind in range(len(KINDS)):
        valves = [valve for one in each for valve in one.likeliest[kind][: max(LIKELIEST // len(each), 1)]]
        together = np.sum([one.beside(valves) for one in each], axis=0)
        said.append(log_mean(together) + math.log(len(valves) / sum(one.among[kind] for one in each)))
    return log_mean(np.array([alone, log_mean(np.array(said))]))


@dataclass(frozen=True, slots=True)
class _Compared:
    """A record beside valves. loads : the likeliest. free : tempered log-likelihood of co itself. odds : ln Bayes
    factor, tempered. likeliest : valves of each kind, bands in co units, out of so many that move (among). jumps :
    whether loads that jump are asked.
    """

    record: Prepared
    direction: int
    tone: ToneColumns
    loads: Loads
    free: float
    odds: float
    likeliest: list[list[Valve]]
    among: list[int]
    jumps: bool = False

    def beside(self, valves: Sequence[Valve]) -> FloatArray:
        """ln Bayes factor of each valve, wherever it stood first; tempered."""
        co = self.record.co
        rows = np.array([[StuckValve(f, b, j * b, start).position(co) for start in STARTS] for f, b, j, _ in valves])
        rows -= rows[..., :1]
        found = _screened(self.record, self.direction, self.tone, rows.reshape(-1, len(co)), self.loads[:SCREENED])
        at = np.argmax(found.max(axis=0).reshape(len(valves), -1), axis=1)
        rows = rows[np.arange(len(valves)), at]
        found = _likeliest(self.record, self.direction, self.tone, rows, self.loads)
        if self.jumps:
            found = np.array([self.jumping(*one) for one in zip(rows, found.tolist(), strict=True)])
        return found - self.free

    def jumping(
        self, row: FloatArray, told: float, fitted: Sequence[tuple[float, float, FloatArray, float]] = ()
    ) -> float:
        """Tempered log-likelihood of an input where in one half of cases the load jumps or turns corners besides.

        told : where it only wanders. fitted : first and second lag, what a process by a fit makes of the input, and the
        price of its numbers: a walk that leaves jumps over is likeliest behind another one. Jumps count as loads do.
        """
        given = self.record, self.direction, self.tone, row[None]
        each = [_weighed(*given, lag, self.loads, FREE_DEAD_TIMES)[:, :, 0].max(axis=0) for lag in FREE_LAGS]
        pairs = [(k, through) for k, one in enumerate(each) for through in range(len(one))]
        tried = list(fitted)
        for k, through in sorted(pairs, key=lambda at: -float(each[at[0]][at[1]].max()))[:SEARCHED]:
            dead = int(FREE_DEAD_TIMES[int(np.argmax(each[k][through]))])
            tried.append((FREE_LAGS[k], 0.0, delayed(responses(row, FREE_LAGS[k])[through], dead), 0.0))
        most = max(
            shocks_that_pay(self.record, lag, load, late, by)[1] - cost
            for lag, by, late, cost in tried
            for load in JUMPING
        )
        return told + float(np.logaddexp(0.0, (most - T_SETPOINT * told) / TEMPER)) - math.log(2.0)


def _compared(record: Prepared, direction: int, tone: ToneColumns, fitted: ProcessModel | None) -> _Compared | None:
    """A record beside all valves; None where co or every valve stands still. fitted : of log_odds_of_valve."""
    travel = float(np.ptp(record.co))
    moved = [positions(record.co, valves) for valves in KINDS] if travel > 0 else [([], record.co)]
    if not all(which for which, _ in moved):
        return None
    co = np.array([record.co, *(through_lag(record.co, lag) for lag in SHORT)])
    sides = [_screened(record, direction, tone, rows, OCTAVES).max(axis=1) for rows in (co, moved[0][1])]
    by_load = np.maximum(*(side - side.max() for side in sides))  # either side is compared under its own likeliest ones
    loads = [OCTAVES[i] for i in np.argsort(-by_load, kind="stable")[:CLOSER_LOADS]]
    free = float(_likeliest(record, direction, tone, co, loads, len(FREE_LAGS)).max())
    own = []
    if fitted is not None:
        lag, second, dead = lags_of(fitted, record)
        through = through_lag(record.co, second)
        by_fit = _weighed(record, direction, tone, through[None], lag, loads, (dead,), first_only=True)
        price = FITTED_NUMBERS / 2.0 * math.log(len(record.pv))
        free = max(free, float(by_fit.max()) - price / TEMPER)
        own = [(lag, second, delayed(responses(through, lag)[0], dead), price)]
    said, likeliest, beside = [], [], []
    for valves, (which, rows) in zip(KINDS, moved, strict=True):
        screened = _screened(record, direction, tone, rows, loads[:SCREENED]).max(axis=0)
        first = np.argsort(-screened, kind="stable")[:LIKELIEST]
        found = _likeliest(record, direction, tone, rows[first], loads) - free
        said.append(log_mean(found) + math.log(len(first) / len(which)))
        order = np.argsort(-found, kind="stable")
        best = [valves[which[i]] for i in first[order]]
        likeliest.append([(family, travel * band, jump, start) for family, band, jump, start in best])
        beside.append((rows[first[order[:JUMPED]]], found[order[:JUMPED]] + free))
    among = [len(which) for which, _ in moved]
    one = _Compared(record, direction, tone, loads, free, log_mean(np.array(said)), likeliest, among)
    if one.odds <= 0.0 or len(tone.columns):
        return one
    # free jumps of a load explain what the slips of a valve do, so both sides have them
    one, said = replace(one, free=one.jumping(record.co, free, own), jumps=True), []
    for (rows, found), many in zip(beside, among, strict=True):
        with_jumps = np.array([one.jumping(*each) for each in zip(rows, found.tolist(), strict=True)]) - one.free
        said.append(log_mean(with_jumps) + math.log(len(rows) / many))
    return replace(one, odds=log_mean(np.array(said)))


def _screened(record: Prepared, direction: int, tone: ToneColumns, rows: FloatArray, loads: Loads) -> FloatArray:
    """Tempered log-likelihood of rows behind one lag, the likeliest; shape (loads, rows)."""
    each = [_weighed(record, direction, tone, rows, lag, loads, FREE_DEAD_TIMES, first_only=True) for lag in FREE_LAGS]
    return np.asarray(np.max(each, axis=(0, 2, 4)))


def _likeliest(
    record: Prepared, direction: int, tone: ToneColumns, rows: FloatArray, loads: Loads, lags: int = CLOSER_LAGS
) -> FloatArray:
    """Tempered log-likelihood of each row with its likeliest process and load.

    lags : first ones that get finer dead times.
    """
    each = [_weighed(record, direction, tone, rows, lag, loads, FREE_DEAD_TIMES).max(axis=(0, 1)) for lag in FREE_LAGS]
    found = np.full(len(rows), -math.inf)
    for i in range(len(rows)):
        for k in np.argsort([-float(one[i].max()) for one in each], kind="stable")[:lags]:
            late = FREE_DEAD_TIMES[int(np.argmax(each[k][i]))]
            dead = tuple(late + part for part in FINER if late + part >= 0.0)
            closer = _weighed(record, direction, tone, rows[i : i + 1], FREE_LAGS[k], loads, dead)
            found[i] = max(found[i], float(closer.max()))
    return found


def lags_of(fitted: ProcessModel, record: Prepared) -> tuple[float, float, float]:
    """First and second lag of a process, and its dead time, in samples of a record."""
    dt = record.sample_time_s
    first = math.inf if fitted.linear().integrators else max(fitted.tau1_s / dt, LEAST_LAG)
    return first, fitted.tau2_s / dt, min(fitted.theta_s / dt, EVERY_DEAD_TIME[-1])


LEAST_LAG = 0.02  # samples; a shorter one is none
FITTED_NUMBERS = 3.0  # of a process that was fitted: each costs half of the logarithm of the samples (Schwarz 1978)


def through_lag(rows: FloatArray, lag: float) -> FloatArray:
    """Rows through a lag in samples, from rest."""
    if lag < LEAST_LAG:
        return rows
    n, pole = rows.shape[-1], pole_of(lag)
    return filtered(spectrum(rows), n, impulse_response((1.0 - pole,), (1.0, -pole), n))


def _weighed(
    record: Prepared, direction: int, tone: ToneColumns, rows: FloatArray, lag: float, loads: Loads,
    dead: tuple[float, ...], *, first_only: bool = False,
) -> FloatArray:  # fmt: skip
    """Tempered log-likelihoods, shape (loads, second lags, rows, dead times); no gain of the wrong sign."""
    fits = under_loads(record, rows, lag, loads, dead, first_only=first_only, tones=tone.columns, ends=tone.taken)
    right = np.where(fits.gain * direction > 0, fits.gain, 0.0)
    each = fits.tempered(right[..., None]).reshape(len(loads), len(tone.taken), -1, len(rows), len(dead))
    return np.asarray(WEIGHT * np.max(each - np.array(tone.prices)[:, None, None, None] / TEMPER, axis=1))


def log_mean(values: FloatArray) -> float:
    """Logarithm of the mean of exp(values)."""
    top = float(values.max())
    return top + math.log(float(np.mean(np.exp(values - top))))
