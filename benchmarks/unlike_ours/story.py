"""One loop with all that happens to it: the process, its controller, noise, disturbances, people."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from retuner import GainTable, PidGains, Regions
from unlike_ours.controllers import Options, Setup
from unlike_ours.process import Array, Curved, Flow, Linear, exothermic, poly, tank
from unlike_ours.truth import Truth, Tuned

Rng = np.random.Generator
Noise = Callable[[Rng, int], Array]
DISTURBANCES = ("sp", "load", "ramp", "slope", "pulse")
EVENTS = 8  # Disturbances of each loop


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
        """Span of pv."""
        return self.pv_range[1] - self.pv_range[0]

    @property
    def co_start(self) -> float:
        """The output that holds the start."""
        if isinstance(self.process, Linear):
            return sum(self.co_range) / 2
        return self.process.rest(self.start_pv)

    def factor(self, t: float) -> float:
        """Factor of the process gain at a time."""
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
            low, high = (320.0, 355.0) if story.name == "exothermic" else story.pv_range
            rim = 0.0 if story.name == "exothermic" else 0.12 * story.span
            way = way if low + rim < sp + way * wide < high - rim else -way
            story.events.append(Event(t, kind, way * wide, over))
            sp += way * wide
        else:
            story.events.append(Event(t, kind, way * wide * load_of_step(story.truth), over))
        pause = float(rng.choice([8, 15, 25, 40, 70]) if story.name == "hasty" else rng.uniform(40, 90))
        t += pause * scale * (0.25 if i and rng.uniform() < 0.15 else 1.0)
    story.length = t + 30 * scale


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


# ---- The stories, drawn: each unlike the other benchmarks in something that those hold fixed.
#
# inverse, ringing, high, integrating, dead, runaway, overshooting, two_speeds    processes: see the functions
# few_samples, many_samples    2 or 3, and 30 to 60 samples to an effective dead time; 4 to 25 in the others
# noisy, coloured, quantised, noise_changes    2 to 5 % of a step, AR(1), a sensor in steps, noise that grows by 6 and 3
# forms, derivative, weights, rates    a controller of another make: ideal or series form with 3 digits; PID with a
#     filter; setpoint weight; output rate, dead band, rounded output
# valve_lag, ms, hours, ramps, hasty    a lag in the actuator; other units of time; ramps of setpoint and load;
#     disturbances that come before the last has settled
# valve_curve, ph, tank, exothermic, two_loops    nonlinear plants, and a partner loop
# drift_slow, drift_fast, operator, restarts, bad_link    a gain that changes by 2 to 3; people; memory; lost samples
# right    a loop that begins with the reference's gains


def log(rng: Rng, low: float, high: float) -> float:
    """Evenly in the logarithm."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


# Processes in units of their dead time, gain 1.


def lagging(rng: Rng) -> Linear:
    return Linear((1.0,), (1.0, log(rng, 0.3, 12.0)), 1.0)


def inverse(rng: Rng) -> Linear:
    t = log(rng, 1.5, 6.0)
    dens = poly((1, t), (1, t * float(rng.uniform(0.3, 1))))
    return Linear((1.0, -float(rng.uniform(0.4, 1.5))), dens, float(rng.uniform(0.2, 1)))


def ringing(rng: Rng) -> Linear:
    """Complex poles, zeta 0.15 to 0.7."""
    zeta, t = float(rng.uniform(0.15, 0.7)), log(rng, 0.7, 4.0)
    return Linear((1.0,), (1.0, 2 * zeta * t, t * t), float(rng.uniform(0.3, 1.2)))


def high(rng: Rng) -> Linear:
    """Four to eight lags."""
    n, a = int(rng.integers(4, 9)), float(rng.uniform(0.5, 1.0))
    return Linear((1.0,), poly(*((1.0, a**i) for i in range(n))), 0.05)


def integrating(rng: Rng) -> Linear:
    return Linear((0.3,), poly((0.0, 1.0), (1.0, log(rng, 0.2, 6.0))), float(rng.uniform(0.3, 1.0)))


def dead(rng: Rng) -> Linear:
    """Almost pure dead time."""
    return Linear((1.0,), (1.0, log(rng, 0.03, 0.25)), 1.0)


def runaway(rng: Rng) -> Linear:
    """An unstable pole."""
    return Linear((1.0,), poly((-1.0, log(rng, 5.0, 15.0)), (1.0, 0.2)), float(rng.uniform(0.4, 1.0)))


def overshooting(rng: Rng) -> Linear:
    """A zero in the left half plane: an open-loop step overshoots."""
    t = log(rng, 2.0, 8.0)
    dens = poly((1, t), (1, log(rng, 1.0, 3.0)), (1, 0.3))
    return Linear((1.0, t * float(rng.uniform(1.2, 3.0))), dens, float(rng.uniform(0.5, 1.0)))


