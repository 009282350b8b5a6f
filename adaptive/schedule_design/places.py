"""Places along the variable: the process there, all that it may still be, and how well a set of gains serves it.

J of a set at a place is (IAE_ys/IAE_ys' + IAE_d/IAE_d')/2 against the place's own settings, those that SIMC gives it
with an Ms within its limit on every model that is still allowed (identification/robust_simc.py).
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.performance import load_variation, setpoint_variation
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.table import Lookup

OUT = 2.0
"""Standard deviations out at which a model is still allowed."""
LEAST_STD = 0.02
"""Least standard deviation of every ln p: no curve is known better than that."""
MOST_MS = 2.2
"""Largest Ms of a place's own settings on any allowed model: above it they are none, whatever the spread says."""
SECOND_LAG = 3
"""Place of ln tau2 among ln b, ln theta, ln tau, ln tau2."""
LONGEST_LAG = 30.0
"""A lag of so many dead times and more is as good as an integrator; longer ones are cut there, the slope gain kept."""


@dataclass(frozen=True, slots=True)
class DesignLimits:
    """What is demanded of a schedule.

    ms : largest Ms at any place on any model still allowed; 1.5 to 2.5, default 1.8. j : largest J over that of the
    place's own settings; 1.05 to 2, default 1.25. std : largest standard deviation of ln Kc with which a place counts
    as known; 0.1 to 0.5, default 0.2 (identification's own limit).

    Raises ValueError: a limit outside its range.
    """

    ms: float = 1.8
    j: float = 1.25
    std: float = 0.2

    def __post_init__(self) -> None:
        for name, low, high in (("ms", 1.5, 2.5), ("j", 1.05, 2.0), ("std", 0.1, 0.5)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)} is outside {low:g} to {high:g}")


@dataclass(frozen=True, slots=True)
class Judged:
    """A set at a place. ms : on the likeliest model, ms_worst : on all allowed. j : see the head."""

    ms: float
    ms_worst: float
    j: float


@dataclass(frozen=True, slots=True)
class Place:
    """One place x: the process, the models still allowed, and the settings that are its own.

    processes : of the model and of all allowed, as the sampled controller sees them.
    ln_std : of ln b, ln theta, ln tau (, ln tau2). gain_std : of ln Kc of its own settings. known : whether settings
    may follow. iae : of its own settings for a step of setpoint and of load. x2 : of a second variable.
    """

    x: float
    model: ProcessModel
    allowed: tuple[ProcessModel, ...]
    processes: tuple[LinearProcess, ...]
    ln_std: tuple[float, ...]
    gain_std: float
    known: bool
    own: PidGains
    iae: tuple[float, float]
    sample_time_s: float
    x2: float | None = None
    _judged: dict[PidGains, Judged] = field(default_factory=dict, repr=False, compare=False)
    _j: dict[PidGains, float] = field(default_factory=dict, repr=False, compare=False)

    def judged(self, gains: PidGains) -> Judged:
        """How a set does here; asked once."""
        if gains not in self._judged:
            self._judged[gains] = self._judge(gains)
        return self._judged[gains]

    def keeps(self, gains: PidGains, limits: DesignLimits) -> bool:
        """Whether a set meets the limits here; a place that is not known demands nothing."""
        if not self.known:
            return True
        if gains in self._judged:
            return self.judged(gains).ms_worst <= self._limit(limits) and self.judged(gains).j <= limits.j
        limit = self._limit(limits)
        if self._least_j(gains) > limits.j:
            return False
        if any(sensitivity_peak(process, gains) > limit for process in self.processes):  # the first is enough
            return False
        # J of these gains in steps of ROUNDED, asked once: what a search over thousands of sets can pay for
        near = PidGains(*(_rounded(gain) for gain in (gains.kp, gains.ki, gains.kd)))
        if near not in self._j:
            setpoint, load = iae(self.model, near, self.sample_time_s) if self._stable(near) else (math.inf, math.inf)
            self._j[near] = 0.5 * (setpoint / self.iae[0] + load / self.iae[1])
        return self._j[near] <= limits.j

    def _stable(self, gains: PidGains) -> bool:
        return math.isfinite(sensitivity_peak(self.processes[0], gains))

    def _least_j(self, gains: PidGains) -> float:
        """What J is at the least: an error that never changes its sign has the integral 1/(k ki), of a load 1/ki."""
        if not gains.ki:
            return math.inf
        return 0.5 * abs(1 / (self.model.k * gains.ki) / self.iae[0] + 1 / (gains.ki * self.iae[1]))

    def _limit(self, limits: DesignLimits) -> float:
        """Limit of Ms here: where its own settings cannot keep what is demanded, what they reach."""
        return max(limits.ms, self.judged(self.own).ms_worst)

    def _judge(self, gains: PidGains) -> Judged:
        peaks = [sensitivity_peak(process, gains) for process in self.processes]
        ms, worst = peaks[0], max(peaks)
        if not math.isfinite(ms):
            return Judged(ms, worst, math.inf)
        setpoint, load = iae(self.model, gains, self.sample_time_s)
        return Judged(ms, worst, 0.5 * (setpoint / self.iae[0] + load / self.iae[1]))


