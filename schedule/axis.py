"""One axis of an operating map: a scheduling variable, its range and the borders on it, and its place without chatter.

Borders b_1 < ... < b_(n-1) divide low..high into n parts; a value on a border belongs to the part above it, values
outside low..high belong to the end parts. A part is left only when the value has passed a border by more than the
hysteresis h and the minimum stay is over; the place is then the part that contains the value, a neighbour or not. So
the value must travel 2 h to go out and come back: n changes of place need a travel of at least 2 h (n - 1), and noise
of less than 2 h from peak to peak cannot make it chatter.

A filter may come first: y' = (1 - w) y + w x with w = dt/(filter_s + dt), a first-order lag by backward difference as
in the PID law's derivative, stable for every dt. The filtered value chooses the place and interpolates. A value that is
not finite (a failed sensor, a signal that is stale) leaves both where they are.
"""

import math
from bisect import bisect_right
from dataclasses import InitVar, dataclass
from itertools import pairwise

CAN = "can"
VARIABLES = ("sp", "pv", "co", CAN)
"""Setpoint, process value, controller output, or another signal on the bus."""


@dataclass(frozen=True, slots=True)
class AxisLaw:
    """What `place` and `filtered` need: floors[i], ceilings[i] are part i's borders widened by h."""

    bounds: tuple[float, ...]
    floors: tuple[float, ...]
    ceilings: tuple[float, ...]
    min_stay_s: float
    filter_s: float


@dataclass(frozen=True, slots=True)
class Axis:
    """One scheduling variable and the parts that borders make of its range.

    Parameters
    ----------
    variable : what the axis is along: "sp", "pv", "co" or "can".
    unit : its unit, for people ("degC", "%").
    low, high : range of the variable; values outside count as the end parts.
    bounds : the n - 1 borders, increasing strictly, between low and high.
    hysteresis : how far the value must pass a border before its place changes, in unit, each way; 0 or more and at most
        half of the narrowest part's width, so that every part can be entered from both sides.
    min_stay_s : shortest time in a part, seconds, 0 or more.
    filter_s : time constant of the first-order filter before it all, seconds, 0 (none) or more.
    signal : name of the signal when the variable is "can", for people.
    names : of its parts, where they have any, for messages; not kept.

    Raises
    ------
    ValueError
        Anything else than this; the message names it.
    """

    variable: str
    unit: str
    low: float
    bounds: tuple[float, ...]
    high: float
    hysteresis: float = 0.0
    min_stay_s: float = 0.0
    filter_s: float = 0.0
    signal: str = ""
    names: InitVar[tuple[str, ...]] = ()

    def __post_init__(self, names: tuple[str, ...]) -> None:
        if self.variable not in VARIABLES:
            raise ValueError(f"variable = {self.variable!r} is unknown; use one of {', '.join(VARIABLES)}")
        for text in (self.unit, self.signal):
            if not text.isprintable():
                raise ValueError(f"{text!r} has characters that cannot be printed on one line")
        if self.signal and self.variable != CAN:
            raise ValueError(f"signal = {self.signal!r} belongs to variable {CAN!r}, not to {self.variable!r}")
        self._check_edges(names)
        for name, value in (("min_stay_s", self.min_stay_s), ("filter_s", self.filter_s)):
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} = {value} must be a finite number, 0 or more")

    def _check_edges(self, names: tuple[str, ...]) -> None:
        """Edges that increase, wide enough for the hysteresis."""
        edges = self.edges
        for edge in (*edges, self.high - self.low):
            if not math.isfinite(edge):
                raise ValueError(f"low, bounds, high = {edges}: {edge} is not a finite number")
        for i, (below, above) in enumerate(pairwise(edges)):
            if not below < above:
                raise ValueError(f"low, bounds, high = {edges} must increase; {above} after {below} does not")
            if not 0 <= 2 * self.hysteresis <= above - below:
                named = f"region {names[i]!r}" if i < len(names) else f"part {i + 1} of {self.label}"
                raise ValueError(
                    f"hysteresis = {self.hysteresis} must be 0 to half of every region's width;"
                    f" {named} is {above - below:g} wide"
                )

    def __len__(self) -> int:
        return len(self.bounds) + 1

    @property
    def edges(self) -> tuple[float, ...]:
        """Lower end, borders, upper end."""
        return (self.low, *self.bounds, self.high)

    @property
    def label(self) -> str:
        """What people call the variable: the signal's name, else sp, pv or co."""
        return self.signal or self.variable

    @property
    def is_plain(self) -> bool:
        """Whether its place follows from the value alone: no filter, and a value that comes with every sample."""
        return not self.filter_s and self.variable != CAN

    def span(self, part: int) -> tuple[float, float]:
        """Lower and upper border of a part, in unit; part counts from 0 (the lowest)."""
        edges = self.edges
        return edges[part], edges[part + 1]

    def centre(self, part: int) -> float:
        """Middle of a part, in unit."""
        low, high = self.span(part)
        return low + (high - low) / 2.0

    def text(self, part: int) -> str:
        """A part in words: 20 to 80 degC."""
        low, high = self.span(part)
        named = f"{self.signal} " if self.signal else ""
        return f"{named}{low:g} to {high:g} {self.unit}".rstrip()

    def law(self) -> AxisLaw:
        """The numbers that the steps below work with."""
        floors = (-math.inf, *(bound - self.hysteresis for bound in self.bounds))
        ceilings = (*(bound + self.hysteresis for bound in self.bounds), math.inf)
        return AxisLaw(self.bounds, floors, ceilings, self.min_stay_s, self.filter_s)


def filtered(law: AxisLaw, y: float, x: float, dt_s: float) -> float:
    """The filter's next value; y itself when x is not finite. y : last value. dt_s : time since then, 0 or more."""
    if not math.isfinite(x):
        return y
    if law.filter_s == 0.0:
        return x
    w = dt_s / (law.filter_s + dt_s)
    return (1.0 - w) * y + w * x


def place(law: AxisLaw, part: int, since_s: float, y: float, t_s: float) -> int:
    """The part in which y stands at t_s, having been in `part` since since_s (see the head of this file)."""
    if law.floors[part] <= y <= law.ceilings[part] or not law.min_stay_s <= t_s - since_s < math.inf:
        return part
    return bisect_right(law.bounds, y)
