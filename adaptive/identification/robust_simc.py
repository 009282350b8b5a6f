"""SIMC settings for what a record leaves open: the smallest tau_c that is robust on every model still allowed.

    tau_c >= theta,   Ms(best model) <= nominal limit,   Ms(every plausible model) <= worst limit

Where a dead time is longer than the lag, or the process swings by itself (complex poles), SIMC's lag is not what a PI
controller should go by. Almost pure dead time would get next to no gain; a pair of poles has no lag to take, and SIMC's
gains make such a loop unstable at any tau_c. There the settings have the most integral action that an Ms allows
(loop/most_integral.py), and a larger tau_c is a smaller Ms. At tau1 = theta both are the same settings.

The first remedy for doubt is a larger tau_c (by at most so much); what is still not robust then is for the guard, or
for the user, to judge by the Ms that comes with the settings. Half a sampling interval counts as dead time.

A loop that has derivative action gets SIMC's PID settings (tau_D is the second lag; Skogestad 2003, table 1) where that
lag is known well enough for them to be robust by the same limits. The derivative's filter counts in Ms on the best
model, where it is known. Where the integral time is shorter than SIMC's, tau_D is at most a quarter of it.
"""

from collections.abc import Sequence

from retuner.adaptive.fit.structure import LEAST_ZETA
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.most_integral import most_integral
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import ControllerKind, Tuning
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.schedule.gains import PidGains, series_kept
from retuner.schedule.late_dataclass import dataclass, replace

PI, PID = ControllerKind.PI, ControllerKind.PID
BISECTIONS = 8  # Bisections for tau_c between its limits: to a few thousandths
SWINGS = 0.85
"""zeta under which a process counts as swinging by itself; over it SIMC's settings for two equal lags are as robust."""
WALL = (0.9, 1.08)
"""Shares of the least damping that is fitted between which a fit has stopped there. Well below it evidence has won."""
LONG_TIMES = 30.0
"""Dead times beyond which the lag of a process with a lead is as an integrator's, and SIMC's settings hold."""
MS_AIM = 1.59  # Ms of the most integral action: that of SIMC with tau_c = theta (Grimholt & Skogestad 2012)
BEYOND_WALL = 1.5  # factor by which the damping of such a process is taken for less: 0.1, which few processes are below


@dataclass(frozen=True, slots=True)
class RobustSettings:
    """Settings.

    ms_nominal : largest Ms on the best model; 1.5 to 2, default 1.68 (SIMC's own is 1.59 to 1.70).
    ms_worst : largest Ms on a plausible model; 1.6 to 2.5, default 1.8, the limit that
        settings are judged by (1.95 let 4 of 11 wrong ones through, and held none up that was right).
    ms_third : largest Ms on the best model when a third lag hides in it, see third_lag; 1.6 to 2.5, default 1.8.
    hidden_share : that lag, as a share of c2; 0 to 1, default 0.25 (processes of order three to eight).
    believed : excess up to which a model counts as plausible here; default 4.
    tau_c_most : largest tau_c over theta for the sake of the best model; default 3 (a process that swings needs it).
    tau_c_doubt : the same for the sake of the others; default 1.8.
    tau_i_share : integral time over SIMC's; default 1.
    tau_f_s : filter time of the derivative in seconds, which Ms on the best model counts; 0 or more; default 0.
    """

    ms_nominal: float = 1.68
    ms_worst: float = 1.8
    ms_third: float = 1.8
    hidden_share: float = 0.25
    believed: float = 4.0
    tau_c_most: float = 3.0
    tau_c_doubt: float = 1.8
    tau_i_share: float = 1.0
    tau_f_s: float = 0.0


@dataclass(frozen=True, slots=True)
class RobustTuning:
    """Settings with the Ms that they have on the best and on the worst plausible model, sampling included."""

    tuning: Tuning
    ms_nominal: float
    ms_worst: float


def robust_simc(
    estimate: ModelEstimate, sample_time_s: float, settings: RobustSettings, in_force: PidGains | None = None
) -> RobustTuning:
    """Settings for an estimate; PI, or PID where the gains in force have derivative action."""
    return robust_simc_on(estimate.log.model(), estimate.plausible, sample_time_s, settings, in_force)


