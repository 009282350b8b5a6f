"""One sample of a loop, and a window of samples: the form in which every other file of `adaptive` sees data."""

import math
from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache, wraps
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from retuner.schedule.late_dataclass import dataclass

FloatArray = npt.NDArray[np.float64]

EVERYWHERE = (-math.inf, math.inf)  # ends of a range that are not known
EVEN = (0.5, 1.5)  # intervals, in the usual one, between which a clock is even: stamps are rounded, and read late
GAP = 10.0  # usual intervals without a sample that are a gap in the record: nothing is known of co in it
LARGEST = 1e30  # largest magnitude of a number; the squares of larger ones leave the range of double precision in a fit


class LoopMode(IntEnum):
    """Who moves the controller output.

    Attributes
    ----------
    MANUAL : an operator. AUTO : the controller.
    """

    MANUAL = 0
    AUTO = 1


class LoopSample(NamedTuple):
    """What the loop did at one sampling instant. Plain scalars only: this is the per-sample path.

    Attributes
    ----------
    t_s : time of the sample in seconds, increasing.
    sp, pv : setpoint and process value in the same engineering unit.
    co : controller output applied from this instant on (held until the next sample).
    mode : MANUAL or AUTO.
    limited : -1 when co stands at its lower limit, +1 at the upper, 0 between.
    x : value of the scheduling variable (whatever the table is scheduled by); NaN while a signal on the bus is stale.
    revision : sequence number of the gain set that the controller ran in this sample, as it reports it.
    x2 : value of the second scheduling variable, where there are two; as x.
    """

    t_s: float
    sp: float
    pv: float
    co: float
    mode: int = LoopMode.AUTO
    limited: int = 0
    x: float = 0.0
    revision: int = 0
    x2: float = 0.0


def plain(sample: LoopSample) -> LoopSample:
    """The sample in Python's own numbers: numpy's are slow one by one, and JSON refuses some."""
    t_s, sp, pv, co, mode, limited, x, revision, x2 = sample
    values = float(t_s), float(sp), float(pv), float(co)
    return LoopSample(*values, int(mode), int(limited), float(x), int(revision), float(x2))


def finite(sample: LoopSample) -> bool:
    """Whether the loop's own numbers are all finite (NaN passes min/max, so every door asks); x and x2 may be NaN."""
    return all(map(math.isfinite, sample[:4]))


def all_finite(values: FloatArray) -> bool:
    """Whether all values are finite: the extremes tell, as neither passes over a nan. No array is made for it."""
    return not len(values) or (math.isfinite(values.min()) and math.isfinite(values.max()))