ROUNDED = 0.03
"""Steps of ln of a gain in which J is looked up in a search; a step changes J by about as much."""


def _rounded(gain: float) -> float:
    return math.copysign(math.exp(ROUNDED * round(math.log(abs(gain)) / ROUNDED)), gain) if gain else 0.0


def iae(model: ProcessModel, gains: PidGains, sample_time_s: float) -> tuple[float, float]:
    """For a unit step of setpoint and of load, of a stable loop."""
    process = model.seen_by_controller(sample_time_s).linear()
    setpoint = setpoint_variation(process, gains, derivative_on_setpoint=False, with_output=False)
    return setpoint.error, load_variation(process, gains, with_output=False).error


def place_at(curves: Curves, x: float, sample_time_s: float, limits: DesignLimits, x2: float | None = None) -> Place:
    """The place x (and x2) of some curves."""
    if x2 is None:
        ln, covariance = curves.ln(np.array([x]))[0], curves.ln_covariance(x)
    else:
        ln, covariance = curves.ln(np.array([x]), np.array([x2]))[0], curves.ln_covariance(x, x2)
    return replace(place_of(x, ln, covariance, curves.form.sign, sample_time_s, limits), x2=x2)


def place_of(x: float, ln: FloatArray, p: FloatArray, sign: int, sample_time_s: float, limits: DesignLimits) -> Place:
    """A place from ln b, ln theta, ln tau (, ln tau2) there and their covariance p. sign : of the process gain."""
    covariance = p + LEAST_STD**2 * np.eye(len(ln))
    model = model_of(ln, sign)
    values, vectors = np.linalg.eigh(covariance)
    ways = OUT * vectors * np.sqrt(np.maximum(values, 0.0))
    allowed = tuple(model_of(moved(ln, side * way), sign) for way in ways.T for side in (1.0, -1.0))
    settings = RobustSettings(ms_worst=max(limits.ms - 0.03, 1.5))
    own = robust_simc_on(model, [Plausible(m, OUT**2) for m in allowed], sample_time_s, settings).tuning.gains
    # standard deviation of ln Kc = -ln b - ln(theta + tau2/2), the larger part of SIMC's answer
    effective = np.exp(ln[1]) + (0.5 * np.exp(ln[3]) if len(ln) > 3 else 0.0)
    way = np.zeros(len(ln))
    way[0], way[1] = 1.0, np.exp(ln[1]) / effective
    if len(ln) > 3:
        way[3] = 0.5 * np.exp(ln[3]) / effective
    spread = float(np.sqrt(way @ covariance @ way))
    std = tuple(float(s) for s in np.sqrt(np.diag(covariance)))
    seen = tuple(m.seen_by_controller(sample_time_s).linear() for m in (model, *allowed))
    known = spread <= limits.std and all(sensitivity_peak(m, own) <= MOST_MS for m in seen)
    return Place(x, model, allowed, seen, std, spread, known, own, iae(model, own, sample_time_s), sample_time_s)


def moved(ln: FloatArray, way: FloatArray) -> FloatArray:
    """ln p so far away from the likeliest.

    What a record sees of a second lag is the lag, not its logarithm: where it is hardly known, twice its standard
    deviation out is tau2 (1 + d), as the fit's derivatives say, and not tau2 exp(d), hundreds of times as long.
    """
    found = ln + way
    if len(ln) > SECOND_LAG and way[SECOND_LAG] > 0:
        found[SECOND_LAG] = ln[SECOND_LAG] + math.log1p(way[SECOND_LAG])
    return np.asarray(found, dtype=np.float64)


def model_of(ln: FloatArray, sign: int) -> ProcessModel:
    """The model of ln b, ln theta, ln tau (, ln tau2)."""
    slope, theta, tau = sign * math.exp(ln[0]), math.exp(ln[1]), math.exp(ln[2])
    tau2 = math.exp(ln[3]) if len(ln) > 3 else 0.0
    tau = min(tau, LONGEST_LAG * (theta + tau2))
    if not tau2:
        return ProcessModel(ProcessType.FOPDT, slope * tau, tau, 0.0, theta)
    return ProcessModel(ProcessType.SOPDT, slope * tau, max(tau, tau2), min(tau, tau2), theta)


