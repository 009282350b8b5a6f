"""The gain table: one set of gains a region, and how they are looked up. Immutable: every change is a new revision.

Contract of the lookup, in terms of the regions' centres c_0 < ... < c_(n-1) along each axis as knots:
  - hard: the gains of the region that `choose` says; x itself plays no part, hysteresis and minimum stay do.
  - interpolated: with c_i <= x <= c_(i+1) and w = (x - c_i)/(c_(i+1) - c_i), each of kp, ki, kd is
    (1 - w) g_i + w g_(i+1): at a knot exactly the gains of that region, between two knots their exact weighted mean,
    outside the first and last knot the gains of the end region (clamped, never extrapolated). The region plays no part.
    With two axes the weights of both are multiplied: bilinear between the four cell centres round (x, x2).
Interpolation is in parallel form, because there the interpolated controller's output is the weighted mean of its
corners' outputs; interpolated times put ki off by up to 94 % between ordinary corners.
All gains of a table act in one direction: a sign that differs is a mistake, and a mean of both signs acts in neither.

What runs is therefore not always what a region stores. `at` gives the gains in force; `stored_for` turns gains that
shall be in force at (x, x2) into the set that one region must store for it. Only that region's set changes: the others
stand proved at their own centres, and spreading the change over them would take them off what was proved there.
"""

import math
from bisect import bisect_right
from enum import StrEnum

from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.regions import Regions

GAIN_NAMES = ("kp", "ki", "kd")
LEAST_SHARE = 1e-12  # A remainder below this share of what is wanted is rounding (a few thousand spacings of doubles)


class Lookup(StrEnum):
    """How the active gains follow from the table.

    Attributes
    ----------
    HARD : the region's own set. INTERPOLATED : a mean of the sets at the centres around.
    """

    HARD = "hard"
    INTERPOLATED = "interpolated"


@dataclass(frozen=True, slots=True)
class GainTable:
    """Gains by operating region.

    Parameters
    ----------
    loop : name of the loop, printable, not empty.
    regions : the operating regions.
    gains : one set a region, in the order of the regions, all of one direction.
    lookup : hard or interpolated.
    revision : number of changes since the table was made, 0 or more.

    Raises
    ------
    ValueError
        The number of sets is not that of the regions, directions differ, the name or revision is not as said.
    """

    loop: str
    regions: Regions
    gains: tuple[PidGains, ...]
    lookup: Lookup = Lookup.HARD
    revision: int = 0
    _knots: tuple[tuple[float, ...], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.loop.strip() or not self.loop.isprintable():
            raise ValueError(f"loop = {self.loop!r} must be a name that can be printed on one line")
        if len(self.gains) != len(self.regions):
            raise ValueError(f"{len(self.regions)} regions need as many sets of gains, not {len(self.gains)}")
        if len({gains.direction for gains in self.gains}) > 1:
            signs = ", ".join(f"{n} {g.direction:+d}" for n, g in zip(self.regions.names, self.gains, strict=True))
            raise ValueError(f"the gains act in different directions ({signs}); all regions of a loop act one way")
        if self.revision < 0:
            raise ValueError(f"revision = {self.revision} must be 0 or more")
        if self.lookup not in tuple(Lookup):
            raise ValueError(f"lookup = {self.lookup!r} is unknown; use {' or '.join(Lookup)}")
        object.__setattr__(self, "lookup", Lookup(self.lookup))
        knots = tuple(tuple(axis.centre(i) for i in range(len(axis))) for axis in self.regions.axes)
        object.__setattr__(self, "_knots", knots)

    def index(self, region: int | str) -> int:
        """Index of a region given by index or name.

        Raises
        ------
        ValueError
            There is no such region.
        """
        if isinstance(region, str):
            if region not in self.regions.names:
                raise ValueError(f"region {region!r} does not exist; there are {', '.join(self.regions.names)}")
            return self.regions.names.index(region)
        self.regions.span(region)
        return region

    def gains_of(self, region: int | str) -> PidGains:
        """The set that the table holds for a region, by index or name; errors as index."""
        return self.gains[self.index(region)]

    def with_gains(self, region: int | str, gains: PidGains) -> "GainTable":
        """The next revision: the same table with other gains for one region; errors as index and GainTable."""
        i = self.index(region)
        return replace(self, gains=(*self.gains[:i], gains, *self.gains[i + 1 :]), revision=self.revision + 1)

    def at(self, region: int, x: float, x2: float = 0.0) -> PidGains:
        """The gains in force: in this region (as `choose` says), at these scheduling values (as `values` says).

        Raises
        ------
        ValueError
            There is no such region, or x or x2 is not finite (go on with the gains in force).
        """
        if self.lookup is Lookup.HARD and 0 <= region < len(self.gains) and math.isfinite(x) and math.isfinite(x2):
            return self.gains[region]
        found = self.weights(region, x, x2)
        if len(found) == 1:
            return self.gains[found[0][0]]
        return PidGains(*(sum(w * getattr(self.gains[i], name) for i, w in found) for name in GAIN_NAMES))

    def weights(self, region: int, x: float, x2: float = 0.0) -> tuple[tuple[int, float], ...]:
        """The regions whose sets are in force, with their shares: above 0, together 1. Arguments and errors as `at`."""
        for axis, value in zip(self.regions.axes, (x, x2), strict=False):
            if not math.isfinite(value):
                raise ValueError(f"{axis.label} = {value} is not a finite number; keep the active gains")
        self.index(region)
        if self.lookup is Lookup.HARD:
            return ((region, 1.0),)
        first = _shares(self._knots[0], x)
        if len(self._knots) == 1:
            return first
        columns, second = len(self._knots[1]), _shares(self._knots[1], x2)
        return tuple((i * columns + j, v * w) for i, v in first for j, w in second if v * w)

    def stored_for(self, region: int | str, wanted: PidGains, x: float, x2: float = 0.0) -> PidGains | None:
        """The set that a region must store, the others unchanged, so that `wanted` is in force at (x, x2).

        None when there is none: the region has no share there, the neighbours act the other way, or their part of the
        mean alone is already more than is wanted of a gain. Errors as `at` and `index`.
        """
        i = self.index(region)
        shares = self.weights(i, x, x2)
        own = dict(shares).get(i, 0.0)
        if own == 0.0 or (len(self.gains) > 1 and wanted.direction != self.gains[0].direction):
            return None
        if own == 1.0:
            return wanted
        needed = []
        for name in GAIN_NAMES:
            others = sum(w * getattr(self.gains[j], name) for j, w in shares if j != i)
            value, stored = getattr(wanted, name), getattr(self.gains[i], name)
            rest = (value - others) / own
            if abs(rest) <= LEAST_SHARE * abs(value):  # a gain that shall be as small as the others make it
                rest = 0.0
            if rest * wanted.direction < 0 or (rest == 0.0 and value != 0.0 and stored != 0.0):
                return None
            needed.append(rest)
        return PidGains(*needed) if all(map(math.isfinite, needed)) and any(needed) else None


def _shares(knots: tuple[float, ...], x: float) -> tuple[tuple[int, float], ...]:
    """The one or two knots that count at x, with their shares; the end knot alone outside."""
    above = bisect_right(knots, x)
    if above in {0, len(knots)}:
        return ((min(above, len(knots) - 1), 1.0),)
    w = (x - knots[above - 1]) / (knots[above] - knots[above - 1])
    return ((above - 1, 1.0 - w), (above, w)) if w else ((above - 1, 1.0),)
