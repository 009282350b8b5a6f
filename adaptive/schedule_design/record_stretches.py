"""Records cut into stretches: what a joint fit along a scheduling variable works on.

A stretch begins a little before a setpoint change, or where the one before is long enough. Its start is its own: level
and slope there are unknowns, so that what moves the loop slowly between the stretches teaches nothing wrong. pv and
the variable are means over an interval round their time; co is kept as its integral, exact at any delay.
"""

from collections.abc import Sequence
from enum import IntEnum
from itertools import pairwise

import numpy as np

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import GAP, FloatArray, Window
from retuner.schedule.late_dataclass import dataclass

MOST_ROWS = 400  # rows of a stretch at the most; longer ones are cut
FEWEST_ROWS = 24  # A shorter stretch shows no dynamics beside its start
LEAD_ROWS = 4  # rows of a stretch before its setpoint change: they tell its start
CHANGED = 3.0
"""A setpoint has changed when it moves by so many standard deviations of its noise, and by a hundredth of its range."""
SMOOTHED_ROWS = 5  # the scheduling variable is averaged over so many rows: it only says where the loop is


@dataclass(frozen=True, slots=True)
class Signals:
    """One record on an even clock. t_s, pv, sp, x : at the middle of each interval of h_s, shape (n,).

    x2 : a second scheduling variable there, where there is one.

    begun_s, fired : times, and the integral of co until each, at the record's own samples.
    changes : rows at which the setpoint changes.
    """

    h_s: float
    t_s: FloatArray
    pv: FloatArray
    sp: FloatArray
    x: FloatArray
    begun_s: FloatArray
    fired: FloatArray
    changes: tuple[int, ...]
    x2: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Stretch:
    """Rows first to end of a record. changed : its setpoint changes, LEAD_ROWS after its first row."""

    signals: Signals
    first: int
    end: int
    changed: bool

    def __len__(self) -> int:
        return self.end - self.first

    @property
    def pv(self) -> FloatArray:
        """pv of its rows."""
        return self.signals.pv[self.first : self.end]

    @property
    def x(self) -> FloatArray:
        """The scheduling variable of its rows."""
        return self.signals.x[self.first : self.end]

    @property
    def x2(self) -> FloatArray | None:
        """The second scheduling variable of its rows."""
        return None if self.signals.x2 is None else self.signals.x2[self.first : self.end]

    @property
    def t_s(self) -> FloatArray:
        """Times of its rows."""
        return self.signals.t_s[self.first : self.end]

    def fired(self, t_s: FloatArray) -> FloatArray:
        """The integral of co until these times; before the record co was what it was at first."""
        return self.summed(self.signals.fired, t_s)

    def summed(self, fired: FloatArray, t_s: FloatArray) -> FloatArray:
        """An integral over the record's samples, until these times. fired : until each of begun_s."""
        begun = self.signals.begun_s
        found = np.interp(t_s, begun, fired)
        early = begun[0] - t_s
        rate = (fired[1] - fired[0]) / (begun[1] - begun[0])
        return np.asarray(np.where(early > 0, fired[0] - rate * early, found), dtype=np.float64)


def signals_of(window: Window, x: FloatArray, every: int, x2: FloatArray | None = None) -> Signals:
    """A record with `every` of its samples in an interval.

    window : the record. x : the scheduling variable at its samples, shape (n,). x2 : a second one.
    """
    dt = window.sample_time_s
    h = every * dt
    held = np.diff(window.t_s, append=window.t_s[-1] + dt)
    fired = np.concatenate([[0.0], np.cumsum(window.co * held)])
    t = np.arange(window.t_s[0] + h / 2, window.t_s[-1], h) if every > 1 else window.t_s
    pv, sp, x = (_averaged(window.t_s, values, t, h, dt) for values in (window.pv, window.sp, x))
    beside = None if x2 is None else _smoothed(_averaged(window.t_s, x2, t, h, dt))
    begun = np.append(window.t_s, window.t_s[-1] + dt)
    # rows of the even clock in which the setpoint steps
    moved = np.abs(np.diff(window.sp))
    least = max(CHANGED * noise_sigma(window.sp), 0.01 * float(np.ptp(window.sp)))
    rows = np.unique(np.searchsorted(t, window.t_s[1:][moved > least])) if least else np.zeros(0, dtype=np.int64)
    changes = tuple(int(row) for row in rows if row < len(t))
    return Signals(h, t, pv, sp, _smoothed(x), begun, fired, changes, beside)