# ---- The fewest sets of gains with which every place meets its limits, as steps and as interpolation.
#
# Steps: every set serves the places round its own up to where it first fails; the fewest such ranges that cover the
# whole are found from below, each time the one that reaches farthest. Borders stand in the middle of what both
# sides serve. Interpolation: knots at places with their own sets, a way from knot to knot is open when every place
# between meets its limits with the mean of both; the fewest knots are the shortest way. The first and last sets
# hold beyond their knots.

CALMER = (1.0, 0.92, 0.85)
"""Factors on a place's own gains that are tried as well: a calmer set may serve more places."""
LEAST_PART = 0.001
"""Share of the way from the first knot to the last within which two edges are one."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Sets of gains along the variable.

    lookup : hard or interpolated. edges : lower end, borders, upper end. sets : one for each part between them.
    room : how far each border may move either way with both neighbours' sets still serving; 0 for interpolation.
    """

    lookup: Lookup
    edges: tuple[float, ...]
    sets: tuple[PidGains, ...]
    room: tuple[float, ...] = ()

    def part(self, x: float, x2: float | None = None) -> int:
        """The set in whose part x lies. x2 : there is no second variable."""
        del x2
        return sum(x >= edge for edge in self.edges[1:-1])

    def gains_at(self, x: float) -> PidGains:
        """In force at x, without hysteresis."""
        if self.lookup is Lookup.HARD:
            return self.sets[self.part(x)]
        knots = [(a + b) / 2 for a, b in pairwise(self.edges)]
        if x <= knots[0] or len(knots) == 1:
            return self.sets[0]
        for (x0, one), (x1, two) in pairwise(zip(knots, self.sets, strict=True)):
            if x <= x1:
                return mean_of(one, two, (x - x0) / (x1 - x0))
        return self.sets[-1]


def mean_of(one: PidGains, two: PidGains, share: float) -> PidGains:
    """(1 - share) of one and share of two, in parallel form."""
    a, b = 1.0 - share, share
    return PidGains(a * one.kp + b * two.kp, a * one.ki + b * two.ki, a * one.kd + b * two.kd)


def steps(places: Sequence[Place], limits: DesignLimits, most: int) -> Layout | None:
    """The fewest sets with borders; None when `most` do not suffice."""
    reaches = [
        (*_reach(places, i, gains, limits), gains)
        for i, place in enumerate(places)
        if place.known
        for gains in (times(place.own, factor) for factor in CALMER)
    ]
    chosen: list[tuple[int, int, PidGains]] = []
    covered = -1
    while covered < len(places) - 1:
        fitting = [reach for reach in reaches if reach[0] <= max(covered, 0) and reach[1] > covered]
        if not fitting or len(chosen) == most:
            return None
        chosen.append(max(fitting, key=lambda reach: (reach[1], -reach[0])))
        covered = chosen[-1][1]
    # borders in the middle of what neighbours share
    bounds, room = [], []
    for (_, last, _), (first, _, _) in pairwise(chosen):
        low, high = places[min(first, last)].x, places[last].x
        bounds.append((low + high) / 2)
        room.append((high - low) / 2)
    edges = (places[0].x, *bounds, places[-1].x)
    return Layout(Lookup.HARD, edges, tuple(gains for *_, gains in chosen), tuple(room))


def _reach(places: Sequence[Place], at: int, gains: PidGains, limits: DesignLimits) -> tuple[int, int]:
    """First and last place round `at` that a set serves without a break."""
    if not places[at].keeps(gains, limits):
        return at, at - 1
    first = last = at
    while first > 0 and places[first - 1].keeps(gains, limits):
        first -= 1
    while last < len(places) - 1 and places[last + 1].keeps(gains, limits):
        last += 1
    return first, last


def times(gains: PidGains, factor: float) -> PidGains:
    """All gains times one factor."""
    return PidGains(gains.kp * factor, gains.ki * factor, gains.kd * factor)


KEPT = 6
"""Ways to one knot that are followed further, those that leave the edges most room."""

Knot = tuple[int, PidGains]
"""A place's index, and its set."""


