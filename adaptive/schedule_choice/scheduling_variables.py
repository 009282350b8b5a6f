"""Variables that gains may follow, at the samples of the records, and the curves along one or two of them."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.schedule_choice.boundaries_of_one_variable import mean_of
from retuner.adaptive.schedule_design.curve_shapes import SIMPLER
from retuner.adaptive.schedule_design.curves import Curves, Progress, curves
from retuner.adaptive.schedule_design.motion import recursion
from retuner.adaptive.schedule_design.places import Place
from retuner.adaptive.schedule_design.record_stretches import (
    CurveAxis,
    CurveShape,
    Second,
    Stretch,
    cut,
    moving,
    signals_of,
    without_gaps,
)
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median, quantile
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

ROWS = 400  # rows wanted in a typical stretch
OWN = ("sp", "pv", "co")  # signals of the loop itself; another variable may move pv on its own


@dataclass(frozen=True, slots=True)
class SchedulingVariable:
    """A variable at the samples of every record. follows : it goes after a signal of the loop, as a filtered pv."""

    name: str
    values: tuple[FloatArray, ...]
    follows: bool = False

    @property
    def outside(self) -> bool:
        """Whether it is no signal of the loop itself, and so may move pv on its own."""
        return self.name not in OWN and not self.follows

    def span(self) -> tuple[float, float]:
        """Lowest and highest value visited, noise apart."""
        low = min(quantile(v, 0.001) for v in self.values)
        high = max(quantile(v, 0.999) for v in self.values)
        return low, high

    def noise(self) -> float:
        """Standard deviation of its noise; none where it stands still most of the time, and steps."""
        return max(0.0 if np.mean(np.diff(v) == 0) > 0.5 else noise_sigma(v) for v in self.values)


FOLLOWS = 0.95  # share of a variable's variance that a lag of sp, pv or co explains where it follows the loop
LAGS = 12  # lags that are tried, from a sample to a tenth of the record


def follows_loop(windows: Sequence[Window], values: Sequence[FloatArray]) -> bool:
    """Whether a variable is a signal of the loop behind a lag: it cannot move pv on its own then.

    A filtered pv, a temperature beside the one that is controlled, a valve's position. Taken for a variable from
    outside, its push would explain what the process does.
    """
    y = np.concatenate(list(values))
    varied = max(float(np.var(y)), 1e-300)
    dt = median([w.sample_time_s for w in windows])
    longest = max(0.1 * float(windows[0].t_s[-1] - windows[0].t_s[0]), 2 * dt)
    for lag in (0.0, *np.geomspace(dt, longest, LAGS).tolist()):
        for name in OWN:
            decay, signals = math.exp(-dt / lag) if lag else 0.0, [getattr(w, name) for w in windows]
            # each behind a first-order lag, at rest at first
            late = [recursion(np.full(len(x) - 1, decay), (1 - decay) * x[1:], x[0]) for x in signals]
            behind = np.concatenate(late)
            if float(np.ptp(behind)):
                x = behind - float(np.mean(behind))
                slope, level = np.polyfit(x, y, 1)  # variance round a straight line
                if float(np.var(y - level - slope * x)) < (1 - FOLLOWS) * varied:
                    return True
    return False


def axis_of(candidate: SchedulingVariable, span: tuple[float | None, float | None]) -> CurveAxis:
    """The axis from end to end of a schedule, by the ends that are given and those that the records visit."""
    own = candidate.span()
    low, high = (given if given is not None else seen for given, seen in zip(span, own, strict=True))
    if not max(low, own[0]) < min(high, own[1]):
        raise ValueError(
            f"{candidate.name}: the records visit {own[0]:.4g} to {own[1]:.4g}, and nothing of low = {low:g} to "
            f"high = {high:g}; give ends that take in some of it"
        )
    return CurveAxis(low, high)


LEAST_RATIO = 2.0  # high over low of a variable from outside from which its ratios are tried as its steps


def curves_along(windows: Sequence[Window], candidate: SchedulingVariable, axis: CurveAxis, told: Progress) -> Curves:
    """Curves over the variable, or over its ratios where these say more."""
    axes = [axis]
    if candidate.outside and axis.low > 0 and axis.high / axis.low >= LEAST_RATIO:
        axes.append(replace(axis, by_ratio=True))
    found = []
    for i, one in enumerate(axes):

        def shared(stage: str, share: float, i: int = i) -> None:
            told(stage, (i + share) / len(axes))

        found.append(
            curves(stretches_of(windows, candidate), one, direction(windows), shared, pushed=candidate.outside)
        )
    return max(found, key=lambda c: c.log_likelihood - SIMPLER * c.form.size)


def silent(stage: str, share: float) -> None:
    """Progress that nobody wants to see."""
    del stage, share


def curves_over_both(
    windows: Sequence[Window], both: tuple[SchedulingVariable, SchedulingVariable], alone: Sequence[Curves]
) -> Curves:
    """Curves over two variables at once, every parameter a product of one over each. alone : along either by itself."""
    one, two = both
    axes = [found.form.axis for found in alone]
    second = Second(axes[1], (CurveShape.CONSTANT,) * 3, two.outside)
    richest = max((found.rich for found in alone), key=lambda form: (len(form.shapes), form.felt is not None))
    some = stretches_of(windows, one, two)
    return curves(some, axes[0], direction(windows), silent, pushed=one.outside, second=second, known=richest)


SEEN = 5
"""Setpoint changes that must agree on the direction in which the controller acts, on balance, weighed by their size."""


def direction(windows: Sequence[Window]) -> int | None:
    """Sign of the process gain as the controller's answers to setpoint changes show it; None where there are too few.

    In a loop that is closed and works, co goes the process' way when the setpoint moves. Where it never does, the
    controller is read off the record.
    """
    votes = []
    for window in windows:
        moved = np.diff(window.sp)
        large = np.flatnonzero(np.abs(moved) > 0.1 * max(float(np.ptp(window.sp)), 1e-300))
        for row in large[(large > SEEN) & (large < len(moved) - SEEN)].tolist():
            kick = float(np.mean(window.co[row + 1 : row + 1 + SEEN]) - np.mean(window.co[row - SEEN + 1 : row + 1]))
            votes.append(math.copysign(1.0, moved[row]) * kick)
    total = sum(votes)
    against = sum(abs(v) for v in votes if v * total < 0)
    if votes and against <= abs(total):
        return int(math.copysign(1, total))
    read_off = (settings_in_force(window).direction for window in windows)
    return next((way for way in read_off if way is not None), None)


def stretches_of(
    windows: Sequence[Window], one: SchedulingVariable, two: SchedulingVariable | None = None
) -> list[Stretch]:
    """All stretches of all records, with one variable or two."""
    found: list[Stretch] = []
    for i, window in enumerate(windows):
        # samples in an interval: a typical time between setpoint changes has ROWS
        n = len(window.t_s)
        changes = int(np.count_nonzero(np.abs(np.diff(window.sp)) > 0.01 * np.ptp(window.sp)))
        every = max(1, round(n / (changes + 1) / ROWS)) if changes < n / 20 else max(1, n // 40 // ROWS)
        values = np.stack([c.values[i] for c in (one, two) if c is not None], axis=1)
        for piece, there in without_gaps(window, values):
            found += moving(cut(signals_of(piece, there[:, 0], every, there[:, 1] if two is not None else None)))
    return found


# ---- Fast crossings: the loop in motion, with gains that change on the way.
#
# Margins at rest say nothing of a loop whose gains follow its own pv: that is a nonlinear controller. So the setpoint
# steps as far as it ever did in the records, a quarter of the range at the least, from the ends and the middle, on the
# process as the curves have it (motion.py), with the gains looked up as the table looks them up, and with every place's
# own gains, looked up without delay, for comparison. The controller is
# the parallel PI in increments, co' = kp e' + ki e: what a bumpless change of gains does.

STEPS_IN_THETA = 6  # simulated steps in the shortest dead time
MOST_STEPS = 6000
SETTLING = 8.0  # Length of a crossing in the longest tau_I + theta
LEAST_SHARE, MOST_SHARE = 0.25, 0.9  # shares of the range that are stepped over, at the least and at the most
STARTS = 3  # places from which it is stepped, each way
WORSE = 1.25
"""IAE of a crossing over that with every place's own gains, from which the schedule is told to be worse in motion."""
GRID = 201

