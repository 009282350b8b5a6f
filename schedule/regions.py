"""Operating regions along one or two scheduling variables: which region a loop is in, without chatter.

One axis makes a row of regions from low to high. Two axes (temperature and load, say) make a map of cells, one region
a cell, counted row by row: region = i n_2 + j, i along the first axis and j along the second, both from 0. Each axis
chooses its place by itself (filter, hysteresis, minimum stay), and the region is where both stand; when the
value of one is not finite, the other goes on. Regions are neighbours when they share a boundary; those that meet only
in a corner are not.

`choose` runs at every sample. Its common case, one axis without a filter and x still inside the region's widened
boundaries, is one comparison; a law that needs more has floors that no x reaches, so that nobody else pays for it. With
filters the common case is that both filtered values are still inside them: the filters move and nothing else does.
"""

import math
import sys
from bisect import bisect_right
from itertools import pairwise
from typing import NamedTuple

from retuner.schedule.late_dataclass import InitVar, dataclass, field

# ---- One axis of an operating map: a scheduling variable, its range and the boundaries on it, and its place without
# chatter.
#
# Boundaries b_1 < ... < b_(n-1) divide low..high into n parts; a value on a boundary belongs to the part above it,
# values outside low..high belong to the end parts. A part is left only when the value has passed a boundary by more
# than the hysteresis h and the minimum stay is over; the place is then the part that contains the value, a neighbour or
# not. So the value must travel 2 h to go out and come back: n changes of place need a travel of at least 2 h (n - 1),
# and noise of less than 2 h from peak to peak cannot make it chatter.
#
# A filter may come first: y' = (1 - w) y + w x with w = dt/(filter_s + dt), a first-order lag by backward
# difference as in the PID law's derivative, stable for every dt. The filtered value chooses the place and
# interpolates. A value that is not finite (a failed sensor, a signal that is stale) leaves both where they are.

CAN = "can"
VARIABLES = ("sp", "pv", "co", CAN)  # Setpoint, process value, controller output, or another signal on the bus


@dataclass(frozen=True, slots=True)
class AxisLaw:
    """What `place` and `filtered` need: floors[i], ceilings[i] are part i's boundaries widened by h."""

    bounds: tuple[float, ...]
    floors: tuple[float, ...]
    ceilings: tuple[float, ...]
    min_stay_s: float
    filter_s: float


@dataclass(frozen=True, slots=True)
class Axis:
    """One scheduling variable and the parts that boundaries make of its range.

    Parameters
    ----------
    variable : what the axis is along: "sp", "pv", "co" or "can".
    unit : its unit, for people ("degC", "%").
    low, high : range of the variable; values outside count as the end parts.
    bounds : the n - 1 boundaries, increasing strictly, between low and high.
    hysteresis : how far the value must pass a boundary before its place changes, in unit, each way; 0 or more and at
        most half of the narrowest part's width, so that every part can be entered from both sides.
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
        for name, value in (("min_stay_s", self.min_stay_s), ("filter_s", self.filter_s)):
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} = {value} must be a finite number, 0 or more")

    def __len__(self) -> int:
        return len(self.bounds) + 1

    @property
    def edges(self) -> tuple[float, ...]:
        """Lower end, boundaries, upper end."""
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
        """Lower and upper boundary of a part, in unit; part counts from 0 (the lowest)."""
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
    """The part in which y stands at t_s, having been in `part` since since_s (see above)."""
    if law.floors[part] <= y <= law.ceilings[part] or not law.min_stay_s <= t_s - since_s < math.inf:
        return part
    return bisect_right(law.bounds, y)


# ---- Operating regions along one or two scheduling variables


class RegionState(NamedTuple):
    """Where a loop is. Plain scalars only: it is kept in the memory and travels per sample.

    region : index of the region. since_s : when its place on the first axis was entered, seconds; since2_s : the same
    on the second. y, y2 : filtered values in force, t_s : of which time (used where an axis is not plain, else 0).
    """

    region: int
    since_s: float
    since2_s: float = 0.0
    y: float = 0.0
    y2: float = 0.0
    t_s: float = 0.0


class Boundary(NamedTuple):
    """The boundary between two neighbours: axis 0 or 1, and where on it, in that axis' unit."""

    axis: int
    value: float


@dataclass(frozen=True, slots=True)
class RegionLaw:
    """What `choose` needs, made by Regions.law().

    axes : empty when there is one and it is plain (see the head). cells : where there are axes, a region's time
    constant, floor and ceiling on the first, and on the second.
    """

    bounds: tuple[float, ...]
    floors: tuple[float, ...]
    ceilings: tuple[float, ...]
    min_stay_s: float
    axes: tuple[AxisLaw, ...] = ()
    columns: int = 1
    cells: tuple[tuple[float, float, float, float, float, float], ...] = ()


