"""What a schedule is designed for and judged on: a process that depends on one place, and what is true of it there.

The place is pv itself, or a signal from outside (a flow) that the loop does not move. All values are absolute, in the
units of the plant; rest at a place means that pv and co stand still there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from online.judge import Judge

from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.schedule_design.places import LEAST_STD
from retuner.adaptive.signals.sample import FloatArray
from retuner.scheduling import ScheduleDesign


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


# ---- Whether the truth lies within the bands of a design: k, tau and theta by the half rule, and SIMC's Kc of them.
#
# The half rule gives three lags that are alike other settings than the two lags that move as they do. So the ultimate
# gain and period are compared as well: they are of the process and not of its form.

NAMES = ("k", "tau", "theta", "kc", "ku", "pu")
STEP = 1e-5


def bands(found: ScheduleDesign, subject: Subject) -> list[dict[str, Any]]:
    """A row for each known place: how far the truth is from the curves, and one standard deviation as they claim it."""
    rows = []
    for place in found.places:
        if not place.known or not subject.low <= place.x <= subject.high:
            continue
        curves = found.design.curves
        ln = curves.ln(np.array([place.x]))[0]
        covariance = curves.ln_covariance(place.x) + LEAST_STD**2 * np.eye(len(ln))
        slopes = np.stack([(_told(ln + STEP * way) - _told(ln)) / STEP for way in np.eye(len(ln))], axis=1)
        std = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
        off = _told(ln) - _true(subject.local(place.x))
        rows.append(
            {"x": place.x, "off": dict(zip(NAMES, off.tolist(), strict=True))}
            | {"std": dict(zip(NAMES, std.tolist(), strict=True))}
        )
    return rows


def _told(ln: FloatArray) -> FloatArray:
    """ln k, tau, theta, Kc, Ku, Pu of ln b, theta, tau (, tau2)."""
    lags = [math.exp(x) for x in ln[2:]]
    return _true(LinearProcess(math.exp(ln[0]) * lags[0], tuple(lags), (), math.exp(ln[1])))


def _true(process: LinearProcess) -> FloatArray:
    """The same of a process of any order."""
    model = half_rule(process)
    kc = model.tau1_s / (abs(model.k) * 2 * model.theta_s)
    ku, pu = ultimate(process)
    return np.log([abs(model.k), model.tau1_s, model.theta_s, kc, abs(ku), pu])
