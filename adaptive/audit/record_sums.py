"""Sums over a whole record, all that an audit's screening counts sample by sample: one call of the compiled engine.

numpy computes the same where there is no engine, and is the reference (engine_c/screen.h has the formulas in C). What
needs no more than a part of the record (noise, quantisation, oscillation) is not here.
"""

from collections.abc import Iterable

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.indexes.autocovariance import running_mean
from retuner.adaptive.indexes.output_limits import STRETCH, is_limit
from retuner.adaptive.indexes.recording_quality import STRAIGHT, runs
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import astuple, dataclass, fields

ONE_SIDED = 0.5  # share of its size that the error at a limit has to keep, where co is there once only
LAGS = 20  # lags of the error's covariances (Desborough & Harris 1992 use 5 to 20)


@dataclass(frozen=True, slots=True)
class Measure:
    """What a record is counted against.

    longest_s : interval that still counts, s; longer ones are gaps. band : of co's noise, in its unit; 0 where every
    move counts. shortest : intervals of constant co that make a long stretch. width : samples of a slow mean.
    """

    longest_s: float
    band: float
    shortest: float
    width: int


@dataclass(frozen=True, slots=True)
class AtExtreme:
    """Samples with co at one extreme of the record.

    samples, stretches : how many. long, longest : stretches of STRETCH samples or more, and the longest in samples.
    held_s : time at it. error, size : integrals of the error and of its magnitude meanwhile, unit of pv times seconds.
    """

    samples: float
    stretches: float
    long: float
    longest: float
    held_s: float
    error: float
    size: float


@dataclass(frozen=True, slots=True)
class RecordSums:
    """See Measure for what these are counted against.

    held_s : time on record without gaps. gaps : their number. error_mean, error_variance : of sp - pv. size : integral
    of |error|. travel, turns, moves : of co: sum of |changes|, reversals beyond its noise, changes. pv_low, pv_high,
    pv_variance : of pv. straight, repeated : steps of pv that continue the one before, and that are none. sp_moves :
    changes of sp. sp_low to co_high : extremes. still : samples in long stretches of constant co. pv_slow, co_slow :
    standard deviation of slow means. low, high : co at its extremes. covariance : of the error at lags 0 to LAGS.
    """

    held_s: float
    gaps: float
    error_mean: float
    error_variance: float
    size: float
    travel: float
    turns: float
    moves: float
    pv_low: float
    pv_high: float
    pv_variance: float
    straight: float
    repeated: float
    sp_moves: float
    sp_low: float
    sp_high: float
    still: float
    co_low: float
    co_high: float
    pv_slow: float
    co_slow: float
    low: AtExtreme
    high: AtExtreme
    covariance: FloatArray

    def limit(self, samples: int, side: AtExtreme) -> bool:
        """Whether one extreme of co is a limit; samples : of the record.

        One long stretch in which the error goes to both sides is a hand's: a limit that binds leaves it on one.
        """
        if side.long == 1 and abs(side.error) < ONE_SIDED * side.size:
            return False
        counts = (int(x) for x in (self.moves, side.samples, side.stretches, side.long, side.longest))
        return is_limit(samples, *counts)


SUMMED = tuple(field.name for field in fields(RecordSums))[:-3]
OF_A_SIDE = tuple(field.name for field in fields(AtExtreme))
PLAIN, PARTS = len(SUMMED), len(OF_A_SIDE)
NUMBERS = PLAIN + 2 * PARTS + LAGS + 1


def record_sums(record: Window, by: Measure) -> RecordSums:
    """The sums of a record, of at least three samples."""
    engine = compiled()
    if engine is None:
        return counted(record, by)
    out: FloatArray = engine.screened(record, astuple(by), NUMBERS)
    low, high, lags = (out[PLAIN:][PARTS * i :] for i in range(3))
    plain_sums = dict(zip(SUMMED, out[:PLAIN].tolist(), strict=True))
    return RecordSums(**plain_sums, low=_side(low[:PARTS].tolist()), high=_side(high[:PARTS].tolist()), covariance=lags)


def _side(numbers: Iterable[float]) -> AtExtreme:
    return AtExtreme(**dict(zip(OF_A_SIDE, numbers, strict=True)))


def counted(record: Window, by: Measure) -> RecordSums:
    """The counts by numpy."""
    sp, pv, co = record.sp, record.pv, record.co
    steps_s, error = np.diff(record.t_s), sp - pv
    held_s = np.append(np.minimum(steps_s, by.longest_s), 0.0)
    moves, steps = np.diff(co), np.diff(pv)
    still = [end - first for first, end in runs(moves == 0)]
    return RecordSums(
        float(np.sum(held_s)), float(np.sum(steps_s > by.longest_s)), float(np.mean(error)), float(np.var(error)),
        float(np.abs(error) @ held_s), float(np.sum(np.abs(moves))), _turns(co, by.band),
        float(np.count_nonzero(moves)), float(np.min(pv)), float(np.max(pv)), float(np.var(pv)),
        float(np.sum(np.abs(np.diff(steps)) <= STRAIGHT * float(np.ptp(pv)))), float(np.sum(steps == 0)),
        float(np.count_nonzero(np.diff(sp))), float(np.min(sp)), float(np.max(sp)),
        float(sum(n for n in still if n >= by.shortest)), float(np.min(co)), float(np.max(co)), _slow(pv, by.width),
        _slow(co, by.width), _extreme(co == np.min(co), error, held_s), _extreme(co == np.max(co), error, held_s),
        covariances(error),
    )  # fmt: skip


def _turns(co: FloatArray, band: float) -> float:
    """Reversals of co, moves within the band not counted."""
    moves = np.diff(np.round((co - co[0]) / band) if band > 0 else co)
    signs = np.sign(moves[moves != 0])
    return float(np.sum(signs[1:] != signs[:-1]))


def _slow(x: FloatArray, width: int) -> float:
    """Standard deviation of means round every width-th sample."""
    means = running_mean(x - x[0], width)[width // 2 :: width]
    return float(np.std(means)) if len(means) else 0.0


def _extreme(there: np.ndarray, error: FloatArray, held_s: FloatArray) -> AtExtreme:
    lengths, held_s = [end - first for first, end in runs(there)], np.where(there, held_s, 0.0)
    counts = (sum(lengths), len(lengths), sum(n >= STRETCH for n in lengths), max(lengths))
    return _side((*map(float, counts), *map(float, (np.sum(held_s), error @ held_s, np.abs(error) @ held_s))))


def covariances(error: FloatArray) -> FloatArray:
    """Covariances of a signal at lags 0 to LAGS, shape (LAGS + 1,); 0 beyond its end."""
    n, e = len(error), error - np.mean(error)
    return np.array([float(e[j:] @ e[: n - j]) / (n - j) if j < n else 0.0 for j in range(LAGS + 1)])
