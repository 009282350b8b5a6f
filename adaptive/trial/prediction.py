"""What a change promises: damping, IAE and control effort with the new gains, and with the old ones beside them.

    spread = (on the best model, least, greatest) over the models that the records still allow

per unit of a setpoint step, and of a load at the process input. A load's size is never known, but the integral takes it
over: |load| = |ki integral e dt| (Astrom & Hagglund, Advanced PID Control, 2006, section 4.3). So the IAE of a load per
unit of it can be promised and measured, and is 1/ki where nothing swings. The decay of a load's response is promised
over a step and a pulse of it, because either may come.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.trial.batch_responses import ClosedLoop, Upset
from retuner.adaptive.trial.response_numbers import ResponseNumbers, shapes, swing
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

MOST_MODELS = 16  # Models, the most likely ones, over which a promise is spread
UPSETS = (Upset(setpoint=1.0), Upset(load_step=1.0), Upset(pulse=1.0))
NAMES = ("overshoot", "damping", "decay", "iae", "travel", "settle_s")
MOST_DECAY = 0.95  # A promise that rests on a response alone never promises less than this
SWINGS = 2.0
"""IAE over integrated error of a load's response that swings, for a promise without a model (1 where it does not)."""


@dataclass(frozen=True, slots=True)
class Spread:
    """A number on the best model, its least and greatest over all allowed ones; infinite where a loop never rests.

    Raises ValueError: a number is NaN, or best does not lie between low and high.
    """

    best: float
    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= self.best <= self.high:
            raise ValueError(f"spread {self.low}..{self.high} round {self.best}: give low <= best <= high")

    @classmethod
    def over(cls, values: Sequence[float]) -> "Spread":
        """The spread of values, the best model's first."""
        return cls(values[0], min(values), max(values))

    def to_list(self) -> list[float | None]:
        """best, low, high; null where infinite."""
        return [value if math.isfinite(value) else None for value in (self.best, self.low, self.high)]

    @classmethod
    def from_list(cls, values: Sequence[float | None]) -> "Spread":
        """The spread from its plain form."""
        best, low, high = (math.inf if value is None else float(value) for value in values)
        return cls(best, low, high)


@dataclass(frozen=True, slots=True)
class Expected:
    """One set of gains under one kind of upset: see response_numbers.py for the numbers and their units."""

    overshoot: Spread
    damping: Spread
    decay: Spread
    iae: Spread
    travel: Spread
    settle_s: Spread

    @classmethod
    def over(cls, shapes: Sequence[ResponseNumbers]) -> "Expected":
        """What is expected over the allowed models, the best one first."""
        return cls(*(Spread.over([getattr(shape, name) for shape in shapes]) for name in NAMES))

    def to_dict(self) -> dict[str, list[float | None]]:
        """Each number as [best, low, high]."""
        return {name: getattr(self, name).to_list() for name in NAMES}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Expected":
        """The numbers from their plain form."""
        return cls(*(Spread.from_list(body[name]) for name in NAMES))


