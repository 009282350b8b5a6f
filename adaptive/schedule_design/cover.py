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


KEPT = 6
"""Ways to one knot that are followed further, those that leave the edges most room."""

Knot = tuple[int, PidGains]
"""A place's index, and its set."""


def knots(places: Sequence[Place], limits: DesignLimits, most: int) -> Layout | None:
    """The fewest knots; None when `most` do not suffice."""
    usable = [(i, _times(p.own, factor)) for i, p in enumerate(places) if p.known for factor in CALMER]
    usable = [(i, gains) for i, gains in usable if places[i].keeps(gains, limits)]
    known: dict[tuple[Knot, Knot], bool] = {}
    ways: list[tuple[Knot, ...]] = [
        (knot,) for knot in usable if all(p.keeps(knot[1], limits) for p in places[: knot[0]])
    ]
    for _ in range(most):
        for way in ways:
            i, gains = way[-1]
            if all(p.keeps(gains, limits) for p in places[i + 1 :]):
                return _knotted(places, way)
        ways = _longer(places, usable, ways, limits, known)
    return None


def _longer(
    places: Sequence[Place],
    usable: Sequence[Knot],
    ways: Sequence[tuple[Knot, ...]],
    limits: DesignLimits,
    known: dict[tuple[Knot, Knot], bool],
) -> list[tuple[Knot, ...]]:
    """Every way one knot farther; to each knot those that leave the edges most room."""
    found: dict[Knot, list[tuple[float, tuple[Knot, ...]]]] = {}
    for way in ways:
        for knot in usable:
            room = _room([places[i].x for i, _ in (*way, knot)]) if knot[0] > way[-1][0] else None
            if room is None:
                continue
            pair = (way[-1], knot)
            if pair not in known:
                known[pair] = _open(places, *pair, limits)
            if known[pair]:
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


def _knotted(places: Sequence[Place], way: Sequence[Knot]) -> Layout | None:
    """Edges whose middles are the knots; None where there are none in order."""
    centres = [places[i].x for i, _ in way]
    sets = tuple(gains for _, gains in way)
    if len(centres) == 1:
        return Layout(Lookup.HARD, (places[0].x, places[-1].x), sets)
    room = _room(centres)
    if room is None:
        return None
    edges = [sum(room) / 2]
    for c in centres:
        edges.append(2 * c - edges[-1])
    return Layout(Lookup.INTERPOLATED, tuple(edges), sets, (0.0,) * (len(centres) - 1))
