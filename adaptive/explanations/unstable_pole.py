"""A process that runs away by itself, told from all others by samples, whatever load moved them.

    G(s) = k e^(-theta s) / ((tau1 s - 1)(tau2 s + 1))     against the same with tau1 s + 1, and with tau1 s

    odds = prior odds (L_away / L_others)^(1/T)

L is the likelihood of the book (wandering_load.py, with its T): co is the input, whatever made it, and every process
has the same loads that wander, and the same tone, to explain the record by. pv is predicted from sample to sample: a
simulation of such a process would run away while the loop stood. On the book's grid the next pole is a factor of two
away, and a clear step is far from all that stands there. So from the likeliest of some on either side the lags, dead
time and gain go on to the best there is (Nelder & Mead 1965), with loads beside its own.
"""

import math
from collections.abc import Sequence
from itertools import product
from operator import attrgetter

import numpy as np

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, LAGS
from retuner.adaptive.explanations.tone import likeliest_tone
from retuner.adaptive.explanations.wandering_load import (
    AT_PV,
    LOADS_OF_BOOK,
    MOST_SAMPLES,
    SLOPE,
    T_SETPOINT,
    VALUE,
    Prepared,
    setpoint_share,
    temper,
    under_loads,
)
from retuner.adaptive.identification.estimate import STRUCTURE_STD, LogModel, proper_covariance
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass, replace

GROWS = (-6.0, -12.0, -25.0, -50.0, -100.0, -200.0, -400.0)
RESTS = (1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0, 400.0, math.inf)
SECONDS, LONGEST_SECOND = (0.0, 0.7, 2.0, 5.0, 12.0), 0.9
"""First lags, as the grid counts them, and second lags from which processes are looked for, samples; longest second lag
as a share of the first."""
Load = tuple[float, int]
RUNAWAYS = 0.02
"""Probability that a process runs away by itself, before any record: exothermic reactors, some tanks and vehicles."""
FEWEST_ROWS, MOST_LEAD = 60, 10.0  # samples of a record that may tell; largest lead of one
MOST_TRIES = 80  # likelihoods of a refinement
SEEN = (
    ((0.05, VALUE), (0.2, VALUE), (0.8, VALUE), (math.inf, VALUE)),
    ((0.05, SLOPE), (0.4, SLOPE)),
    ((0.2, AT_PV),),
)
"""Loads under which starts are chosen, by order; a process that runs away has none at pv, as in the book."""
FINE_LOADS = {order: tuple(load for load in LOADS_OF_BOOK if load[1] == order) for order in (VALUE, SLOPE, AT_PV)}
BESIDE = 2
"""Loads by order and bandwidth, and how many on both sides of a process's own it may have while it is refined."""
APART = 0.3  # steps of the logarithms of lags and dead time from which a refinement begins
CLOSE = 0.1, 0.02  # of the logarithm of the likelihood, and of lags and dead time, at which it ends
LEAST_LAG, MOST_DEAD = 0.1, 60.0  # samples: a shorter lag cannot be seen; the longest dead time
LONGEST = math.log(1e4)  # of the first lag, ln samples: a longer one integrates
MOST_GAIN = 1e100  # of the wrong sign, in the units of pv and co: its square is a number
SLOPE_AT = 0.1  # step of the logarithms from which curvatures are taken
USUAL = (1.0, 1.0, 0.1)
"""What is known beside the record of ln tau2, ln theta, ln tau1, as an information: the first two, which may be too
short to be seen, to a factor of e."""


@dataclass(frozen=True, slots=True)
class _Point:
    """A process and its load. likelihood : its logarithm. lag, second, dead : in samples, the lag as in the grid.

    walk : bandwidth and order of its load. gain, information : of least squares. variance : what it leaves of a row.
    """

    likelihood: float
    lag: float
    second: float
    dead: float
    walk: Load
    gain: float
    information: float
    variance: float


LIKELIHOOD = attrgetter("likelihood")


