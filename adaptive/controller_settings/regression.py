"""The PID law as a linear regression: which columns a controller of some structure makes, and the fit with its spread.

    increments   d co = kp (b d sp - d pv) + ki (sp - pv)' dt - kd d r              (' one sample ago)
    levels       the same summed up, with a constant for each stretch

    r = (tau_f r' + d pv) / (tau_f + dt)                                             the law of schedule/pid.py

Increments need no bias and forget at once what limits and manual moves did. But rounding of co, and pv and co that were
not read at the same instant, enter two increments with opposite signs; levels suffer once. Which equation is the better
one the standard deviations say. The law acts on pv with its noise and has none of its own, so ordinary least squares is
consistent in closed loop, where noise on pv would bias a process model.

Standard deviations are from sums over blocks of consecutive samples (Liang & Zeger 1986, clustered scores): remainders
of a law that is nearly right are neither white nor of even size.
"""

import math

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.recording_quality import runs
from retuner.adaptive.signals.recursion import recursion
from retuner.adaptive.signals.sample import FloatArray, Window, median, quantile
from retuner.schedule.late_dataclass import dataclass, replace

BLOCKS = 30  # blocks of consecutive samples whose scores count as independent
STRETCH = 0.1  # length of a stretch with its own constant in the level equation, as a share of the record
SHORTEST_STRETCH = 64  # shortest stretch in samples
MAD_TO_SIGMA = 1.4826
OUTLIER = 6.0  # Remainders beyond so many (robust) standard deviations are moves that no law made
OUTLIER_ROUNDS = 6  # rounds of leaving out outliers
FILTER_STEP = 1e-3  # step of the derivative by the filter time, as a share of it
EXACT = 1e-9  # remainders under this share of the movement are rounding of doubles

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Structure:
    """What a controller may look like.

    integral, proportional : whether it has them. derivative : "" for none, "pv" or "error" for what it acts on.
    lag : samples from pv to the co that it moves. tau_f_s : filter time of the derivative. pv_filter_s : filter time of
    the pv that the whole controller sees. All in seconds.
    """

    proportional: bool = True
    integral: bool = True
    derivative: str = ""
    lag: int = 0
    tau_f_s: float = 0.0
    pv_filter_s: float = 0.0

    @property
    def filter_s(self) -> float:
        """The filter time that is there: of the derivative where there is one, else of pv."""
        return self.tau_f_s if self.derivative else self.pv_filter_s

    def filtering(self, tau_s: float) -> "Structure":
        """The regression with another filter time."""
        return replace(self, tau_f_s=tau_s) if self.derivative else replace(self, pv_filter_s=tau_s)

    @property
    def unknowns(self) -> int:
        """Numbers to be found, for information criteria."""
        filters = int(bool(self.derivative)) + int(self.pv_filter_s > 0)
        return int(self.proportional) + int(self.integral) + int(bool(self.derivative)) + filters


@dataclass(frozen=True, slots=True)
class Regression:
    """A fit. values, std : by name (kp, ki, kd, b_kp). remainder : of every sample, co units, NaN-free, shape (n - 1,).

    kept : samples used. rms, rho : of the equation's remainder, and its correlation from one sample to the next.
    explained : share of co's movement. levels : the level equation was used.
    """

    structure: Structure
    values: dict[str, float]
    std: dict[str, float]
    remainder: FloatArray
    kept: BoolArray
    rms: float
    rho: float
    explained: float
    levels: bool

    @property
    def main(self) -> str:
        """The gain that matters most: kp, or ki of a controller without."""
        return "kp" if self.structure.proportional else "ki"

    def spread(self, name: str) -> float:
        """Standard deviation of a gain as a share of it, infinite for a gain that is not there."""
        value = abs(self.values.get(name, 0.0))
        return self.std[name] / value if value > 0 else math.inf

    def doubt(self, name: str) -> float:
        """The same with what may be wrong because co is not all explained.

        Where pv was recorded with errors that the controller did not see, gains come out too small by up to that share;
        the standard deviation of an even distribution over it.
        """
        return math.hypot(self.spread(name), max(1 - self.explained, 0.0) / math.sqrt(3.0))


def filtered(x: FloatArray, tau_s: float, dt_s: float) -> FloatArray:
    """First-order filter by backward difference, at rest before the first sample; shape (n,)."""
    if tau_s <= 0:
        return x
    a = tau_s / (tau_s + dt_s)
    followed: FloatArray = recursion(np.asarray(a), (1 - a) * (x - x[0]))[1:] + x[0]
    return followed


def columns(window: Window, structure: Structure, at: dict[str, float] | None = None) -> tuple[list[str], FloatArray]:
    """Names and columns of the increment equation, shape (n - 1, number of names).

    at : gains at which the equation is linearised in the filter time as well; then "tau" is one of the names, and its
        value is the Gauss-Newton step of the filter time.
    """
    if at is not None:
        names, x = columns(window, structure)
        step = FILTER_STEP * max(structure.filter_s, window.sample_time_s)
        further = columns(window, structure.filtering(structure.filter_s + step))[1]
        bend = (further - x) @ np.array([at[name] for name in names]) / step
        return [*names, "tau"], np.column_stack([x, bend])
    dt, lag = np.diff(window.t_s), structure.lag
    typical = window.sample_time_s
    pv, sp = _late(filtered(window.pv, structure.pv_filter_s, typical), lag), _late(window.sp, lag)
    e = sp - pv
    named: dict[str, FloatArray] = {}
    if structure.proportional:
        named["kp"] = -np.diff(pv)
        if np.ptp(sp) > 0:
            named["b_kp"] = np.diff(sp)
    if structure.integral:
        named["ki"] = e[:-1] * dt
    if structure.derivative:
        slope = np.concatenate([[0.0], np.diff(e if structure.derivative == "error" else -pv) / dt])
        named["kd"] = np.diff(filtered(slope, structure.tau_f_s, typical))
    if structure.derivative or structure.pv_filter_s > 0:  # the filter was not at rest before the record
        a = structure.filter_s / (structure.filter_s + typical)
        named["start"] = np.asarray((a - 1) * a ** np.arange(len(dt)), dtype=np.float64)
    return list(named), np.stack(list(named.values()), axis=1)


