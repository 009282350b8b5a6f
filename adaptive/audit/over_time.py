"""How a loop ran day by day or week by week: the numbers of loop_screen.py for each part of its time."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from retuner.adaptive.audit.lasting_swing import lasting_swing
from retuner.adaptive.audit.loop_screen import DAY_S, in_automatic, measure
from retuner.adaptive.audit.record_sums import record_sums
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import Window
from retuner.schedule.late_dataclass import dataclass, fields

WEEK_S = 7 * DAY_S
MONDAY_S = 4 * DAY_S
"""The first Monday of the calendar that starts on 1970-01-01, a Thursday."""
FEWEST_DAYS, FEWEST_WEEKS, MOST_WEEKS = 2, 2, 26
"""A record of less than two days has no course; from two weeks on it is told by week, beyond half a year by four."""
FEWEST_SAMPLES = 100
"""Least number of samples of a part that is reported."""
SHOWN = 0.5
"""A part counts where so much of its time is on record."""


@dataclass(frozen=True, slots=True)
class PartOfTime:
    """A day or week of a loop.

    begin_s : in the record's time. span_s : on record. Shares are 0 to 1. error : mean |sp - pv|, NaN without
    a setpoint. Travel and reversals of co are a day's. swinging : share of the stretches in which a swing lasts.
    """

    begin_s: float
    span_s: float
    in_automatic: float
    at_limits: float
    travel_per_day: float
    reversals_per_day: float
    swinging: float
    error: float


def period_of(span_s: float) -> float | None:
    """Length of the parts of a record's time, seconds; None where it is too short to have a course."""
    if span_s < FEWEST_DAYS * DAY_S:
        return None
    weeks = span_s / WEEK_S
    return DAY_S if weeks < FEWEST_WEEKS else WEEK_S if weeks <= MOST_WEEKS else 4 * WEEK_S


def over_time(
    record: Window, period_s: float, first_s: float, *, setpoint: bool = True, swings: bool = True
) -> Iterator[PartOfTime]:
    """The parts of a record that hold enough.

    record : of any length. period_s : of a part. first_s : in the record's time, the beginning of one part, so that all
    of them are known. setpoint, swings : whether there is one, and whether the loop swings at all.
    """
    lowest, highest = float(record.co.min()), float(record.co.max())
    at = np.floor((record.t_s - first_s) / period_s)
    edges = [0, *(np.flatnonzero(np.diff(at)) + 1).tolist(), len(at)]
    for begin, end in pairwise(edges):
        if end - begin < FEWEST_SAMPLES:
            continue
        part = slice(begin, end)
        window = Window(record.t_s[part], record.sp[part], record.pv[part], record.co[part])
        by = measure(end - begin, window.sample_time_s, noise_sigma(window.co))
        sums = record_sums(window, by)
        if sums.held_s < SHOWN * period_s:
            continue
        ends = ((sums.low, sums.co_low == lowest), (sums.high, sums.co_high == highest))
        limits = [side for side, whole in ends if whole and sums.limit(end - begin, side)]
        wave = lasting_swing(window.sp - window.pv, window.co) if swings else None
        days = sums.held_s / DAY_S
        yield PartOfTime(
            first_s + float(at[begin]) * period_s,
            sums.held_s,
            in_automatic(window.co, by, sums, limits),
            sum(side.samples for side in limits) / (end - begin),
            sums.travel / days,
            sums.turns / days,
            wave.share if wave is not None else 0.0,
            sums.size / sums.held_s if setpoint else math.nan,
        )


def joined_parts(parts: Sequence[PartOfTime]) -> list[PartOfTime]:
    """Parts in the order of time, those of one day or week as one: means over the time on record."""
    found = []
    for begin_s in sorted({part.begin_s for part in parts}):
        same = [part for part in parts if part.begin_s == begin_s]
        spans = np.array([part.span_s for part in same])
        means = [float(np.array([getattr(part, one.name) for part in same]) @ spans / spans.sum()) for one in NUMBERS]
        found.append(PartOfTime(begin_s, float(spans.sum()), *means))
    return found


NUMBERS = fields(PartOfTime)[2:]
"""What is told of a part."""
