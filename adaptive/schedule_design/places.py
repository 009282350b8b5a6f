"""Places along the variable: the process there, all that it may still be, and how well a set of gains serves it.

J of a set at a place is (IAE_ys/IAE_ys' + IAE_d/IAE_d')/2 against the place's own settings, those that SIMC gives it
with an Ms within its limit on every model that is still allowed (identification/robust_simc.py).
"""

import math

import numpy as np

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.performance import load_variation, setpoint_variation
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace

OUT = 2.0  # standard deviations out at which a model is still allowed
LEAST_STD = 0.02  # least standard deviation of every ln p: no curve is known better than that
MOST_MS = 2.2
"""Largest Ms of a place's own settings on any allowed model: above it they are none, whatever the spread says."""
SECOND_LAG = 3  # place of ln tau2 among ln b, ln theta, ln tau, ln tau2
LONGEST_LAG = 30.0
"""A lag of so many dead times and more is as good as an integrator; longer ones are cut there, the slope gain kept."""


@dataclass(frozen=True, slots=True)
class DesignLimits:
    """What is demanded of a schedule.

    ms : largest Ms at any place on any model still allowed; 1.5 to 2.5, default 1.8. j : largest J over that of the
    place's own settings; 1.05 to 2, default 1.25. std : largest standard deviation of ln Kc with which a place counts
    as known; 0.1 to 0.5, default 0.2 (identification's own limit).

    Raises ValueError: a limit outside its range.
    """

    ms: float = 1.8
    j: float = 1.25
    std: float = 0.2

    def __post_init__(self) -> None:
        for name, low, high in (("ms", 1.5, 2.5), ("j", 1.05, 2.0), ("std", 0.1, 0.5)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)} is outside {low:g} to {high:g}")


@dataclass(frozen=True, slots=True)
class Judged:
    """A set at a place. ms : on the likeliest model, ms_worst : on all allowed. j : see the head."""

    ms: float
    ms_worst: float
    j: float


@dataclass(frozen=True, slots=True)
class Place:
    """One place x: the process, the models still allowed, and the settings that are its own.

    processes : of the model and of all allowed, as the sampled controller sees them.
    ln_std : of ln b, ln theta, ln tau (, ln tau2). gain_std : of ln Kc of its own settings. known : whether settings
    may follow. iae : of its own settings for a step of setpoint and of load. x2 : of a second variable.
    """

    x: float
    model: ProcessModel
    processes: tuple[LinearProcess, ...]
    ln_std: tuple[float, ...]
    gain_std: float
    known: bool
    own: PidGains
    iae: tuple[float, float]
    sample_time_s: float
    x2: float | None = None
    _judged: dict[PidGains, Judged] = field(default_factory=dict, repr=False, compare=False)
    _j: dict[PidGains, float] = field(default_factory=dict, repr=False, compare=False)

    def judged(self, gains: PidGains) -> Judged:
        """How a set does here; asked once."""
        if gains not in self._judged:
            peaks, j = [sensitivity_peak(process, gains) for process in self.processes], math.inf
            if math.isfinite(peaks[0]):
                setpoint, load = iae(self.model, gains, self.sample_time_s)
                j = 0.5 * (setpoint / self.iae[0] + load / self.iae[1])
            self._judged[gains] = Judged(peaks[0], max(peaks), j)
        return self._judged[gains]

    def keeps(self, gains: PidGains, limits: DesignLimits) -> bool:
        """Whether a set meets the limits here; a place that is not known demands nothing."""
        if not self.known:
            return True
        # where its own settings cannot keep the Ms that is demanded, what they reach
        limit = max(limits.ms, self.judged(self.own).ms_worst)
        if gains in self._judged:
            return self.judged(gains).ms_worst <= limit and self.judged(gains).j <= limits.j
        # an error that never changes its sign has the integral 1/(k ki), of a load 1/ki: J is that at the least
        ki = gains.ki
        if not ki or 0.5 * abs(1 / (self.model.k * ki) / self.iae[0] + 1 / (ki * self.iae[1])) > limits.j:
            return False
        if any(sensitivity_peak(process, gains) > limit for process in self.processes):  # the first is enough
            return False
        # J of these gains in steps of ROUNDED, asked once: what a search over thousands of sets can pay for
        near = PidGains(*(_rounded(gain) for gain in (gains.kp, gains.ki, gains.kd)))
        if near not in self._j:
            stable = math.isfinite(sensitivity_peak(self.processes[0], near))
            setpoint, load = iae(self.model, near, self.sample_time_s) if stable else (math.inf, math.inf)
            self._j[near] = 0.5 * (setpoint / self.iae[0] + load / self.iae[1])
        return self._j[near] <= limits.j


