"""Gains in force along the scheduling variable: one set, a table of regions, or a curve through points."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import Protocol

from retuner import GainTable, PidGains
from retuner.schedule.regions import Regions, choose, enter


class Lookup(Protocol):
    """Gains by the scheduling variable; `size` sets are stored."""

    size: int

    def begin(self, x: float) -> None:
        """The loop starts there."""

    def gains(self, x: float, t_s: float) -> PidGains:
        """In force at this sample."""

    def frozen(self, x: float) -> PidGains:
        """In force after a long time at x, reached from below."""


class Curve:
    """Straight lines between sets at points, in parallel form; one set is the same everywhere."""

    def __init__(self, xs: Sequence[float], sets: Sequence[PidGains]) -> None:
        self.xs, self.sets, self.size = list(xs), list(sets), len(sets)

    def begin(self, x: float) -> None:
        """Nothing is remembered."""

    def gains(self, x: float, _t_s: float) -> PidGains:
        """See Lookup."""
        return self.frozen(x)

    def frozen(self, x: float) -> PidGains:
        """See Lookup."""
        i = bisect_right(self.xs, x)
        if i == 0 or i == len(self.xs):
            return self.sets[min(i, len(self.xs) - 1)] if i == 0 else self.sets[-1]
        low, high = self.sets[i - 1], self.sets[i]
        w = (x - self.xs[i - 1]) / (self.xs[i] - self.xs[i - 1])
        return mixed(low, high, w)


def regions_along(by: str, low: float, bounds: tuple[float, ...], high: float, hysteresis: float) -> Regions:
    """Regions along pv, or along a signal of that name from outside."""
    names = tuple(f"part {i + 1}" for i in range(len(bounds) + 1))
    if by == "pv":
        return Regions("pv", "", names, low, bounds, high, hysteresis)
    return Regions("can", "", names, low, bounds, high, hysteresis, signal=by)


def mixed(low: PidGains, high: PidGains, w: float) -> PidGains:
    """(1 - w) low + w high."""
    return PidGains((1 - w) * low.kp + w * high.kp, (1 - w) * low.ki + w * high.ki, (1 - w) * low.kd + w * high.kd)


class Table:
    """A gain table, hard or interpolated, with hysteresis, stay and filter as it says."""

    def __init__(self, table: GainTable) -> None:
        self.table, self.size = table, len(table.gains)
        self._law = table.regions.law()
        self._state = enter(self._law, table.regions.low, 0.0)

    def begin(self, x: float) -> None:
        """See Lookup."""
        self._state = enter(self._law, x, 0.0)

    def gains(self, x: float, t_s: float) -> PidGains:
        """See Lookup."""
        self._state = choose(self._law, self._state, x, t_s)
        return self.table.at(self._state.region, x)

    def frozen(self, x: float) -> PidGains:
        """See Lookup."""
        return self.table.at(enter(self._law, x, 0.0).region, x)
