"""The fewest sets of gains with which every place meets its limits, as steps and as interpolation.

Steps: every set serves the places round its own up to where it first fails; the fewest such ranges that cover the whole
are found from below, each time the one that reaches farthest. Borders stand in the middle of what both sides serve.
Interpolation: knots at places with their own sets, a way from knot to knot is open when every place between meets its
limits with the mean of both; the fewest knots are the shortest way. The first and last sets hold beyond their knots.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from retuner.adaptive.schedule_design.places import DesignLimits, Place
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup

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

    def gains_at(self, x: float) -> PidGains:
        """In force at x, without hysteresis."""
        if self.lookup is Lookup.HARD:
            part = sum(x >= edge for edge in self.edges[1:-1])
            return self.sets[part]
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
        for gains in (_times(place.own, factor) for factor in CALMER)
    ]
    chosen: list[tuple[int, int, PidGains]] = []
    covered = -1
    while covered < len(places) - 1:
        fitting = [reach for reach in reaches if reach[0] <= max(covered, 0) and reach[1] > covered]
        if not fitting or len(chosen) == most:
            return None
        chosen.append(max(fitting, key=lambda reach: (reach[1], -reach[0])))
        covered = chosen[-1][1]
    return _stepped(places, chosen)


def _stepped(places: Sequence[Place], chosen: Sequence[tuple[int, int, PidGains]]) -> Layout:
    """Borders in the middle of what neighbours share."""
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


def _times(gains: PidGains, factor: float) -> PidGains:
    """All gains times one factor."""
    return PidGains(gains.kp * factor, gains.ki * factor, gains.kd * factor)


def knots(places: Sequence[Place], limits: DesignLimits, most: int) -> Layout | None:
    """The fewest knots; None when `most` do not suffice."""
    usable = [i for i, place in enumerate(places) if place.known]
    ways: dict[int, tuple[int, ...]] = {}
    for i in usable:
        if all(place.keeps(places[i].own, limits) for place in places[:i]):
            ways[i] = (i,)
    for _ in range(most):
        ends = [way for i, way in ways.items() if all(p.keeps(places[i].own, limits) for p in places[i + 1 :])]
        for way in sorted(ends):
            layout = _knotted(places, way)
            if layout is not None:
                return layout
        ways = _longer(places, usable, ways, limits)
    return None


def _longer(
    places: Sequence[Place], usable: Sequence[int], ways: dict[int, tuple[int, ...]], limits: DesignLimits
) -> dict[int, tuple[int, ...]]:
    """Every way one knot farther."""
    found: dict[int, tuple[int, ...]] = {}
    for end, way in ways.items():
        for j in usable:
            if j > end and j not in found and _open(places, end, j, limits):
                found[j] = (*way, j)
    return found


def _open(places: Sequence[Place], i: int, j: int, limits: DesignLimits) -> bool:
    """Whether every place between two knots is served by the mean of both."""
    x0, x1 = places[i].x, places[j].x
    between = places[i + 1 : j]
    return all(
        p.keeps(mean_of(places[i].own, places[j].own, (p.x - x0) / (x1 - x0)), limits)
        for p in sorted(between, key=lambda p: abs(p.x - (x0 + x1) / 2))
    )


def _knotted(places: Sequence[Place], way: Sequence[int]) -> Layout | None:
    """Edges whose middles are the knots; None where there are none in order.

    With the lowest edge e_0 free, e_(i+1) = 2 c_i - e_i; every edge must lie between its knots.
    """
    centres = [places[i].x for i in way]
    sets = tuple(places[i].own for i in way)
    if len(centres) == 1:
        return Layout(Lookup.HARD, (places[0].x, places[-1].x), sets)
    low, high = -float("inf"), centres[0]  # of e_0; e_i = offset + sign e_0
    offset, sign = 0.0, 1.0
    for c0, c1 in pairwise(centres):
        offset, sign = 2 * c0 - offset, -sign
        a, b = sorted(((c0 - offset) / sign, (c1 - offset) / sign))
        low, high = max(low, a), min(high, b)
    if low > -float("inf") and high - low < LEAST_PART * (centres[-1] - centres[0]):
        return None
    edges = [(low + high) / 2 if low > -float("inf") else high - (centres[1] - centres[0]) / 2]
    for c in centres:
        edges.append(2 * c - edges[-1])
    return Layout(Lookup.INTERPOLATED, tuple(edges), sets, (0.0,) * (len(centres) - 1))
