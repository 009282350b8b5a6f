"""Where the next experiment teaches most: the place whose gain is known least, and a step that shows it there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.schedule_design.places import Place
from retuner.adaptive.signals.noise import noise_sigma

OVER_NOISE = 20.0
"""Size of the answer over the noise of pv."""
LEAST_SHARE = 0.03
"""And as a share of what pv travels in the records."""
LAGS, DEAD_TIMES = 3.0, 10.0
"""How long the step is held: theta and so many lags, at most so many dead times more (a slow rise shows the slope)."""


CO_SHARE = 0.8
"""Of the room that co has at a place: a step may use so much, the rest is left to loads."""

Range = tuple[float | None, float | None]
"""Lower and upper limit, each where it is known."""


@dataclass(frozen=True, slots=True)
class NextExperiment:
    """A step of the controller output in manual, or of the setpoint in automatic, at a place of the variable.

    x : where. co_step : in units of co. sp_step : in units of pv. hold_s : how long. gain_std : of ln Kc there now.
    x2 : of a second variable. held : whether the output's limits hold the step below what would be seen well.
    """

    x: float
    co_step: float
    sp_step: float
    hold_s: float
    gain_std: float
    held: bool = False
    x2: float | None = None

    def to_dict(self) -> dict[str, float | bool | None]:
        """Keys x, x2 (null for one variable), co_step, sp_step, hold_s, gain_std, held."""
        return {
            "x": self.x,
            "x2": self.x2,
            "co_step": self.co_step,
            "sp_step": self.sp_step,
            "hold_s": self.hold_s,
            "gain_std": self.gain_std,
            "held": self.held,
        }


def next_experiment(curves: Curves, places: Sequence[Place], co: Range = (None, None)) -> NextExperiment:
    """The experiment that teaches most. co : limits of the output; a step goes where there is room, and no farther."""
    least = max(places, key=lambda place: place.gain_std)
    model = least.model
    stretches = curves.joint.stretches
    travel = max(float(s.pv.max()) for s in stretches) - min(float(s.pv.min()) for s in stretches)
    noise = max(noise_sigma(s.pv) for s in stretches)
    answer = max(OVER_NOISE * noise, LEAST_SHARE * travel)
    hold = model.theta_s + min(LAGS * (model.tau1_s + model.tau2_s), DEAD_TIMES * (model.theta_s + model.tau2_s))
    lag = model.tau1_s or hold
    reached = model.k * min(1.0, (hold - model.theta_s) / lag)
    wanted = answer / abs(reached)
    step = _within(wanted, float(curves.rest.co(np.array([least.x]))[0]), co, inwards=_inwards(least, places, reached))
    return NextExperiment(least.x, step, step * reached, hold, least.gain_std, abs(step) < 0.999 * wanted, least.x2)


def _inwards(least: Place, places: Sequence[Place], gain: float) -> float:
    """Sign of the step of co that moves pv away from the nearer end of the range."""
    middle = (places[0].x + places[-1].x) / 2
    return math.copysign(1.0, gain) * (1.0 if least.x <= middle else -1.0)


def _within(wanted: float, rest: float, co: Range, inwards: float) -> float:
    """A step of this size away from rest, inwards where there is room; else the other way, or as far as it goes."""
    low, high = co
    up = math.inf if high is None else CO_SHARE * max(high - rest, 0.0)
    down = math.inf if low is None else CO_SHARE * max(rest - low, 0.0)
    room = {1.0: up, -1.0: down}
    way = inwards if room[inwards] >= min(wanted, room[-inwards]) else -inwards
    return way * min(wanted, room[way])