def _smoothed(x: FloatArray) -> FloatArray:
    if len(x) <= SMOOTHED_ROWS:
        return x
    padded = np.pad(x, SMOOTHED_ROWS // 2, mode="edge")
    return np.convolve(padded, np.full(SMOOTHED_ROWS, 1 / SMOOTHED_ROWS), "valid")


def _averaged(at_s: FloatArray, values: FloatArray, t_s: FloatArray, h_s: float, dt: float) -> FloatArray:
    """Means over h_s round each of t_s; a value stands for the time round its own."""
    if h_s <= 1.5 * dt:
        return np.interp(t_s, at_s, values)
    edges = np.concatenate([[at_s[0] - dt / 2], (at_s[1:] + at_s[:-1]) / 2, [at_s[-1] + dt / 2]])
    summed = np.concatenate([[0.0], np.cumsum(values * np.diff(edges))])
    low, high = (np.interp(t_s + side * h_s / 2, edges, summed) for side in (-1, 1))
    width = np.clip(t_s + h_s / 2, edges[0], edges[-1]) - np.clip(t_s - h_s / 2, edges[0], edges[-1])
    return np.asarray((high - low) / width, dtype=np.float64)


def cut(signals: Signals) -> list[Stretch]:
    """The stretches of a record, in time."""
    n, last = len(signals.t_s), -MOST_ROWS
    starts: dict[int, bool] = {0: False}
    for row in signals.changes:
        if row - last > FEWEST_ROWS:  # a ramp is one change
            starts[max(row - LEAD_ROWS, 0)] = row >= LEAD_ROWS
        last = row
    edges = [*sorted(starts), n]
    found: list[Stretch] = []
    for first, end in pairwise(edges):
        pieces = -(-(end - first) // MOST_ROWS)
        inside = np.linspace(first, end, pieces + 1).astype(int).tolist()
        found += [Stretch(signals, a, b, starts[first] and a == first) for a, b in pairwise(inside)]
    return [stretch for stretch in found if len(stretch) >= FEWEST_ROWS]


BLOCKS = 8  # parts of a stretch whose means are compared
BEYOND_NOISE = 3.0  # standard deviations of such a mean by noise alone, from which pv is seen to move


def tells(stretch: Stretch) -> bool:
    """Whether pv moves beyond its noise."""
    means = np.array([float(np.mean(part)) for part in np.array_split(stretch.pv, BLOCKS)])
    noise = noise_sigma(stretch.pv) / np.sqrt(len(stretch) / BLOCKS)
    return bool(float(np.std(means)) > BEYOND_NOISE * noise)


def moving(stretches: Sequence[Stretch]) -> list[Stretch]:
    """The stretches in which both co and pv move."""
    return [s for s in stretches if np.ptp(s.pv) > 0 and np.ptp(np.diff(s.fired(s.t_s))) > 0]


def without_gaps(window: Window, values: FloatArray) -> list[tuple[Window, FloatArray]]:
    """A record and a variable at its samples, cut where samples are missing; short pieces are left out."""
    rows = np.flatnonzero(np.diff(window.t_s) > GAP * window.sample_time_s) + 1
    if not len(rows):
        return [(window, values)]
    edges = [0, *rows.tolist(), len(window.t_s)]
    return [(window.part(slice(a, b)), values[a:b]) for a, b in pairwise(edges) if b - a >= FEWEST_ROWS]


# ---- Shapes of a parameter over the scheduling variable, and what is thought of them before any record.
#
#     ln p(x) = m + 3 z_0 + 0.7 z_1 xi(x) + 0.35 sum_j z_j e_j(x),    z ~ N(0, 1),    xi from -1 to 1 over the range
#
# Level, slope, and bends: e_j are the principal components of a straight-line-free integrated Wiener process on a
# few knots (the prior of the smoothing spline, Wahba 1978). With the bends left out it is a line in ln p, with the
# slope left out as well a constant; which of the three holds, the evidence decides for each parameter by itself.

LEVEL_STD, SLOPE_STD, BEND_STD = 3.0, 0.7, 0.35
"""Spread of ln p: whole level; either end against the middle (a factor of 4 over the range is one); a bend."""
BENDS = 6  # principal components of a bend
KNOTS = 13


class CurveShape(IntEnum):
    """How many coefficients a parameter has."""

    CONSTANT = 1
    LINE = 2
    BENT = 2 + BENDS


@dataclass(frozen=True, slots=True)
class CurveAxis:
    """Where the curves live: low to high of the scheduling variable.

    by_ratio : whether a straight line is one over ln x, a power law, as gain, lag and delay over a flow are.
    """

    low: float
    high: float
    by_ratio: bool = False

    def columns(self, x: FloatArray, shape: CurveShape) -> FloatArray:
        """d ln p(x) / dz, shape (*x.shape, shape). Outside low..high it is what it is at the end."""
        inside = np.clip(x, self.low, self.high)
        share = (inside - self.low) / (self.high - self.low)
        if self.by_ratio:
            share = np.log(inside / self.low) / np.log(self.high / self.low)
        xi = 2 * share - 1
        found = [np.full(x.shape, LEVEL_STD), SLOPE_STD * xi]
        found += [np.interp(xi, _PLACES, bend) for bend in _BENT.T]
        return np.stack(found[: int(shape)], axis=-1)

    def grid(self, n: int) -> FloatArray:
        """n places from low to high."""
        return np.linspace(self.low, self.high, n)


@dataclass(frozen=True, slots=True)
class Second:
    """A second variable beside the first: ln p(x, x2) is the curve over x and one over x2 without a level of its own.

    So every parameter is a product k(x) f(x2): both may matter, and neither bends the other's curve.

    axis : of x2. shapes : of each parameter over it. pushed : it comes from outside and moves pv by itself.
    """

    axis: CurveAxis
    shapes: tuple[CurveShape, ...]
    pushed: bool = False

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of coefficients of each parameter."""
        return tuple(int(shape) - 1 for shape in self.shapes)

    def columns(self, x2: FloatArray, i: int) -> FloatArray:
        """d ln p_i / dz at x2, shape (*x2.shape, sizes[i])."""
        return self.axis.columns(x2, self.shapes[i])[..., 1:]


def _bends() -> FloatArray:
    """The bends at the knots, shape (KNOTS, BENDS), scaled by BEND_STD."""
    t = np.linspace(0.0, 1.0, KNOTS)
    early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
    wiener = early**2 * (3 * late - early) / 6
    line = np.stack([np.ones(KNOTS), t], axis=1)
    q = np.linalg.qr(line)[0]
    free = np.eye(KNOTS) - q @ q.T
    values, vectors = np.linalg.eigh(free @ wiener @ free)
    bends = vectors[:, ::-1][:, :BENDS] * np.sqrt(values[::-1][:BENDS])
    typical = np.sqrt(np.mean(np.sum(bends**2, axis=1)))
    return np.asarray(bends * BEND_STD / typical, dtype=np.float64)


_PLACES = np.linspace(-1.0, 1.0, KNOTS)
_BENT = _bends()


# ---- The installed characteristic: how strongly a percent of co acts, over co itself.
#
#     v = phi(u),   ln phi'(u) = slope and bends over co, without a level of its own (that is the slope gain's)
#
# A valve's curve, burst firing, a fan's law: on the way co is far from where it rests, and the process answers
# there with another gain than at rest. A fit that knows only the place of pv puts that into lags and bends of the
# place (Hammerstein model; Narendra and Gallman 1966). At rest the two are one: the gain at a place is that of the
# co which holds it.

GRID = 101  # values of co at which phi is worked out; a straight line between
LEAST_TRAVEL = 1e-6  # travel of co, as a share of its size, below which it has no characteristic


@dataclass(frozen=True, slots=True)
class Characteristic:
    """A characteristic of co over axis, its range in the records. shape : LINE or BENT; CONSTANT is co as it is.

    slope : of ln phi' per unit of co, as it is known beforehand. doubt : of its coefficients, 1 where nothing is.
    """

    axis: CurveAxis
    shape: CurveShape = CurveShape.CONSTANT
    slope: float = 0.0
    doubt: float = 1.0

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.shape) - 1

    def columns(self, co: FloatArray) -> FloatArray:
        """d ln phi'/dz at co, shape (*co.shape, size)."""
        return self.doubt * self.axis.columns(co, self.shape)[..., 1:]

    def known(self, co: FloatArray) -> FloatArray:
        """ln phi' as it is known beforehand, shape (*co.shape); 0 in the middle of the axis."""
        inside = np.clip(co, self.axis.low, self.axis.high)
        return np.asarray(self.slope * (inside - (self.axis.low + self.axis.high) / 2), dtype=np.float64)

    def felt(self, co: FloatArray, z: FloatArray) -> FloatArray:
        """phi(co) for each variant of z, shape (size, variants): (n, variants). Beyond the axis its slope stays."""
        grid = self.axis.grid(GRID)
        rate = np.exp(self.known(grid)[:, None] + self.columns(grid) @ z)
        width = (self.axis.high - self.axis.low) / (GRID - 1)
        summed = np.concatenate([np.zeros((1, z.shape[1])), np.cumsum((rate[1:] + rate[:-1]) / 2 * width, axis=0)])
        inside = np.clip(co, self.axis.low, self.axis.high)
        found = [np.interp(inside, grid, summed[:, i]) for i in range(z.shape[1])]
        ends = np.where((co > self.axis.high)[:, None], rate[-1], rate[0])
        return np.asarray(np.stack(found, axis=1) + (co - inside)[:, None] * ends, dtype=np.float64)


def over(stretches: Sequence[Stretch], shape: CurveShape = CurveShape.BENT) -> Characteristic | None:
    """The characteristic over what co does in the records; None where it stands still."""
    rates = [np.diff(s.fired(s.t_s)) / np.diff(s.t_s) for s in stretches]
    low, high = min(float(np.min(r)) for r in rates), max(float(np.max(r)) for r in rates)
    if not high - low > LEAST_TRAVEL * max(abs(low), abs(high)):
        return None
    return Characteristic(CurveAxis(low, high), shape)


def summed(characteristic: Characteristic, stretches: Sequence[Stretch], z: FloatArray) -> list[FloatArray]:
    """The integral of phi(co) until each of a stretch's Signals.begun_s, (n, variants), for each; worked out once."""
    done: list[tuple[Signals, FloatArray]] = []
    found = []
    for stretch in stretches:
        signals = stretch.signals
        known = next((values for of, values in done if of is signals), None)
        if known is None:
            held = np.diff(signals.begun_s)
            felt = characteristic.felt(np.diff(signals.fired) / held, z) * held[:, None]
            known = np.concatenate([np.zeros((1, z.shape[1])), np.cumsum(felt, axis=0)])
            done.append((signals, known))
        found.append(known)
    return found
