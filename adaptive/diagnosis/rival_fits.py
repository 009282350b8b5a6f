"""Three explanations of one record, fitted with the same engine and compared by the same criterion.

    linear     pv = G co + load steps + random walk                          the loop's own doing, and ordinary upsets
    external   the same + a sinusoid with harmonics at a free frequency      an oscillation from outside
    stuck      the same with co replaced by the output of a stuck valve      see sticking.py

Harmonics belong to the second, because what comes from outside is often another loop's limit cycle, a triangle or a
saw, which one sinusoid leaves to the valve. What is left counts as it is, not whitened: even one real pole takes an
oscillation that is slow against the sampling for noise.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise, product

import numpy as np

from retuner.adaptive.fit.dynamics import Dynamics
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import USEFUL, Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import Fit, refine
from retuner.adaptive.fit.search import with_second_lag
from retuner.adaptive.fit.structure import SLOPE
from retuner.adaptive.identification.candidate import Candidate, Seen, judged
from retuner.adaptive.identification.loads import improved
from retuner.adaptive.identification.structure_choice import ChoiceSettings, candidates
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window

HARMONICS = 5
"""Of an outside oscillation: a triangle or a saw is told from its first five to two percent."""
MORE_HARMONICS = 11
"""The same where a loop shows its slope instead, as squares with sharp corners."""
SHARP = 4
"""Samples in the shortest wave of those, at least."""
WHITE = 0
"""Order of the filter for what is left: a filter would whiten any slow oscillation without naming its cause."""
WEAKENED = 3.0
"""The process is also tried with a gain e^-3 of the linear one: next to a tone it may have no part at all."""


def linear(window: Window, signs: tuple[int, ...], settings: ChoiceSettings, most_samples: int) -> list[Candidate]:
    """The linear explanation in every structure, best first."""
    return candidates(window, signs, settings, most_samples)


def external(fit: Candidate, frequencies: list[float], most_loads: int) -> Candidate:
    """The best explanation with a tone from outside.

    fit : the linear one. frequencies : where to look, rad/s.
    """
    found = []
    base = replace(fit.fit.misfit, harmonics=HARMONICS, ar=(), sigma=fit.fit.misfit.record.noise_std)
    plain = replace(base, loads=0, rounded=False)
    x = fit.fit.x
    weak = x.copy()
    weak[SLOPE] -= WEAKENED
    for w in frequencies:
        found.append(judged(refine(base, np.append(fit.fit.p, np.log(w)))))
        starts = (x, weak) if base.loads else (weak,)  # without loads the first is the one above
        found += [judged(refine(plain, np.append(start, np.log(w)))) for start in starts]
        found.append(judged(refine(*_afresh(plain, w))))
    best = min(found, key=lambda c: c.criterion)
    return improved(best, most_loads, Seen(found))


def sharper(tone: Candidate) -> Candidate:
    """The same tone with as many harmonics as sharp corners need, where the record shows them and they pay."""
    record = tone.fit.misfit.record
    period_s = 2 * math.pi / math.exp(float(tone.fit.p[-1]))
    if period_s < SHARP * MORE_HARMONICS * record.sample_time_s:
        return tone
    finer = judged(refine(replace(tone.fit.misfit, harmonics=MORE_HARMONICS), tone.fit.p))
    return min(tone, finer, key=lambda c: c.criterion)


FRESH_LAGS = (2.0, 8.0, 30.0, 120.0)
FRESH_THETAS = (1.0, 4.0, 16.0)
"""Samples in the lag and dead time that a process beside a tone is looked for with."""
FRESH_GAINS = (0.1, 0.3, 1.0, 3.0)
"""Its gain in ranges of pv over ranges of co."""


def _afresh(plain: Misfit, w: float) -> tuple[Misfit, FloatArray]:
    """A first-order process beside a tone, from a grid: load steps bought instead of the tone lead the process astray.

    plain : without load steps. w : of the tone, rad/s.
    """
    record, misfit = plain.record, replace(plain, type=ProcessType.FOPDT)
    dt, usual = record.sample_time_s, record.pv_range / (record.co_range or 1.0)
    points = [
        np.array([np.log(gain * usual / (lag * dt)), np.log(theta * dt), np.log(lag * dt), np.log(w)])
        for lag, theta, gain in product(FRESH_LAGS, FRESH_THETAS, FRESH_GAINS)
    ]
    return misfit, points[int(np.argmin(misfit.costs(points)))]


# A valve that sticks: the two published two-parameter models, S the stick band, J the slip jump, in units of co.
#
#     f_s = (S + J)/2 static and f_d = (S - J)/2 kinetic friction
#
#     Kano et al. (2004)   at rest: stays until |u - y| > f_s; in motion: y = u - d f_d, and rests when u stops or turns
#     He et al. (2007)     friction is overcome anew at every sample: y moves by the push less f_d whenever the push,
#                          what was left plus the change of u, exceeds f_s
#
# After a reversal Kano's valve rests until co has travelled S, He's until S to S + J, then it jumps by J; going on in
# one direction, Kano's follows and He's moves in steps of J. J = 0 is backlash. Real valves do either (Garcia 2008).


class Family(StrEnum):
    """Which of the two models."""

    KANO = "kano"
    HE = "he"


@dataclass(frozen=True, slots=True)
class StuckValve:
    """A valve.

    family : model. stick : S > 0. jump : J, 0 <= J <= 2 S (S at the most in He's model).
    start : where the valve stands in its band when the record begins, -1 to 1 in units of f_s.

    Raises
    ------
    ValueError
        A number is outside its range.
    """

    family: Family
    stick: float
    jump: float
    start: float = 0.0

    def __post_init__(self) -> None:
        most = 2 * self.stick if self.family == Family.KANO else self.stick
        if not (0 < self.stick < math.inf and 0 <= self.jump <= most * (1 + 1e-12)):
            raise ValueError(f"stiction band {self.stick}, jump {self.jump}: band above 0, jump up to {most}")
        if not -1 <= self.start <= 1:
            raise ValueError(f"start {self.start} is outside the band, -1 to 1")

    def position(self, co: FloatArray) -> FloatArray:
        """Position of the valve for the controller output co, shape (n,)."""
        f_static, f_kinetic = (self.stick + self.jump) / 2, (self.stick - self.jump) / 2
        run = _kano if self.family == Family.KANO else _he
        return np.array(run(co.tolist(), f_static, f_kinetic, self.start * f_static))

    def numbers(self) -> tuple[float, float, float, float]:
        """Family (0 Kano, 1 He), stick, jump and start, as the compiled engine takes them."""
        return float(self.family == Family.HE), self.stick, self.jump, self.start


def _kano(co: list[float], f_static: float, f_kinetic: float, start: float) -> list[float]:
    y, direction, moving = co[0] + start, 0, False
    found = [y]
    for before, u in pairwise(co):
        change = u - before
        if moving and change * direction <= 0:
            moving = False
        if not moving and abs(u - y) > f_static:
            moving, direction = True, 1 if u > y else -1
        if moving:
            y = u - direction * f_kinetic
        found.append(y)
    return found


def _he(co: list[float], f_static: float, f_kinetic: float, start: float) -> list[float]:
    y, left = co[0] + start, -start
    found = [y]
    for before, u in pairwise(co):
        push = left + u - before
        if push > f_static or -push > f_static:
            left = math.copysign(f_kinetic, push)
            y += push - left
        else:
            left = push
        found.append(y)
    return found


# The explanation of a record by a valve that sticks: which band, which jump, and which process behind it.
#
# The sum of squares has a valley in S that is narrower than 5 %, and many others. So bands, jumps and both valve models
# are scanned with first-order dynamics on a grid first; the best few are refined with their process, scanned finely
# round S, J and the place where the valve stood when the record began, and refined again with a second lag and loads.


STICK_NODES = 45
STICK_RANGE = (0.1, 1.2)
"""Stick bands tried, as shares of the usual travel of co within a period."""
JUMP_SHARES = {Family.KANO: (0.0, 0.3, 0.6, 0.9, 1.2), Family.HE: (0.3, 0.6, 0.95)}
"""Slip jumps tried, as shares of the stick band."""
LAGS_PER_PERIOD = (0.02, 0.1, 0.4, 1.5, 20.0)
THETAS_PER_PERIOD = (0.01, 0.06, 0.15, 0.3)
"""Dynamics tried for every band, as shares of the period."""
FINALISTS = 6
"""Valves that are refined."""
FINE = (0.85, 0.93, 0.97, 0.99, 1.01, 1.03, 1.07, 1.15)
"""Factors of the fine scan."""
STARTS = tuple(i / 10 for i in range(-10, 11))
"""Places in the band tried for the beginning of the record."""
POLISHED = 3
"""Of the finalists, those that are scanned and refined until nothing helps."""
ROUNDS = 8
"""Rounds of fine scan and refinement at the most."""
ENOUGH = 0.5
"""A round must lower the criterion by this."""
UNKNOWN_START = 0.6
"""Periods after which a valve has slipped at least once, and where it stood first no longer matters."""
MOST_ROWS = 500
"""Rows of the coarse scan."""
NOTHING_NEW = 1e-12
"""A column of whose square less than this share is its own says nothing: a valve that stood still in these rows."""
LEAST_TRAVEL = 0.05
"""The usual travel of co counts as at least this share of its range."""


@dataclass(frozen=True, slots=True)
class Sticking:
    """A stuck valve that explains a record, and the fit of the record with it."""

    valve: StuckValve
    fit: Candidate


def turns_s(sticking: Sticking) -> FloatArray:
    """When the valve of an explanation turns round, in record time."""
    record = sticking.fit.fit.misfit.record
    moved = np.diff(sticking.valve.position(record.co))
    rows = np.flatnonzero(moved)
    return np.asarray(record.t_s[rows[1:][np.diff(np.sign(moved[rows])) != 0]], dtype=np.float64)


def sticking(linear: Candidate, period_s: float, most_loads: int) -> Sticking:
    """The best explanation with a stuck valve.

    linear : the explanation without. period_s : of the oscillation, or a typical time of the record's movement.
    """
    record, sign = linear.fit.misfit.record, linear.fit.misfit.sign
    ranked = _scanned(record, sign, period_s)
    misfit = replace(
        linear.fit.misfit,
        type=ProcessType.FOPDT,
        loads=0,
        sigma=record.noise_std,
        ar=(),
        ramp=False,
        rounded=False,
        harmonics=0,
        most_order=WHITE,
    )
    firsts = [_with_lag(_fine(_refined(misfit, valve, x))) for valve, x in ranked]
    closest = sorted(firsts, key=lambda s: s.fit.criterion)[:POLISHED]
    best = min((_settled(s) for s in closest), key=lambda s: s.fit.criterion)
    return replace(best, fit=improved(best.fit, most_loads, Seen([best.fit])))


def _settled(at: Sticking) -> Sticking:
    """Fine scans and refinements in turn, until neither helps."""
    for _ in range(ROUNDS):
        after = _fine(at)
        if after.fit.criterion >= at.fit.criterion - ENOUGH:
            return _with_lag(at)
        at = after
    return _with_lag(at)


def _scanned(record: Record, sign: int, period_s: float) -> list[tuple[StuckValve, FloatArray]]:
    """The best valves on the grid, each with x of first order."""
    travel, nodes = _travel(record, period_s), Nodes.of(record, period_s)
    valves, pairs = list(_grid(travel)), nodes.pairs()
    engine = compiled()
    if engine is not None:
        left, gain = engine.valves_scanned(record, [v.numbers() for v in valves], nodes)
    else:
        left, gain = _through(record, valves, nodes)
    left = np.where(gain * sign > 0, left, np.inf).ravel()
    best = [i for i in np.argsort(left, kind="stable")[:FINALISTS].tolist() if math.isfinite(left[i])]
    if not best:
        usual = np.log([record.pv_range / travel / period_s, pairs[0][1], pairs[0][0]])
        return [(StuckValve(Family.KANO, STICK_RANGE[0] * travel, 0.0), usual)]
    found = []
    for i in best:
        lag, theta = pairs[i % len(pairs)]
        found.append((valves[i // len(pairs)], np.log([abs(gain.ravel()[i]), theta, lag])))
    return found


def _grid(travel: float) -> Iterator[StuckValve]:
    """Valves of both models."""
    for stick in (np.geomspace(*STICK_RANGE, STICK_NODES) * travel).tolist():
        for family, shares in JUMP_SHARES.items():
            for share in shares:
                yield StuckValve(family, stick, share * stick)


def _travel(record: Record, period_s: float) -> float:
    """Usual travel of co within a period."""
    n = max(int(period_s / record.sample_time_s), 3)
    pieces = [record.co[i : i + n] for i in range(0, max(len(record.co) - n, 1), n)]
    return max(float(np.median([np.ptp(piece) for piece in pieces])), LEAST_TRAVEL * record.co_range)


@dataclass(frozen=True, slots=True)
class Nodes:
    """First-order dynamics of the scan, on the rows that it looks at.

    lags_s, thetas_s : every pair is a node. basis : shape (lags, 3, rows), orthonormal, of bias, start and trend.
    free : shape (lags, rows), pv without them.
    """

    lags_s: FloatArray
    thetas_s: FloatArray
    rows: slice
    basis: FloatArray
    free: FloatArray

    @classmethod
    def of(cls, record: Record, period_s: float) -> "Nodes":
        """The nodes for a record with a swing."""
        rows, dt = _rows(record, period_s), record.sample_time_s
        t, pv = record.t_s[rows], record.pv[rows]
        lags = [max(share * period_s, dt) for share in LAGS_PER_PERIOD]
        basis = []
        for lag in lags:
            start = Dynamics(0.0, 1 / lag).step(t - t[0] + dt)
            basis.append(np.linalg.qr(np.stack([np.ones_like(t), start / start[-1], t / t[-1]], axis=1))[0].T)
        thetas = [max(share * period_s, dt / 2) for share in THETAS_PER_PERIOD]
        free = [pv - q.T @ (q @ pv) for q in basis]
        return cls(np.array(lags), np.array(thetas), rows, np.array(basis), np.array(free))

    def pairs(self) -> list[tuple[float, float]]:
        """Lag and dead time of every node."""
        return list(product(self.lags_s.tolist(), self.thetas_s.tolist()))


def _rows(record: Record, period_s: float) -> slice:
    """The rows that the coarse scan looks at: thinned, and without the time in which the valve's start still tells."""
    n = len(record.pv)
    first = int(UNKNOWN_START * period_s / record.sample_time_s)
    return slice(first if first < n // 3 else 0, None, -(-n // MOST_ROWS))


def _through(record: Record, valves: list[StuckValve], nodes: Nodes) -> tuple[FloatArray, FloatArray]:
    """Sum of squares and slope gain with every valve's position as input, shape (valves, nodes)."""
    pairs = nodes.pairs()
    left, gain = np.full((len(valves), len(pairs)), np.inf), np.zeros((len(valves), len(pairs)))
    for i, valve in enumerate(valves):
        moved = _moved(record, valve)
        for j, (lag, theta) in enumerate(pairs) if np.ptp(moved) > 0 else ():
            q, y = nodes.basis[j // len(nodes.thetas_s)], nodes.free[j // len(nodes.thetas_s)]
            column = Dynamics(0.0, 1 / lag).held(record.clock, moved, theta)[nodes.rows]
            gain[i, j], left[i, j] = _projected(y, column, column - q.T @ (q @ column))
    return left, gain


def _projected(y: FloatArray, column: FloatArray, free: FloatArray) -> tuple[float, float]:
    """Coefficient of a column and what it leaves of y. free : the column without what else explains y."""
    size, whole = float(free @ free), float(y @ y)
    if not size > NOTHING_NEW * float(column @ column):
        return 0.0, whole
    gain = float(y @ free) / size
    return gain, whole - gain**2 * size


def _moved(record: Record, valve: StuckValve) -> FloatArray:
    """Position of the valve, counted from its first value."""
    engine = compiled()
    if engine is not None:
        travelled: FloatArray = engine.valve_travel(valve.numbers(), record.co)
        return travelled
    position = valve.position(record.co)
    return np.asarray(position - position[0], dtype=np.float64)


def _refined(misfit: Misfit, valve: StuckValve, x: FloatArray) -> Sticking:
    """One valve with its process refined."""
    return Sticking(valve, judged(refine(replace(misfit, co=_moved(misfit.record, valve)), x)))


def _with_lag(at: Sticking) -> Sticking:
    """The same with a second lag, where that pays."""
    if at.fit.fit.misfit.type != ProcessType.FOPDT:
        return at
    richer = judged(with_second_lag(at.fit.fit, ProcessType.SOPDT, [], 1))
    return replace(at, fit=richer) if richer.criterion < at.fit.criterion else at


def _fine(at: Sticking) -> Sticking:
    """Neighbouring bands, jumps and starts with the process held, then refined from the best of them."""
    fit: Fit = at.fit.fit
    best, (cost,) = at.valve, _costs(fit, [at.valve])
    for around in (_starts, _bands, _jumps, _sticks):
        valves = around(best)
        for valve, tried in zip(valves, _costs(fit, valves), strict=True):
            if tried < cost:
                best, cost = valve, tried
    if best is at.valve:
        return at
    return _refined(fit.misfit, best, fit.p)


def _costs(fit: Fit, valves: list[StuckValve]) -> list[float]:
    """Sum of squares with lags and dead time held, and the gain, which another band changes, free as well."""
    misfit, record, engine = fit.misfit, fit.misfit.record, compiled()
    if engine is not None:
        costs: list[float] = engine.valve_costs(misfit, fit.p, [v.numbers() for v in valves])
        return costs
    columns, _ = misfit.columns(fit.p)
    size = np.abs(np.diag(np.linalg.qr(columns)[1]))
    q, _ = np.linalg.qr(columns[:, size > USEFUL * np.max(size)])
    y = record.pv - q @ (q.T @ record.pv)
    found = []
    for valve in valves:
        moved = replace(misfit, co=_moved(record, valve)).moved(fit.p)
        found.append(_projected(y, moved, moved - q @ (q.T @ moved))[1])
    return found


def _starts(valve: StuckValve) -> list[StuckValve]:
    return [replace(valve, start=start) for start in STARTS if start != valve.start]


def _bands(valve: StuckValve) -> list[StuckValve]:
    return [replace(valve, stick=valve.stick * f, jump=valve.jump * f) for f in FINE]


def _sticks(valve: StuckValve) -> list[StuckValve]:
    most = 2.0 if valve.family == Family.KANO else 1.0
    return [replace(valve, stick=valve.stick * f) for f in FINE if valve.jump <= most * valve.stick * f]


def _jumps(valve: StuckValve) -> list[StuckValve]:
    most = 2.0 if valve.family == Family.KANO else 1.0
    return [replace(valve, jump=min(max(valve.jump, 0.05 * valve.stick) * f, most * valve.stick)) for f in FINE]
