"""The gain table: one set of gains a region, and how they are looked up. Immutable: every change is a new revision.

Contract of the lookup, in terms of the regions' centres c_0 < ... < c_(n-1) as knots:
  - hard: the gains of the region that `choose` says; x itself plays no part, hysteresis and minimum stay do.
  - interpolated: with c_i <= x <= c_(i+1) and w = (x - c_i)/(c_(i+1) - c_i), each of kp, ki, kd is
    (1 - w) g_i + w g_(i+1): at a knot exactly the gains of that region, between two knots their exact weighted mean,
    outside the first and last knot the gains of the end region (clamped, never extrapolated). The region plays no part.
Interpolation is in parallel form, because there the interpolated controller's output is the weighted mean of its
corners' outputs; interpolated times put ki off by up to 94 % between ordinary corners.
All gains of a table act in one direction: a sign that differs is a mistake, and a mean of both signs acts in neither.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, field, replace
from enum import StrEnum

from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions


class Lookup(StrEnum):
    """How the gains in force follow from the table."""

    HARD = "hard"
    INTERPOLATED = "interpolated"


@dataclass(frozen=True, slots=True)
class GainTable:
    """Gains by operating region.

    Parameters
    ----------
    loop : name of the loop, printable, not empty.
    regions : the operating regions.
    gains : one set a region, from low to high, all of one direction.
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
    _knots: tuple[float, ...] = field(init=False, repr=False, compare=False)

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
        object.__setattr__(self, "_knots", tuple(self.regions.centre(i) for i in range(len(self.regions))))

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

    def at(self, region: int, x: float) -> PidGains:
        """The gains in force: in this region (as `choose` says), at this value of the scheduling variable.

        Raises
        ------
        ValueError
            There is no such region, or x is not finite (go on with the gains in force).
        """
        if not math.isfinite(x):
            raise ValueError(f"{self.regions.variable} = {x} is not a finite number; keep the gains in force")
        if self.lookup is Lookup.HARD:
            return self.gains[self.index(region)]
        self.index(region)
        return self._between(x)

    def _between(self, x: float) -> PidGains:
        """Exact weighted mean of the sets at the two knots round x; the end sets outside."""
        knots = self._knots
        above = bisect_right(knots, x)
        if above in {0, len(knots)}:
            return self.gains[min(above, len(knots) - 1)]
        one, two = self.gains[above - 1], self.gains[above]
        w = (x - knots[above - 1]) / (knots[above] - knots[above - 1])
        v = 1.0 - w
        return PidGains(v * one.kp + w * two.kp, v * one.ki + w * two.ki, v * one.kd + w * two.kd)
