"""A place along the scheduling variable, and how likely a set of gains is in spec there.

At a place a set is in spec while Ms and J keep their limits. Along a shape (one tau_I) that is an interval of ln Kc,
worked out on the likeliest process. What is not known of a process is above all its ln Kc, so with its doubt s

    P(in spec) = Phi((high - ln Kc)/s) - Phi((low - ln Kc)/s)
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.region_model.region_advice import features
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.schedule_design.places import LEAST_STD, DesignLimits, iae
from retuner.schedule.gains import PidGains

MS_END = 2.1
"""Largest Ms where a set ends, the guard's own limit at a boundary (guard/settings.py)."""
OVER_OWN = 1.03
"""Times the Ms of a place's own settings that a set may have there, where these are over the limit themselves."""
KC_TRIED = 25
"""Gains that are tried of each shape."""
WIDEST = math.log(8.0)
"""Of the interval in which a gain keeps its limits, either way from the place's own."""
BISECTIONS = 12
J_BISECTIONS = 6


@dataclass(frozen=True)
class Spot:
    """A place x: the likeliest process there, and how well Kc is known.

    process : as the sampled controller sees it. ln_std : of ln Kc. own : SIMC's set. iae : of it, for a step of the
    setpoint and of the load.
    """

    x: float
    model: ProcessModel
    process: LinearProcess
    ln_std: float
    own: PidGains
    iae: tuple[float, float]
    sample_time_s: float
    limits: DesignLimits
    _asked: dict[float, tuple[float, float, float]] = field(default_factory=dict, repr=False, compare=False)

    def ms(self, gains: PidGains) -> float:
        """By the likeliest process."""
        return sensitivity_peak(self.process, gains)

    def interval(self, tau_i_s: float) -> tuple[float, float, float]:
        """ln |Kc| of this shape from which J is kept, up to which Ms is, and up to which Ms is that of an end."""
        if tau_i_s not in self._asked:
            limit = max(self.limits.ms, OVER_OWN * self.ms(self.own))
            high, end = (self._largest(tau_i_s, ms) for ms in (limit, max(MS_END, limit)))
            self._asked[tau_i_s] = (self._least(tau_i_s, high), high, end)
        return self._asked[tau_i_s]

    def chance(self, ln_kc: float, tau_i_s: float) -> float:
        """That a set is in spec here."""
        low, high, _ = self.interval(tau_i_s)
        return max(_normal((high - ln_kc) / self.ln_std) - _normal((low - ln_kc) / self.ln_std), 0.0)

    def _set(self, ln_kc: float, tau_i_s: float) -> PidGains:
        kc = math.copysign(math.exp(ln_kc), self.own.kp)
        return PidGains(kc, kc / tau_i_s, 0.0)

    def _largest(self, tau_i_s: float, ms: float) -> float:
        middle = math.log(abs(self.own.kp))
        return _border(lambda x: self.ms(self._set(x, tau_i_s)) <= ms, middle - WIDEST, middle + WIDEST, BISECTIONS)

    def _least(self, tau_i_s: float, high: float) -> float:
        """inf where J is not kept even at the largest gain."""
        if not self._is_fast(high, tau_i_s):
            return math.inf
        return -_border(lambda x: self._is_fast(-x, tau_i_s), -high, WIDEST - high, J_BISECTIONS)

    def _is_fast(self, ln_kc: float, tau_i_s: float) -> bool:
        gains = self._set(ln_kc, tau_i_s)
        if not math.isfinite(self.ms(gains)):
            return False
        found = iae(self.model, gains, self.sample_time_s)
        return sum(one / own for one, own in zip(found, self.iae, strict=True)) / 2 <= self.limits.j


def _border(keeps: Callable[[float], bool], low: float, high: float, times: int) -> float:
    """Up to where something is kept that is so at low."""
    for _ in range(times):
        middle = (low + high) / 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return low


def _normal(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2)) if math.isfinite(z) else float(z > 0)


@dataclass(frozen=True, slots=True)
class Best:
    """The set that serves some places best: how many of them are expected to be in spec."""

    gains: PidGains
    kept: float


def spot_of(x: float, log: LogModel, sample_time_s: float, limits: DesignLimits) -> Spot | None:
    """The place x by what is known of the process there; None where that is not known well enough."""
    ln_std = math.hypot(math.sqrt(float(features(log, sample_time_s).p[0, 0])), LEAST_STD)
    model = log.model()
    plain = without_second_lag(model.seen_by_controller(sample_time_s))
    own = simc(plain, plain.theta_s).gains
    process = model.seen_by_controller(sample_time_s).linear()
    if ln_std > limits.std or not math.isfinite(sensitivity_peak(process, own)):
        return None
    return Spot(x, model, process, ln_std, own, iae(model, own, sample_time_s), sample_time_s, limits)


def best_of(spots: Sequence[Spot]) -> Best:
    """The set for these places, in order: the shape of one of three, within what a boundary bears at both ends."""
    shapes = {spot.own.kp / spot.own.ki: None for spot in (spots[0], spots[len(spots) // 2], spots[-1])}
    return max((_of_shape(spots, tau_i_s) for tau_i_s in shapes), key=lambda one: one.kept)


def _of_shape(spots: Sequence[Spot], tau_i_s: float) -> Best:
    """The best gain of a shape, by one standard deviation inside what a boundary bears at either end."""
    own = [math.log(abs(spot.own.kp)) for spot in spots]
    most = min(spot.interval(tau_i_s)[2] - spot.ln_std for spot in (spots[0], spots[-1]))
    tried = np.minimum(np.linspace(min(own) - 0.3, max(own) + 0.3, KC_TRIED), most).tolist()
    kept = [sum(spot.chance(ln_kc, tau_i_s) for spot in spots) for ln_kc in tried]
    at = int(np.argmax(kept))
    kc = math.copysign(math.exp(tried[at]), spots[0].own.kp)
    return Best(PidGains(kc, kc / tau_i_s, 0.0), kept[at])
