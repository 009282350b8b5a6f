"""Fast crossings: the loop in motion, from one end of the range to the other, with gains that change on the way.

Margins at rest say nothing of a loop whose gains follow its own pv: that is a nonlinear controller. So the setpoint
steps from one end to the other and back, on the process as the curves have it (motion.py), with the gains looked up as
the table looks them up, and with every place's own gains, looked up without delay, for comparison. The controller is
the parallel PI in increments, co' = kp e' + ki e: what a bumpless change of gains does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.schedule_design.cover import Layout, mean_of
from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.schedule_design.places import Place
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

STEPS_IN_THETA = 6
"""Simulated steps in the shortest dead time."""
MOST_STEPS = 6000
SETTLING = 8.0
"""Length of a crossing in the longest tau_I + theta."""
INSIDE = 0.9
"""Share of the range that is crossed: the ends of the records are where the curves end."""
WORSE = 1.25
"""IAE of a crossing over that with every place's own gains, from which the schedule is told to be worse in motion."""
GRID = 201

Lookup = Callable[[float, float], PidGains]
"""Gains in force at a setpoint and a pv."""


@dataclass(frozen=True, slots=True)
class Crossing:
    """A step over the range with a lookup variable. up : its direction. iae_ratio : over that with own gains.

    overshoot : beyond the end, as a share of the step; own_overshoot : the same with own gains.
    """

    variable: str
    up: bool
    iae_ratio: float
    overshoot: float
    own_overshoot: float

    def to_dict(self) -> dict[str, object]:
        """Keys variable, up, iae_ratio (null where it does not end), overshoot, own_overshoot, proper."""
        numbers = {name: getattr(self, name) for name in ("iae_ratio", "overshoot", "own_overshoot")}
        told = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
        return {"variable": self.variable, "up": self.up, **told, "proper": self.proper}

    @property
    def proper(self) -> bool:
        """Whether moving costs no more than resting gains let expect."""
        return self.iae_ratio <= WORSE and self.overshoot <= max(self.own_overshoot + 0.1, 0.25)


def crossings(curves: Curves, places: Sequence[Place], layout: Layout, variables: Sequence[str]) -> list[Crossing]:
    """Both ways over the range, for each lookup variable of "sp" and "pv"."""
    known = [place for place in places if place.known]
    low, high = known[0].x, known[-1].x
    edge = 0.5 * (1 - INSIDE) * (high - low)
    if len(known) < 2 or not high > low:
        return []
    process = _Process.of(curves, known)
    own = _own(known)
    found = []
    for start, end in ((low + edge, high - edge), (high - edge, low + edge)):
        best = _run(process, start, end, lambda _, pv: own(pv))
        for variable in variables:
            run = _run(process, start, end, _lookup(layout, variable))
            found.append(Crossing(variable, end > start, run[0] / best[0], run[1], best[1]))
    return found


def _lookup(layout: Layout, variable: str) -> Lookup:
    """The table along sp or pv."""
    if variable == "sp":
        return lambda sp, _: layout.gains_at(sp)
    return lambda _, pv: layout.gains_at(pv)


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
    def of(cls, curves: Curves, places: Sequence[Place]) -> "_Process":
        grid = np.linspace(places[0].x, places[-1].x, GRID)
        ln = curves.ln(grid)
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
    y, w, v, iae, peak, last = start, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(process.steps):
        b, theta, tau, tau2 = process.at(y).tolist()
        error = end - y
        gains = lookup(end, y)
        past.append(past[-1] + gains.kp * (error - last) + gains.ki * error * dt)
        last = error
        u = past[max(len(past) - 1 - round(theta / dt), 0)]
        before = v
        v += (1 - math.exp(-dt / tau2)) * (u - v) if tau2 > 0 else u - v
        w = w * math.exp(-dt / tau) + b * (v - before)
        y += w * dt
        iae += abs(error) * dt
        peak = max(peak, (y - end) * math.copysign(1.0, end - start))
        if abs(y - end) > 10 * size:
            return math.inf, math.inf
    return (iae if abs(end - y) < 0.5 * size else math.inf), peak / size
