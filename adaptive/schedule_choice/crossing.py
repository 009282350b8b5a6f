"""Fast crossings: the loop in motion, with gains that change on the way.

Margins at rest say nothing of a loop whose gains follow its own pv: that is a nonlinear controller. So the setpoint
steps as far as it ever did in the records, a quarter of the range at the least, from the ends and the middle, on the
process as the curves have it (motion.py), with the gains looked up as the table looks them up, and with every place's
own gains, looked up without delay, for comparison. The controller is
the parallel PI in increments, co' = kp e' + ki e: what a bumpless change of gains does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.schedule_design.cover import mean_of
from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.schedule_design.places import Place
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

STEPS_IN_THETA = 6
"""Simulated steps in the shortest dead time."""
MOST_STEPS = 6000
SETTLING = 8.0
"""Length of a crossing in the longest tau_I + theta."""
LEAST_SHARE, MOST_SHARE = 0.25, 0.9
"""Shares of the range that are stepped over, at the least and at the most."""
STARTS = 3
"""Places from which it is stepped, each way."""
WORSE = 1.25
"""IAE of a crossing over that with every place's own gains, from which the schedule is told to be worse in motion."""
GRID = 201

Lookup = Callable[[float, float], PidGains]
"""Gains in force at a setpoint and a pv."""


@dataclass(frozen=True, slots=True)
class Crossing:
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
        numbers = {name: getattr(self, name) for name in ("iae_ratio", "overshoot", "own_overshoot")}
        told = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
        return {"variable": self.variable, "up": self.up, "share": self.share, **told, "proper": self.proper}

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
) -> list[Crossing]:
    """Both ways, for each lookup variable of "sp" and "pv".

    gains_at : of the schedule. largest : step of the setpoint in the records. x2 : where a second variable stands.
    """
    known = [place for place in places if place.known]
    if len(known) < 2:
        return []
    low, high = known[0].x, known[-1].x
    share = min(max(largest / (high - low), LEAST_SHARE), MOST_SHARE)
    process = _Process.of(curves, known, x2)
    own = _own(known)
    found = []
    size = share * (high - low)
    for up in (True, False):
        edges = [(x, x + size) for x in np.linspace(low, high - size, STARTS).tolist()]
        ways = edges if up else [(end, start) for start, end in edges]
        best = [_run(process, start, end, lambda _, pv: own(pv)) for start, end in ways]
        for variable in variables:
            runs = [_run(process, start, end, _lookup(gains_at, variable)) for start, end in ways]
            each = [
                Crossing(variable, up, share, run[0] / ideal[0], run[1], ideal[1])
                for run, ideal in zip(runs, best, strict=True)
            ]
            found.append(min(each, key=lambda one: (one.proper, -one.iae_ratio)))
    return found


def _lookup(gains_at: Callable[[float], PidGains], variable: str) -> Lookup:
    if variable == "sp":
        return lambda sp, _: gains_at(sp)
    return lambda _, pv: gains_at(pv)


def _own(places: Sequence[Place]) -> Callable[[float], PidGains]:
    """Every place's own gains, a straight line between neighbours."""
    xs = [place.x for place in places]

    def at(x: float) -> PidGains:
        i = int(np.clip(np.searchsorted(xs, x) - 1, 0, len(xs) - 2))
        share = min(max((x - xs[i]) / (xs[i + 1] - xs[i]), 0.0), 1.0)
        return mean_of(places[i].own, places[i + 1].own, share)

    return at


@dataclass(frozen=True, slots=True)
class _Process:
    """Curves on a grid, for stepping. rows : b, theta, tau, tau2 at grid places; dt_s, steps : of the simulation."""

    low: float
    high: float
    rows: FloatArray
    dt_s: float
    steps: int

    @classmethod
    def of(cls, curves: Curves, places: Sequence[Place], x2: float | None) -> "_Process":
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


def _run(process: _Process, start: float, end: float, lookup: Lookup) -> tuple[float, float]:
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
