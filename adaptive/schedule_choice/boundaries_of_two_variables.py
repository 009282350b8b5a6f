"""The fewest sets of gains over two variables: cells of a table with steps, or knots of one that is interpolated.

Steps: boundaries across each variable, one set a cell, that of a place in it which serves the whole cell.
Interpolation: knots at even distances, each with its place's own set, weights of both variables multiplied
(schedule/table.py). Fewer sets win. A place that is not known demands nothing; a cell or knot without one takes the set
of the nearest.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise, product

import numpy as np

from retuner.adaptive.schedule_choice.boundaries_of_one_variable import CALMER, mean_of
from retuner.adaptive.schedule_design.places import DesignLimits, Place
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.table import Lookup

COUNT = 7  # places along each of two variables that are looked at
KNOTS: tuple[tuple[int, ...], ...] = ((3,), (0, 6), (1, 5), (0, 3, 6), (1, 3, 5), (0, 2, 4, 6))
"""Places out of COUNT that may be knots: at even distances, so that they are the middles of their parts."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Sets of gains over two variables, row by row: the second variable counts fastest.

    lookup : hard or interpolated. edges, edges2 : lower end, boundaries, upper end of each variable.
    """

    lookup: Lookup
    edges: tuple[float, ...]
    edges2: tuple[float, ...]
    sets: tuple[PidGains, ...]

    def part(self, x: float, x2: float | None) -> int:
        """The set in whose cell a place lies."""
        i = sum(x >= edge for edge in self.edges[1:-1])
        return i * (len(self.edges2) - 1) + sum(x2 is not None and x2 >= edge for edge in self.edges2[1:-1])

    def gains_at(self, x: float, x2: float) -> PidGains:
        """The gains in force there, without hysteresis."""
        if self.lookup is Lookup.HARD:
            return self.sets[self.part(x, x2)]
        columns = len(self.edges2) - 1
        i, share = _between(self.edges, x)
        j, share2 = _between(self.edges2, x2)
        across = [
            mean_of(self.sets[row * columns + j], self.sets[row * columns + min(j + 1, columns - 1)], share2)
            for row in (i, min(i + 1, len(self.edges) - 2))
        ]
        return mean_of(across[0], across[1], share)


def _between(edges: Sequence[float], x: float) -> tuple[int, float]:
    """The knot below x, and the share of the way to the next."""
    knots = [(a + b) / 2 for a, b in pairwise(edges)]
    i = min(max(sum(x >= knot for knot in knots) - 1, 0), max(len(knots) - 2, 0))
    if len(knots) == 1:
        return 0, 0.0
    return i, min(max((x - knots[i]) / (knots[i + 1] - knots[i]), 0.0), 1.0)


@dataclass(frozen=True)
class PlaceGrid:
    """COUNT x COUNT places, row by row, and what they demand. limits : to be kept."""

    places: tuple[Place, ...]
    limits: DesignLimits
    _kept: dict[tuple[int, PidGains], bool] = field(default_factory=dict)

    def keeps(self, at: int, gains: PidGains) -> bool:
        """Whether a set serves a place; asked once."""
        if (at, gains) not in self._kept:
            self._kept[at, gains] = self.places[at].keeps(gains, self.limits)
        return self._kept[at, gains]

    def edges(self, axis: int) -> list[float]:
        """Values of the places along a variable."""
        if axis:
            return [place.x2 for place in self.places[:COUNT] if place.x2 is not None]
        return [place.x for place in self.places[::COUNT]]

    def near(self, at: int) -> list[int]:
        """The known places, the nearest first."""
        i, j = divmod(at, COUNT)
        known = [k for k, place in enumerate(self.places) if place.known]
        return sorted(known, key=lambda k: (k // COUNT - i) ** 2 + (k % COUNT - j) ** 2)


def cells(places: Sequence[Place], limits: DesignLimits, lookup: str, most: int) -> Cells | None:
    """The fewest sets over two variables, at most so many; None when they do not suffice.

    places : COUNT x COUNT, row by row, one known at the least. lookup : "hard", "interpolated" or "auto".
    """
    grid = PlaceGrid(tuple(places), limits)
    options = [] if lookup == Lookup.INTERPOLATED else [_stepped(grid, most)]
    if lookup != Lookup.HARD:
        options.append(_knotted(grid, most))
    return min((one for one in options if one is not None), key=lambda one: len(one.sets), default=None)


def _knotted(grid: PlaceGrid, most: int) -> Cells | None:
    axes = sorted(product(KNOTS, KNOTS), key=lambda pair: len(pair[0]) * len(pair[1]))
    for (rows, columns), calmer in product(axes, CALMER):
        if not 1 < len(rows) * len(columns) <= most:
            continue
        sets = tuple(grid.places[grid.near(i * COUNT + j)[0]].own.times(calmer) for i, j in product(rows, columns))
        found = Cells(Lookup.INTERPOLATED, _round(grid.edges(0), rows), _round(grid.edges(1), columns), sets)
        if all(
            grid.keeps(at, found.gains_at(place.x, math.nan if place.x2 is None else place.x2))
            for at, place in enumerate(grid.places)
            if place.known
        ):
            return found
    return None


def _round(values: Sequence[float], knots: tuple[int, ...]) -> tuple[float, ...]:
    if len(knots) == 1:
        return values[0], values[-1]
    half = (values[knots[1]] - values[knots[0]]) / 2
    return (*(values[k] - half for k in knots), values[knots[-1]] + half)


def _stepped(grid: PlaceGrid, most: int) -> Cells | None:
    served: dict[tuple[int, int, int, int], PidGains | None] = {}
    sizes = sorted(product(range(1, COUNT + 1), repeat=2), key=lambda pair: (pair[0] * pair[1], abs(pair[0] - pair[1])))
    for rows, columns in sizes:
        if rows * columns > most:
            break
        for cut, cut2 in product(_cuts(rows), _cuts(columns)):
            sets = _sets(grid, cut, cut2, served)
            if sets is not None:
                return Cells(Lookup.HARD, _boundaries(grid.edges(0), cut), _boundaries(grid.edges(1), cut2), sets)
    return None


def _cuts(parts: int) -> Iterator[tuple[int, ...]]:
    """First places of the parts, and the end, in every way."""
    return ((0, *inside, COUNT) for inside in combinations(range(1, COUNT), parts - 1))


def _sets(
    grid: PlaceGrid, cut: Sequence[int], cut2: Sequence[int], served: dict[tuple[int, int, int, int], PidGains | None]
) -> tuple[PidGains, ...] | None:
    found = []
    for cell in ((a, b, c, d) for (a, b), (c, d) in product(pairwise(cut), pairwise(cut2))):
        if cell not in served:
            served[cell] = _one(grid, *cell)
        gains = served[cell]
        if gains is None:
            return None
        found.append(gains)
    return tuple(found)


def _one(grid: PlaceGrid, first: int, end: int, first2: int, end2: int) -> PidGains | None:
    """A set that serves every place of a cell, that of one of its places; None when none does."""
    inside = [i * COUNT + j for i in range(first, end) for j in range(first2, end2) if grid.places[i * COUNT + j].known]
    middle = (first + end) // 2 * COUNT + (first2 + end2) // 2
    if not inside:
        return grid.places[grid.near(middle)[0]].own
    corners = sorted(
        inside, key=lambda k: -abs(2 * (k // COUNT) - first - end + 1) - abs(2 * (k % COUNT) - first2 - end2 + 1)
    )
    for calmer in CALMER:
        for at in (k for k in grid.near(middle) if k in inside):
            gains = grid.places[at].own.times(calmer)
            if all(grid.keeps(k, gains) for k in corners):
                return gains
    return None


def _boundaries(values: Sequence[float], cut: Sequence[int]) -> tuple[float, ...]:
    """Ends, and boundaries in the middle between the places on both sides."""
    inside = [float(np.mean(values[k - 1 : k + 1])) for k in cut[1:-1]]
    return (values[0], *inside, values[-1])
