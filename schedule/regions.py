"""Operating regions along one scheduling variable, with hysteresis and a minimum stay.

Region i reaches from bounds[i-1] to bounds[i]. A region is left when the variable has passed its border by the
hysteresis, and not before the minimum stay is over, so that noise on the variable cannot make the gains chatter.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple


class RegionLaw(NamedTuple):
    """What the step needs: inner borders, hysteresis, and minimum stay in seconds."""

    bounds: tuple[float, ...]
    hysteresis: float
    min_stay_s: float


class RegionState(NamedTuple):
    """The region that is in force, and since when; low and high are its borders widened by the hysteresis."""

    region: int
    since_s: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions along a named variable.

    Parameters
    ----------
    variable : what schedules ("sp", "pv" or "co"). unit : of the variable.
    names : one per region, unique. low, high : ends of the whole range.
    bounds : inner borders, strictly increasing between low and high; one fewer than names.
    hysteresis : how far beyond a border a region is kept; from 0 to half of the narrowest region.
    min_stay_s : shortest stay in a region, seconds.

    Raises
    ------
    ValueError
        A value is not finite or breaks one of these rules; it is named.
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
        edges = self.edges
        if not all(math.isfinite(v) for v in (*edges, self.hysteresis, self.min_stay_s)):
            raise ValueError(f"regions: edges {edges}, hysteresis and min_stay_s must be finite numbers")
        if len(self.names) != len(self.bounds) + 1:
            raise ValueError(
                f"regions: {len(self.names)} names for {len(self.bounds)} bounds; one name more than bounds"
            )
        if len(set(self.names)) != len(self.names) or not all(self.names):
            raise ValueError(f"regions: names {self.names} must be different and not empty")
        widths = [b - a for a, b in zip(edges, edges[1:], strict=False)]
        if min(widths) <= 0:
            raise ValueError(f"regions: low, bounds and high must increase; they are {edges}")
        if not 0 <= self.hysteresis <= min(widths) / 2:
            raise ValueError(f"regions: hysteresis = {self.hysteresis} must lie between 0 and half of the narrowest "
                             f"region, {min(widths) / 2:g}")  # fmt: skip
        if self.min_stay_s < 0:
            raise ValueError(f"regions: min_stay_s = {self.min_stay_s} must not be negative")

    @property
    def edges(self) -> tuple[float, ...]:
        """All borders from low to high."""
        return (self.low, *self.bounds, self.high)

    @property
    def centres(self) -> tuple[float, ...]:
        """Middle of each region: the knots of an interpolated table."""
        edges = self.edges
        return tuple((a + b) / 2 for a, b in zip(edges, edges[1:], strict=False))

    def law(self) -> RegionLaw:
        """What `choose` needs."""
        return RegionLaw(self.bounds, self.hysteresis, self.min_stay_s)


def _at(law: RegionLaw, index: int, t_s: float) -> RegionState:
    """The state of having entered a region."""
    low = law.bounds[index - 1] - law.hysteresis if index > 0 else -math.inf
    high = law.bounds[index] + law.hysteresis if index < len(law.bounds) else math.inf
    return RegionState(index, t_s, low, high)


def enter(law: RegionLaw, x: float, t_s: float) -> RegionState:
    """The region of x without a history; on a border the upper one. A non-finite x is refused.

    Raises
    ------
    ValueError
        x is not finite.
    """
    if not math.isfinite(x):
        raise ValueError(f"the scheduling variable is {x}; it must be finite to enter a region")
    return _at(law, sum(1 for b in law.bounds if x >= b), t_s)


def choose(law: RegionLaw, state: RegionState, x: float, t_s: float) -> RegionState:
    """The region after one more sample; the same object while nothing changes. A non-finite x holds the region."""
    if state.low < x < state.high or x - x != 0.0:
        return state
    if t_s - state.since_s < law.min_stay_s:
        return state
    entered = enter(law, x, t_s)
    return state if entered.region == state.region else entered
