"""What each record of a loop says of every process, on one clock.

A long record is compared in windows of one length, averages over a few rows where pv stands still for as long. What the
setpoint makes co do says more than loads do. With s its share in what moves a record, W the likelihood under a load
that wanders (wandering_load.py) and A that of the answers beside a load of any spectrum (any_load.py),

    ln L/T = (1 - s + s q)/T_LOADS ln W + s/T_SETPOINT ln A

Real loads swing and pause as well: a walk leaves a rest of them, which the inverse of the controller explains, but not
what the setpoint makes co do. By loads alone A would say nothing, for the load may then be everything. A alone says too
little of a slow process under noise, for which an autoregression is too short. So the walk counts there as far as it
explains the record: q = 1/(1 + exp((lead - ORDER)/T_LOADS)), the lead that of any spectrum over the walk, which ORDER
numbers more gain by chance (Akaike 1974).
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.cause_odds.smoothed_record import with_smoothing
from retuner.adaptive.explanations.any_load import ORDER, log_likelihood_of_answers
from retuner.adaptive.explanations.jumping_load import with_jumps
from retuner.adaptive.explanations.process_grid import EVERY_LAG, gain_unit, shapes
from retuner.adaptive.explanations.wandering_load import (
    MOST_SAMPLES,
    T_LOADS,
    T_SETPOINT,
    TEMPER,
    Prepared,
    best_a_row,
    setpoint_share,
    temper,
)
from retuner.adaptive.identification.candidate import MODEL_ERROR
from retuner.adaptive.signals.sample import FloatArray, Window, quantile
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

ROWS = 10  # rows of an integral time: a loop at its limit swings in 1.2 of those by Ziegler and Nichols, so in twelve
MOST_HELD = 0.9  # quantile of the rows for which pv stands still, no shorter than their mean where it is quantised
FEWEST_RECORD_SAMPLES = 60  # Samples of a record that a load that wanders is looked for in


@dataclass(frozen=True, slots=True)
class ComparedRecords:
    """Windows of records, one by one.

    dt_s : the clock of all. records : as they were compared. each : log-likelihood of every process under a load that
    wanders. weighed : as it counts; see the head. shares : of the setpoint, or of the hand, in what moves a record.
    powers : of its likelihood.
    """

    dt_s: float
    records: tuple[Prepared, ...]
    each: tuple[FloatArray, ...]
    weighed: tuple[FloatArray, ...]
    shares: tuple[float, ...]
    powers: tuple[float, ...]


def compared(
    windows: Sequence[Window], gains: PidGains | None, direction: int, settings: OddsSettings
) -> ComparedRecords | None:
    """All records and windows under a load that wanders; None where nothing moves. direction : of the process."""
    dt = max(_interval_s(w, gains, settings) for w in windows)
    parts = [part for w in windows for part in windows_of(w, dt, settings.most_windows)]
    parts = [part for part in parts if len(part.t_s) >= round(dt / part.sample_time_s)]  # an interval or longer
    both = [(Prepared.at(part, dt), Prepared.at(replace(part, pv=part.sp), dt).pv) for part in parts]
    both = [(r, sp) for r, sp in both if len(r.pv) >= FEWEST_RECORD_SAMPLES and np.ptp(r.pv) > 0 and np.ptp(r.co) > 0]
    if not both:
        return None
    unit = gain_unit(gains, dt) if gains is not None else None
    records, each = zip(*(with_smoothing(record, direction, unit, settings.smooths) for record, _ in both), strict=True)
    if unit is not None:
        each = tuple(with_jumps(*one, direction, unit) for one in zip(records, each, strict=True))
    if unit is None:  # no share is asked
        return ComparedRecords(dt, records, each, each, (0.0,) * len(records), (1.0,) * len(records))
    moved = [_share(record, sp, alone) for record, (_, sp), alone in zip(records, both, each, strict=True)]
    answered = [share for _, share in moved]
    weighed = [_weighed(*one, direction, unit) for one in zip(records, each, answered, strict=True)]
    powers = tuple(TEMPER / temper(share) for share in answered)
    return ComparedRecords(dt, records, each, tuple(weighed), tuple(share for share, _ in moved), powers)


def _weighed(record: Prepared, walk: FloatArray, share: float, direction: int, unit: float) -> FloatArray:
    """Log-likelihood of every process as it counts.

    walk : under a load that wanders. share : s of wandering_load.py. What a process leaves of the answers is not told
    from noise down to MODEL_ERROR of pv's range, for none of the grid is the loop's.
    """
    if not share:
        return TEMPER / T_LOADS * walk
    asked = np.zeros((len(shapes(EVERY_LAG)), *walk.shape[1:]), dtype=bool)
    asked[: len(walk)] = True
    coarse = replace(record, resolution=max(record.resolution, MODEL_ERROR * float(np.ptp(record.pv))))
    answers = log_likelihood_of_answers(coarse, direction, unit, asked)[: len(walk)]
    if not np.ptp(answers) > 0:  # too short for an autoregression
        answers, walks = TEMPER * walk, 1.0
    else:
        walks = _walks(record, walk, answers, direction, unit)
    return TEMPER * (1.0 - share + share * walks) / T_LOADS * walk + share / T_SETPOINT * answers


def _walks(record: Prepared, walk: FloatArray, answers: FloatArray, direction: int, unit: float) -> float:
    """q of the head of this file, from the likeliest process of either."""
    asked = np.zeros((len(shapes(EVERY_LAG)), *walk.shape[1:]), dtype=bool)
    for one in (walk, answers):
        asked[np.unravel_index(int(np.argmax(one)), one.shape)] = True
    any_spectrum = float(np.max(log_likelihood_of_answers(record, direction, unit, asked)))
    rows = len(record.pv) - ORDER
    freedom = rows - ORDER
    by_answers = any_spectrum / freedom + 0.5 * math.log(freedom / len(record.pv) / record.size)
    lead = rows * (by_answers - best_a_row(record, walk))
    return 1.0 / (1.0 + math.exp(min((lead - ORDER) / T_LOADS, MOST_LEAD)))


MOST_LEAD = 50.0  # beyond it there is no walk at all


def windows_of(window: Window, dt_s: float, most: int) -> list[Window]:
    """A record in windows of MOST_SAMPLES intervals of dt_s each or fewer, at most so many, spread over it.

    None overlaps where they hold the whole record: what two of them held would count twice.
    """
    longest = MOST_SAMPLES * max(round(dt_s / window.sample_time_s), 1)
    count = max(min(-(-len(window.t_s) // longest), most), 1)
    length = min(longest, len(window.t_s) // count)
    firsts = np.linspace(0, max(len(window.t_s) - length, 0), count).round().astype(int)
    return [window.part(slice(int(first), int(first) + length)) for first in firsts]


def _share(record: Prepared, setpoint: FloatArray, likelihood: FloatArray) -> tuple[float, float]:
    """setpoint_share. setpoint : from its first value; pv's own where co goes by hand, and then moves all."""
    if np.array_equal(setpoint, record.pv):
        return 1.0, 1.0
    row = int(np.unravel_index(int(np.argmax(likelihood)), likelihood.shape)[0])
    return setpoint_share(record, setpoint, shapes()[row].lag)


def _interval_s(window: Window, gains: PidGains | None, settings: OddsSettings) -> float:
    """The interval at which a record is compared: a few windows hold it, or of a longer one as much as leaves ROWS in
    an integral time, and pv shows a change in most of its rows.

    What is at rest without any noise before a step, and after it, shows a change in each row between.
    """
    fits = -(-len(window.t_s) // (settings.most_windows * MOST_SAMPLES))
    if gains is not None and gains.ki and gains.kp:
        fits = min(fits, max(int(gains.kp / gains.ki / ROWS / window.sample_time_s), 1))
    held = np.diff(np.flatnonzero(np.diff(window.pv, prepend=math.nan, append=math.nan)))
    shown = min(round(min(float(np.mean(held)), quantile(held, MOST_HELD))), settings.most_held)
    return window.sample_time_s * max(fits, min(shown, max(len(window.t_s) // FEWEST_RECORD_SAMPLES, 1)))
