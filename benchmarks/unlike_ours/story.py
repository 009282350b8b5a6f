"""One loop with all that happens to it: the process, its controller, noise, disturbances, people."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from retuner import GainTable, PidGains, Regions
from unlike_ours.controllers import Options, Setup
from unlike_ours.process import Array, Curved, Flow, Linear
from unlike_ours.truth import Truth, Tuned

Rng = np.random.Generator
Noise = Callable[[Rng, int], Array]
DISTURBANCES = ("sp", "load", "ramp", "slope", "pulse")
EVENTS = 8
"""Disturbances of each loop."""


@dataclass(frozen=True)
class Event:
    """t : seconds. kind : a disturbance (a step of sp or load, a ramp of sp or slope of the load `over` seconds, a
    pulse of so many), or manual, edit, restart. size : pv units for sp, co units for loads, a factor for edit.
    """

    t: float
    kind: str
    size: float = 0.0
    over: float = 0.0


@dataclass(frozen=True)
class Partner:
    """Another loop that it acts on and that acts on it: processes from its output here, from here there, its own."""

    here: Linear
    there: Linear
    own: Linear
    tuned: Tuned


@dataclass
class Story:
    """One loop. times in seconds, sub : steps of the simulation a sample. drift : factor of the gain, from .. to."""

    name: str
    process: Linear | Curved | Flow
    truth: Truth
    dt: float
    sub: int
    pv_range: tuple[float, float]
    co_range: tuple[float, float]
    start_pv: float
    gains: PidGains
    noise: Noise
    events: list[Event] = field(default_factory=list)
    length: float = 0.0
    resolution: float = 0.0
    options: Options = field(default_factory=Options)
    own: bool = False
    jitter: float = 0.0
    lost: float = 0.0
    drift: float = 1.0
    drifts: tuple[float, float] = (0.0, 0.0)
    bounds: tuple[float, ...] = ()
    partner: Partner | None = None

    @property
    def span(self) -> float:
        """Of pv."""
        return self.pv_range[1] - self.pv_range[0]

    @property
    def co_start(self) -> float:
        """The output that holds the start."""
        if isinstance(self.process, Linear):
            return sum(self.co_range) / 2
        return self.process.rest(self.start_pv)

    def factor(self, t: float) -> float:
        """Of the process gain at a time."""
        begin, end = self.drifts
        return self.drift ** min(max((t - begin) / (end - begin), 0.0), 1.0) if end > begin else 1.0

    def setup(self) -> Setup:
        """What the user gives."""
        names = tuple(f"r{i + 1}" for i in range(len(self.bounds) + 1))
        edge = 0.01 * self.span if self.bounds else 0.0
        regions = Regions("sp", "-", names, self.pv_range[0], self.bounds, self.pv_range[1], edge)
        table = GainTable("loop", regions, (self.gains,) * len(names))
        return Setup(self.dt, self.pv_range, self.co_range, table, (self.start_pv, self.co_start), self.options)

    def tuned(self, gains: PidGains) -> Tuned:
        """The controller with these gains, for the truth."""
        return Tuned(gains.kp, gains.ki, gains.kd, self.options.tau_f, self.options.b)


def disturbances(rng: Rng, story: Story, size: float) -> None:
    """At irregular times, some before the last has settled. size : of a usual setpoint step, share of pv's range."""
    scale, t, sp = story.truth.scale, 25 * story.truth.scale, story.start_pv
    kinds = ["sp", "sp", "sp", "load", "load", "load", "pulse"]
    if story.name == "ramps":
        kinds = ["sp", "sp", "load", "load", "pulse", "slope", "ramp"]
    for i in range(EVENTS):
        kind, wide = str(rng.choice(kinds)), size * float(rng.uniform(0.5, 2.0)) * story.span
        way, over = float(rng.choice([-1, 1])), float(rng.uniform(3, 30)) * scale
        if kind in {"sp", "ramp"}:
            way = way if _inside(story, sp + way * wide) else -way
            story.events.append(Event(t, kind, way * wide, over))
            sp += way * wide
        else:
            story.events.append(Event(t, kind, way * wide * load_of_step(story.truth), over))
        pause = float(rng.choice([8, 15, 25, 40, 70]) if story.name == "hasty" else rng.uniform(40, 90))
        t += pause * scale * (0.25 if i and rng.uniform() < 0.15 else 1.0)
    story.length = t + 30 * scale


def _inside(story: Story, sp: float) -> bool:
    low, high = (320.0, 355.0) if story.name == "exothermic" else story.pv_range
    rim = 0.0 if story.name == "exothermic" else 0.12 * story.span
    return low + rim < sp < high - rim


def load_of_step(truth: Truth) -> float:
    """The load, in co units per pv unit, that moves pv about as much as a setpoint step does."""
    k = abs(truth.process.num[0]) / truth.process.den[0] if truth.process.den[0] > 0 else math.inf
    kp = abs(truth.best.kp)
    return min(0.7 * kp, 1.5 / k) if math.isfinite(k) else 0.5 * kp


def people(rng: Rng, story: Story) -> None:
    """What is done to it besides."""
    scale, length = story.truth.scale, story.length
    if story.name == "operator":
        for what in ("manual", "edit", "manual", "edit"):
            size, over = float(np.exp(rng.uniform(-0.5, 0.5))), float(rng.uniform(3, 25)) * scale
            story.events.append(Event(float(rng.uniform(0.2, 0.95)) * length, what, size, over))
    if story.name == "restarts":
        story.events += [Event(float(rng.uniform(0.05, 0.98)) * length, "restart") for _ in range(5)]
    if story.name == "drift_fast":
        story.drifts = (0.4 * length, 0.4 * length + 20 * scale)
    if story.name == "drift_slow":
        story.drifts = (0.1 * length, length)
    story.events.sort(key=lambda event: event.t)