def two_speeds(rng: Rng) -> Linear:
    """A fast and a slow part side by side."""
    slow, share = log(rng, 10.0, 30.0), float(rng.uniform(0.3, 0.6))
    return Linear((1.0, (1 - share) * slow + share * 1.5), poly((1, 1.5), (1, slow)), 1.0)


MAKERS: dict[str, Callable[[Rng], Linear]] = {
    made.__name__: made for made in (inverse, ringing, high, integrating, dead, runaway, overshooting, two_speeds)
}
PLAIN = ("high", "integrating", "inverse", "ringing")
FOREIGN = ("forms", "derivative", "rates", "noisy", "hasty")
FLOWS = ("tank", "exothermic")
SCHEDULED = ("tank", "ph")
NAMES = (
    *MAKERS, "few_samples", "many_samples", "noisy", "coloured", "quantised", "noise_changes", "forms", "derivative",
    "weights", "rates", "valve_lag", "ms", "hours", "ramps", "hasty", "valve_curve", "ph", *FLOWS, "two_loops",
    "drift_slow", "drift_fast", "operator", "restarts", "bad_link", "right",
)  # fmt: skip
CO_RANGES = ((0.0, 100.0), (4.0, 20.0), (-10.0, 10.0), (0.0, 1.0))


def white(sigma: float) -> Noise:
    return lambda rng, n: sigma * rng.standard_normal(n)


def even(sigma: float) -> Noise:
    return lambda rng, n: sigma * math.sqrt(3.0) * rng.uniform(-1, 1, n)


def coloured(sigma: float, phi: float) -> Noise:
    """AR(1)."""

    def made(rng: Rng, n: int) -> Array:
        shocks, out, x = rng.standard_normal(n), np.empty(n), 0.0
        for i in range(n):
            x = phi * x + shocks[i]
            out[i] = x
        return sigma * math.sqrt(1 - phi * phi) * out

    return made


