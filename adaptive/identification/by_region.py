"""A record cut at boundaries of a signal, and a model for each region that it passes through.

A level whose gain rises with the level, a heat exchanger over its flow: one model for the whole record is wrong
everywhere. What lies within two boundaries without a break is a stretch. The stretches of a region are joined, not
averaged: each is fitted with what the others have shown as its prior (the iterated extended Kalman update, Bell &
Cathey 1993), the one in which co and pv move most first.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.fit.record import Record
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.identification.identify import FitSettings, identify_window
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass

FEWEST_SAMPLES = 40  # A shorter stretch shows no dynamics beside its start and its noise
STANDS = 10  # samples in a row at one end of pv's range that are no measurement
MOVES_ELSEWHERE = 0.5  # share of samples that repeat the one before, from which pv is coarse
CROSSED = 3.0  # A boundary is crossed when the signal is beyond it by so many standard deviations of its noise


@dataclass(frozen=True, slots=True)
class RegionRecord:
    """What a record holds of one region. low, high : its boundaries, infinite at the ends. stretches : its rows."""

    low: float
    high: float
    stretches: tuple[Window, ...]


def by_region(window: Window, by: FloatArray, bounds: Sequence[float]) -> tuple[RegionRecord, ...]:
    """The record cut at boundaries, the lowest region first.

    window : the record. by : the signal that the boundaries are of, shape (n,). bounds : the boundaries, increasing.

    Raises ValueError: no boundary, one that is not finite, or they do not increase.
    """
    edges = np.asarray(bounds, dtype=np.float64)
    if not len(edges) or not np.all(np.isfinite(edges)) or np.any(np.diff(edges) <= 0):
        raise ValueError(f"boundaries {', '.join(f'{b:g}' for b in bounds) or 'none'}: give finite ones that increase")
    margin, now = CROSSED * noise_sigma(by), int(np.searchsorted(edges, by[0], side="right"))
    at: list[int] = []  # the region of every sample; noise at a boundary changes none
    for value in by.tolist():
        above = int(np.searchsorted(edges, value - margin, side="right"))
        below = int(np.searchsorted(edges, value + margin, side="right"))
        now = max(now, above) if above > now else min(now, below)
        at.append(now)
    # where pv stands at its largest or smallest value, as a sensor does at an end of its range
    clipped = np.zeros(len(window.pv), dtype=np.bool_)
    if float(np.mean(np.diff(window.pv) == 0.0)) <= MOVES_ELSEWHERE:  # a coarse signal stands anywhere
        for end in (float(np.max(window.pv)), float(np.min(window.pv))):
            runs = np.flatnonzero(np.diff(np.concatenate([[False], window.pv == end, [False]])))
            for first, after in zip(runs[::2].tolist(), runs[1::2].tolist(), strict=True):
                clipped[first:after] |= after - first >= STANDS
    cuts = [0, *(np.flatnonzero(np.diff(at).astype(bool) | np.diff(clipped)) + 1).tolist(), len(at)]
    ends = [-math.inf, *edges.tolist(), math.inf]
    stretches: list[list[Window]] = [[] for _ in ends[1:]]
    for first, end in pairwise(cuts):
        if end - first >= FEWEST_SAMPLES and not clipped[first]:
            stretches[at[first]].append(window.part(slice(first, end)))
    return tuple(RegionRecord(ends[i], ends[i + 1], tuple(found)) for i, found in enumerate(stretches))


def identify_region(record: RegionRecord, sign: int | None, settings: FitSettings) -> ModelEstimate | None:
    """The process in one region; None where no stretch of it moves.

    sign : of the process gain, where it is known.
    """
    moving = [w for w in record.stretches if np.ptp(w.pv) > 0 and np.ptp(w.co) > 0]
    found: ModelEstimate | None = None
    for window in sorted(moving, key=_excitation, reverse=True):
        priors = None if found is None else {a.log.type: a.log for a in found.alternatives}
        found = identify_window(window, sign, priors, settings)
        sign = found.log.sign
    return found


def _excitation(window: Window) -> float:
    record = Record.of(window)
    return record.pv_range / record.noise_std
