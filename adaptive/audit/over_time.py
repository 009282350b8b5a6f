"""How a loop ran day by day or week by week: the numbers of loop_screen.py for each part of its time."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise, zip_longest

import numpy as np

from retuner.adaptive.audit.lasting_swing import lasting_swing
from retuner.adaptive.audit.loop_screen import DAY_S, GAP, in_automatic, measure
from retuner.adaptive.audit.record_sums import record_sums
from retuner.adaptive.indexes.autocovariance import running_mean
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.late_dataclass import dataclass, fields

WEEK_S = 7 * DAY_S
MONDAY_S = 4 * DAY_S  # The first Monday of the calendar that starts on 1970-01-01, a Thursday
FEWEST_DAYS, FEWEST_WEEKS, MOST_WEEKS = 2, 2, 26
"""A record of less than two days has no course; from two weeks on it is told by week, beyond half a year by four."""
FEWEST_SAMPLES = 100  # least number of samples of a part that is reported
SHOWN = 0.5  # A part counts where so much of its time is on record


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
        window = record.part(slice(begin, end))
        by = measure(end - begin, window.sample_time_s, noise_sigma(window.co))
        sums = record_sums(window, by)
        if sums.held_s < SHOWN * period_s:
            continue
        ends = ((sums.low, sums.co_low == lowest), (sums.high, sums.co_high == highest))
        limits = [side for side, whole in ends if whole and sums.limit(end - begin, side)]
        swing = lasting_swing(window.sp - window.pv, window.co) if swings else None
        days = sums.held_s / DAY_S
        yield PartOfTime(
            first_s + float(at[begin]) * period_s,
            sums.held_s,
            in_automatic(window.co, by, sums, limits),
            sum(side.samples for side in limits) / (end - begin),
            sums.travel / days,
            sums.turns / days,
            swing[1] if swing is not None else 0.0,
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


NUMBERS = fields(PartOfTime)[2:]  # what is told of a part

# Which stretches of a long record are diagnosed: where something happens, and spread over time.
#
# A setpoint change shows the process; an event of the error shows what the loop makes of a load; the newest stretch
# tells whether it is still so. A stretch never holds a gap. It holds CYCLES periods of the oscillation where there is
# one; else it is as long as its event needs: an event of width m stands out of what means over m samples usually are,
#
#     score = max over m of |mean over m samples of e| / (1.4826 median |such means|)


CYCLES = 15.0  # ten to twenty show a cause, and drift little
FEWEST_WINDOW_SAMPLES, USUAL_WINDOW_SAMPLES, MOST_WINDOW_SAMPLES = 200, 800, 4_000
"""Samples of a stretch: at least, without an oscillation, and from which a slow one is condensed."""
BEFORE = 0.2  # share of a stretch that lies before the event that it is taken for
WIDTHS = (4, 16, 64)  # widths of events that are looked for, in samples
OF_A_WIDTH = 25
"""A stretch in widths of its event: the return from a load takes several, and what is usual must be seen as well."""
LEAST_SCORE = 4.0
EVENTS = 20  # Events of a width at most
SPREAD, LONG = 8, 1_024  # stretches that stand for the whole record, and their samples

Stretch = tuple[int, int]  # first sample and number of samples


def stretches_of_interest(record: Window, period_s: float | None, most: int) -> list[Window]:
    """Stretches of a record in the order of time, at most `most`; they do not overlap.

    record : of any length. period_s : of its oscillation, None where there is none. none where most is 0.
    """
    if most == 0:
        return []
    n, usual_s = len(record.t_s), record.sample_time_s
    length = USUAL_WINDOW_SAMPLES if period_s is None else max(int(CYCLES * period_s / usual_s), FEWEST_WINDOW_SAMPLES)
    if n <= max(1.5 * length, USUAL_WINDOW_SAMPLES):  # a fit takes all of so many, and `diagnose` says the same of them
        return [record.condensed(MOST_WINDOW_SAMPLES)]
    gap = np.concatenate([[0], np.cumsum(np.diff(record.t_s) > GAP * usual_s)])
    taken: list[Stretch] = []
    for wanted, many in _wanted(record, length, gap, events=period_s is None):
        begin = min(max(wanted, 0), n - many)
        apart = all(begin >= b + m or b >= begin + many for b, m in taken)
        if len(taken) < most and apart and gap[begin] == gap[begin + many - 1]:
            taken.append((begin, many))
    parts = [record.part(slice(begin, begin + many)) for begin, many in sorted(taken)]
    return [part.condensed(MOST_WINDOW_SAMPLES) for part in parts or [record]]


def spread_over(record: Window) -> list[Window]:
    """Stretches that stand for the whole of a record, quiet ones too, evenly over it; none holds a gap."""
    n = len(record.t_s)
    if n <= SPREAD * LONG:
        begins, length = np.array([0]), n
    else:
        begins, length = np.linspace(0, n - LONG, SPREAD).astype(int), LONG
    gaps = np.flatnonzero(np.diff(record.t_s) > GAP * record.sample_time_s) + 1
    parts = []
    for begin in begins.tolist():
        inside = gaps[(gaps > begin) & (gaps < begin + length)].tolist()
        edges = [begin, *inside, begin + length]
        longest = max(range(len(edges) - 1), key=lambda i: edges[i + 1] - edges[i])
        if edges[longest + 1] - edges[longest] >= FEWEST_WINDOW_SAMPLES or len(begins) == 1:
            parts.append(record.part(slice(edges[longest], edges[longest + 1])))
    return parts


def _wanted(record: Window, length: int, gap: np.ndarray, *, events: bool) -> Iterator[Stretch]:
    """Stretches, the most telling first: the newest, a setpoint change, two events (or where the error is largest)."""
    begins = np.arange(len(record.t_s) - length + 1)
    whole = begins[gap[begins + length - 1] == gap[begins]]
    newest = [(int(begin), length) for begin in whole[-1:]]
    moves = np.abs(np.diff(record.sp))
    changes = [(int(i - BEFORE * length), length) for i in np.argsort(moves)[::-1][:EVENTS] if moves[i] > 0]
    error = record.sp - record.pv
    telling = _events(error, len(error) // 2) if events else []
    if not telling:  # stretches without gaps in which the error is largest
        sums = np.concatenate([[0.0], np.cumsum(error**2)])
        energy = sums[whole + length] - sums[whole]
        largest = np.argsort(energy)[::-1][:: max(length // 4, 1)][:EVENTS]
        telling = [(int(begin), length) for begin in whole[largest]]
    spread = [(int(b), length) for b in whole[np.linspace(0, len(whole) - 1, 12).astype(int)]] if len(whole) else []
    for some in zip_longest(newest, changes, telling[::2], telling[1::2], spread):
        yield from (stretch for stretch in some if stretch is not None)


def _events(error: FloatArray, longest: int) -> list[Stretch]:
    """Stretches round events, the most unusual first."""
    level = error - median(error)
    found: list[tuple[float, Stretch]] = []
    for width in WIDTHS:
        means = np.abs(running_mean(level, width))
        usual = 1.4826 * median(means)
        many = min(max(OF_A_WIDTH * width, FEWEST_WINDOW_SAMPLES), USUAL_WINDOW_SAMPLES, longest)
        if usual <= 0 or many <= 0:
            continue
        blocks = np.maximum.reduceat(means, np.arange(0, len(means), many))
        for block in np.argsort(blocks)[::-1][:EVENTS]:
            at = int(block * many + np.argmax(means[block * many : (block + 1) * many]))
            if means[at] > LEAST_SCORE * usual:
                found.append((float(means[at]) / usual, (int(at - BEFORE * many), many)))
    return [stretch for _, stretch in sorted(found, reverse=True)]