def knots(places: Sequence[Place], limits: DesignLimits, most: int) -> Layout | None:
    """The fewest knots; None when `most` do not suffice."""
    rows = [_row(places, factor, limits) for factor in CALMER]
    reached: dict[Knot, list[Knot]] = {}
    ways: list[tuple[Knot, ...]] = [
        (knot,) for row in rows for knot in row if all(p.keeps(knot[1], limits) for p in places[: knot[0]])
    ]
    for _ in range(most):
        for way in ways:
            i, gains = way[-1]
            if all(p.keeps(gains, limits) for p in places[i + 1 :]):
                layout = _knotted(places, way)
                if layout is not None:
                    return layout
        for end in {way[-1] for way in ways} - reached.keys():
            reached[end] = [knot for row in rows for knot in _within_reach(places, end, row, limits)]
        ways = _longer(places, ways, reached)
    return None


def _row(places: Sequence[Place], factor: float, limits: DesignLimits) -> list[Knot]:
    """The known places with their own gains times a factor, where these keep the limits."""
    found = [(i, times(p.own, factor)) for i, p in enumerate(places) if p.known]
    return [(i, gains) for i, gains in found if places[i].keeps(gains, limits)]


NEARER = 4
"""Places short of the farthest that are tried as well: edges must fit between knots."""


def _within_reach(places: Sequence[Place], end: Knot, row: Sequence[Knot], limits: DesignLimits) -> list[Knot]:
    """The knots of a row to which a way from `end` is open: the farthest, found by bisection, and some nearer ones."""
    ahead = [knot for knot in row if knot[0] > end[0]]
    low, high = -1, len(ahead)  # open up to low, closed from high on
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _open(places, end, ahead[middle], limits) else (low, middle)
    nearer = ahead[max(low - NEARER, 0) : max(low, 0)]
    return [*(knot for knot in nearer if _open(places, end, knot, limits)), *ahead[max(low, 0) : low + 1]]


def _longer(
    places: Sequence[Place], ways: Sequence[tuple[Knot, ...]], reached: dict[Knot, list[Knot]]
) -> list[tuple[Knot, ...]]:
    """Every way one knot farther; to each knot those that leave the edges most room."""
    found: dict[Knot, list[tuple[float, tuple[Knot, ...]]]] = {}
    for way in ways:
        for knot in reached[way[-1]]:
            room = _room([places[i].x for i, _ in (*way, knot)])
            if room is not None:
                found.setdefault(knot, []).append((room[1] - room[0], (*way, knot)))
    return [way for several in found.values() for _, way in sorted(several, key=lambda one: -one[0])[:KEPT]]


def _open(places: Sequence[Place], one: Knot, two: Knot, limits: DesignLimits) -> bool:
    """Whether every place between two knots is served by the mean of both."""
    (i, low), (j, high) = one, two
    x0, x1 = places[i].x, places[j].x
    between = places[i + 1 : j]
    return all(
        p.keeps(mean_of(low, high, (p.x - x0) / (x1 - x0)), limits)
        for p in sorted(between, key=lambda p: abs(p.x - (x0 + x1) / 2))
    )


def _room(centres: Sequence[float]) -> tuple[float, float] | None:
    """Where the lowest of the edges may lie whose middles are the knots; None where there are none in order.

    With the lowest edge e_0 free, e_(i+1) = 2 c_i - e_i; every edge must lie between its knots.
    """
    low, high = 2 * centres[0] - centres[-1], centres[0]  # of e_0; e_i = offset + sign e_0
    offset, sign = 0.0, 1.0
    for c0, c1 in pairwise(centres):
        offset, sign = 2 * c0 - offset, -sign
        a, b = sorted(((c0 - offset) / sign, (c1 - offset) / sign))
        low, high = max(low, a), min(high, b)
    return (low, high) if high - low >= LEAST_PART * (centres[-1] - centres[0]) else None


EDGES_TRIED = 39
"""Places of the lowest edge that are tried: that counts with which the outer edges stand out least."""


def _edges(centres: Sequence[float], lowest: float) -> list[float]:
    edges = [lowest]
    for c in centres:
        edges.append(2 * c - edges[-1])
    return edges


def _knotted(places: Sequence[Place], way: Sequence[Knot]) -> Layout | None:
    """Edges whose middles are the knots; None where there are none in order."""
    centres = [places[i].x for i, _ in way]
    sets = tuple(gains for _, gains in way)
    if len(centres) == 1:
        return Layout(Lookup.HARD, (places[0].x, places[-1].x), sets)
    room = _room(centres)
    if room is None:
        return None
    low, high = places[0].x, places[-1].x
    tried = [_edges(centres, e) for e in np.linspace(*room, EDGES_TRIED + 2).tolist()[1:-1]]
    edges = min(tried, key=lambda e: max(low - e[0], 0.0) ** 2 + max(e[-1] - high, 0.0) ** 2)
    return Layout(Lookup.INTERPOLATED, tuple(edges), sets, (0.0,) * (len(centres) - 1))