Lookup = Callable[[float, float], PidGains]  # gains in force at a setpoint and a pv


@dataclass(frozen=True, slots=True)
class RegionCrossing:
    """The worst of the steps one way. up : which. share : of the range that is stepped over.

    variable : that looks the gains up. iae_ratio : over that with own gains. overshoot : beyond the end, as a share of
    the step; own_overshoot : the same with own gains.
    """

    variable: str
    up: bool
    share: float
    iae_ratio: float
    overshoot: float
    own_overshoot: float

    def to_dict(self) -> dict[str, object]:
        """Keys variable, up, share, iae_ratio (null where it does not end), overshoot, own_overshoot, proper."""
        return plain_values(self, "variable up share iae_ratio overshoot own_overshoot proper")

    @property
    def proper(self) -> bool:
        """Whether moving costs no more than resting gains let expect."""
        return self.iae_ratio <= WORSE and self.overshoot <= max(self.own_overshoot + 0.1, 0.25)


def crossings(
    curves: Curves,
    places: Sequence[Place],
    gains_at: Callable[[float], PidGains],
    variables: Sequence[str],
    largest: float,
    x2: float | None = None,
) -> list[RegionCrossing]:
    """Crossings both ways, for each lookup variable of "sp" and "pv".

    gains_at : of the schedule. largest : step of the setpoint in the records. x2 : where a second variable stands.
    """
    known = [place for place in places if place.known]
    if len(known) < 2:
        return []
    low, high = known[0].x, known[-1].x
    share = min(max(largest / (high - low), LEAST_SHARE), MOST_SHARE)
    process = _ProcessAlong.of(curves, known, x2)
    xs = [place.x for place in known]

    def own(x: float) -> PidGains:
        """Every place's own gains, a straight line between neighbours."""
        i = int(np.clip(np.searchsorted(xs, x) - 1, 0, len(xs) - 2))
        between = min(max((x - xs[i]) / (xs[i + 1] - xs[i]), 0.0), 1.0)
        return mean_of(known[i].own, known[i + 1].own, between)

    found = []
    size = share * (high - low)
    for up in (True, False):
        edges = [(x, x + size) for x in np.linspace(low, high - size, STARTS).tolist()]
        ways = edges if up else [(end, start) for start, end in edges]
        best = [_run(process, start, end, lambda _, pv: own(pv)) for start, end in ways]
        for variable in variables:
            lookup: Lookup = (lambda sp, _: gains_at(sp)) if variable == "sp" else (lambda _, pv: gains_at(pv))
            runs = [_run(process, start, end, lookup) for start, end in ways]
            each = [
                RegionCrossing(variable, up, share, run[0] / ideal[0], run[1], ideal[1])
                for run, ideal in zip(runs, best, strict=True)
            ]
            found.append(min(each, key=lambda one: (one.proper, -one.iae_ratio)))
    return found


