"""What the recording has done to a signal: noise, quantisation, repeated values, compression.

    noise share   sigma^2 / variance, sigma from second differences (noise.py)
    quantum       the step of a grid on which (nearly) all values lie; 0 when there is none
    repeated      share of samples equal to the one before
    compression   n / (n - number of zero second differences)          Thornhill, Choudhury & Shah 2004, section 4

Historians keep only the corners of a signal and draw straight lines between them (second difference zero), or hold the
last value. Compression above 3 spoils indexes that look at shapes and at non-linearity (the same source). A quantised
signal stands still as well; its compression cannot be told and counts as 1.

    held together pv and co stand still in the same samples, again and again: gaps filled with the last values. A
                  historian that compresses holds each signal for itself; a controller with pv at rest moves on.

    deviation     what the historian let pass: a point was kept because without it the line, or the held value, would
                  have missed the signal by more. So the smallest misses of the kept points tell it.
"""

import math

import numpy as np
import numpy.typing as npt

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, distinct, kept_of_signal, median, quantile
from retuner.schedule.late_dataclass import dataclass

STRAIGHT = 1e-6  # A second difference below this share of the signal's range is zero
FURTHER = 10  # samples on either side over which a line of printed values must be straight as well: a slow curve is not
MOST_DECIMALS = 5  # values printed with more decimals than these are straight enough without them
ON_GRID = 0.05  # how near to a whole number of quanta a value must be, in quanta
GRID_SHARE = 0.99  # share of values that must fit the grid
FEWEST_LEVELS = 4  # fewer values lie on many grids
FEWER_LEVELS = 0.5  # A grid shows in repetition: there must be fewer distinct values than this share of the samples
MOST_LEVELS = 1000
"""More steps than these in the range of the record are the number format's, not the sensor's (10 bits)."""


@dataclass(frozen=True, slots=True)
class RecordingQuality:
    """See the head of this file; noise_share and repeated 0 to 1, quantum in the signal's units, compression >= 1."""

    noise_share: float
    quantum: float
    repeated: float
    compression: float


@kept_of_signal
def recording_quality(x: FloatArray) -> RecordingQuality | None:
    """Judge one signal, shape (n,); None for a constant one."""
    span = float(np.ptp(x))
    if span <= 0:
        return None
    steps = np.diff(x)
    step = quantum(x)
    straight = 0 if step else int(np.sum(_on_lines(x)))
    noise = min(noise_sigma(x) ** 2 / float(np.var(x)), 1.0)
    return RecordingQuality(noise, step, float(np.mean(steps == 0)), len(x) / (len(x) - straight))


def _on_lines(x: FloatArray) -> npt.NDArray[np.bool_]:
    """Which samples but the first and the last lie on a straight line with their neighbours, shape (n - 2,).

    Lines that were printed with few decimals are straight to twice the last digit only, near by and further off.
    """
    bend, span = np.abs(np.diff(x, 2)), float(np.ptp(x))
    straight = np.asarray(bend <= STRAIGHT * span, dtype=np.bool_)
    digit = _last_digit(x)
    if digit and len(x) > 2 * FURTHER:
        wide = np.full(len(bend), math.inf)
        wide[FURTHER - 1 : len(bend) - FURTHER + 1] = np.abs(
            x[: -2 * FURTHER] - 2 * x[FURTHER:-FURTHER] + x[2 * FURTHER :]
        )
        straight |= (bend <= PRINTED * digit) & (wide <= PRINTED * digit)
    return straight


PRINTED = 2.0 + 1e-6  # digits by which a second difference of rounded values on a line may be off


def _kept(x: FloatArray) -> npt.NDArray[np.int64]:
    """The samples at which lines meet; where they were printed with few decimals, the sharpest of each bend."""
    bends = np.flatnonzero(~_on_lines(x)) + 1
    if not len(bends) or not _last_digit(x):
        return bends
    groups = np.split(bends, np.flatnonzero(np.diff(bends) > 1) + 1)
    sharp = np.abs(np.diff(x, 2))
    return np.array([int(group[np.argmax(sharp[group - 1])]) for group in groups])


