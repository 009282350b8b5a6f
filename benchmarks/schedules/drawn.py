"""Processes that are drawn: gain, lags and dead time over the range as smooth curves, with a kink, or constant.

Each of the three changes by a factor over the range 0 to 100, up or down. Shapes of its logarithm, from 0 to 1:

ramp      the place itself                      sigmoid   most of the change in the middle third
hump      up and down again                     kink      nothing up to a place, then all of it
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cases.processes import log_uniform
from online.varying import SUBSTEPS, Local, VaryingPlant

from retuner.adaptive.process.model import LinearProcess
from schedules.subject import Subject, sampling

SMOOTH = ("ramp", "sigmoid", "hump")
NOISE = 0.1
POINTS = 400
"""Of the tabled resting output."""


def shape(name: str, kink: float) -> Callable[[float], float]:
    """From the place in 0..1 to the share of the change."""
    return {
        "ramp": lambda z: z,
        "hump": lambda z: math.sin(math.pi * z) ** 2,
        "sigmoid": lambda z: (math.tanh(6 * (z - 0.5)) / math.tanh(3) + 1) / 2,
        "kink": lambda z: max(z - kink, 0.0) / (1 - kink),
    }[name]


@dataclass(frozen=True)
class Course:
    """A process over y in 0..100: the middle one times factor to the power sign x (share - 1/2), for k, tau, theta."""

    middle: Local
    signs: tuple[int, int, int]
    factor: float
    share: Callable[[float], float]

    def at(self, y: float) -> Local:
        """The linearisation at y."""
        part = self.share(min(max(y, 0.0), 100.0) / 100.0) - 0.5
        k, tau, theta = (self.factor ** (sign * part) for sign in self.signs)
        m = self.middle
        return Local(m.k * k, m.tau1_s * tau, m.tau2_s * tau, m.theta_s * theta)

    @cached_property
    def _held(self) -> list[float]:
        inside = [1 / self.at(100.0 * (i + 0.5) / POINTS).k for i in range(POINTS)]
        return [0.0, *(float(x) for x in np.cumsum(inside) * 100.0 / POINTS)]

    def rest(self, y: float) -> float:
        """The input that holds y: the integral of dy/k(y) from 0."""
        inside = min(max(y, 0.0), 100.0)
        i = min(int(inside * POINTS / 100.0), POINTS - 1)
        low, high = self._held[i], self._held[i + 1]
        return low + (high - low) * (inside * POINTS / 100.0 - i) + (y - inside) / self.at(inside).k


class AlongPv:
    """A varying plant whose place is its own pv, in absolute values."""

    def __init__(self, course: Course, dt_s: float, place: float) -> None:
        self._plant = VaryingPlant(course.at, course.rest, dt_s, place)
        self._y0, self._u0 = place, course.rest(place)

    def move(self, co: float, _place: float) -> float:
        """See Live."""
        return self._y0 + self._plant.move(co - self._u0)


class AlongSignal:
    """A process whose gain, lags and delay follow a signal from outside; its rest stays where it is."""

    def __init__(self, course: Course, dt_s: float, sp0: float) -> None:
        self._course, self._h_s, self._sp0 = course, dt_s / SUBSTEPS, sp0
        self._times, self._inputs = [-math.inf], [0.0]
        self._t, self._x, self._y = 0.0, 0.0, 0.0

    def move(self, co: float, place: float) -> float:
        """See Live; co = 0 is rest."""
        local, h = self._course.at(place), self._h_s
        decay = 1 - math.exp(-h / local.tau1_s)
        follow = 1 - math.exp(-h / local.tau2_s) if local.tau2_s else 1.0
        self._times.append(self._t)
        self._inputs.append(co)
        for _ in range(SUBSTEPS):
            late = self._inputs[bisect_right(self._times, self._t - local.theta_s + h / 2) - 1]
            before = self._x
            self._x += follow * (late - self._x)
            self._y += decay * (local.k * ((before + self._x) / 2 if local.tau2_s else self._x) - self._y)
            self._t += h
        return self._sp0 + self._y


def draw(rng: np.random.Generator, kind: str, factor: float, *, by: str = "pv") -> Subject:
    """One process. kind : "smooth", "kink" or "constant". by : "pv", or the name of an outside signal."""
    scale = 10 ** rng.uniform(-1, 2)
    tau1 = log_uniform(rng, 0.7, 15.0)
    tau2 = tau1 * log_uniform(rng, 0.05, 0.5) if rng.uniform() < 0.5 else 0.0
    signs = tuple(int(rng.choice([-1, 1])) for _ in range(3))
    k = float(rng.choice([-1, 1])) * log_uniform(rng, 0.5, 5.0)
    name = "kink" if kind == "kink" else str(rng.choice(SMOOTH))
    share = shape(name, float(rng.uniform(0.3, 0.7)))
    grown = 1.0 if kind == "constant" else factor
    course = Course(Local(k, tau1 * scale, tau2 * scale, scale), (signs[0], signs[1], signs[2]), grown, share)
    if by != "pv":
        course = replace(course, middle=replace(course.middle, k=abs(k)))
    return _subject(course, f"{kind} {name} x{grown:g} {signs}", f"{kind} x{grown:g}", by)


def _subject(course: Course, name: str, kind: str, by: str) -> Subject:
    def local(y: float) -> LinearProcess:
        return course.at(y).linear()

    dt_s = sampling(local, 0.0, 100.0)
    inside = by == "pv"
    rests = (course.rest(0.0), course.rest(100.0)) if inside else (-100.0 / course.middle.k, 100.0 / course.middle.k)
    room = 0.5 * abs(rests[1] - rests[0])
    return Subject(
        name=name,
        kind=kind if inside else f"{kind} by a signal",
        low=0.0,
        high=100.0,
        by=by,
        dt_s=dt_s,
        noise=NOISE,
        span=100.0,
        live=(lambda y: AlongPv(course, dt_s, y)) if inside else (lambda _: AlongSignal(course, dt_s, 50.0)),
        rest=course.rest if inside else lambda _: 0.0,
        local=local,
        co_min=min(rests) - room,
        co_max=max(rests) + room,
        sp0=50.0,
        constant=course.factor == 1.0,
    )
