"""A loop under scheduled gains, a sample at a time: read pv, look up the gains, compute co, hold it.

A visit is a place, a setpoint, and a load from some sample on. Gains are taken over without a bump, as the controllers
of drivers/controller do. The scheduling variable is what is measured: pv with its noise, or the signal, and it may lag.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import change, law, start, step
from schedules.lookups import Lookup
from schedules.subject import Subject

LOST_SPANS = 3.0  # A loop whose pv is so many spans from its setpoint is lost


@dataclass(frozen=True, slots=True)
class Visit:
    """n samples towards one place. load : added to co from sample load_at on, until another is; None: as it was."""

    place: float
    sp: float
    n: int
    load: float | None = None
    load_at: int = 0


@dataclass
class Trace:
    """What happened, a value a sample. x : the scheduling variable. y : pv without noise. gains : in force."""

    dt_s: float
    sp: list[float] = field(default_factory=list)
    pv: list[float] = field(default_factory=list)
    co: list[float] = field(default_factory=list)
    x: list[float] = field(default_factory=list)
    y: list[float] = field(default_factory=list)
    gains: list[PidGains] = field(default_factory=list)
    lost: bool = False

    def add(self, sp: float, pv: float, co: float, x: float, y: float, gains: PidGains) -> None:
        """One sample."""
        self.sp.append(sp)
        self.pv.append(pv)
        self.co.append(co)
        self.x.append(x)
        self.y.append(y)
        self.gains.append(gains)

    def iae(self) -> float:
        """Integrated absolute error without noise; infinite for a lost loop."""
        if self.lost:
            return math.inf
        return sum(abs(sp - y) for sp, y in zip(self.sp, self.y, strict=True)) * self.dt_s


def run(subject: Subject, lookup: Lookup, visits: Sequence[Visit], noise: np.ndarray, lag_s: float = 0.0) -> Trace:
    """All visits from rest at the first. noise : a value a sample. lag_s : of the scheduling variable."""
    first = visits[0]
    dt_s, trace = subject.dt_s, Trace(subject.dt_s)
    plant, inside = subject.live(first.place), subject.by == "pv"
    y = subject.sp_at(first.place)
    x = first.place
    lookup.begin(x)
    limits = {"co_min": subject.co_min, "co_max": subject.co_max}
    rules = law(lookup.frozen(x), **limits)
    state: tuple[float, float, float, float, int] = tuple(start(rules, y, y, subject.rest(first.place)))
    follow = 1 - math.exp(-dt_s / lag_s) if lag_s else 1.0
    place, load, more = first.place, 0.0, iter(noise.tolist())
    for visit in visits:
        ramp = (visit.place - place) / max(visit.n // 10, 1)
        for i in range(visit.n):
            if not inside and i < max(visit.n // 10, 1):
                place += ramp
            pv = y + next(more)
            x += follow * ((pv if inside else place) - x)
            gains = lookup.gains(x, len(trace.pv) * dt_s)
            if gains != rules.gains:
                new = law(gains, **limits)
                state = tuple(change(rules, new, state, visit.sp, pv))
                rules = new
            state, co = step(rules, state, visit.sp, pv, dt_s)
            trace.add(visit.sp, pv, co, x, y, gains)
            load = visit.load if i == visit.load_at and visit.load is not None else load
            y = plant.move(co + load, place)
            if not abs(y - visit.sp) < LOST_SPANS * subject.span:
                trace.lost = True
                return trace
        place = visit.place
    return trace
