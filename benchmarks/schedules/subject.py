"""What a schedule is designed for and judged on: a process that depends on one place, and what is true of it there.

The place is pv itself, or a signal from outside (a flow) that the loop does not move. All values are absolute, in the
units of the plant; rest at a place means that pv and co stand still there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from online.judge import Judge

from retuner.adaptive.process.model import LinearProcess


class Live(Protocol):
    """A plant in motion."""

    def move(self, co: float, place: float) -> float:
        """Hold co for one sample, the outside signal at `place` (no use where the place is pv); pv at its end."""


@dataclass(frozen=True)
class Subject:
    """One plant.

    name, kind : what it is, and to which row of the table it belongs.
    low, high : places that it works at. by : "pv", or the name of the outside signal that is the place.
    dt_s : sampling interval. noise : standard deviation of the measurement, pv units.
    span : of pv, its unit of size. sp0 : setpoint where the place is an outside signal.
    live : a plant at rest at a place. rest : co there. local : the linearisation there.
    co_min, co_max : range of the output. constant : the process is the same everywhere.
    """

    name: str
    kind: str
    low: float
    high: float
    by: str
    dt_s: float
    noise: float
    span: float
    live: Callable[[float], Live]
    rest: Callable[[float], float]
    local: Callable[[float], LinearProcess]
    co_min: float
    co_max: float
    sp0: float = 0.0
    constant: bool = False

    def sp_at(self, place: float) -> float:
        """The setpoint of rest there."""
        return place if self.by == "pv" else self.sp0

    def places(self, count: int) -> list[float]:
        """So many places, evenly spread, a twentieth of the range from its ends."""
        rim = (self.high - self.low) / 20
        return [float(x) for x in np.linspace(self.low + rim, self.high - rim, count)]

    def judge(self, place: float) -> Judge:
        """What is in spec there."""
        return Judge(self.local(place), self.dt_s)


Make = Callable[[np.random.Generator], Subject]


def sampling(local: Callable[[float], LinearProcess], low: float, high: float, per_theta: float = 8.0) -> float:
    """Interval of so many samples to the effective dead time of the middle place of five."""
    thetas = sorted(Judge.theta(local(low + (high - low) * share)) for share in (0.1, 0.3, 0.5, 0.7, 0.9))
    return float(f"{thetas[2] / per_theta:.2g}")