OF_AXIS = ("variable", "unit", "low", "bounds", "high", "hysteresis", "min_stay_s", "filter_s", "signal")
"""What regions along one variable have of their axis."""
_LARGEST = sys.float_info.max
_NO_AXIS = (math.inf, -_LARGEST, _LARGEST)
"""What stands for a second axis where there is none: a filter that never moves, and no boundary."""


@dataclass(frozen=True, slots=True)
class Regions:
    """Operating regions along one or two named scheduling variables.

    Parameters
    ----------
    variable, unit, low, bounds, high, hysteresis, min_stay_s, filter_s, signal : the first axis, as Axis says.
    names : one a region, row by row (see above), different, not empty.
    second : the second axis, None for none.

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
    filter_s: float = 0.0
    signal: str = ""
    second: Axis | None = None
    axes: tuple[Axis, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        own = {name: getattr(self, name) for name in OF_AXIS}
        first = Axis(**own, names=self.names if self.second is None else ())
        axes = (first,) if self.second is None else (first, self.second)
        object.__setattr__(self, "axes", axes)
        # One printable name a region, all different
        if len(self.names) != math.prod(self.shape):
            bounds = " and ".join(str(len(axis.bounds)) for axis in self.axes)
            raise ValueError(f"{bounds} bounds make {math.prod(self.shape)} regions, not {len(self.names)}")
        for name in self.names:
            if not name.isprintable():
                raise ValueError(f"{name!r} has characters that cannot be printed on one line")
        if not all(name.strip() for name in self.names) or len(set(self.names)) < len(self.names):
            raise ValueError(f"names = {self.names} must be different and not empty")

    @classmethod
    def along(cls, names: tuple[str, ...], first: Axis, second: Axis | None = None) -> "Regions":
        """Regions along one or two axes; errors as the class."""
        return cls(names=names, second=second, **{name: getattr(first, name) for name in OF_AXIS})

    def __len__(self) -> int:
        return len(self.names)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of parts along each axis."""
        return tuple(len(axis) for axis in self.axes)

    def law(self) -> RegionLaw:
        """The numbers that `choose` works with."""
        laws = tuple(axis.law() for axis in self.axes)
        first = laws[0]
        if len(laws) == 1 and self.axes[0].is_plain:
            return RegionLaw(first.bounds, first.floors, first.ceilings, first.min_stay_s)
        n = len(self)
        never = (math.inf,) * n, (-math.inf,) * n
        seconds = [_sides(laws[1], j) for j in range(self.shape[1])] if len(laws) > 1 else [_NO_AXIS]
        cells = tuple((*_sides(first, i), *second) for i in range(self.shape[0]) for second in seconds)
        return RegionLaw(first.bounds, *never, first.min_stay_s, laws, len(seconds), cells)

    def cell(self, region: int) -> tuple[int, ...]:
        """Place of a region on each axis, from 0.

        Raises
        ------
        ValueError
            There is no such region.
        """
        if not 0 <= region < len(self.names):
            raise ValueError(f"region {region} does not exist; there are {len(self.names)}, counted from 0")
        return (region,) if self.second is None else divmod(region, len(self.second))

    def region_at(self, cell: tuple[int, ...]) -> int:
        """The region of a cell, which counts from 0.

        Raises
        ------
        ValueError
            There is no such cell.
        """
        shape = self.shape
        if len(cell) != len(shape) or not all(0 <= i < n for i, n in zip(cell, shape, strict=True)):
            raise ValueError(f"cell {cell} does not exist; the regions are {' x '.join(map(str, shape))}")
        return cell[0] if self.second is None else cell[0] * len(self.second) + cell[1]

    def span(self, region: int, axis: int = 0) -> tuple[float, float]:
        """Lower and upper boundary of a region along an axis (0 or 1), in its unit; errors as `cell`."""
        return self.axes[axis].span(self.cell(region)[axis])

    def centre(self, region: int, axis: int = 0) -> float:
        """Middle of a region along an axis (0 or 1), in its unit; errors as `cell`."""
        return self.axes[axis].centre(self.cell(region)[axis])

    def text(self, region: int) -> str:
        """Where a region lies, in words: "20 to 80 degC", "20 to 80 degC, flow 30 to 60 %"; errors as `cell`."""
        return ", ".join(axis.text(part) for axis, part in zip(self.axes, self.cell(region), strict=True))

    def neighbours(self, region: int) -> tuple[int, ...]:
        """The regions that share a boundary with this one, in order; errors as `cell`."""
        return tuple(other for other in range(len(self)) if self.distance(region, other) == 1)

    def distance(self, a: int, b: int) -> int:
        """The least number of boundaries on the way from one region to another; errors as `cell`."""
        return sum(abs(i - j) for i, j in zip(self.cell(a), self.cell(b), strict=True))

    def boundary(self, a: int, b: int) -> Boundary:
        """The boundary between two neighbours.

        Raises
        ------
        ValueError
            A region does not exist, or they share no boundary.
        """
        if self.distance(a, b) != 1:
            raise ValueError(f"regions {self.names[a]!r} and {self.names[b]!r} share no boundary")
        one, two = self.cell(a), self.cell(b)
        axis = 0 if one[0] != two[0] else 1
        return Boundary(axis, self.axes[axis].bounds[min(one[axis], two[axis])])


