"""How the tuning of a loop stands over all processes that its records allow, each with its likelihood.

    P(class | records)  ~  P(class) x mean over the class's processes of the tempered likelihood

The classes are those of diagnosis: Ms over its limit by too much gain (aggressive) or by too much integral action for
the gain (slow integrating), much more gain or integral action possible at a good Ms (sluggish), and in order. A class
counts by the mean over its processes and not by their number: how finely a grid is drawn says nothing of plants.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, LoopRobustness, robustness, shapes, units
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

CLASSES = ("ok", "aggressive", "slow_integrating", "sluggish")


@dataclass(frozen=True, slots=True)
class TuningLimits:
    """Where a class of tuning ends.

    ms_high : Ms above which a loop has too little robustness; 1.7 to 2.5, default 2.0: in the middle between what is
        drawn as good (1.75) and as bad. ms_good : Ms up to which gain may be raised; 1.5 to 1.8, default 1.7.
    gm_large : gain margin above which a high Ms is the integral's fault; 2 to 6, default 3.
    room : how many times as much gain a loop must bear to be sluggish; 1.5 to 5, default 2.5.
    slack : how many times as much integral action than it has SIMC gives one that is; 2 to 10, default 5.
    beyond : loop gains more than so many times beyond the stability limit are left out: no record of a working loop
        comes from there; 1 to 3, default 1.25.
    """

    ms_high: float = 2.0
    ms_good: float = 1.7
    gm_large: float = 3.0
    room: float = 2.5
    slack: float = 5.0
    beyond: float = 1.25


@dataclass(frozen=True, slots=True)
class TuningOdds:
    """The processes that a loop's records allow, with the gains in force.

    weights : of every process of the grid, shape (shapes, dead times, gains), sum 1; classes in their prior odds.
    classes : probability by class. robustness : of the gains in force. gains, sample_time_s : of them, and of the grid.
    """

    weights: FloatArray
    classes: dict[str, float]
    robustness: LoopRobustness
    gains: PidGains
    sample_time_s: float


def tuning_odds(
    log_likelihood: FloatArray, gains: PidGains, sample_time_s: float, prior: dict[str, float], limits: TuningLimits
) -> TuningOdds:
    """Weigh the classes.

    log_likelihood : of all records of the loop together (wandering_load.py). gains : in force. prior : of each class,
    sum 1. sample_time_s : of the condensed records.
    """
    known = robustness(gains, sample_time_s)
    classes = class_of(known, gains, sample_time_s, limits)
    within = known.ultimate * limits.beyond >= GAINS
    likelihood = np.exp(log_likelihood - float(np.max(log_likelihood[within], initial=-np.inf)))
    likelihood[~within] = 0.0
    weights = np.zeros_like(likelihood)
    for i, name in enumerate(CLASSES):
        of_class = (classes == i) & within
        if of_class.any():
            weights[of_class] = likelihood[of_class] * (prior[name] / int(of_class.sum()))
    weights /= float(weights.sum())
    shares = {name: float(weights[classes == i].sum()) for i, name in enumerate(CLASSES)}
    return TuningOdds(weights, shares, known, gains, sample_time_s)


def class_of(known: LoopRobustness, gains: PidGains, sample_time_s: float, limits: TuningLimits) -> FloatArray:
    """The class of every process of the grid, as an index of CLASSES."""
    high = known.ms > limits.ms_high
    slack = simc_integral(known.scale, gains, sample_time_s)
    weak = ~high & ((known.room(limits.ms_good) > limits.room) | (slack > limits.slack))
    by_integral = high & (known.gain_margin > limits.gm_large)
    return np.asarray(np.select([by_integral, high, weak], [2, 1, 3], 0), dtype=np.float64)


def simc_integral(scale: float, gains: PidGains, sample_time_s: float) -> FloatArray:
    """How many times the integral action in force SIMC gives each process, tau_c = theta; infinite without any.

    SIMC with the half rule (Skogestad 2003, eq. 23 and 24): Ki = Kc / min(tau1, 8 theta).
    """
    if not gains.ki:
        return np.full((len(shapes()), len(DEAD_TIMES), len(GAINS)), np.inf)
    unit = (abs(gains.kp) or abs(gains.ki) * 10 * sample_time_s) / scale
    process_gain = GAINS * units() / unit
    return np.asarray(_simc()[:, :, None] / process_gain / (abs(gains.ki) * sample_time_s), dtype=np.float64)


@cache
def _simc() -> FloatArray:
    """SIMC's ki for a process gain of one, per sample; shape (shapes, dead times)."""
    found = np.empty((len(shapes()), len(DEAD_TIMES)))
    dead = np.array(DEAD_TIMES) + 0.5
    for row, shape in zip(found, shapes(), strict=True):
        if shape.integrates:
            theta = dead + shape.second
            row[:] = 1.0 / (2.0 * theta * 8.0 * theta)
        else:
            theta, lag = dead + shape.second / 2, shape.lag + shape.second / 2
            row[:] = lag / (2.0 * theta * np.minimum(lag, 8.0 * theta))
    return found