def changing(sigma: float) -> Noise:
    def made(rng: Rng, n: int) -> Array:
        size = np.ones(n)
        size[n // 3 : n // 2], size[3 * n // 4 :] = 6.0, 3.0
        return sigma * size * rng.standard_normal(n)

    return made


def draw(name: str, seed: int, index: int) -> Story:
    rng = np.random.default_rng([seed, NAMES.index(name), index])
    unit = {"ms": 1e-3 * log(rng, 2, 50), "hours": 3600 * log(rng, 0.5, 4)}.get(name, log(rng, 0.5, 300))
    per_dead = {"few_samples": (2, 4), "many_samples": (30, 61)}.get(name, (4, 26))
    n = int(rng.integers(*per_dead))
    # Process, ranges and sampling; the rest is not known yet
    if name in FLOWS:
        pv_range, co_range = ((0.0, 100.0),) * 2 if name == "tank" else ((300.0, 370.0), (200.0, 400.0))
        start = float(rng.uniform(25, 70) if name == "tank" else rng.uniform(325, 345))
        plant: Linear | Curved | Flow = (tank if name == "tank" else exothermic)(unit * 10)
    else:
        low, span = float(rng.choice([0, 0, -1, 20, 300])), log(rng, 0.5, 2000)
        pv_range, co_range = (low, low + span), CO_RANGES[int(rng.integers(4))]
        start = low + span * float(rng.uniform(0.35, 0.65))
        usual = lagging if rng.uniform() < 0.6 or name in {"valve_curve", "ph"} else MAKERS[str(rng.choice(PLAIN))]
        base = MAKERS.get(name, usual)(rng).lagged(float(rng.uniform(0.1, 0.6)) if name == "valve_lag" else 0.0)
        spans = (pv_range[1] - pv_range[0]) / (co_range[1] - co_range[0])
        size = log(rng, 0.7, 2.5) * spans * float(rng.choice([1, 1, 1, -1]))
        slow = base.slowed(unit)
        plant = curved(name, rng, slow, pv_range, co_range) if name in {"valve_curve", "ph"} else slow.times(size)
    local = plant if isinstance(plant, Linear) else plant.local(start)
    dt = Truth(local, unit / n).scale / n
    sub = max(1, min(4, round(12 / n)))
    plant = rounded(plant, dt / sub)
    truth = Truth(plant if isinstance(plant, Linear) else plant.local(start), dt)
    gains = PidGains(truth.best.kp, truth.best.ki)
    story = Story(name, plant, truth, dt, sub, pv_range, co_range, start, gains, white(0.0))
    step = 0.02 + 0.08 * float(rng.uniform())
    story.noise = _noise(rng, name, step * story.span)
    if name == "quantised":
        story.resolution = log(rng, 0.02, 0.2) * step * story.span
    _controller(rng, story)
    if name == "bad_link":
        story.jitter, story.lost = 0.3, 0.15
    if name.startswith("drift"):
        story.drift = log(rng, 2, 3) ** float(rng.choice([-1, 1]))
    disturbances(rng, story, step)
    people(rng, story)
    if name == "two_loops":
        story.partner = _partner(rng, story, unit)
    return story


def curved(name: str, rng: Rng, linear: Linear, pv_range: tuple[float, float], co_range: tuple[float, float]) -> Curved:
    """A valve of equal percentage before a lag, or a titration curve behind it."""
    (low, top), (closed, full) = pv_range, co_range
    r, steep = float(rng.uniform(8, 30)), float(rng.uniform(2.0, 4.0))

    def share(u: float) -> float:
        return (min(max(u, closed), full) - closed) / (full - closed)

    if name == "valve_curve":
        return Curved(linear, lambda u: (r ** share(u) - 1) / (r - 1), lambda v: low + (top - low) * v, co_range)
    most = math.tanh(steep / 2)

    def behind(v: float) -> float:
        return low + (top - low) * (0.5 + 0.5 * math.tanh(steep * (v - 0.5)) / most)

    return Curved(linear, share, behind, co_range)


def rounded(plant: Linear | Curved | Flow, h: float) -> Linear | Curved | Flow:
    if isinstance(plant, Curved):
        return replace(plant, linear=replace(plant.linear, theta=round(plant.linear.theta / h) * h))
    return replace(plant, theta=round(plant.theta / h) * h)


def _noise(rng: Rng, name: str, step: float) -> Noise:
    """step : of the setpoint, pv units."""
    if name == "noisy":
        return (white if rng.uniform() < 0.5 else even)(step * float(rng.uniform(0.02, 0.05)))
    if name == "coloured":
        return coloured(step * log(rng, 0.005, 0.03), float(rng.uniform(0.5, 0.95)))
    return changing(0.005 * step) if name == "noise_changes" else white(step * log(rng, 0.001, 0.02))


def _controller(rng: Rng, story: Story) -> None:
    """Its gains at the start, and of which make it is."""
    name, scale, co_span = story.name, story.truth.scale, story.co_range[1] - story.co_range[0]
    kc, ti = _begin(rng, name, story.truth)
    kd = kc * min(0.4 * scale, ti / 4.5) if name == "derivative" else 0.0
    story.gains = PidGains(kc, kc / ti, kd)
    story.own = name in FOREIGN or (name not in {*FLOWS, "ph"} and rng.uniform() < 0.3)
    form = str(rng.choice(["ideal", "series", "parallel"]))
    rough, dull = float(rng.uniform() < 0.5), float(rng.uniform() < 0.5)
    made = {
        "forms": Options(form, digits=3),
        "derivative": Options(form, digits=4, tau_f=0.1 * scale, on_error=rough > 0),
        "weights": Options(b=float(rng.choice([0.0, 0.3, 0.7]))),
        "rates": Options(
            rate=0.15 * co_span / scale, dead_band=dull * 0.002 * story.span, co_step=rough * 0.002 * co_span
        ),
    }
    story.options = made.get(name, Options())
    if name in SCHEDULED:
        story.bounds = tuple(story.pv_range[0] + story.span * share for share in (0.35, 0.65))


def _begin(rng: Rng, name: str, truth: Truth) -> tuple[float, float]:
    """Kc and tau_I: the reference's, or off by 1.5 to 4, stable and out of specification."""
    best = truth.best
    for _ in range(0 if name == "right" else 40):
        kc = best.kp * float(rng.choice([1 / 4, 1 / 3, 1 / 2, 1.5, 2.0, 2.5]))
        ti = best.kp / best.ki * float(rng.choice([1 / 3, 1 / 2, 1.0, 2.0, 4.0]))
        tuned = Tuned(kc, kc / ti)
        if truth.ms(tuned) < 12 and not truth.in_spec(tuned):
            return kc, ti
    return best.kp, best.kp / best.ki


def _partner(rng: Rng, story: Story, unit: float) -> Partner:
    """A second loop, its gains 0.6 of its reference's."""
    local = story.truth.plain
    k, h = local.num[0] / (local.den[0] or 1.0), story.dt / story.sub

    def part(share: float) -> Linear:
        return Linear((k * share,), (1.0, unit * log(rng, 1, 6)), round(unit * float(rng.uniform(0.2, 1)) / h) * h)

    own = part(1.0)
    best = Truth(own, story.dt).best
    tuned = Tuned(best.kp * 0.6, best.ki * 0.6)
    return Partner(part(float(rng.uniform(0.2, 0.45))), part(float(rng.uniform(-0.45, 0.45))), own, tuned)