@dataclass(frozen=True, slots=True)
class _Record:
    """A record as it is compared: tones that a load may hold besides, shape (number, n), how many of them each
    explanation takes, and the logarithm of the price of each.
    """

    rows: Prepared
    direction: int
    tones: FloatArray
    ends: tuple[int, ...] = (0,)
    prices: tuple[float, ...] = (0.0,)

    def best(self, lag: float, second: float, dead_times: Sequence[float], loads: Sequence[Load]) -> _Point:
        """The likeliest dead time and load of these."""
        given = (self.rows, self.rows.co[None], lag, loads, dead_times)
        fits = under_loads(*given, through=second, tones=self.tones, ends=self.ends, again=len(dead_times) > 1)
        wrong = np.where(fits.gain * self.direction > 0, 0.0, np.minimum(np.abs(fits.gain), MOST_GAIN))
        left = fits.left + fits.information * wrong**2
        each = -0.5 * fits.freedom[:, None] * np.log(left[:, 0] / fits.size) - np.tile(self.prices, len(loads))[:, None]
        i, j = (int(at) for at in np.unravel_index(int(np.argmax(each)), each.shape))
        numbers = (fits.gain[i, 0, j], fits.information[i, 0, j], left[i, 0, j] / fits.freedom[i])
        own = loads[i // len(self.ends)]
        return _Point(float(each[i, j]), lag, second, dead_times[j], own, *(float(x) for x in numbers))

    def best_of(self, lags: Sequence[float], beside: Sequence[_Point] = (), enough: float = math.inf) -> _Point:
        """The likeliest process with first lags of one sign, from the likeliest of these under each order of load on.

        beside : others from which it is looked for. enough : likelihood from which none likelier is looked for.
        """
        pairs = [(lag, second) for lag in lags for second in SECONDS if second < LONGEST_SECOND * abs(lag)]
        each = SEEN if lags[0] > 0 else SEEN[:-1]
        starts = [max((self.best(*pair, DEAD_TIMES, loads) for pair in pairs), key=LIKELIHOOD) for loads in each]
        found: list[_Point] = []
        for start in (*sorted(starts, key=LIKELIHOOD, reverse=True), *beside):
            found.append(self._refined(start))
            if found[-1].likelihood >= enough:
                break
        return max(found, key=LIKELIHOOD)

    def at(self, x: FloatArray, start: _Point) -> _Point:
        """The process of ln second, ln dead time (and ln first lag, unless it integrates), with a load beside that of
        another point.
        """
        second, dead = (math.exp(min(max(float(v), math.log(LEAST_LAG)), math.log(MOST_DEAD))) for v in x[:2])
        lag = math.copysign(math.exp(min(float(x[2]), LONGEST)), start.lag) if len(x) > 2 else start.lag
        of_order = FINE_LOADS[start.walk[1]]
        at = of_order.index(start.walk)
        return self.best(lag, second, (dead,), of_order[max(at - BESIDE, 0) : at + BESIDE + 1])

    def _refined(self, start: _Point) -> _Point:
        """The best near a start."""
        from scipy.optimize import minimize

        def cost(at: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
            return -self.at(at, start).likelihood

        x = logs_of(start)
        corners = np.vstack([x, x + APART * np.eye(len(x))])
        done = minimize(
            cost, x.tolist(), method="Nelder-Mead",
            options={"initial_simplex": corners, "maxfev": MOST_TRIES, "fatol": CLOSE[0], "xatol": CLOSE[1]},
        )  # fmt: skip
        return self.at(np.asarray(done.x, dtype=np.float64), start)


def logs_of(point: _Point) -> FloatArray:
    """What is free of a process: ln second, ln dead time, ln first lag."""
    free = (max(point.second, LEAST_LAG), max(point.dead, LEAST_LAG), abs(point.lag))
    return np.log(free[: 2 if math.isinf(point.lag) else 3])


@dataclass(frozen=True, slots=True)
class UnstablePole:
    """lead : logarithm of how much likelier, tempered, the best process that runs away by itself is than any other.
    at : that one, in a record. tempered : T.
    """

    lead: float
    record: _Record
    at: _Point
    tempered: float

    def probability(self, prior: float) -> float:
        """That the process runs away by itself, where it was so likely before the record."""
        return 1.0 / (1.0 + (1.0 - prior) / prior * math.exp(-self.lead))

    @property
    def log(self) -> LogModel:
        """The process with the covariance of what is free of it, by the curvature of the tempered likelihood."""
        x, n = logs_of(self.at), 3
        steps = SLOPE_AT * np.eye(n)
        told = {(i, s): self.record.at(x + s * steps[i], self.at) for i, s in product(range(n), (-1, 1))}
        bend, slope = np.zeros((n, n)), np.zeros(n)
        for i in range(n):
            up, down = told[i, 1], told[i, -1]
            bend[i, i] = 2.0 * self.at.likelihood - up.likelihood - down.likelihood
            slope[i] = math.log(abs(up.gain / down.gain)) / (2.0 * SLOPE_AT)
            for j in range(i):
                both = self.record.at(x + steps[i] + steps[j], self.at).likelihood
                bend[i, j] = bend[j, i] = up.likelihood + told[j, 1].likelihood - both - self.at.likelihood
        sizes, ways = np.linalg.eigh(bend / (SLOPE_AT**2 * self.tempered))
        free = np.linalg.inv((ways * np.maximum(sizes, 0.0)) @ ways.T + np.diag(USUAL))
        # ln k' = ln K - ln tau1, ln theta, ln tau1, ln tau2 from ln tau2, ln theta, ln tau1
        turn = np.array([[slope[0], slope[1], slope[2] - 1.0], [0, 1, 0], [0, 0, 1], [1, 0, 0]])
        p = turn @ free @ turn.T + STRUCTURE_STD**2 * np.eye(4)
        p[0, 0] += self.tempered * self.at.variance / (self.at.information * self.at.gain**2)
        dt = math.log(self.record.rows.sample_time_s)
        logs = np.array([math.log(abs(self.at.gain)) - x[2] - dt, x[1] + dt, x[2] + dt, x[0] + dt])
        return LogModel(logs, proper_covariance(p), self.record.direction, ProcessType.RUNAWAY)


def unstable_pole(window: Window, direction: int, least: float = 0.0) -> UnstablePole | None:
    """How likely the process runs away by itself, and which one it is then; None where the record tells nothing.

    direction : sign of its gain. least : a lead under this need not be told exactly.
    """
    dt = window.sample_time_s * -(-len(window.t_s) // MOST_SAMPLES)
    rows = Prepared.at(window, dt)
    if len(rows.pv) < FEWEST_ROWS or not np.ptp(rows.co) > 0 or not np.ptp(rows.pv) > 0:
        return None
    record = _Record(rows, direction, np.zeros((0, len(rows.pv))))
    away = record.best_of(GROWS)
    other = record.best_of(RESTS, enough=away.likelihood - least * T_SETPOINT)
    moved = Prepared.at(replace(window, pv=window.sp), dt).pv
    known = max((lag for lag in LAGS if lag <= other.lag), default=LAGS[0])
    tempered = temper(setpoint_share(rows, moved, known)[1])
    if away.likelihood - other.likelihood > tempered:  # a tone, or another start, may take the lead away
        error = Prepared.at(replace(window, pv=window.sp - window.pv), dt).pv
        record = _Record(rows, direction, *likeliest_tone(error))
        away = record.best_of(GROWS)
        other = record.best_of(RESTS, [replace(away, lag=lag) for lag in (-away.lag, math.inf)])
    lead = min(max((away.likelihood - other.likelihood) / tempered, -MOST_LEAD), MOST_LEAD)
    return UnstablePole(lead, record, away, tempered)
