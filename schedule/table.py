"""The gain table: one set of gains per region, immutable, with a revision that counts up with every change.

Hard lookup: the gains of the region in force, wherever in it the variable stands. Interpolated lookup: the gains of a
region hold at its centre; between two centres they are the weighted mean of both, below the first and above the last
centre they stay. In parallel form the mean of the gains is exactly the mean of the two controllers.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions


class Lookup(StrEnum):
    """How gains are read between the regions' centres."""

    HARD = "hard"
    INTERPOLATED = "interpolated"


@dataclass(frozen=True, slots=True)
class GainTable:
    """Gains per region.

    Parameters
    ----------
    loop : name of the loop. regions : where each set holds. gains : one set per region, all of one direction.
    lookup : hard or interpolated. revision : 0 as commissioned, one more with every change.

    Raises
    ------
    ValueError
        The numbers of regions and gains differ, directions differ, or the revision is negative.
    """

    loop: str
    regions: Regions
    gains: tuple[PidGains, ...]
    lookup: Lookup = Lookup.HARD
    revision: int = 0

    def __post_init__(self) -> None:
        if len(self.gains) != len(self.regions.names):
            raise ValueError(
                f"table {self.loop}: {len(self.gains)} sets of gains for {len(self.regions.names)} regions"
            )
        if len({gains.direction for gains in self.gains}) > 1:
            raise ValueError(f"table {self.loop}: the regions' gains act in different directions")
        if self.revision < 0:
            raise ValueError(f"table {self.loop}: revision = {self.revision} must not be negative")

    def index(self, region: str | int) -> int:
        """Index of a region by name or index.

        Raises
        ------
        KeyError
            There is no such region.
        """
        if isinstance(region, str):
            if region not in self.regions.names:
                raise KeyError(f"table {self.loop} has no region {region!r}; it has {', '.join(self.regions.names)}")
            return self.regions.names.index(region)
        if not 0 <= region < len(self.gains):
            raise KeyError(f"table {self.loop} has no region {region}; it has 0 to {len(self.gains) - 1}")
        return region

    def gains_of(self, region: str | int) -> PidGains:
        """The gains stored for a region."""
        return self.gains[self.index(region)]

    def with_gains(self, region: str | int, gains: PidGains) -> "GainTable":
        """A new revision with other gains in one region."""
        i = self.index(region)
        changed = (*self.gains[:i], gains, *self.gains[i + 1 :])
        return replace(self, gains=changed, revision=self.revision + 1)

    def at(self, region: str | int, x: float) -> PidGains:
        """The gains to run in a region when the scheduling variable stands at x."""
        i = self.index(region)
        return self.gains[i] if self.lookup == Lookup.HARD else self._interpolated(x)

    def _interpolated(self, x: float) -> PidGains:
        """Weighted mean of the two centres round x, ends held."""
        knots = self.regions.centres
        if x <= knots[0]:
            return self.gains[0]
        for i in range(1, len(knots)):
            if x < knots[i]:
                w = (x - knots[i - 1]) / (knots[i] - knots[i - 1])
                a, b = self.gains[i - 1], self.gains[i]
                return PidGains(a.kp + w * (b.kp - a.kp), a.ki + w * (b.ki - a.ki), a.kd + w * (b.kd - a.kd))
        return self.gains[-1]
