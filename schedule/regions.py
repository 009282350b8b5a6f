"""Operating regions along one scheduling variable: which region a loop is in, without chatter.

Borders b_1 < ... < b_(n-1) divide low..high into n regions; a value on a border belongs to the region above it, values
outside low..high belong to the end regions. A loop leaves its region only when x has passed a border by more than the
hysteresis h and the minimum stay is over; it then goes to the region that contains x, be it a neighbour or not. So x
must travel 2 h to go out and come back, and noise of less than that cannot make it chatter.

`choose` runs at every sample: the common case, x still inside the region's widened borders, is one comparison.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

VARIABLES = ("sp", "pv", "co")


class RegionState(NamedTuple):
    """Where a loop is. region : index of the region, 0 is the lowest. since_s : when it was entered, seconds."""

    region: int
    since_s: float


@dataclass(frozen=True, slots=True)
class RegionLaw:
    """What `choose` needs, made by Regions.law(): floors[i], ceilings[i] are region i's borders widened by h."""

    bounds: tuple[float, ...]
    floors: tuple[float, ...]
    ceilings: tuple[float, ...]
    min_stay_s: float


@dataclass(frozen=True, slots=True)
class Regions:
    """Operating regions along a named scheduling variable.

    Parameters
    ----------
    variable : what the regions are along: "sp", "pv" or "co".
    unit : its unit, for people ("degC", "%").
    names : names of the regions from low to high, n of them, different, not empty.
    low, high : range of the variable; values outside count as the end regions.
    bounds : the n - 1 borders, increasing strictly, between low and high.
    hysteresis : how far x must pass a border before the region changes, in unit, each way; 0 or more and at most half
        of the narrowest region's width, so that every region can be entered from both sides.
    min_stay_s : shortest time in a region, seconds, 0 or more.

    Raises
    ------
    ValueError
        Anything else than this; the message names it.
    """

    variable: str
    unit: str
    names: tuple[str, ...]
    low: float
    bounds: tuple[float, ...]
    high: float
    hysteresis: float = 0.0
    min_stay_s: float = 0.0

    def __post_init__(self) -> None:
        if self.variable not in VARIABLES:
            raise ValueError(f"variable = {self.variable!r} is unknown; use one of {', '.join(VARIABLES)}")
        self._check_names()
        edges = (self.low, *self.bounds, self.high)
        for edge in (*edges, self.high - self.low):
            if not math.isfinite(edge):
                raise ValueError(f"low, bounds, high = {edges}: {edge} is not a finite number")
        for i, (below, above) in enumerate(pairwise(edges)):
            if not below < above:
                raise ValueError(f"low, bounds, high = {edges} must increase; {above} after {below} does not")
            if not 0 <= 2 * self.hysteresis <= above - below:
                raise ValueError(
                    f"hysteresis = {self.hysteresis} must be 0 to half of every region's width;"
                    f" region {self.names[i]!r} is {above - below:g} wide"
                )
        if not 0 <= self.min_stay_s < math.inf:
            raise ValueError(f"min_stay_s = {self.min_stay_s} must be a finite number, 0 or more")

    def _check_names(self) -> None:
        """One printable name a region, all different."""
        if len(self.names) != len(self.bounds) + 1:
            raise ValueError(f"{len(self.bounds)} bounds make {len(self.bounds) + 1} regions, not {len(self.names)}")
        for name in (*self.names, self.unit):
            if not name.isprintable():
                raise ValueError(f"{name!r} has characters that cannot be printed on one line")
        if not all(name.strip() for name in self.names) or len(set(self.names)) < len(self.names):
            raise ValueError(f"names = {self.names} must be different and not empty")

    def __len__(self) -> int:
        return len(self.names)

    def law(self) -> RegionLaw:
        """The numbers that `choose` works with."""
        floors = (-math.inf, *(bound - self.hysteresis for bound in self.bounds))
        ceilings = (*(bound + self.hysteresis for bound in self.bounds), math.inf)
        return RegionLaw(self.bounds, floors, ceilings, self.min_stay_s)

    def span(self, region: int) -> tuple[float, float]:
        """Lower and upper border of a region, in unit.

        Raises
        ------
        ValueError
            There is no such region.
        """
        if not 0 <= region < len(self.names):
            raise ValueError(f"region {region} does not exist; there are {len(self.names)}, counted from 0")
        edges = (self.low, *self.bounds, self.high)
        return edges[region], edges[region + 1]

    def centre(self, region: int) -> float:
        """Middle of a region, in unit; errors as `span`."""
        low, high = self.span(region)
        return low + (high - low) / 2.0


def enter(law: RegionLaw, x: float, t_s: float) -> RegionState:
    """The region of x at the first sample, without hysteresis. x in the variable's unit, t_s in seconds.

    Raises
    ------
    ValueError
        x or t_s is not finite.
    """
    if not math.isfinite(x) or not math.isfinite(t_s):
        raise ValueError(f"x = {x} at t_s = {t_s} s: both must be finite to choose a first region")
    return RegionState(bisect_right(law.bounds, x), t_s)


def choose(law: RegionLaw, state: RegionState, x: float, t_s: float) -> RegionState:
    """The region at this sample; the same object as long as nothing changes.

    x : scheduling variable in its unit; when it is not finite (a failed sensor), the region stays.
    t_s : time of the sample in seconds; when it is not finite or runs backwards, the region stays.
    """
    region = state[0]
    if law.floors[region] <= x <= law.ceilings[region]:
        return state
    if not math.isfinite(x) or not law.min_stay_s <= t_s - state.since_s < math.inf:
        return state
    return RegionState(bisect_right(law.bounds, x), t_s)
