"""How the tuning of a loop stands over all processes that its records allow, each with its likelihood.

    P(class | records)  ~  P(class) x mean over the class's processes of the tempered likelihood

The classes are those of diagnosis: Ms over its limit by too much gain (aggressive) or by too much integral action for
the gain (slow integrating), much more gain or integral action possible at a good Ms (sluggish), and in order. A class
counts by the mean over its processes and not by their number: how finely a grid is drawn says nothing of plants. In
the mean, processes weigh by how usual they are (UsualProcess): a grid reaches farther than plants do.
"""

import math
from functools import cache

import numpy as np

from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    GAINS,
    LoopRobustness,
    robustness,
    shapes,
    units,
)
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

CLASSES = ("ok", "aggressive", "slow_integrating", "sluggish")


@dataclass(frozen=True, slots=True)
class TuningLimits:
    """Where a class of tuning ends.

    ms_high : Ms above which a loop has too little robustness; 1.7 to 2.5, default 2.0: in the middle between what is
        drawn as good (1.75) and as bad. ms_good : Ms up to which gain may be raised; 1.5 to 1.8, default 1.7.
    gm_large : gain margin above which a high Ms is the integral's fault; 2 to 6, default 3. less : it is, too, where no
        gain down to so many times less would cure; 3 to 10, default 5: an integrating process under a short integral
        time swings the more the less gain it has.
    room : how many times as much gain a loop must bear to be sluggish; 1.5 to 5, default 2.5.
    slack : how many times as much integral action than it has SIMC gives one that is; 2 to 10, default 5.
    reset : a loop that swings at a frequency of less than this over its integral time has too much integral action,
        whatever cures it; 0.2 to 1, default 0.5 (the controller then is an integrator to within 27 degrees).
    beyond : loop gains more than so many times beyond the stability limit are left out: no record of a working loop
        comes from there; 1 to 3, default 1.25.
    """

    ms_high: float = 2.0
    ms_good: float = 1.7
    gm_large: float = 3.0
    less: float = 5.0
    room: float = 2.5
    slack: float = 5.0
    reset: float = 0.5
    beyond: float = 1.25


@dataclass(frozen=True, slots=True)
class UsualProcess:
    """How usual a process is in the loop that it was found in; standard deviations of natural logarithms, wide ones.

    dead, dead_std : effective dead time in samples; default 3 and 1.5 (loops are sampled for their dead time).
    lag, lag_std : first lag in samples; default 15 and 1.7. integral_std : of the integral time in force over SIMC's;
        default 1.2: whoever set the loop knew its lag to a factor of three or so.
    margin, margin_std : gain margin of a loop with too much gain; default 1.35 and 0.25: with less it would have been
        put in manual. room, room_std : of a sluggish loop, how many times as much gain it bears; default 5, and 1
        beyond.
    """

    dead: float = 3.0
    dead_std: float = 1.5
    lag: float = 15.0
    lag_std: float = 1.7
    integral_std: float = 1.2
    margin: float = 1.35
    margin_std: float = 0.25
    room: float = 5.0
    room_std: float = 1.0


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
    largest = float(np.max(log_likelihood[within], initial=-np.inf))
    likelihood = np.exp(np.where(within, log_likelihood - largest, -np.inf))
    usual_ones = _usual(known, classes, gains, sample_time_s, limits)
    weights = np.zeros_like(likelihood)
    for i, name in enumerate(CLASSES):
        of_class = (classes == i) & within
        if of_class.any():
            among = usual_ones[of_class]
            weights[of_class] = likelihood[of_class] * (prior[name] / float(among.sum())) * among
    weights /= float(weights.sum())
    slowly = known.swing * abs(gains.kp) < limits.reset * sample_time_s * abs(gains.ki)
    slow = slowly & bool(gains.kp) & (classes == CLASSES.index("aggressive"))  # too much integral action
    classes = np.where(slow, CLASSES.index("slow_integrating"), classes)
    shares = {name: float(weights[classes == i].sum()) for i, name in enumerate(CLASSES)}
    return TuningOdds(weights, shares, known, gains, sample_time_s)


def _usual(
    known: LoopRobustness, classes: FloatArray, gains: PidGains, sample_time_s: float, limits: TuningLimits
) -> FloatArray:
    """How usual every process of the grid is within its class, 1 for the most usual."""
    usual = UsualProcess()
    dead, lag, second = _times()
    far = np.log(dead / usual.dead) ** 2 / usual.dead_std**2
    far = far + np.where(np.isinf(lag), 0.0, np.log(np.minimum(lag, FINITE) / usual.lag)) ** 2 / usual.lag_std**2
    if gains.kp and gains.ki:
        integral = np.minimum(lag + second / 2, 8.0 * (dead + second / np.where(np.isinf(lag), 1.0, 2.0)))
        ratio = abs(gains.kp / gains.ki) / sample_time_s / integral
        far = far + np.log(ratio) ** 2 / usual.integral_std**2
    margin = np.log(np.maximum(known.gain_margin, 1e-9) / usual.margin) ** 2 / usual.margin_std**2
    room = np.maximum(np.log(known.room(limits.ms_good) / usual.room), 0.0) ** 2 / usual.room_std**2
    aggressive, sluggish = CLASSES.index("aggressive"), CLASSES.index("sluggish")
    far = far + np.select([classes == aggressive, classes == sluggish], [margin, room], 0.0)
    return np.asarray(np.exp(-0.5 * far), dtype=np.float64)


FINITE = 1e9  # A lag in samples that has an end


@cache
def _times() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Dead times with the sampler's half sample, first and second lags; in samples, ready for (shapes, dead, 1)."""
    lag, second = (np.array([getattr(shape, name) for shape in shapes()])[:, None, None] for name in ("lag", "second"))
    return (np.array(DEAD_TIMES) + 0.5)[None, :, None], lag, second


def class_of(known: LoopRobustness, gains: PidGains, sample_time_s: float, limits: TuningLimits) -> FloatArray:
    """The class of every process of the grid, as an index of CLASSES."""
    high = known.ms > limits.ms_high
    slack = simc_integral(known.scale, gains, sample_time_s)
    weak = ~high & ((known.room(limits.ms_good) > limits.room) | (slack > limits.slack))
    log_gain = np.log(GAINS)
    good = np.maximum.accumulate(np.where(high, -np.inf, log_gain), axis=2)  # the largest that is good, up to each
    by_integral = high & ((known.gain_margin > limits.gm_large) | (log_gain - good > math.log(limits.less)))
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
