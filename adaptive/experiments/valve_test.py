"""A valve test: small steps of co up and down in manual, and what they say of resolution, dead band and stroke.

    staircase   one large step up, then small ones: 1 1 1 1 up, 1 x 8 down, 4 down, 1 x 4 down, 1 x 8 up, back
    play        p follows u once u is D/2 ahead of it                       D: dead band, taken up at each reversal
    resolution  the valve moves to p once p is R away from it, else stands  R: smallest change that moves it
    process     y_j = a y_(j-1) + b x_j + c + d j                           y_j: pv at the end of hold j, x_j: the valve

The levels at the ends of the holds need no model of what happens within one: a settles how far pv has come, a = 1 is a
tank. D and R are tried on a grid; each pair gives x, the least squares over a, b, c, d, and by them its likelihood,
N/2 ln(sum of squares) with the noise unknown. Half of the odds beforehand are on a valve with neither. The kind of
test is that of ISA-75.25.02 (2000) and of EnTech's valve specification (1998); the reading is ours.

A stroke is read off the large step: the large move minus the small ones, each as the time to half of its response,
is half of the time that the valve needs for the difference.
"""

import math
from itertools import pairwise

import numpy as np

from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.late_dataclass import dataclass

STAIRCASE = (8, *(1,) * 4, *(-1,) * 8, -4, *(-1,) * 4, *(1,) * 8, -4)
"""Moves of a valve test in small steps; the last leads back to where it began."""
SHORT = (1, 1, -1, -1)  # moves of the test that a diagnosis proposes: whether pv follows at all
BANDS = np.arange(0.0, 8.01, 0.5)  # dead bands that are tried, in small steps
RESOLUTIONS = np.array([0.0, *np.arange(1.25, 4.01, 0.25)])
"""Resolutions that are tried, in small steps: one below a step moves with every step and cannot be told from none."""
NEITHER = 0.5  # odds beforehand of a valve with neither
RANGE_ODDS = 0.9  # share of the odds that a range holds
FEWEST_HOLDS, FEWEST_SAMPLES = 12, 4  # holds in a record, and samples in each, below which nothing is read
SAME = 0.02  # co within this share of the smallest move is held
LAST = 0.25  # A hold's level is the mean of its last share of samples
LARGE_MOVE = 2.5  # moves of this many usual ones are large


@dataclass(frozen=True, slots=True)
class ValveReading:
    """What a valve test says; co units, and s.

    step : the small step. dead_band, resolution : mean over the odds. dead_band_range, resolution_range : of nine
    tenths of the odds. dead_band_odds, resolution_odds : that there is one at all. sound : odds of neither.
    stroke_s : of the whole range of 100, at the most; None where the record does not tell.
    """

    step: float
    dead_band: float
    dead_band_range: tuple[float, float]
    dead_band_odds: float
    resolution: float
    resolution_range: tuple[float, float]
    resolution_odds: float
    sound: float
    holds: int
    stroke_s: float | None = None

    def to_dict(self) -> dict[str, float | int | bool]:
        """Keys as above, the ends of a range as _low and _high; stroke_s where it is known."""
        ends = {
            f"{name}_{end}": value
            for name, pair in (("dead_band", self.dead_band_range), ("resolution", self.resolution_range))
            for end, value in zip(("low", "high"), pair, strict=True)
        }
        plain = ("step", "dead_band", "dead_band_odds", "resolution", "resolution_odds", "sound", "holds")
        stroke = {} if self.stroke_s is None else {"stroke_s": self.stroke_s}
        return {**{name: getattr(self, name) for name in plain}, **ends, **stroke}


