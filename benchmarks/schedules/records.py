"""Days of ordinary closed-loop record: the loop goes over its range and back under poor gains.

Each of VISITED places is visited `visits` times, on the way up and on the way down in turn, each time somewhere in its
part of the range. In the middle of every second one the load
steps to another level and stays there. Where the place is an outside signal, the signal
ramps there and the setpoint steps up or down at each.
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from cases.plant import log_uniform, robustness
from online.judge import Judge
from online.varying import SUBSTEPS, Local, VaryingPlant

from retuner import GainTable, LinearProcess, PidGains
from schedules.lookups import Lookup, regions_along
from schedules.loop import Trace, Visit, run
from schedules.subject import Subject, sampling
from schedules.truth import Truth

VISITED = 8
HOLD_THETA, HOLD_CLOSED = 50.0, 6.0
"""A visit lasts so many dead times there, or so many times of the loop under the gains in force, up to MOST_SAMPLES."""
MOST_SAMPLES = 2500
LOAD_SHARE = 0.05  # Share of the span by which the largest load would move pv at rest
STEP_SHARE = 0.08  # Share of the span of a setpoint step where the place is an outside signal
MS_POOR = 2.5  # The poor gains are no worse than this anywhere
REGIONS_IN_FORCE = 3


def poor(truth: Truth, rng: np.random.Generator) -> PidGains:
    """One set for everywhere: stable everywhere, and right nowhere or in few places."""
    best = truth.best()
    least = min(best, key=lambda g: abs(g.kp))
    tau_i = float(np.median([g.kp / g.ki for g in best]) * rng.uniform(0.6, 2.0))
    kp = least.kp * float(rng.uniform(0.4, 1.0))
    for _ in range(20):
        # the largest true Ms over the places
        gains = PidGains(kp, kp / tau_i)
        half = truth.subject.dt_s / 2
        seen = [replace(judge.process, theta_s=judge.process.theta_s + half) for judge in truth.judges]
        if max(robustness(process, gains).ms for process in seen) <= MS_POOR:
            break
        kp, tau_i = 0.8 * kp, 1.1 * tau_i
    return PidGains(kp, kp / tau_i)


def poor_table(truth: Truth, rng: np.random.Generator) -> GainTable:
    """Three regions with a poor set each."""
    subject = truth.subject
    low, high = subject.low, subject.high
    bounds = tuple(low + (high - low) * i / REGIONS_IN_FORCE for i in range(1, REGIONS_IN_FORCE))
    sets = []
    for i in range(REGIONS_IN_FORCE):
        mine = [j for x, j in zip(truth.places, truth.judges, strict=True) if sum(x >= b for b in bounds) == i]
        least = min((j.best for j in mine), key=lambda g: abs(g.kp))
        kp, tau_i = least.kp * float(rng.uniform(0.4, 1.0)), least.kp / least.ki * float(rng.uniform(0.8, 1.6))
        sets.append(PidGains(kp, kp / tau_i))
    return GainTable("loop", regions_along(subject.by, low, bounds, high, (high - low) / 100), tuple(sets))


def record(truth: Truth, in_force: Lookup, rng: np.random.Generator, visits: int, lag_s: float) -> Trace:
    """So many visits of each place under the gains in force."""
    subject = truth.subject
    width = (subject.high - subject.low) / VISITED
    plan: list[Visit] = []
    order = [i for turn in range(visits) for i in (range(VISITED) if turn % 2 == 0 else range(VISITED - 1, -1, -1))]
    side = 1.0
    for index, i in enumerate(order):
        place = subject.low + width * (i + float(rng.uniform(0.25, 0.75)))
        side = -side
        sp = place if subject.by == "pv" else subject.sp0 + side * STEP_SHARE * subject.span
        n = hold(subject, in_force.frozen(place), place)
        size = LOAD_SHARE * subject.span / subject.local(place).k
        load = size * float(rng.uniform(0.4, 1.0)) * (1 if rng.uniform() < 0.5 else -1) if index % 2 else None
        plan.append(Visit(place, sp, n, load, n // 2))
    noise = subject.noise * rng.standard_normal(sum(visit.n for visit in plan))
    return run(subject, in_force, plan, noise, lag_s)


def hold(subject: Subject, gains: PidGains, place: float) -> int:
    """Samples of a visit."""
    local = subject.local(place)
    closed = abs(gains.kp / gains.ki) + abs(1 / (local.k * gains.ki))
    return int(min(max(HOLD_THETA * Judge.theta(local), HOLD_CLOSED * closed) / subject.dt_s, MOST_SAMPLES))


def walk(truth: Truth, rng: np.random.Generator, count: int) -> list[Visit]:
    """A fresh walk of so many visits, up to a fifth of the range at a time, each with a load in its middle."""
    subject = truth.subject
    span = subject.high - subject.low
    low, high = subject.low + span / 20, subject.high - span / 20
    place = float(rng.uniform(low, high))
    visits: list[Visit] = []
    side = 1.0
    while len(visits) < count:
        there = place + float(rng.uniform(0.04, 0.2)) * span * float(rng.choice([-1, 1]))
        if not low <= there <= high:
            continue
        place, side = there, -side
        sp = place if subject.by == "pv" else subject.sp0 + side * STEP_SHARE * subject.span
        n = int(min(2 * HOLD_THETA * Judge.theta(subject.local(place)) / subject.dt_s, MOST_SAMPLES))
        load = LOAD_SHARE * subject.span / subject.local(place).k * float(rng.uniform(-1, 1))
        visits.append(Visit(place, sp, n, load, n // 2))
    return visits


# ---- Processes that are drawn: gain, lags and dead time over the range as smooth curves, with a kink, or constant.
#
# Each of the three changes by a factor over the range 0 to 100, up or down. Shapes of its logarithm, from 0 to 1:
#
# ramp      the place itself                      sigmoid   most of the change in the middle third
# hump      up and down again                     kink      nothing up to a place, then all of it

SMOOTH = ("ramp", "sigmoid", "hump")
NOISE = 0.1
POINTS = 400  # Points of the tabled resting output


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