def robust_simc_on(
    process: ProcessModel,
    allowed: Sequence[Plausible],
    sample_time_s: float,
    settings: RobustSettings,
    in_force: PidGains | None = None,
) -> RobustTuning:
    """Settings for the most likely model and all that are still allowed; PI, or PID as said at the head of the file."""
    # A damping at the least that is fitted may be anything less
    model = process.seen_by_controller(sample_time_s)
    at_wall = WALL[0] * LEAST_ZETA < model.zeta < WALL[1] * LEAST_ZETA
    model = replace(model, zeta=model.zeta / BEYOND_WALL) if at_wall else model
    others = [p.model.seen_by_controller(sample_time_s) for p in believed(allowed, settings.believed)]
    if in_force is not None and in_force.kd and model.tau2_s:
        with_derivative, robust = _tightest(model, others, settings, PID)
        if robust:
            return with_derivative
    return _tightest(model, others, settings, PI)[0]


def _tightest(
    model: ProcessModel, others: Sequence[ProcessModel], settings: RobustSettings, kind: ControllerKind
) -> tuple[RobustTuning, bool]:
    """Settings with the smallest tau_c that is robust, or with the largest; and whether they are robust."""
    theta = (model.of_second_order() if kind is PID else without_second_lag(model)).theta_s
    third = third_lag(model, settings.hidden_share)
    calmer = 1.0 / model.zeta if model.zeta < SWINGS else 1.0  # the less damped, the larger tau_c may become

    known, plausible = model.linear(), [one.linear() for one in (model, *others)]

    def at(ratio: float) -> Tuning:
        given = by_integral(model, ratio) if asks_for_integral(model) else simc(model, ratio * theta, kind)
        shorter = replace(given.gains, ki=given.gains.ki / settings.tau_i_share)
        return replace(given, gains=series_kept(shorter, given.gains))

    def holds(gains: PidGains) -> bool:
        return all(sensitivity_peak(one, gains) <= settings.ms_worst for one in plausible)

    def proper(gains: PidGains, ratio: float) -> bool:
        if third is not None and sensitivity_peak(third.linear(), gains) > settings.ms_third:
            return False
        doubt = ratio >= settings.tau_c_doubt * calmer
        return sensitivity_peak(known, gains, settings.tau_f_s) <= settings.ms_nominal and (doubt or holds(gains))

    def told(tuning: Tuning) -> RobustTuning:
        worst = max(sensitivity_peak(one, tuning.gains) for one in plausible)
        return RobustTuning(tuning, sensitivity_peak(known, tuning.gains, settings.tau_f_s), worst)

    tightest = at(1.0)
    if proper(tightest.gains, 1.0):
        return told(tightest), True
    low, high = 1.0, settings.tau_c_most * calmer
    best = at(high)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        found = at(middle)
        if proper(found.gains, middle):
            high, best = middle, found
        else:
            low = middle
    return told(best), holds(best.gains) and proper(best.gains, high)


def swings(model: ProcessModel) -> bool:
    """Whether a process swings by itself, and no third lag is longer than the pair of poles that does."""
    return model.zeta < SWINGS and model.tau3_s <= 2 * model.zeta * model.tau1_s


def asks_for_integral(model: ProcessModel) -> bool:
    """Whether a process that comes to rest has no lag that a PI controller should go by (head of this file)."""
    if model.inverse_s < 0:
        return model.tau1_s <= LONG_TIMES * model.theta_s
    plain = without_second_lag(model)
    return swings(model) or 0.0 < plain.tau1_s < plain.theta_s


def by_integral(model: ProcessModel, ratio: float = 1.0) -> Tuning:
    """PI settings with the most integral action. ratio : by which a calmer loop's distance of Ms from 1 is smaller."""
    gains = most_integral(model.linear(), 1.0 + (MS_AIM - 1.0) / ratio)
    return Tuning("most-integral", "ideal", gains)


def third_lag(model: ProcessModel, share: float) -> ProcessModel | None:
    """The model with a dead time of at least a share of its second lag, None where it has that already.

    A fit of two lags to a process of higher order often ends at no dead time at all: what is left then lacks the phase
    of the lags that it cannot see, just where the loop crosses over.
    """
    if not model.tau2_s:
        return None
    hidden = share * (model.tau2_s / (2 * model.zeta) if model.zeta < 1 else model.tau2_s)
    dead = model.theta_s + max(model.inverse_s, 0.0) + model.tau3_s
    return replace(model, theta_s=model.theta_s + hidden - dead) if dead < hidden else None


def believed(around: Sequence[Plausible], excess: float) -> list[Plausible]:
    """The models that the record believes to within an excess."""
    return [p for p in around if p.excess <= excess]