def _last_digit(x: FloatArray) -> float:
    """The last decimal with which values were printed, in their units; 0 where they have too many."""
    for decimals in range(MOST_DECIMALS + 1):
        scaled = x * 10**decimals
        if float(np.max(np.abs(scaled - np.round(scaled)))) < PRINTED_TO:
            return 10.0**-decimals
    return 0.0


PRINTED_TO = 1e-6  # rounding of doubles, in last digits
LEAST_STRAIGHT = 0.4  # share of the samples on straight lines from which a recorder drew them
SMALLEST_MISSES = 0.2
"""Quantile of the misses that is taken for the deviation: a few kept points are the ends of the record's gaps."""
FEWEST_KEPT = 8


@kept_of_signal
def hidden_sigma(x: FloatArray) -> float:
    """Standard deviation of what compression took away from a signal, in its units; 0 where it was not compressed.

    Inside its deviation the signal may have been anywhere, and is taken to be evenly spread.
    """
    span = float(np.ptp(x))
    if span <= 0 or quantum(x):
        return 0.0
    on_lines, bends, steps = _on_lines(x), _kept(x), np.diff(x)
    straight = (float(np.sum(on_lines)) + 2) / len(x)
    if len(bends) < FEWEST_KEPT or straight < LEAST_STRAIGHT:
        return 0.0
    held = float(np.mean(steps == 0)) > HELD * straight
    if held:
        misses = np.abs(steps)[steps != 0]
    else:
        # Distance of every kept point from the line between its neighbours
        before, at, after = bends[:-2], bends[1:-1], bends[2:]
        part = (at - before) / (after - before)
        misses = np.abs(x[at] - x[before] - part * (x[after] - x[before]))
    misses = misses[misses > _last_digit(x)]
    if not misses.size:
        return 0.0
    return quantile(misses, SMALLEST_MISSES) / 3**0.5


HELD = 0.5  # share of repeats among the straight pieces from which the last value was held, and no lines were drawn


@kept_of_signal
def quantum(x: FloatArray) -> float:
    """Step of the grid on which the values lie, in their units; 0 when they lie on none."""
    values = distinct(x)
    if not FEWEST_LEVELS <= len(values) <= FEWER_LEVELS * len(x):
        return 0.0
    gaps, above = np.diff(values), values[1:] - values[0]
    step = float(np.min(gaps[gaps > float(np.ptp(x)) / (2 * MOST_LEVELS)], initial=float(np.ptp(x))))
    for reach in (3, 30, 2 * MOST_LEVELS):  # values are rounded: the further ones settle the last digits of the step
        near = above < (reach + 0.5) * step
        counts = np.round(above[near] / step)
        step = float(counts @ above[near] / (counts @ counts)) if np.any(counts) else step
    fits = np.abs(above / step - np.round(above / step)) <= ON_GRID
    return step if float(np.mean(fits)) >= GRID_SHARE and float(np.ptp(x)) < MOST_LEVELS * step else 0.0


FEWEST_HELD = 5  # samples in a row without any change that count as held
FEWEST_HOLDS = 3
ALIKE = 0.7  # Share of the holds of each signal that must be holds of both
END = 1  # samples by which the ends of a hold of both may differ


@dataclass(frozen=True, slots=True)
class HeldStretches:
    """Stretches in which pv and co were held together. share : of the samples. samples : in each, the median."""

    share: float
    samples: float


def held_together(pv: FloatArray, co: FloatArray) -> HeldStretches | None:
    """Where both signals, shape (n,), stood still at once time and again; None where each moves for itself."""
    still = np.diff(pv) == 0, np.diff(co) == 0
    of_pv, of_co = (_holds(each) for each in still)
    both = [hold for hold in _holds(still[0] & still[1]) if _among(hold, of_pv) and _among(hold, of_co)]
    if len(both) < max(FEWEST_HOLDS, ALIKE * len(of_pv), ALIKE * len(of_co)):
        return None
    lengths = [end - first for first, end in both]
    return HeldStretches(sum(lengths) / len(pv), median(lengths))


def _holds(still: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    return [(first, end) for first, end in runs(still) if end - first >= FEWEST_HELD]


def _among(hold: tuple[int, int], others: list[tuple[int, int]]) -> bool:
    return any(abs(hold[0] - first) <= END and abs(hold[1] - end) <= END for first, end in others)


def runs(condition: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Stretches in which a condition holds: first row, and row after the last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], condition.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