ROUNDED = 0.03  # steps of ln of a gain in which J is looked up in a search; a step changes J by about as much


def _rounded(gain: float) -> float:
    return math.copysign(math.exp(ROUNDED * round(math.log(abs(gain)) / ROUNDED)), gain) if gain else 0.0


def iae(model: ProcessModel, gains: PidGains, sample_time_s: float) -> tuple[float, float]:
    """IAE for a unit step of setpoint and of load, of a stable loop."""
    process = model.seen_by_controller(sample_time_s).linear()
    setpoint = setpoint_variation(process, gains, derivative_on_setpoint=False, with_output=False)
    return setpoint.error, load_variation(process, gains, with_output=False).error


def place_at(curves: Curves, x: float, sample_time_s: float, limits: DesignLimits, x2: float | None = None) -> Place:
    """The place x (and x2) of some curves."""
    ln = curves.ln(np.array([x]), None if x2 is None else np.array([x2]))[0]
    covariance = curves.ln_covariance(x, x2)
    return replace(place_of(x, ln, covariance, curves.form.sign, sample_time_s, limits), x2=x2)


def place_of(x: float, ln: FloatArray, p: FloatArray, sign: int, sample_time_s: float, limits: DesignLimits) -> Place:
    """A place from ln b, ln theta, ln tau (, ln tau2) there and their covariance p. sign : of the process gain."""
    covariance = p + LEAST_STD**2 * np.eye(len(ln))
    model = model_of(ln, sign)
    values, vectors = np.linalg.eigh(covariance)
    ways = OUT * vectors * np.sqrt(np.maximum(values, 0.0))
    allowed = tuple(model_of(moved(ln, side * way), sign) for way in ways.T for side in (1.0, -1.0))
    # standard deviation of ln Kc = -ln b - ln(theta + tau2/2), the larger part of SIMC's answer
    effective = np.exp(ln[1]) + (0.5 * np.exp(ln[3]) if len(ln) > 3 else 0.0)
    way = np.zeros(len(ln))
    way[0], way[1] = 1.0, np.exp(ln[1]) / effective
    if len(ln) > 3:
        way[3] = 0.5 * np.exp(ln[3]) / effective
    spread = float(np.sqrt(way @ covariance @ way))
    std = tuple(float(s) for s in np.sqrt(np.diag(covariance)))
    return place_on(x, model, allowed, std, spread, sample_time_s, limits)


def place_on(
    x: float,
    model: ProcessModel,
    allowed: tuple[ProcessModel, ...],
    ln_std: tuple[float, ...],
    gain_std: float,
    sample_time_s: float,
    limits: DesignLimits,
) -> Place:
    """A place by its likeliest model and those OUT standard deviations out, with its own settings."""
    settings = RobustSettings(ms_worst=max(limits.ms - 0.03, 1.5))
    own = robust_simc_on(model, [Plausible(m, OUT**2) for m in allowed], sample_time_s, settings).tuning.gains
    seen = tuple(m.seen_by_controller(sample_time_s).linear() for m in (model, *allowed))
    known = gain_std <= limits.std and all(sensitivity_peak(m, own) <= MOST_MS for m in seen)
    return Place(x, model, seen, ln_std, gain_std, known, own, iae(model, own, sample_time_s), sample_time_s)


def moved(ln: FloatArray, way: FloatArray) -> FloatArray:
    """ln p so far away from the likeliest.

    What a record sees of a second lag is the lag, not its logarithm: where it is hardly known, twice its standard
    deviation out is tau2 (1 + d), as the fit's derivatives say, and not tau2 exp(d), hundreds of times as long.
    """
    found = ln + way
    if len(ln) > SECOND_LAG and way[SECOND_LAG] > 0:
        found[SECOND_LAG] = ln[SECOND_LAG] + math.log1p(way[SECOND_LAG])
    return np.asarray(found, dtype=np.float64)


def model_of(ln: FloatArray, sign: int) -> ProcessModel:
    """The model of ln b, ln theta, ln tau (, ln tau2)."""
    slope, theta, tau = sign * math.exp(ln[0]), math.exp(ln[1]), math.exp(ln[2])
    tau2 = math.exp(ln[3]) if len(ln) > 3 else 0.0
    tau = min(tau, LONGEST_LAG * (theta + tau2))
    if not tau2:
        return ProcessModel(ProcessType.FOPDT, slope * tau, tau, 0.0, theta)
    return ProcessModel(ProcessType.SOPDT, slope * tau, max(tau, tau2), min(tau, tau2), theta)