@dataclass(frozen=True, slots=True)
class _ProcessAlong:
    """Curves on a grid, for stepping. rows : b, theta, tau, tau2 at grid places; dt_s, steps : of the simulation."""

    low: float
    high: float
    rows: FloatArray
    dt_s: float
    steps: int

    @classmethod
    def of(cls, curves: Curves, places: Sequence[Place], x2: float | None) -> "_ProcessAlong":
        grid = np.linspace(places[0].x, places[-1].x, GRID)
        ln = curves.ln(grid, None if x2 is None else np.full(GRID, x2))
        values = np.exp(ln)
        values[:, 0] *= curves.form.sign
        if values.shape[1] == 3:
            values = np.concatenate([values, np.zeros((GRID, 1))], axis=1)
        longest = max(p.own.kp / p.own.ki + p.model.theta_s for p in places)
        dt = max(float(np.min(values[:, 1])) / STEPS_IN_THETA, SETTLING * longest / MOST_STEPS)
        return cls(places[0].x, places[-1].x, values, dt, math.ceil(SETTLING * longest / dt))

    def at(self, x: float) -> FloatArray:
        """b, theta, tau, tau2 at x."""
        place = (x - self.low) / (self.high - self.low) * (GRID - 1)
        found: FloatArray = self.rows[min(max(round(place), 0), GRID - 1)]
        return found


def _run(process: _ProcessAlong, start: float, end: float, lookup: Lookup) -> tuple[float, float]:
    """IAE and overshoot of one crossing; infinite where it does not end."""
    dt, size = process.dt_s, abs(end - start)
    past = [0.0]
    y, away, v, iae, peak, last = start, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(process.steps):
        b, theta, tau, tau2 = process.at(y).tolist()
        error = end - y
        gains = lookup(end, y)
        past.append(past[-1] + gains.kp * (error - last) + gains.ki * error * dt)
        last = error
        u = past[max(len(past) - 1 - round(theta / dt), 0)]
        before = v
        v += (1 - math.exp(-dt / tau2)) * (u - v) if tau2 > 0 else u - v
        away = away * math.exp(-dt / tau) + v - before
        y += b * away * dt
        iae += abs(error) * dt
        peak = max(peak, (y - end) * math.copysign(1.0, end - start))
        if abs(y - end) > 10 * size:
            return math.inf, math.inf
    return (iae if abs(end - y) < 0.5 * size else math.inf), peak / size
