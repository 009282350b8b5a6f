"""pv as plateaus with steps between them: what a valve leaves that stands still and slips.

    pv = b + c exp(-t/T) + sum_j a_j [1 - exp(-(t - s_j)/T)]+        one T for all, jumps at rows s_j

Jumps are found one by one where they take away most (orthogonal least squares, Chen, Billings & Luo 1989), then moved
to where they fit best. How many pay is told by

    n/2 ln(RSS/n + sigma^2/4) + 2 ln n for every jump

twice Schwarz's price, because what is left is coloured. sigma is the noise by the smaller of first and second
differences, and no finer than 0.4 % of pv's range.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.signals.sample import FloatArray, least_squares, median
from retuner.schedule.late_dataclass import dataclass

LAGS = (0.0, 3.0, 8.0, 20.0, 45.0, 100.0)  # T tried at first, in rows
HALVINGS = 2  # times that T is looked for halfway to its neighbours
MOST_JUMPS = 16
LEAST_SIGMA = 0.004  # Noise is at least this share of pv's range
MEDIAN_TO_SIGMA = 1.4826
LEAST_NEW_SHARE = 1e-6  # A column of which less than this share is not explained by the others is no further jump
MOVED_PASSES = 2  # times that every jump is moved to its best row
MOVED_ROWS = 12  # how far, in rows
LEVEL = 0.12  # levels closer than this share of the fit's range are one plateau
SETTLED = 2.5  # time constants after a jump until a plateau counts


@dataclass(frozen=True, slots=True)
class Plateau:
    """A stretch in which pv has one level. first, last : rows, the transition before it left out. level : of pv."""

    first: int
    last: int
    level: float


@dataclass(frozen=True, slots=True)
class Steps:
    """pv as steps. jumps : rows. lag : T in rows. fitted : shape (n,). sigma : of the noise. criterion : see above."""

    jumps: tuple[int, ...]
    lag: float
    fitted: FloatArray
    sigma: float
    criterion: float

    @property
    def range(self) -> float:
        """Range of the fitted pv."""
        return float(np.ptp(self.fitted))


def rough_sigma(pv: FloatArray) -> float:
    """Noise of pv by its first and second differences, in pv units, at least LEAST_SIGMA of the range."""
    first, second = np.diff(pv), np.diff(pv, 2)
    spreads = [MEDIAN_TO_SIGMA * median(np.abs(d - median(d))) for d in (first, second)]
    return max(min(spreads[0] / 2**0.5, spreads[1] / 6**0.5), LEAST_SIGMA * float(np.ptp(pv)))


def price(rss: float, n: int, sigma: float, jumps: int) -> float:
    """The criterion."""
    return n / 2 * float(np.log(rss / n + sigma**2 / 4)) + 2 * jumps * float(np.log(n))


def as_steps(pv: FloatArray) -> Steps:
    """The best description of pv, shape (n,), by steps through one lag."""
    sigma = rough_sigma(pv)
    found = {lag: _with_lag(pv, lag, sigma) for lag in LAGS}
    best = min(found, key=lambda lag: found[lag][0])
    for _ in range(HALVINGS):
        tried = sorted(found)
        at = tried.index(best)
        for other in (*tried[max(at - 1, 0) : at], *tried[at + 1 : at + 2]):
            middle = (best * other) ** 0.5 if best * other else (best + other) / 2
            found[middle] = _with_lag(pv, middle, sigma)
        best = min(found, key=lambda lag: found[lag][0])
    criterion, chosen = found[best]
    jumps = tuple(sorted(j + 1 for j in chosen))
    return Steps(jumps, best, _fitted(pv, *_parts(len(pv), best), chosen), sigma, criterion)


def _parts(n: int, lag: float) -> tuple[FloatArray, FloatArray]:
    """The response from a jump on, shape (n,), and orthonormal columns of what is there without any: level and start,
    shape (n, 1 or 2).
    """
    start = [np.ones(n), np.exp(-np.arange(n) / lag)] if lag else [np.ones(n)]
    rise = -np.expm1(-np.arange(n) / lag) if lag else np.ones(n)
    return rise, np.asarray(np.linalg.qr(np.stack(start, axis=1))[0], dtype=np.float64)


def responses(rise: FloatArray, at: npt.ArrayLike) -> FloatArray:
    """Responses to a jump as columns, shape (n, number). rise : from the jump on. at : column j jumps at row j + 1."""
    n = len(rise)
    since = np.arange(n)[:, None] - (np.atleast_1d(np.asarray(at, dtype=np.intp))[None, :] + 1)
    return np.asarray(np.concatenate([np.zeros(n), rise])[since + n])


def _fitted(pv: FloatArray, rise: FloatArray, rest: FloatArray, chosen: list[int]) -> FloatArray:
    columns = np.concatenate([rest, responses(rise, chosen)], axis=1)
    return np.asarray(np.einsum("ij,j->i", columns, least_squares(columns, pv)), dtype=np.float64)


def _with_lag(pv: FloatArray, lag: float, sigma: float) -> tuple[float, list[int]]:
    """Criterion and columns of the best description with one lag."""
    n, (rise, rest) = len(pv), _parts(len(pv), lag)
    form = through_lag(*((1.0, math.exp(-1.0 / lag)) if lag else (0.0, 0.0)))
    rows, left = steps_chosen(pv, rise, rest, LEAST_NEW_SHARE, MOST_JUMPS, form)
    prices = [price(rss, n, sigma, jumps) for jumps, rss in enumerate(left)]
    chosen = rows[: prices.index(min(prices))]
    if (engine := compiled()) is not None:
        asked = pv, rise, rest, LEAST_NEW_SHARE, chosen, MOVED_ROWS, MOVED_PASSES, form
        chosen, rss = engine.steps_moved(*asked)
    else:
        for _ in range(MOVED_PASSES):
            chosen = _moved(pv, rise, rest, chosen)
        rss = float(np.sum((pv - _fitted(pv, rise, rest, chosen)) ** 2))
    return price(rss, n, sigma, len(chosen)), chosen


def through_lag(lacks: float, stays: float) -> tuple[float, ...]:
    """The form of a response that is 1 - lacks stays^rows."""
    return (1.0 - lacks, lacks - stays, -1.0 - stays, stays)


def steps_chosen(
    pv: FloatArray, rise: FloatArray, basis: FloatArray, unique: float, most: int, form: Sequence[float] = ()
) -> tuple[list[int], list[float]]:
    """Columns of up to so many steps, each where it takes away most, and sums of squares before and after each.

    rise : response to a step. basis : orthonormal columns of what is there without any. unique : a column of which less
    than this share is not explained by the others is no further step. form : for the compiled engine, b0, b1, a1 ... a4
    of a response (b0 + b1 q)/(1 + a1 q + ... + a4 q^4), q the backward shift; empty of any other.
    """
    if (engine := compiled()) is not None:
        found, taken_away = engine.steps_chosen(pv, rise, basis, unique, most, form)
        return found, taken_away.tolist()
    rows = np.arange(len(pv))
    since = rows[:, None] - rows[None, 1:]
    steps = np.where(since >= 0, rise[np.maximum(since, 0)], 0.0)
    left = pv - basis @ (basis.T @ pv)
    whole = np.einsum("ij,ij->j", steps, steps)
    along, free = left @ steps, whole - np.sum((basis.T @ steps) ** 2, axis=0)
    found, remain = list[int](), [float(left @ left)]
    while len(found) < most:
        usable = free > unique * whole
        j = int(np.argmax(np.where(usable, along**2 / np.where(usable, free, 1.0), 0.0)))
        new = steps[:, j] - basis @ (basis.T @ steps[:, j])
        if not usable[j] or not float(new @ new) > 0:
            break
        new /= np.linalg.norm(new)
        basis, taken, told = np.column_stack([basis, new]), float(new @ left), new @ steps
        left, along, free = left - taken * new, along - taken * told, free - told**2
        found.append(j)
        remain.append(float(left @ left))
    return found, remain


def _moved(pv: FloatArray, rise: FloatArray, rest: FloatArray, chosen: list[int]) -> list[int]:
    """Every jump at its best row nearby, the others held where they are."""
    at = list(chosen)
    columns = np.concatenate([rest, responses(rise, at)], axis=1)
    products, onto = columns.T @ columns, columns.T @ pv
    for i, j in enumerate(at):
        mine = rest.shape[1] + i
        others = np.arange(columns.shape[1]) != mine
        near = np.arange(max(j - MOVED_ROWS, 0), min(j + MOVED_ROWS + 1, len(pv) - 1))
        tried = responses(rise, near)
        shared = columns[:, others].T @ tried
        explained = np.linalg.solve(products[np.ix_(others, others)], np.column_stack([onto[others], shared]))
        size = np.einsum("ij,ij->j", tried, tried) - np.einsum("ij,ij->j", shared, explained[:, 1:])
        usable = size > LEAST_NEW_SHARE * len(pv)
        if not usable.any():
            continue
        taken = np.where(usable, (pv @ tried - explained[:, 0] @ shared) ** 2 / np.where(usable, size, 1.0), 0.0)
        best = int(np.argmax(taken))
        at[i] = int(near[best])
        columns[:, mine] = tried[:, best]
        products[mine] = products[:, mine] = columns.T @ columns[:, mine]
        onto[mine] = columns[:, mine] @ pv
    return at


def plateaus(pv: FloatArray, steps: Steps) -> list[Plateau]:
    """The plateaus of a record in order; neighbours of about one level are one."""
    found: list[Plateau] = []
    for first, end in pairwise([0, *steps.jumps, len(pv)]):
        if end <= first:
            continue
        settled = min(first + round(SETTLED * steps.lag), end - 1) if first else 0
        level = median(pv[settled:end])
        if found and abs(level - found[-1].level) < LEVEL * steps.range:
            merged = found.pop()
            found.append(Plateau(merged.first, end, median(pv[merged.first : end])))
        else:
            found.append(Plateau(settled, end, level))
    return found