@dataclass(frozen=True, slots=True)
class Window:
    """Consecutive samples as arrays of shape (n,): what a fit works on.

    noise_std : standard deviation of pv's noise where it is known from elsewhere, pv units; 0 where only pv tells it.

    Raises ValueError: shapes differ, fewer than three samples, a value is not finite or beyond LARGEST, or time does
    not increase (the sample is named).
    """

    t_s: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray
    noise_std: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.t_s)
        if not 0 <= self.noise_std < math.inf:
            raise ValueError(f"noise_std = {self.noise_std} must be 0 or more")
        if n < 3:
            raise ValueError(f"a window needs at least 3 samples, this one has {n}")
        for name in ("t_s", "sp", "pv", "co"):
            values: FloatArray = getattr(self, name)
            if values.shape != (n,):
                raise ValueError(f"{name} has shape {values.shape}; give {n} values in one row, as many as t_s has")
            if not (values.min() >= -LARGEST and values.max() <= LARGEST):
                bad = int(np.argmin(np.isfinite(values) & (np.abs(values) <= LARGEST)))
                if not math.isfinite(values[bad]):
                    raise ValueError(f"{name}[{bad}] = {values[bad]} is not a finite number")
                beyond = f"{name} = {values[bad]:g} is beyond {LARGEST:g}"
                raise ValueError(f"sample {bad + 1}: {beyond}; give the record in its engineering units")
        later = self.t_s[1:] > self.t_s[:-1]
        if not later.all():
            i = int(np.argmin(later))
            raise ValueError(f"time does not increase: t_s[{i}] = {self.t_s[i]}, t_s[{i + 1}] = {self.t_s[i + 1]}")

    @property
    def content(self) -> tuple[tuple[bytes, ...], float]:
        """Its numbers, the same for windows that are alike: what is found in one is kept under them."""
        signals = (self.t_s, self.sp, self.pv, self.co)
        return tuple(np.asarray(one, dtype=np.float64).tobytes() for one in signals), self.noise_std

    @classmethod
    def holding(cls, content: tuple[tuple[bytes, ...], float]) -> "Window":
        """The window of a content."""
        t_s, sp, pv, co = map(np.frombuffer, content[0])
        return cls(t_s, sp, pv, co, content[1])

    @classmethod
    def of(cls, samples: list[LoopSample]) -> "Window":
        """Collect samples into a window."""
        t_s, sp, pv, co = (np.fromiter(map(itemgetter(i), samples), np.float64, len(samples)) for i in range(4))
        return cls(t_s, sp, pv, co)

    def part(self, rows: slice) -> "Window":
        """Some of its samples."""
        return Window(self.t_s[rows], self.sp[rows], self.pv[rows], self.co[rows], self.noise_std)

    def condensed(self, most: int) -> "Window":
        """The record in at most `most` samples: every n-th pv, and co averaged over the n intervals between.

        The averaged co moves a process like the real one as long as n intervals are short against its dynamics.
        """
        n = -(-len(self.t_s) // most)
        if n == 1:
            return self
        starts = np.arange(0, len(self.t_s), n)
        held_s = np.diff(self.t_s, append=2 * self.t_s[-1] - self.t_s[-2])
        co = np.add.reduceat(self.co * held_s, starts) / np.add.reduceat(held_s, starts)
        held = np.asarray(co, dtype=np.float64)
        return Window(self.t_s[starts], self.sp[starts], self.pv[starts], held, self.noise_std)

    def on_even_clock(self) -> "Window":
        """The record at even times, its median interval apart, where rows are missing or fall anywhere: pv on lines
        between samples, sp and co as they were held. What is missing in a gap stays missing.
        """
        dt, steps = self.sample_time_s, np.diff(self.t_s)
        if np.all((steps > EVEN[0] * dt) & (steps < EVEN[1] * dt)):
            return self
        t = np.concatenate([[0.0], np.cumsum(np.where(steps > GAP * dt, dt, steps))])
        even = np.arange(0.0, t[-1] + dt / 2, dt)
        sp, pv = self.sp[np.searchsorted(t, even, "right") - 1], np.interp(even, t, self.pv)
        ends = np.append(t, t[-1] + dt)
        fired = np.concatenate([[0.0], np.cumsum(self.co * np.diff(ends))])
        co = np.asarray(np.diff(np.interp(np.append(even, even[-1] + dt), ends, fired)) / dt, dtype=np.float64)
        return Window(self.t_s[0] + even, sp, pv, co, self.noise_std)

    @property
    def sample_time_s(self) -> float:
        """Median sampling interval in seconds."""
        return _usual_interval(self.t_s)


def in_units(window: Window) -> Window:
    """A whole record as it comes from outside.

    Raises ValueError: pv or co moves, but by numbers whose squares are none in double precision.
    """
    for name, values in (("pv", window.pv), ("co", window.co)):
        if (most := float(np.max(np.abs(values)))) < 1.0 / LARGEST and np.ptp(values) > 0:
            raise ValueError(f"{name} is nowhere beyond {most:g}; give the record in its engineering units")
    return window


def median(values: npt.ArrayLike) -> float:
    """The median of finite numbers; nan of none. np.median takes five times as long, and loads numpy.ma."""
    kept = np.array(values, dtype=np.float64).ravel()
    at = len(kept) // 2
    if not len(kept):
        return math.nan
    kept.partition(at if len(kept) % 2 else (at - 1, at))
    return float(kept[at] if len(kept) % 2 else (kept[at - 1] + kept[at]) / 2.0)


def distinct(values: FloatArray) -> FloatArray:
    """The different numbers among some, ascending; np.unique loads numpy.ma, a tenth of numpy."""
    ordered = np.sort(values)
    return np.asarray(ordered[np.concatenate([[True], ordered[1:] != ordered[:-1]])], dtype=np.float64)


def quantile(values: npt.ArrayLike, share: float) -> float:
    """The value below which a share of finite numbers lies, linear between two of them, as np.quantile has it."""
    kept = np.array(values, dtype=np.float64).ravel()
    place = share * (len(kept) - 1)
    at = int(place)
    part, after = place - at, min(at + 1, len(kept) - 1)
    kept.partition((at, after))
    rise = kept[after] - kept[at]
    return float(kept[at] + rise * part if part < 0.5 else kept[after] - rise * (1 - part))


def least_squares(columns: FloatArray, y: FloatArray) -> FloatArray:
    """c of the least |columns c - y|, shape (k,) or (k, m). columns : (n, k). y : (n,) or (n, m).

    Rows are taken in by some hundred: all at once wake every thread of the algebra, for longer than the work takes.
    """
    k, both = columns.shape[1], np.column_stack([columns, y])
    triangle = both[:0]
    for first in range(0, len(both), ROWS_AT_ONCE):
        rows = np.concatenate([triangle, both[first : first + ROWS_AT_ONCE]])
        triangle = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    rest = np.finfo(np.float64).eps * len(both)
    found = np.linalg.lstsq(triangle[:k, :k], triangle[:k, k:], rcond=rest)[0]
    return np.asarray(found if y.ndim > 1 else found[:, 0], dtype=np.float64)


ROWS_AT_ONCE = 256
Found = TypeVar("Found")
MOST_KEPT = 8192  # Samples of a signal of which something is kept


def kept_of_signal(work: Callable[[FloatArray], Found]) -> Callable[[FloatArray], Found]:
    """The function of a signal, shape (n,), that is worked out once: many ask a record for its noise and its steps."""
    kept = lru_cache(maxsize=64)(lambda data: work(np.frombuffer(data)))
    return wraps(work)(lambda x: kept(x.tobytes()) if x.dtype == np.float64 and len(x) <= MOST_KEPT else work(x))


@kept_of_signal
def _usual_interval(t_s: FloatArray) -> float:
    return median(np.diff(t_s))


# ---- The trapezoidal rule: numpy calls it trapezoid from 2.0 on and trapz before, and either may be installed

Number = TypeVar("Number", np.float64, np.complex128)


def trapezoid(values: npt.NDArray[Number], t: FloatArray) -> Number:
    """Integral of values over t, which increases; both of shape (n,). In units of values times those of t."""
    areas: npt.NDArray[Number] = np.diff(t) * (values[1:] + values[:-1]) / 2.0
    area: Number = areas.sum()
    return area


# ---- Did the sensor stand still during a record: the same pv to the last digit, sample after sample?
#
#     at least STOOD samples alike, OVER_OTHERS times as many as anywhere else in the record (but where it stood again)
#     and what else is kept of the loop has noise:  median |second difference| > median |first difference| > 0
#
# A pv in coarse steps, or one without noise, also stands still: at rest, and for a dead time. The last line tells them
# apart: where a signal moves by steps or smoothly, its second differences are smaller than its first ones; white noise
# has them larger by the square root of 3. What looks alike for so long by chance is coloured noise in coarse steps, and
# nothing is lost with that record but time.

STOOD = 20
OVER_OTHERS = 5


def stood_still(pv: FloatArray, recorded: int) -> tuple[int, float] | None:
    """How many samples in a row were alike where the sensor stood still the longest in a record, and what they were;
    None where it did not.

    pv : all that is kept, the newest last. recorded : how many of them are the record.
    """
    before, pv = pv[: len(pv) - recorded], pv[len(pv) - recorded :]
    runs = [len(list(alike)) for _, alike in groupby(pv.tolist())]
    longest = max(runs)
    first = sum(runs[: runs.index(longest)])
    stuck = slice(first, first + longest)
    others = max((n for n in runs if n < STOOD), default=0)
    if longest < max(STOOD, OVER_OTHERS * others):
        return None
    # whether what else is kept has white noise, seen at its own resolution
    parts = [part for part in (before, pv[: stuck.start], pv[stuck.stop :]) if len(part) > 2]
    if sum(map(len, parts)) < STOOD:
        return None
    once, twice = (np.concatenate([np.abs(np.diff(part, n)) for part in parts]) for n in (1, 2))
    return (longest, float(pv[first])) if median(twice) > median(once) > 0.0 else None
