"""Does a load that repeats make a record likelier: steps to and fro, or ramps up and down, at even times?

    ln B = ln L(co itself | process, load that wanders and steps or turns at t0 + i P by a, at t0 + (i + d) P by -a)
           - 7/2 ln n  -  ln L(co itself | process, load that wanders)

It is the rival of a valve that sticks: ramps up and down make the pv of a fast loop a square under a triangle of co, as
a valve does, and steps do so in a slow loop. Its size costs half of ln n; first turn, period and share of the rise cost
ln n each, as any row may be one. A tone with harmonics costs more, one that turns at any time (slip_odds.py) pays for
each turn. Of some 50 sticking valves in traps (seeds 7401, 7402) one had larger odds for it than for its valve, by
e^0.8; all of six such loads had, by e^11 to e^42.

Where it turns is first seen from single shocks of the load beside co, whitened; even times are then moved to the best.
"""

import math

import numpy as np

from retuner.adaptive.explanations.jumping_load import MOST_JUMPS, delayed, shocks, whitened
from retuner.adaptive.explanations.slip_odds import MOST_ROWS, alone
from retuner.adaptive.explanations.valve_odds import LAGS
from retuner.adaptive.explanations.wandering_load import SLOPE, TEMPER, VALUE, Prepared, filtered, responses, spectrum
from retuner.adaptive.signals.sample import FloatArray, least_squares

LOADS = tuple((b, VALUE) for b in (0.01, 0.1, 0.8)) + tuple((b, SLOPE) for b in (0.005, 0.02, 0.1, 0.8))
"""Bandwidths and orders of the loads that wander beside it: one that repeats needs no other."""
FEW = (1, 4)  # dead times of co beside single turns
FEWEST_TURNS, ROUNDS, SHORTEST, LEAST_SHARE = 3, 1.9, 4.0, 0.02
"""Turns to begin with; periods of a record that show one; rows of the shortest; share of it from a turn to the next, at
least. With 1.2 to 1.7 periods seven of 460 records of a sticking valve had odds for such a load."""
CLOSER = 4  # Lags, loads and dead times that are looked at closely, and starts of each
STEPS = (8.0, 3.0, 1.0, 0.3) * 2
"""Rows by which the first turn, the last one and those between are moved as long as that pays."""
NUMBERS = 7.0  # Numbers of such a load: a size, and three times that count twice, as any row may be one
TINY = 1e-12
Turns = tuple[float, float, float]  # First turn and period, in rows, and the share of it until the turn back


def log_odds_of_repeating(record: Prepared, direction: int) -> tuple[float, float]:
    """Tempered logarithm of the Bayes factor of a load that repeats, and its period in s; see the head of this file.

    direction : sign of the process gain. -inf and nan where nothing turns often enough.
    """
    if not (np.ptp(record.co) > 0 and np.ptp(record.pv) > 0):
        return -math.inf, math.nan
    record, found = record.coarser(MOST_ROWS), []
    n = len(record.pv)
    for lag in LAGS:
        moved = responses(record.co, lag)[0]
        for dead in FEW:
            late = delayed(moved, dead)
            for load in LOADS:
                rows, told = shocks(record, lag, 0.0, load, MOST_JUMPS, late)
                found.append((float(np.max(told)), (lag, load, late, rows)))
    likeliest = sorted(found, key=lambda one: -one[0])[:CLOSER]
    best, period = max((_evenly(record, *behind) for _, behind in likeliest), default=(-math.inf, math.nan))
    lead = best - NUMBERS / 2.0 * math.log(n) - alone(record, direction)
    return lead / TEMPER, period * record.sample_time_s


def _evenly(
    record: Prepared, lag: float, load: tuple[float, int], late: FloatArray, rows: list[int]
) -> tuple[float, float]:
    """ln L of the likeliest load that turns at even times, and its period in rows.

    late : what co does behind the first lag and dead time. rows : of single turns, the likeliest first.
    """
    n = len(record.pv)
    y, basis, response, _ = whitened(record, lag, load, late)
    y = y - basis @ (basis.T @ y)
    power, noise = float(y @ y), n * record.resolution**2

    def told(each: list[Turns]) -> FloatArray:
        """ln L of each."""
        columns = filtered(spectrum(np.array([_train(n, *one) for one in each])), n, response)
        columns = columns - (columns @ basis) @ basis.T
        size = np.maximum(np.einsum("ij,ij->i", columns, columns), TINY * power)
        left = np.maximum(power - (columns @ y) ** 2 / size, 0.0) + noise
        return np.asarray(-(n - basis.shape[1]) / 2.0 * np.log(left / float(np.var(record.pv))))

    starts = [_fitted(np.array(sorted(rows[:count]))) for count in range(FEWEST_TURNS, len(rows) + 1)]
    starts = [one for one in starts if _may_be(one, n)]
    found = [(-math.inf, math.nan)]
    first = told(starts) if starts else np.zeros(0)
    for i in np.argsort(-first, kind="stable")[:CLOSER].tolist():
        at, best = starts[i], float(first[i])
        for step in STEPS:
            while moves := [one for one in _moved(at, n, step) if _may_be(one, n)]:
                each = told(moves)
                if float(each.max()) <= best:
                    break
                at, best = moves[int(np.argmax(each))], float(each.max())
        found.append((best, at[1]))
    return max(found, key=lambda one: one[0])


def _fitted(rows: FloatArray) -> Turns:
    """Even times of turns to and fro, by least squares. rows : in order."""
    i = np.arange(len(rows))
    first, period, rise = least_squares(np.column_stack([np.ones(len(rows)), i // 2, i % 2]), rows).tolist()
    return first, period, rise / period if period else 0.0


def _may_be(turns: Turns, n: int) -> bool:
    return SHORTEST < turns[1] < n / ROUNDS and LEAST_SHARE < turns[2] < 1.0 - LEAST_SHARE


def _moved(turns: Turns, n: int, step: float) -> list[Turns]:
    """All turns, the last one or those between by a step to either side."""
    first, period, share = turns
    of, between = step * period / max(n - first, period), step / period
    return [(first + s * step, period, share) for s in (-1, 1)] + [
        (first, period + s * a, share + s * b) for s in (-1, 1) for a, b in ((of, 0.0), (0.0, between))
    ]


def _train(n: int, first: float, period: float, share: float) -> FloatArray:
    """1 at every turn and -1 at every turn back, parted between the two rows next to it."""
    shocked = np.zeros(n + 1)
    for sign, at in ((1.0, first), (-1.0, first + share * period)):
        times = np.arange(at - period * math.floor((at - 1.0) / period), n - 1.0, period)
        rows = times.astype(int)
        shocked += sign * np.bincount(rows, 1.0 - times + rows, n + 1)
        shocked += sign * np.bincount(rows + 1, times - rows, n + 1)
    return shocked[:n]