def _late(x: FloatArray, lag: int) -> FloatArray:
    late: FloatArray = np.concatenate([np.full(lag, x[0]), x[: len(x) - lag]])
    return late


def by_increments(
    window: Window,
    structure: Structure,
    usable: BoolArray,
    at: dict[str, float] | None = None,
    *,
    trim: bool = True,
    sure: bool = True,
) -> Regression:
    """Least squares on increments; with trim, moves that no law made are left out.

    usable : increments that the law made, shape (n - 1,). at : see columns. sure : with standard deviations, which cost
    more than the fit; else they are infinite.
    """
    names, x = columns(window, structure, at)
    y = np.diff(window.co)
    kept = usable.copy()
    values = _solve(x[kept], y[kept])
    remainder = y - x @ values
    for _ in range(OUTLIER_ROUNDS if trim else 0):
        size = np.abs(remainder)
        sigma = max(MAD_TO_SIGMA * median(size[kept]), quantile(size[kept], 0.95) / 1.96)
        fresh = usable & (size <= OUTLIER * sigma + EXACT * float(np.max(np.abs(y))))
        if np.array_equal(fresh, kept):
            break
        kept = fresh
        values = _solve(x[kept], y[kept])
        remainder = y - x @ values
    return _told(structure, names, values, (x[kept], y[kept]), (remainder, kept), levels=False, sure=sure)


def by_levels(
    window: Window, structure: Structure, kept: BoolArray, at: dict[str, float] | None = None, *, sure: bool = True
) -> Regression:
    """Least squares on the summed equation, each stretch of kept increments with its own constant.

    at : see columns. sure : see by_increments.
    """
    names, x = columns(window, structure, at)
    y = np.diff(window.co)
    longest = max(round(STRETCH * len(y)), SHORTEST_STRETCH)
    equation, parts = np.column_stack([x, y]), list[FloatArray]()
    for first, end in runs(kept):
        if end - first <= x.shape[1] + 1:
            continue
        many = -(-(end - first) // longest)
        each, longer = divmod(end - first, many)
        middle = first + longer * (each + 1)  # the first ones are longer by a sample where the stretch does not divide
        for rows, pieces in ((equation[first:middle], longer), (equation[middle:end], many - longer)):
            if pieces:
                levels = np.cumsum(rows.reshape(pieces, -1, rows.shape[1]), axis=1)
                parts.append((levels - levels.mean(axis=1, keepdims=True)).reshape(rows.shape))
    if not parts:
        return by_increments(window, structure, kept, at, trim=False, sure=sure)
    summed = np.concatenate(parts)
    xs, ys = summed[:, :-1], summed[:, -1]
    values = _solve(xs, ys)
    return _told(structure, names, values, (xs, ys), (y - x @ values, kept), levels=True, sure=sure)


def _solve(x: FloatArray, y: FloatArray) -> FloatArray:
    """Least squares with scaled columns; a column without content gets 0."""
    scale = np.linalg.norm(x, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(x / scale, y, rcond=1e-9)[0] / scale, dtype=np.float64)


def _told(
    structure: Structure,
    names: list[str],
    values: FloatArray,
    equation: tuple[FloatArray, FloatArray],
    per_sample: tuple[FloatArray, BoolArray],
    *,
    levels: bool,
    sure: bool,
) -> Regression:
    """Values with the share explained, and with their standard deviations where these are wanted."""
    x, y = equation
    if not len(y):  # no move is left that the law made: one that says nothing
        x, y = np.zeros((1, len(names))), np.zeros(1)
    r, std = y - x @ values, np.full(len(names), np.inf)
    if sure:  # from what is left in BLOCKS stretches: a remainder has a colour
        scale = np.linalg.norm(x, axis=0)
        there = scale > 0
        xs = x[:, there] / scale[there]
        inverse = np.linalg.pinv(xs.T @ xs)
        blocks = min(BLOCKS, len(r))
        each, longer = divmod(len(r), blocks)
        scores = np.add.reduceat(xs * r[:, None], [i * each + min(i, longer) for i in range(blocks)], axis=0)
        spread = scores.T @ scores * blocks / max(blocks - xs.shape[1], 1)
        std[there] = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0)) / scale[there]
    power = float(np.mean(y * y))
    rms = float(np.sqrt(np.mean(r * r)))
    rho = float(r[1:] @ r[:-1]) / float(r @ r) if rms > 0 else 0.0
    gains, spread_of = (dict(zip(names, numbers.tolist(), strict=True)) for numbers in (values, std))
    explained = 1 - rms * rms / power if power > 0 else 0.0
    return Regression(structure, gains, spread_of, *per_sample, rms, rho, explained, levels)