def read_valve_test(window: Window) -> ValveReading:
    """What the record of a valve test says.

    Raises ValueError: the record has too few holds of co, or nothing in it moves.
    """
    # Where co begins to stand
    moves = np.abs(np.diff(window.co))
    if not np.any(moves > 0):
        raise ValueError("co does not move in the whole record: not a valve test")
    least = SAME * median(moves[moves > np.max(moves) / 50])
    begins = [0, *(np.flatnonzero(moves > least) + 1).tolist()]
    ends = [*begins[1:], len(window.co)]
    kept = [(a, b) for a, b in zip(begins, ends, strict=True) if b - a >= FEWEST_SAMPLES]
    if len(kept) < FEWEST_HOLDS:
        raise ValueError(f"not a valve test: co is held {len(kept)} times, {FEWEST_HOLDS} or more are needed")
    u = np.array([window.co[b - 1] for _, b in kept])
    y = np.array([float(np.mean(window.pv[b - max(round(LAST * (b - a)), 1) : b])) for a, b in kept])
    moves = np.abs(np.diff(u))
    step = median(moves[moves > 0])
    if not np.ptp(y) > 0:
        raise ValueError("pv does not move in the whole record: the valve is stuck, or pv does not depend on it")
    bands, resolutions = np.meshgrid(BANDS * step, RESOLUTIONS * step, indexing="ij")
    fits = [_fit(valve_positions(u, d, r), y) for d, r in zip(bands.ravel(), resolutions.ravel(), strict=True)]
    weight = -0.5 * (len(y) - 1) * np.log(np.maximum(fits, 1e-300))
    prior = np.full(len(fits), (1.0 - NEITHER) / (len(fits) - 1))
    prior[0] = NEITHER
    odds = np.exp(weight - weight.max()) * prior
    odds = (odds / odds.sum()).reshape(bands.shape)
    by_band, by_resolution = odds.sum(axis=1), odds.sum(axis=0)
    return ValveReading(
        step,
        float(by_band @ (BANDS * step)),
        _range(BANDS * step, by_band),
        float(1.0 - by_band[0]),
        float(by_resolution @ (RESOLUTIONS * step)),
        _range(RESOLUTIONS * step, by_resolution),
        float(1.0 - by_resolution[0]),
        float(odds[0, 0]),
        len(kept),
        _stroke(window, kept, step),
    )


def valve_positions(u: FloatArray, dead_band: float, resolution: float) -> FloatArray:
    """Where a valve stands at the end of each hold; it begins in the middle of its play."""
    p = x = float(u[0])
    found = []
    for wanted in u.tolist():
        p = min(max(p, wanted - dead_band / 2), wanted + dead_band / 2)
        if abs(p - x) >= resolution * (1.0 - 1e-9):
            x = p
        found.append(x)
    return np.array(found)


def _fit(x: FloatArray, y: FloatArray) -> float:
    """Sum of squares that is left of y_j = a y_(j-1) + b x_j + c + d j."""
    n = len(y) - 1
    rows = np.column_stack([y[:-1] - y[0], x[1:] - x[0], np.ones(n), np.arange(n) / n])
    solved, *_ = np.linalg.lstsq(rows, y[1:] - y[0], rcond=None)
    left = y[1:] - y[0] - rows @ solved
    return float(left @ left)


def _range(values: FloatArray, odds: FloatArray) -> tuple[float, float]:
    """The values between which RANGE_ODDS of the odds lie."""
    run = np.cumsum(odds)
    tail = (1.0 - RANGE_ODDS) / 2
    low, high = (int(np.searchsorted(run, share)) for share in (tail, 1.0 - tail))
    return float(values[min(low, len(values) - 1)]), float(values[min(high, len(values) - 1)])


def _stroke(window: Window, holds: list[tuple[int, int]], step: float) -> float | None:
    """Time for the whole range, s, as the large moves are later than the small ones; None where neither is seen."""
    large: list[float] = []
    small: list[float] = []
    sizes = []
    for (a0, b0), (a, b) in pairwise(holds):
        old, new = window.pv[a0:b0], window.pv[a:b]
        start, end = float(np.mean(old[-max(len(old) // 4, 1) :])), float(np.mean(new[-max(len(new) // 4, 1) :]))
        half = None  # time to half of pv's answer, s, where the answer is clear of what pv did before
        if abs(end - start) > 4.0 * float(np.std(np.diff(new)) / math.sqrt(2.0) + 1e-12):
            passed = np.flatnonzero((new - start) / (end - start) > 0.5)
            half = float(window.t_s[a + passed[0]] - window.t_s[a]) if len(passed) else None
        size = abs(float(window.co[b - 1] - window.co[b0 - 1]))
        if half is not None:
            (large if size > LARGE_MOVE * step else small).append(half)
            sizes += [size] if size > LARGE_MOVE * step else []
    if not large or not small:
        return None
    later = median(large) - median(small)
    return 2.0 * max(later, window.sample_time_s) * 100.0 / (median(sizes) - step)