@dataclass(frozen=True, slots=True)
class Prediction:
    """New and old gains under a setpoint step and under a load.

    models : how many models it is spread over. ms : of the new set; None for a promise without a model.
    decay_seen : of the response under the old gains that led to the change, None when it does not tell; what was seen
    counts more than what a model says of the old gains.
    wander, moved : standard deviation of the error under the old gains while nothing happened, and how far it went
    (load_variability.py), pv units; 0 where it is not known, or where they were seen to swing. furthest : the largest
    error under them that is kept, pv units; infinite where it is not known.
    """

    setpoint: Expected
    load_step: Expected
    setpoint_before: Expected
    load_before: Expected
    models: int
    decay_seen: float | None = None
    ms: Spread | None = None
    wander: float = 0.0
    moved: float = 0.0
    furthest: float = math.inf

    def decay_before(self, setpoint: bool) -> float:
        """Decay under the old gains: as seen, else on the best model."""
        then = self.setpoint_before if setpoint else self.load_before
        return then.decay.best if self.decay_seen is None else self.decay_seen

    @property
    def unstable_before(self) -> bool:
        """Whether the best model of the proof called the old gains unstable, and the new ones not."""
        if not self.models:
            return False
        old, new = (self.setpoint_before, self.load_before), (self.setpoint, self.load_step)
        return any(math.isinf(one.iae.best) for one in old) and all(math.isfinite(one.iae.best) for one in new)

    @property
    def patience_s(self) -> float:
        """Longest that a response should take until it has settled, s; infinite where a loop may never."""
        return max(self.setpoint.settle_s.high, self.load_step.settle_s.high)

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        names = "setpoint load=load_step setpoint_before load_before models decay_seen"
        spread = {"ms": self.ms.to_list() if self.ms else None}
        return plain_values(self, names) | spread | plain_values(self, "wander moved furthest")

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Prediction":
        """The numbers from their plain form."""
        keys = ("setpoint", "load", "setpoint_before", "load_before")
        setpoint, load, setpoint_before, load_before = (Expected.from_dict(body[key]) for key in keys)
        seen, ms, furthest = body["decay_seen"], body["ms"], body.get("furthest")
        told = None if seen is None else float(seen), None if ms is None else Spread.from_list(ms)
        moved = float(body.get("wander", 0.0)), float(body.get("moved", 0.0))
        farthest = math.inf if furthest is None else float(furthest)
        return cls(setpoint, load, setpoint_before, load_before, int(body["models"]), *told, *moved, farthest)


def predict(
    allowed: Iterable[Plausible],
    old: PidGains,
    new: PidGains,
    sample_time_s: float = 0.0,
    b: float = 1.0,
    tau_f_s: float = 0.0,
) -> Prediction:
    """What `new` promises against `old`.

    allowed : the models that the records allow, the best one first. sample_time_s : of the controller.
    b, tau_f_s : setpoint weight of the controller, and its derivative's filter time in seconds.

    Raises ValueError: no model is given.
    """
    models = sorted(allowed, key=lambda found: found.excess)[:MOST_MODELS]  # stable: the best one stays first
    if not models:
        raise ValueError("a prediction needs at least one model")
    sampled = [found.model.seen_by_controller(sample_time_s).linear() for found in models]
    loops = [ClosedLoop(process, gains, b, tau_f_s) for gains in (new, old) for process in sampled]
    found, n = shapes(loops, UPSETS), len(models)
    now, then = found[:n], found[n:]
    ms = Spread.over([sensitivity_peak(process, new, tau_f_s) for process in sampled])
    steps, steps_before = (Expected.over([row[0] for row in rows]) for rows in (now, then))
    return Prediction(steps, _load(now), steps_before, _load(then), n, ms=ms)


def decay_seen(response: Response | None) -> float | None:
    """Decay of a response that went its whole way and has a second peak; None for any other."""
    if response is None or len(response.peaks) < 2 or response.ending not in {Ending.COMPLETE, Ending.QUIET}:
        return None
    return swing([peak.e for peak in response.peaks], response.band)[2]


def predict_without_model(seen: Response, old: PidGains, new: PidGains) -> Prediction:
    """The prediction of a change that rests on a response's pattern alone: no worse than what was seen.

    The IAE of a load needs no model (1/ki); that of a setpoint step is left open.
    """
    overshoot, damping, before = swing([peak.e for peak in seen.peaks], seen.band)
    decay = min(before, MOST_DECAY)
    length, left_open = seen.t_end_s - seen.t_start_s, Spread(math.inf, 0.0, math.inf)
    first, second = (Spread(one, min(one, 0.0), max(one, 0.0)) for one in (overshoot, damping))
    setpoint = Expected(first, second, Spread(decay, 0.0, decay), left_open, left_open, Spread(length, 0.0, math.inf))
    least = [1 / abs(gains.ki) if gains.ki else math.inf for gains in (new, old)]
    load, load_before = (replace(setpoint, iae=Spread(one, one, SWINGS * one)) for one in least)
    return Prediction(setpoint, load, setpoint, load_before, 0, decay_seen(seen))


def _load(shapes: Sequence[Sequence[ResponseNumbers]]) -> Expected:
    """What is expected over the models under a load step; a pulse may swing more."""
    found = Expected.over([row[1] for row in shapes])
    pulses = [row[2].decay for row in shapes]
    decay = found.decay
    return replace(found, decay=Spread(decay.best, min(decay.low, *pulses), max(decay.high, *pulses)))
