"""The explanation of a record by a valve that sticks (valve/valve_model.py).

The sum of squares has a valley in S that is narrower than 5 %, and many others; a wrong band makes up for a lag or a
dead time that the scan does not have. So bands, jumps and both valve models are scanned on a grid with one lag and
with two, each of the best valleys again with band, jump, lag and dead time together; then they are refined with their
process, scanned finely round S, J and where the valve stood when the record began, and refined again with loads.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import product

import numpy as np

from retuner.adaptive.fit.dynamics import Dynamics
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import USEFUL, WHITE, Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import Fit, refine
from retuner.adaptive.fit.search import with_second_lag
from retuner.adaptive.identification.candidate import Candidate, CandidateList, judged
from retuner.adaptive.identification.loads import improved
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, median
from retuner.adaptive.valve.valve_model import Family, StuckValve
from retuner.schedule.late_dataclass import dataclass, replace

STICK_NODES = 45
STICK_RANGE = (0.1, 1.2)  # Stick bands tried, as shares of the usual travel of co within a period
JUMP_SHARES = {Family.KANO: (0.0, 0.3, 0.6, 0.9, 1.2), Family.HE: (0.3, 0.6, 0.95)}
"""Slip jumps tried, as shares of the stick band."""
LAGS_PER_PERIOD = ((0.02, 0.0), (0.1, 0.0), (0.1, 0.05), (0.4, 0.03), (1.5, 0.03), (20.0, 0.03))
THETAS_PER_PERIOD = (0.01, 0.06, 0.12, 0.2, 0.32)
"""Dynamics tried for every band, as shares of the period: lag and second lag, dead time."""
VALLEYS = 8  # valves that are scanned again and refined, each of another valley
VALLEY_WIDTH = 0.09  # bands of one valley differ by less than this (in logarithms)
APART_JUMPS = 0.31  # jumps of one valley differ by less than this share of the band
NEAR_STICKS, NEAR_JUMPS, NEAR_STARTS = (0.92, 0.96, 1.0, 1.04, 1.08), (-0.15, 0.0, 0.15), (-0.15, 0.0, 0.15)
NEAR_LAGS, NEAR_THETAS = (0.6, 1.0, 1.7), (-0.03, 0.0, 0.03)
"""The second scan: factors of band and lags; what is added to the share of the jump, to the start and to the dead time
in periods."""
FINE = (0.85, 0.93, 0.97, 0.99, 1.01, 1.03, 1.07, 1.15)  # factors of the fine scan
STARTS = tuple(i / 10 for i in range(-10, 11))  # places in the band tried for the beginning of the record
PLAYS = (0.02, 0.04, 0.07, 0.1, 0.14, 0.2)  # play that is tried, as shares of co's range
FINE_STARTS = (-0.06, -0.03, -0.015, 0.015, 0.03, 0.06)
"""Steps of it: the first slip comes earlier or later with it, and the beginning of the record hangs on that."""
POLISHED = 3  # number of starts that are scanned and refined until nothing helps
MOST_POLISH_ROUNDS = 8  # rounds of fine scan and refinement at the most
LEAST_FALL = 0.5  # A round must lower the criterion by this
UNKNOWN_START = 0.6  # periods after which a valve has slipped at least once, and where it stood first no longer matters
MOST_ROWS = 350  # rows of the coarse scan
NOTHING_NEW = 1e-12
"""A column of whose square less than this share is its own says nothing: a valve that stood still in these rows."""
LEAST_TRAVEL = 0.05  # the usual travel of co counts as at least this share of its range


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
    firsts = [with_lag(fine(refined(bare(linear.fit.misfit, type_), valve, x))) for valve, type_, x in ranked]
    closest = sorted(firsts, key=lambda s: s.fit.criterion)[:POLISHED]
    best = min((settled(s) for s in closest), key=lambda s: s.fit.criterion)
    return replace(best, fit=improved(best.fit, most_loads, CandidateList([best.fit])))


def bare(misfit: Misfit, type_: ProcessType) -> Misfit:
    """The misfit of a structure without loads, drift and filter."""
    return replace(
        misfit, type=type_, loads=0, corners=0, sigma=misfit.record.noise_std, ar=(), ramp=False, rounded=False,
        harmonics=0, most_order=WHITE,
    )  # fmt: skip


def with_play(linear: Candidate, most_loads: int) -> Sticking:
    """The explanation by a valve with play that is best, from the process of the explanation without.

    linear : that one. Play (J = 0) reads as a longer lag and an integral too strong, where it is not looked for, and as
    load steps; so it is tried with those of the linear explanation, and with none at first.
    """
    kept = linear.fit.misfit
    tried = []
    for share in PLAYS:
        valves = [StuckValve(Family.KANO, share * kept.record.co_range, 0.0, start) for start in STARTS]
        tried.append(valves[int(np.argmin(valve_costs(linear.fit, valves)))])
    rivals = [fine(_played(kept, tried, linear.fit.p))]
    if kept.loads:
        plain = fine(_played(replace(kept, loads=0, corners=0, rounded=False), tried, linear.fit.x))
        rivals.append(replace(plain, fit=improved(plain.fit, most_loads, CandidateList([plain.fit]))))
    return min(rivals, key=lambda s: s.fit.criterion)


def _played(misfit: Misfit, tried: list[StuckValve], p: FloatArray) -> Sticking:
    """The best play of those that are tried, refined. p : of misfit, from which each begins."""
    return min((refined(misfit, valve, p) for valve in tried), key=lambda s: s.fit.criterion)


def settled(at: Sticking) -> Sticking:
    """Fine scans and refinements in turn, until neither helps."""
    for _ in range(MOST_POLISH_ROUNDS):
        after = fine(at)
        if after.fit.criterion >= at.fit.criterion - LEAST_FALL:
            return with_lag(at)
        at = after
    return with_lag(at)


Ranked = tuple[StuckValve, ProcessType, FloatArray]  # A valve with the structure and the parameters of its process


def _scanned(record: Record, sign: int, period_s: float) -> list[Ranked]:
    """The best valves, each of another valley, with x of their process."""
    nodes, (travel, valves) = Nodes.of(record, period_s), valves_tried(record, period_s)
    left, _ = explained(record, sign, valves, nodes)
    node = np.argmin(left, axis=1)
    best = left[np.arange(len(valves)), node]
    found: list[tuple[float, Ranked]] = []
    for i in valleys(valves, best):
        (lag, second), theta = nodes.at(int(node[i]))
        thetas = [theta + more * period_s for more in NEAR_THETAS]
        near = Nodes.made(record, nodes.rows, [(lag * f, second * f) for f in NEAR_LAGS], thetas)
        around = list(_near(valves[i]))
        closer, gain = explained(record, sign, around, near)
        j, k = np.unravel_index(int(np.argmin(closer)), closer.shape)
        found.append((float(closer[j, k]), (around[j], *near.started(int(k), float(gain[j, k])))))
    if not found:
        usual = np.log([record.pv_range / travel / period_s, float(nodes.thetas_s[0]), float(nodes.lags_s[0])])
        return [(StuckValve(Family.KANO, STICK_RANGE[0] * travel, 0.0), ProcessType.FOPDT, usual)]
    return [ranked for _, ranked in sorted(found, key=lambda f: f[0])]


def valleys(valves: Sequence[StuckValve], left: FloatArray) -> list[int]:
    """Numbers of the best valves, none of them beside a better one."""
    found: list[int] = []
    for i in np.argsort(left, kind="stable").tolist():
        if len(found) == VALLEYS or not math.isfinite(left[i]):
            break
        a = valves[i]
        if not any(
            abs(math.log(a.stick / b.stick)) < VALLEY_WIDTH
            and abs(a.jump / a.stick - b.jump / b.stick) < APART_JUMPS
            and a.family == b.family
            for b in (valves[other] for other in found)
        ):
            found.append(i)
    return found


def _near(valve: StuckValve) -> Iterator[StuckValve]:
    most = 2.0 if valve.family == Family.KANO else 1.0
    shares = {min(max(valve.jump / valve.stick + more, 0.0), most) for more in NEAR_JUMPS}
    starts = {min(max(valve.start + more, -1.0), 1.0) for more in NEAR_STARTS}
    for factor, share, start in product(NEAR_STICKS, sorted(shares), sorted(starts)):
        yield StuckValve(valve.family, valve.stick * factor, share * valve.stick * factor, start)


def explained(record: Record, sign: int, valves: list[StuckValve], nodes: "Nodes") -> tuple[FloatArray, FloatArray]:
    """Sum of squares, infinite where the gain has the wrong sign, and gain of every valve at every node."""
    engine = compiled()
    if engine is not None:
        left, gain = engine.valves_scanned(record, [v.numbers() for v in valves], nodes)
    else:
        left, gain = _through(record, valves, nodes)
    return np.where(gain * sign > 0, left, np.inf), np.abs(gain)


def valves_tried(record: Record, period_s: float) -> tuple[float, list[StuckValve]]:
    """The usual travel of co within a period, and the valves of a grid of bands and jumps.

    Each starts from either of the levels between which it goes, where co goes as far beyond both: a valve never forgets
    where it stood, as each slip comes a band or a jump after the last. In a cycle it stands half a jump above the
    middle of co, or half a jump below.
    """
    n, co = max(int(period_s / record.sample_time_s), 3), record.co
    pieces = [co[i : i + n] for i in range(0, max(len(co) - n, 1), n)]
    travel = max(median([np.ptp(piece) for piece in pieces]), LEAST_TRAVEL * record.co_range)
    middle = (float(np.max(co[:n])) + float(np.min(co[:n]))) / 2
    found = []
    for stick in (np.geomspace(*STICK_RANGE, STICK_NODES) * travel).tolist():
        for family, shares in JUMP_SHARES.items():
            for jump in (share * stick for share in shares):
                for side in (1, -1) if jump else (1,):
                    start = 2 * (middle + side * jump / 2 - float(co[0])) / (stick + jump)
                    found.append(StuckValve(family, stick, jump, min(max(start, -1.0), 1.0)))
    return travel, found


@dataclass(frozen=True, slots=True)
class Nodes:
    """Dynamics of a scan, on the rows that it looks at.

    lags_s, seconds_s : a lag and a second one (0 for none). thetas_s : every pair of lags with one is a node.
    basis : shape (lags, 3, rows), orthonormal, of bias, start and trend. free : shape (lags, rows), pv without them.
    """

    lags_s: FloatArray
    seconds_s: FloatArray
    thetas_s: FloatArray
    rows: slice
    basis: FloatArray
    free: FloatArray

    @classmethod
    def of(cls, record: Record, period_s: float) -> "Nodes":
        """The nodes for a record with a swing."""
        n, first = len(record.pv), int(UNKNOWN_START * period_s / record.sample_time_s)
        rows = slice(first if first < n // 3 else 0, None, -(-n // MOST_ROWS))  # thinned, once the start tells no more
        lags = [(lag * period_s, second * period_s) for lag, second in LAGS_PER_PERIOD]
        return cls.made(record, rows, lags, [share * period_s for share in THETAS_PER_PERIOD])

    @classmethod
    def made(cls, record: Record, rows: slice, lags: list[tuple[float, float]], thetas: list[float]) -> "Nodes":
        """The nodes of given lags (a second one beside each, 0 for none) and dead times."""
        dt = record.sample_time_s
        t, pv = record.t_s[rows], record.pv[rows]
        longest = [max(lag, dt) for lag, _ in lags]
        basis = []
        for lag in longest:
            start = Dynamics(0.0, 1 / lag).step(t - t[0] + dt)
            basis.append(np.linalg.qr(np.stack([np.ones_like(t), start / start[-1], t / t[-1]], axis=1))[0].T)
        free = [pv - q.T @ (q @ pv) for q in basis]
        seconds = np.array([second if second > dt else 0.0 for _, second in lags])
        late = np.array(sorted({max(theta, dt / 2) for theta in thetas}))
        return cls(np.array(longest), seconds, late, rows, np.array(basis), np.array(free))

    def at(self, node: int) -> tuple[tuple[float, float], float]:
        """Lags and dead time of a node."""
        lag, theta = divmod(node, len(self.thetas_s))
        return (float(self.lags_s[lag]), float(self.seconds_s[lag])), float(self.thetas_s[theta])

    def started(self, node: int, gain: float) -> tuple[ProcessType, FloatArray]:
        """Structure and parameters of a node. gain : slope of its first lag."""
        (lag, second), theta = self.at(node)
        if not second:
            return ProcessType.FOPDT, np.log([gain, theta, lag])
        total = lag + second
        return ProcessType.SOPDT, np.log([gain * lag / total, theta, total, lag * second / total])


def _through(record: Record, valves: list[StuckValve], nodes: Nodes) -> tuple[FloatArray, FloatArray]:
    """Sum of squares and slope gain with every valve's position as input, shape (valves, nodes)."""
    many = len(nodes.lags_s) * len(nodes.thetas_s)
    left, gain = np.full((len(valves), many), np.inf), np.zeros((len(valves), many))
    for i, valve in enumerate(valves):
        moved = _moved(record, valve)
        seconds = nodes.seconds_s.tolist() if np.ptp(moved) > 0 else []
        late = [Dynamics(0.0, 1 / s).held(record.clock, moved, 0.0) / s if s else moved for s in seconds]
        for j in range(many) if late else ():
            lag, theta = divmod(j, len(nodes.thetas_s))
            q, y = nodes.basis[lag], nodes.free[lag]
            through = Dynamics(0.0, 1 / float(nodes.lags_s[lag]))
            column = through.held(record.clock, late[lag], float(nodes.thetas_s[theta]))[nodes.rows]
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
    position = valve.position(record.co)
    return np.asarray(position - position[0], dtype=np.float64)


