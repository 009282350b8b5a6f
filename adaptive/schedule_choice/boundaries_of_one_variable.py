"""The fewest sets of gains along one variable with which every place meets its limits: where boundaries or knots lie.

Steps: every set serves the places round its own up to where it first fails; the fewest such ranges that cover the whole
are found from below, each time the one that reaches farthest. Boundaries stand in the middle of what both sides serve.
Interpolation: knots at places with their own sets, a way from knot to knot is open when every place between meets its
limits with the mean of both; the fewest knots are the shortest way. The first and last sets hold beyond their knots.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.schedule_design.places import DesignLimits, Place
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.table import Lookup

CALMER = (1.0, 0.92, 0.85)  # factors on a place's own gains that are tried as well: a calmer set may serve more places
LEAST_PART = 0.001  # share of the way from the first knot to the last within which two edges are one


@dataclass(frozen=True, slots=True)
class Layout:
    """Sets of gains along the variable.

    lookup : hard or interpolated. edges : lower end, boundaries, upper end. sets : one for each part between them.
    """

    lookup: Lookup
    edges: tuple[float, ...]
    sets: tuple[PidGains, ...]

    def part(self, x: float, x2: float | None = None) -> int:
        """The set in whose part x lies. x2 : there is no second variable."""
        del x2
        return sum(x >= edge for edge in self.edges[1:-1])

    def gains_at(self, x: float) -> PidGains:
        """The gains in force at x, without hysteresis."""
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


def boundaries_of_fewest_sets(places: Sequence[Place], limits: DesignLimits, most: int) -> Layout | None:
    """The fewest sets with boundaries; None when `most` do not suffice."""
    reaches = [
        (*_reach(places, i, gains, limits), gains)
        for i, place in enumerate(places)
        if place.known
        for gains in (place.own.times(factor) for factor in CALMER)
    ]
    chosen: list[tuple[int, int, PidGains]] = []
    covered = -1
    while covered < len(places) - 1:
        fitting = [reach for reach in reaches if reach[0] <= max(covered, 0) and reach[1] > covered]
        if not fitting or len(chosen) == most:
            return None
        chosen.append(max(fitting, key=lambda reach: (reach[1], -reach[0])))
        covered = chosen[-1][1]
    # boundaries in the middle of what neighbours share
    bounds = []
    for (_, last, _), (first, _, _) in pairwise(chosen):
        low, high = places[min(first, last)].x, places[last].x
        bounds.append((low + high) / 2)
    edges = (places[0].x, *bounds, places[-1].x)
    return Layout(Lookup.HARD, edges, tuple(gains for *_, gains in chosen))


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


KEPT = 6  # ways to one knot that are followed further, those that leave the edges most room

Knot = tuple[int, PidGains]  # A place's index, and its set


def knots_of_fewest_sets(places: Sequence[Place], limits: DesignLimits, most: int) -> Layout | None:
    """The fewest knots; None when `most` do not suffice."""
    rows: list[list[Knot]] = []  # the known places with their own gains times a factor, where these keep the limits
    for factor in CALMER:
        own = [(i, p.own.times(factor)) for i, p in enumerate(places) if p.known]
        rows.append([(i, gains) for i, gains in own if places[i].keeps(gains, limits)])
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
        # Every way one knot farther; to each knot those that leave the edges most room
        found: dict[Knot, list[tuple[float, tuple[Knot, ...]]]] = {}
        for longer in ((*way, knot) for way in ways for knot in reached[way[-1]]):
            room = _room([places[i].x for i, _ in longer])
            if room is not None:
                found.setdefault(longer[-1], []).append((room[1] - room[0], longer))
        ways = [longer for several in found.values() for _, longer in sorted(several, key=lambda one: -one[0])[:KEPT]]
    return None


NEARER = 4  # places short of the farthest that are tried as well: edges must fit between knots


def _within_reach(places: Sequence[Place], end: Knot, row: Sequence[Knot], limits: DesignLimits) -> list[Knot]:
    """The knots of a row to which a way from `end` is open: the farthest, found by bisection, and some nearer ones."""
    ahead = [knot for knot in row if knot[0] > end[0]]
    low, high = -1, len(ahead)  # open up to low, closed from high on
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _open(places, end, ahead[middle], limits) else (low, middle)
    nearer = ahead[max(low - NEARER, 0) : max(low, 0)]
    return [*(knot for knot in nearer if _open(places, end, knot, limits)), *ahead[max(low, 0) : low + 1]]


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


EDGES_TRIED = 39  # places of the lowest edge that are tried: that counts with which the outer edges stand out least


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
    tried = [[lowest] for lowest in np.linspace(*room, EDGES_TRIED + 2).tolist()[1:-1]]
    for one in tried:
        for c in centres:
            one.append(2 * c - one[-1])
    edges = min(tried, key=lambda e: max(low - e[0], 0.0) ** 2 + max(e[-1] - high, 0.0) ** 2)
    return Layout(Lookup.INTERPOLATED, tuple(edges), sets)