def _sides(law: AxisLaw, part: int) -> tuple[float, float, float]:
    """Time constant, floor and ceiling of a part; what is not finite lies beyond every ceiling."""
    return law.filter_s, max(law.floors[part], -_LARGEST), min(law.ceilings[part], _LARGEST)


def enter(law: RegionLaw, x: float, t_s: float, x2: float = 0.0, last: RegionState | None = None) -> RegionState:
    """The region of x (and x2) without hysteresis: at the first sample, and again after a gap.

    x, x2 : scheduling variables in their units (x2 counts only where there are two). t_s : time in seconds.
    last : where the loop was; an axis whose value is not finite now keeps its place of then.

    Raises ValueError: t_s is not finite, or x or x2 is not and there is no `last`.
    """
    xs = (x, x2)[: max(len(law.axes), 1)]
    if not math.isfinite(t_s) or (last is None and not all(map(math.isfinite, xs))):
        raise ValueError(f"x = {', '.join(map(str, xs))} at t_s = {t_s} s: all must be finite to choose a first region")
    if not law.axes:
        return RegionState(bisect_right(law.bounds, x), t_s) if math.isfinite(x) or last is None else last
    was = last or RegionState(0, t_s)
    y, y2 = (new if math.isfinite(new) else old for new, old in ((x, was.y), (x2, was.y2)))
    places = [
        bisect_right(axis.bounds, new) if math.isfinite(new) else old
        for axis, new, old in zip(law.axes, (x, x2), divmod(was.region, law.columns), strict=False)
    ]
    return RegionState(places[0] * law.columns + sum(places[1:]), t_s, t_s, y, y2, t_s)


def choose(law: RegionLaw, state: RegionState, x: float, t_s: float, x2: float = 0.0) -> RegionState:
    """The region at this sample; the same object as long as nothing changes.

    x, x2 : scheduling variables in their units; when one is not finite (a failed sensor), its axis keeps its place.
    t_s : time of the sample in seconds; when it is not finite or runs backwards, the region stays.
    """
    region = state[0]
    if law.floors[region] <= x <= law.ceilings[region]:
        return state
    if law.axes:
        # the same on filtered values. `filtered` stands here once more, because a call is dear here
        region, since_s, since2_s, y, y2, last_s = state
        dt_s = t_s - last_s
        if dt_s > 0.0:
            lag_s, floor, ceiling, lag2_s, floor2, ceiling2 = law.cells[region]
            w = dt_s / (lag_s + dt_s)
            w2 = dt_s / (lag2_s + dt_s)
            new, new2 = (1.0 - w) * y + w * x, (1.0 - w2) * y2 + w2 * x2
            if floor <= new <= ceiling and floor2 <= new2 <= ceiling2:
                return _new(RegionState, (region, since_s, since2_s, new, new2, t_s))
        return _place_anew(law, state, x, x2, t_s) if 0.0 <= dt_s < math.inf else state
    if not math.isfinite(x) or not law.min_stay_s <= t_s - state.since_s < math.inf:
        return state
    return RegionState(bisect_right(law.bounds, x), t_s)


_new = tuple.__new__  # half the time of a NamedTuple's own constructor


def _place_anew(law: RegionLaw, state: RegionState, x: float, x2: float, t_s: float) -> RegionState:
    """The place axis by axis: a boundary is passed, a value is not known, or no time has gone by."""
    region, since_s, since2_s, y, y2, last_s = state
    dt_s = t_s - last_s
    i, j = divmod(region, law.columns)
    first = law.axes[0]
    y = filtered(first, y, x, dt_s)
    i_now = place(first, i, since_s, y, t_s)
    if i_now != i:
        since_s = t_s
    if len(law.axes) > 1:
        second = law.axes[1]
        y2 = filtered(second, y2, x2, dt_s)
        j_now = place(second, j, since2_s, y2, t_s)
        if j_now != j:
            j, since2_s = j_now, t_s
    return RegionState(i_now * law.columns + j, since_s, since2_s, y, y2, t_s)


def values(law: RegionLaw, state: RegionState, x: float, x2: float = 0.0) -> tuple[float, float]:
    """The scheduling values in force: filtered, and the last good ones where x or x2 is not finite.

    Where the only axis is plain they are the sample's own (x must be finite then: it comes with every sample).
    """
    return (state.y, state.y2) if law.axes else (x, x2)