def refined(misfit: Misfit, valve: StuckValve, x: FloatArray) -> Sticking:
    """One valve with its process refined."""
    return Sticking(valve, judged(refine(replace(misfit, co=_moved(misfit.record, valve)), x)))


def with_lag(at: Sticking) -> Sticking:
    """The explanation with a second lag, where that pays."""
    if at.fit.fit.misfit.type != ProcessType.FOPDT:
        return at
    richer = judged(with_second_lag(at.fit.fit, ProcessType.SOPDT, [], 1))
    return replace(at, fit=richer) if richer.criterion < at.fit.criterion else at


def fine(at: Sticking) -> Sticking:
    """Neighbouring bands, jumps and starts with the process held, then refined from the best of them."""
    fit: Fit = at.fit.fit
    best, (cost,) = at.valve, valve_costs(fit, [at.valve])
    for around in (_starts, _bands, _jumps, _sticks):
        valves = around(best)
        for valve, tried in zip(valves, valve_costs(fit, valves), strict=True):
            if tried < cost:
                best, cost = valve, tried
    if best is at.valve:
        return at
    return refined(fit.misfit, best, fit.p)


def valve_costs(fit: Fit, valves: list[StuckValve]) -> list[float]:
    """Sum of squares with lags and dead time held, and the gain, which another band changes, free as well."""
    misfit, record, engine = fit.misfit, fit.misfit.record, compiled()
    if engine is not None:
        costs: list[float] = engine.valve_costs(misfit, fit.p, [v.numbers() for v in valves])
        return costs
    return [left for _, left in with_best_gain(misfit, fit.p, (_moved(record, valve) for valve in valves))]


