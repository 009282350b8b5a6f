"""From a good fit to the best of its neighbours, move by move, each kept when the criterion says that it pays.

    whiten        refit with the remainder's colour taken out
    ramp          a drift of pv along the record
    load          one more load step, where the remainder asks for it most
    without       one load step less
    round         the loads come through a lag of their own (no real load steps, and a load record is mostly its shape)
    plain         no drift, no such lag: what was taken in early may be needless by now
    merge         two load steps as one that comes through a lag
    elsewhere     one load step at another place

Loads found greedily before anything else are often a cover for drift or for a missing lag, so every load must survive
being left out after the rest has been refined.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import LOAD_COST, Misfit
from retuner.adaptive.fit.record import are_coincident
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.search import instants
from retuner.adaptive.fit.structure import SIZE, dynamics_at
from retuner.adaptive.identification.candidate import Candidate, CandidateList, judged
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray

SCAN = 80  # instants tried for one more load step
MOST_MOVES = 14  # moves tried from one seed at the most
MOVE_EVALUATIONS = 25  # evaluations of the misfit in one move; a move that needs more is no small one
LEAST_GAIN = 1e-3  # A move must lower the criterion by this
START_ROUNDING = 3.0  # first guess of a load's own lag, in sampling intervals
PROMISING = 0.3  # A move is refined only when its linear part alone brings this share of what it costs
INDISPENSABLE = 15.0  # A load that brings this many times what it costs is not tried without
UNIQUE = 1e-9  # A step whose share of a column that nothing else explains is below this is no new load
INTEGRATING = frozenset({ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG})

Proposal = tuple[Misfit, FloatArray]
Move = Callable[[Candidate], Proposal | None]


def improved(seed: Candidate, most_loads: int, seen: CandidateList, most: int = MOST_MOVES) -> Candidate:
    """The best that can be reached by single moves; everything tried is noted in `seen`."""
    best, tried, fruitless, whole = seed, 0, 0, _moves(seed, most_loads)
    moves: list[Move] = []
    while tried < most and fruitless < len(whole):
        moves = moves or list(whole)
        proposal = moves.pop(0)(best)
        fruitless += 1
        if proposal is None or not proposal[0].has_room:
            continue
        tried += 1
        found = judged(refine(*proposal, evaluations=MOVE_EVALUATIONS))
        seen.add(found)
        if found.criterion < best.criterion - LEAST_GAIN:
            best, fruitless, whole = found, 0, _moves(found, most_loads)
    return best


def _moves(at: Candidate, most_loads: int) -> list[Move]:
    """The moves in order; each is asked where the walk stands by then."""
    each = list(reversed(range(at.fit.misfit.loads)))
    dropped = [partial(_without_load, which=j) for j in each]
    moved = [partial(_load_elsewhere, which=j) for j in each]
    plainer: list[Move] = [_merged, _without_ramp, _without_rounding]
    return [_whitened, _with_ramp, *dropped, partial(_with_load, most=most_loads), _with_rounding, *plainer, *moved]


def _whitened(at: Candidate) -> Proposal | None:
    """The fit with the filter and the noise that its remainder asks for."""
    if at.whitened:
        return None
    return replace(at.fit.misfit, ar=at.colour.ar, sigma=at.colour.std), at.fit.p


def _with_ramp(at: Candidate) -> Proposal | None:
    misfit = at.fit.misfit
    if misfit.ramp:
        return None
    record = misfit.record
    column = (record.t_s / record.span_s) ** (2 if misfit.type in INTEGRATING else 1)
    if linear_gains(at, column[:, None])[0] < PROMISING * math.log(len(column)):
        return None
    return replace(misfit, ramp=True), at.fit.p


def _with_rounding(at: Candidate) -> Proposal | None:
    misfit, p = at.fit.misfit, at.fit.p
    if misfit.rounded or misfit.loads == misfit.corners:
        return None
    after = SIZE[misfit.type] + misfit.loads
    lag = np.log(START_ROUNDING * misfit.record.sample_time_s)
    return replace(misfit, rounded=True), np.concatenate([p[:after], [lag], p[after:]])


def _without_ramp(at: Candidate) -> Proposal | None:
    return (replace(at.fit.misfit, ramp=False), at.fit.p) if at.fit.misfit.ramp else None


def _without_rounding(at: Candidate) -> Proposal | None:
    misfit, p, d = at.fit.misfit, at.fit.p, SIZE[at.fit.misfit.type]
    if not misfit.rounded:
        return None
    times, steps = p[d : d + misfit.loads].copy(), misfit.loads - misfit.corners
    times[:steps] = np.minimum(times[:steps] + math.exp(p[d + misfit.loads]), misfit.record.span_s)
    return replace(misfit, rounded=False), np.concatenate([p[:d], times, p[d + misfit.loads + 1 :]])


def _merged(at: Candidate) -> Proposal | None:
    """The two load steps that follow each other most closely as one that comes through a lag."""
    misfit, p, d = at.fit.misfit, at.fit.p, SIZE[at.fit.misfit.type]
    if misfit.loads < 2 or misfit.corners:
        return None
    times = np.sort(p[d : d + misfit.loads])
    first = int(np.argmin(np.diff(times)))
    lag = max(times[first + 1] - times[first], misfit.record.sample_time_s) / 2
    rest = p[d + misfit.loads + int(misfit.rounded) :]
    one = replace(misfit, loads=misfit.loads - 1, rounded=True)
    return one, np.concatenate([p[:d], np.delete(times, first + 1), [math.log(lag)], rest])


def _load_elsewhere(at: Candidate, which: int) -> Proposal | None:
    """A load step taken out, and put where what is left then asks for it most."""
    misfit, d = at.fit.misfit, SIZE[at.fit.misfit.type]
    if (
        misfit.loads < 2 or misfit.corners or which >= misfit.loads
    ):  # a single one is looked for everywhere by the coarse search
        return None
    without = replace(misfit, loads=misfit.loads - 1)
    left = judged(refine(without, np.delete(at.fit.p, d + which), evaluations=0))  # or the process takes its place
    found = _with_load(left, misfit.loads)
    if found is None:
        return None
    after = float(found[1][d + misfit.loads - 1])
    near = abs(after - float(at.fit.p[d + which])) < misfit.record.span_s / SCAN
    return None if near else found


def _without_load(at: Candidate, which: int) -> Proposal | None:
    misfit, d = at.fit.misfit, SIZE[at.fit.misfit.type]
    if which >= misfit.loads or _worth(at, which) > INDISPENSABLE * LOAD_COST * math.log(len(misfit.record.pv)):
        return None
    p = np.delete(at.fit.p, d + which)
    less = replace(misfit, loads=misfit.loads - 1, corners=misfit.corners - int(misfit.is_corner(which)))
    if misfit.rounded and less.loads == less.corners:
        return replace(less, rounded=False), np.delete(p, d + less.loads)
    return less, p


def _with_load(at: Candidate, most: int) -> Proposal | None:
    """One load step more, at the instant where it would take away most of the remainder."""
    misfit, p = at.fit.misfit, at.fit.p
    if misfit.loads >= most:
        return None
    after = SIZE[misfit.type] + misfit.loads - misfit.corners
    places = instants(misfit.record.span_s, SCAN)
    engine = compiled()
    if engine is not None:
        gains = engine.load_gains(misfit, p, places)
    else:
        steps = misfit.lagged(p, dynamics_at(misfit.type, p).step(misfit.record.t_s[:, None] - places[None, :]))
        gains = linear_gains(at, steps / np.maximum(np.max(np.abs(steps), axis=0), np.finfo(np.float64).tiny))
    record = misfit.record
    if record.barred_s:
        gains[are_coincident(misfit.type, p, places, record.barred_s, record.span_s, record.sample_time_s)] = 0.0
    best = int(np.argmax(gains))
    if gains[best] < PROMISING * LOAD_COST * math.log(len(misfit.record.pv)):
        return None
    return replace(misfit, loads=misfit.loads + 1), np.concatenate([p[:after], [places[best]], p[after:]])


def linear_gains(at: Candidate, columns: FloatArray) -> FloatArray:
    """How much each further column by itself would lower n ln sigma^2, everything nonlinear held, shape (columns,)."""
    misfit, n = at.fit.misfit, len(at.fit.misfit.record.pv)
    solved = at.fit.at
    whitened, q, r = misfit.whitened(columns), solved.q[:n], solved.r[:n]
    free = whitened - q @ (q.T @ whitened)
    size = np.einsum("ij,ij->j", free, free)
    usable = size > UNIQUE * n
    taken = np.where(usable, (r @ free) ** 2 / np.where(usable, size, 1.0), 0.0)
    return np.asarray(-n * np.log(np.maximum(1 - taken / float(r @ r), np.finfo(np.float64).tiny)), dtype=np.float64)


def _worth(at: Candidate, which: int) -> float:
    """How much leaving out a load would raise n ln sigma^2, everything nonlinear held: at most that much."""
    misfit, solved = at.fit.misfit, at.fit.at
    n, column = len(misfit.record.pv), solved.priors + which
    diagonal = np.abs(np.diag(solved.triangle))
    if np.min(diagonal) <= UNIQUE * np.max(diagonal):
        return 0.0
    inverse = np.linalg.inv(solved.triangle)
    rise = (float(solved.c[column]) / misfit.sigma) ** 2 / float(inverse[column] @ inverse[column])
    return n * math.log1p(rise / float(solved.r[:n] @ solved.r[:n]))
