"""What an experiment on demand does, and when it has seen enough: pure step functions and their settings.

    step       co = co0 + amplitude until pv has come to rest again, or has gone far enough to show a ramp
    relay      co = co0 + (1 + bias) amplitude while pv is too low, co0 - (1 - bias) amplitude while it is too high,
               switched where pv leaves the reference by more than the hysteresis
    setpoint   sp = sp0 + amplitude under proportional control until pv has come to rest, or swings on; with a hold
               under the gains in force: out for so long and back for as long, whatever else moves pv
    valve      co in manual by one move after the other, each held as long (valve_test.py)

The hysteresis is three standard deviations of the noise seen at rest unless it is given: noise alone then switches the
relay about once in a thousand samples near the reference (Astrom & Hagglund 1995, section 3.6).
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, LoopSample
from retuner.schedule.late_dataclass import dataclass, replace

HYSTERESIS_STD = 3.0  # hysteresis in standard deviations of the noise
REST_DRIFT = 0.005
"""pv is at rest when its trend over the watch moves it by less than this share of the band, or than noise explains."""
TREND_STD = 4.0  # A trend within this many of its standard deviations is noise
SETTLED_SHARE, SWING_SHARE = 0.06, 0.15
"""A response has come to rest when the last part of it surely moves by less than the first share of the whole and
does not swing by more than the second."""
SURE_STD = 2.0  # Surely: the trend and this many of its standard deviations together
TURN_SHARE = 0.02  # A turn is a move back by this share of the range, or by what noise cannot be
STEP_PART, SWUNG_PART, SMOOTH_PART = 0.33, 0.5, 0.67
"""Shares of a step's response; of a setpoint response that has swung once; and of one that has not, because a peak
looks flat from near.
"""
ENOUGH_OF_BAND = 0.6  # A response that has gone this share of the way to the edge of the band has shown its slope
SWUNG, TURNS = 2, 5
"""A swing has turned back this often when peak and undershoot have been seen, and when it need not die down at all."""
SHORTEST_WATCH = 20  # samples before a response may count as come to rest


class Experiment(StrEnum):
    """The experiments under the names of the command line."""

    STEP = "step"
    SETPOINT = "setpoint"
    RELAY = "relay"
    VALVE = "valve"


HELD = (Experiment.SETPOINT, Experiment.VALVE)  # experiments that may hold what they do for a time


@dataclass(frozen=True, slots=True)
class Plan:
    """Settings of an experiment on demand.

    kind : which. amplitude : co percent for step, relay and valve (negative: step down), pv units for setpoint.
    pv_low, pv_high : band that pv must not leave. deviation : how far from rest it may go, pv units.
    co_low, co_high : range of the output, percent. time_s : longest duration of the excitation.
    rest_samples : samples for which the loop is watched before anything is touched; 10 to 10000.
    rest_time_s : how long to wait for rest.
    cycles : full waves of the relay that count; the first is left out; 2 to 50.
    bias : asymmetry of the relay, 0 (symmetric) to 0.8. hysteresis : pv units, None from the noise.
    kc0 : proportional gain of the setpoint experiment, None for that in force. hold_s : how long the setpoint is out,
    and then back, under the gains in force; 0: the experiment under proportional control. For a valve: how long each
    level is held. moves : of a valve test, in amplitudes; together 0.

    Raises ValueError: a setting is out of its range (named).
    """

    kind: Experiment
    amplitude: float
    pv_low: float
    pv_high: float
    co_low: float = 0.0
    co_high: float = 100.0
    time_s: float = 3600.0
    rest_samples: int = 30
    rest_time_s: float = 600.0
    cycles: int = 4
    bias: float = 0.0
    hysteresis: float | None = None
    kc0: float | None = None
    deviation: float = math.inf
    hold_s: float = 0.0
    moves: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("amplitude", "pv_low", "pv_high", "time_s", "rest_time_s"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)} is not a finite number")
        for name, low, high in (("cycles", 2, 50), ("rest_samples", 10, 10000), ("bias", 0.0, 0.8)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}: give {low} to {high}")
        if self.amplitude == 0 or (self.kind == Experiment.RELAY and self.amplitude < 0):
            raise ValueError(f"amplitude = {self.amplitude}: give a number other than 0, positive for a relay")
        if not self.pv_low < self.pv_high:
            raise ValueError(f"pv band {self.pv_low:g} to {self.pv_high:g}: the lower end must be below the upper")
        # settings with one limit, and whether they break it
        hysteresis, kc0 = self.hysteresis, self.kc0
        for name, wrong in (
            ("time_s", self.time_s <= 0),
            ("rest_time_s", self.rest_time_s < 0),
            ("deviation", not self.deviation > 0),
            ("hysteresis", hysteresis is not None and not 0 <= hysteresis < math.inf),
            ("kc0", kc0 is not None and not 0 < abs(kc0) < math.inf),
            ("hold_s", not 0 <= self.hold_s < math.inf or (self.hold_s > 0 and self.kind not in HELD)),
            ("moves", bool(self.moves) != (self.kind == Experiment.VALVE) or sum(self.moves) != 0),
            ("hold_s", self.kind == Experiment.VALVE and self.hold_s == 0),
        ):
            if wrong:
                raise ValueError(f"{name} = {getattr(self, name)} is out of its range")

    def co_of_hold(self, hold: int) -> float:
        """How far a valve test is from co at rest in its hold of this number, the first 0; percent."""
        return self.amplitude * sum(self.moves[: hold + 1])

    def about(self, pv_rest: float) -> "Plan":
        """The plan with its band no wider than the deviation from this pv."""
        if not self.pv_low < pv_rest < self.pv_high:
            return self
        low, high = max(self.pv_low, pv_rest - self.deviation), min(self.pv_high, pv_rest + self.deviation)
        return replace(self, pv_low=low, pv_high=high)

    def co_levels(self, co0: float) -> tuple[float, float]:
        """Lowest and highest output of the experiment about co0."""
        if self.kind == Experiment.STEP:
            return min(co0, co0 + self.amplitude), max(co0, co0 + self.amplitude)
        if self.kind == Experiment.VALVE:
            levels = [co0 + self.co_of_hold(hold) for hold in range(len(self.moves))]
            return min(levels), max(levels)
        if self.kind == Experiment.RELAY:
            return co0 - (1 - self.bias) * self.amplitude, co0 + (1 + self.bias) * self.amplitude
        return co0, co0


class LoopAtRest(NamedTuple):
    """The loop at rest: mean pv and co, noise of pv, and the hysteresis that follows."""

    pv: float
    co: float
    sigma: float
    hysteresis: float


def at_rest(plan: Plan, samples: list[LoopSample]) -> LoopAtRest | None:
    """What the last rest_samples show, or None while the loop moves."""
    if len(samples) < plan.rest_samples:
        return None
    watched = samples[-plan.rest_samples :]
    if len({(s.sp, s.mode) for s in watched}) > 1:
        return None
    pv = np.array([s.pv for s in watched])
    n = len(pv)
    sigma = noise_sigma(pv)
    moved = abs(float(np.polyfit(np.linspace(-0.5, 0.5, n), pv, 1)[0]))
    band = min(plan.pv_high - plan.pv_low, 2 * plan.deviation)
    waits = not plan.hold_s or plan.kind == Experiment.VALVE
    if waits and moved > max(REST_DRIFT * band, TREND_STD * sigma * math.sqrt(12 / n)):
        return None
    hysteresis = HYSTERESIS_STD * sigma if plan.hysteresis is None else plan.hysteresis
    return LoopAtRest(float(np.mean(pv)), float(np.mean([s.co for s in watched])), sigma, hysteresis)


class RelayState(NamedTuple):
    """The relay: whether it stands at its upper level, and how often it has switched; of a valve test, the hold."""

    high: bool
    switches: int


def relay_start() -> RelayState:
    """It begins upwards: pv rests at the reference."""
    return RelayState(high=True, switches=0)


def relay_step(state: RelayState, pv: float, rest: LoopAtRest, direction: int) -> RelayState:
    """Switch or stay; direction is -1 for a process whose pv falls with co."""
    low_by = (rest.pv - pv) * direction
    high = True if low_by > rest.hysteresis else False if low_by < -rest.hysteresis else state.high
    return RelayState(high, state.switches + (high != state.high))


def relay_output(plan: Plan, state: RelayState, rest: LoopAtRest) -> float:
    """co of the relay in percent."""
    low, high = plan.co_levels(rest.co)
    return high if state.high else low


def enough(plan: Plan, samples: list[LoopSample], rest: LoopAtRest, relay: RelayState) -> bool:
    """Whether the samples since the excitation began show what the experiment is for."""
    if plan.kind == Experiment.RELAY:
        return relay.switches >= 2 * plan.cycles + 3
    if plan.hold_s:
        return bool(samples) and samples[-1].t_s - samples[0].t_s >= (len(plan.moves) or 2) * plan.hold_s
    pv = np.array([s.pv for s in samples])
    if len(pv) < SHORTEST_WATCH:
        return False
    if plan.kind == Experiment.SETPOINT:
        # How often a signal has turned back by more than the noise
        y = pv - rest.pv
        turns, extreme, rising = 0, float(y[0]), True
        clear = max(2 * TREND_STD * rest.sigma, TURN_SHARE * float(np.ptp(y)))
        for value in y if float(y[-1]) > 0 else -y:
            if (value > extreme) == rising:
                extreme = float(value)
            elif abs(float(value) - extreme) > clear:
                turns, extreme, rising = turns + 1, float(value), not rising
        return turns >= TURNS or _come_to_rest(pv, rest, SWUNG_PART if turns >= SWUNG else SMOOTH_PART)
    room = plan.pv_high - rest.pv if pv[-1] > rest.pv else rest.pv - plan.pv_low
    far = abs(float(pv[-1]) - rest.pv) > ENOUGH_OF_BAND * room
    return far or _come_to_rest(pv, rest, STEP_PART)


def _come_to_rest(pv: FloatArray, rest: LoopAtRest, part: float) -> bool:
    """Whether this last part is flat, after a clear move."""
    last = pv[-int(part * len(pv)) :]
    moved = abs(float(np.mean(last)) - rest.pv)
    if moved <= 2 * TREND_STD * rest.sigma:
        return False
    trend = abs(float(np.polyfit(np.linspace(-0.5, 0.5, len(last)), last, 1)[0]))
    surely = trend + SURE_STD * rest.sigma * math.sqrt(12 / len(last))
    return surely < SETTLED_SHARE * moved and float(np.ptp(last)) < SWING_SHARE * moved + 2 * TREND_STD * rest.sigma


# Reading levels, crossings and peaks off a record that is noisy: what the graphical methods do with ruler and eye.


CLEAR_MOVE_STDS = 4.0
"""A move of this many standard deviations of the noise is one; 1 in 16000 samples of noise alone is further out."""
SMOOTHED = 0.02  # A smoothed record's noise is brought down to this share of the move that is looked for


def crossing(t_s: FloatArray, values: FloatArray, level: float, rising: bool) -> float:
    """When a signal passes a level: the middle between its first and its last crossing, each interpolated.

    t_s, values : shape (n,). rising : from below to above; else from above to below.

    Raises ValueError: it never does.
    """
    above = values >= level if rising else values <= level
    ups = np.flatnonzero(~above[:-1] & above[1:])
    if above[0]:
        return float(t_s[0])
    if not ups.size:
        raise ValueError(f"pv never passes {level:g}")
    first, last = int(ups[0]), int(ups[-1])
    return (_between(t_s, values, level, first) + _between(t_s, values, level, last)) / 2


def _between(t_s: FloatArray, values: FloatArray, level: float, i: int) -> float:
    """Linear interpolation of the crossing between samples i and i + 1."""
    share = (level - values[i]) / (values[i + 1] - values[i])
    return float(t_s[i] + share * (t_s[i + 1] - t_s[i]))


def smoothed(values: FloatArray, move: float) -> tuple[FloatArray, float]:
    """The record with its noise averaged away over just enough samples (centred), and the noise that is left.

    move : the change that is looked for, in the unit of values. At most a twentieth of the record is averaged over.
    """
    sigma = noise_sigma(values)
    if sigma == 0 or move == 0:
        return values, sigma
    wanted = (sigma / (SMOOTHED * abs(move))) ** 2
    half = int(min(math.ceil(wanted), len(values) // 20)) // 2
    if half < 1:
        return values, sigma
    n = 2 * half + 1
    padded = np.concatenate([np.full(half, values[0]), values, np.full(half, values[-1])])
    return np.convolve(padded, np.full(n, 1 / n), mode="valid"), sigma / math.sqrt(n)


def peak(t_s: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Time and value of the largest value, by a parabola through it and its neighbours."""
    i = int(np.argmax(values))
    if i in {0, len(values) - 1}:
        return float(t_s[i]), float(values[i])
    a, b, c = (float(values[j]) for j in (i - 1, i, i + 1))
    bend = a - 2 * b + c
    shift = 0.5 * (a - c) / bend if bend else 0.0
    step = float(t_s[i + 1] - t_s[i - 1]) / 2
    return float(t_s[i]) + shift * step, b - 0.25 * (a - c) * shift