def with_best_gain(misfit: Misfit, p: FloatArray, inputs: Iterable[FloatArray]) -> Iterator[tuple[float, float]]:
    """Gain, in units of the held one, and sum of squares with it, for every input in place of co."""
    columns, _ = misfit.columns(p)
    size = np.abs(np.diag(np.linalg.qr(columns)[1]))
    q, _ = np.linalg.qr(columns[:, size > USEFUL * np.max(size)])
    y = misfit.record.pv - q @ (q.T @ misfit.record.pv)
    for co in inputs:
        moved = replace(misfit, co=co).moved(p)
        yield _projected(y, moved, moved - q @ (q.T @ moved))


def _starts(valve: StuckValve) -> list[StuckValve]:
    near = {min(max(valve.start + step, -1.0), 1.0) for step in FINE_STARTS}
    return [replace(valve, start=start) for start in sorted(near.union(STARTS)) if start != valve.start]


def _bands(valve: StuckValve) -> list[StuckValve]:
    return [replace(valve, stick=valve.stick * f, jump=valve.jump * f) for f in FINE]


def _sticks(valve: StuckValve) -> list[StuckValve]:
    most = 2.0 if valve.family == Family.KANO else 1.0
    return [replace(valve, stick=valve.stick * f) for f in FINE if valve.jump <= most * valve.stick * f]


def _jumps(valve: StuckValve) -> list[StuckValve]:
    most = 2.0 if valve.family == Family.KANO else 1.0
    return [replace(valve, jump=min(max(valve.jump, 0.05 * valve.stick) * f, most * valve.stick)) for f in FINE]
