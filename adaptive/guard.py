"""Proof before change: what a proposed set of gains must pass before it may reach a controller.

The proof is Ms on the identified process and on every corner of what the records still allow (two standard deviations
along each principal axis of the covariance: deterministic, so that replay decides alike). The remedies come in this
order: a larger tau_c (at most tau_c_max_ratio times theta), a half step, a quarter step, refusal. Steps are taken in
the logarithms of the gains, so the half step lies between old and new in every form. A loop that is itself over the
limit may always be made safer.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from retuner.adaptive.estimate import LogModel
from retuner.adaptive.fit.structure import model_at
from retuner.adaptive.margins import sensitivity_peak
from retuner.adaptive.process import LinearProcess
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.rules.tuning import Tuning
from retuner.schedule.gains import PidGains


class Ruling(StrEnum):
    """Outcome; the value is the sentence that people see."""

    ACCEPTED = "proved: robust on every model that the records allow"
    SAFER = "accepted because it makes a loop safer that is over its limit"
    NOT_ROBUST = "refused: not robust on every model that the records allow, even at a quarter of the step"
    OUTSIDE_LIMITS = "refused: the absolute limits leave no room for the change"
    WRONG_SIGN = "refused: the controller would act the wrong way"
    TOO_SMALL = "no change: the settings in force are as good"


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """Settings.

    ms_nominal : largest Ms on the identified process; 1.4 to 2, default 1.75.
    ms_target : Ms that proposals aim at by their tau_c; 1.4 to ms_nominal, default 1.65 (what is between the two is for
        the process that is never quite the one identified).
    ms_worst : largest Ms on the corners of the uncertainty; up to 3, default 2.1.
    tau_c_max_ratio : largest tau_c over theta; 1 to 3, default 1.3.
    corner_std : how many standard deviations out the corners lie; default 2.
    step_up_max, step_down_max : largest factor per change towards more and towards less action; defaults 2 and 4.
    kc_min, kc_max : absolute limits on |kp|; defaults 0 and infinite.
    smallest_change : changes below this factor are not worth a write; default 1.05.
    """

    ms_nominal: float = 1.75
    ms_target: float = 1.65
    ms_worst: float = 2.1
    tau_c_max_ratio: float = 1.3
    corner_std: float = 2.0
    step_up_max: float = 2.0
    step_down_max: float = 4.0
    kc_min: float = 0.0
    kc_max: float = math.inf
    smallest_change: float = 1.05


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the guard lets through.

    ruling : the outcome. gains : what may be written, None when refused. step : share of the proposed step (0 to 1).
    ms_nominal, ms_worst : Ms of these gains on the model and on the worst corner.
    ms_before : Ms of the gains in force on the model. tau_c_s : of the proposal.
    """

    ruling: Ruling
    gains: PidGains | None
    step: float
    ms_nominal: float
    ms_worst: float
    ms_before: float
    tau_c_s: float

    @property
    def accepted(self) -> bool:
        """Whether gains may be written."""
        return self.gains is not None

    def to_dict(self) -> dict[str, object]:
        """Plain values; null where Ms is infinite (unstable)."""
        ms = {
            name: value if math.isfinite(value) else None
            for name, value in (("nominal", self.ms_nominal), ("worst", self.ms_worst), ("before", self.ms_before))
        }
        return {
            "accepted": self.accepted,
            "ruling": self.ruling.name.lower(),
            "step": self.step,
            "ms": ms,
            "tau_c_s": self.tau_c_s,
            "reason": str(self.ruling),
        }


def corners(log: LogModel, out: float) -> list[LinearProcess]:
    """The mean and both ends of every principal axis of the covariance, `out` standard deviations out.

    An axis ends where a parameter has changed by a factor of two: beyond that the covariance says only that the record
    does not know (a second lag that may be nothing), and its Gaussian has no meaning.
    """
    values, vectors = np.linalg.eigh(log.p)
    axes = out * vectors * np.sqrt(np.maximum(values, 0.0))
    axes = axes * np.minimum(1.0, MOST_LOG_STEP / np.maximum(np.max(np.abs(axes), axis=0), MOST_LOG_STEP))
    points = [log.x, *(log.x + s * axes[:, j] for j in range(len(log.x)) for s in (1.0, -1.0))]
    return [model_at(log.type, x, log.sign).linear() for x in points]


MOST_LOG_STEP = math.log(2.0)
"""Farthest that a corner lies from the mean in any log-parameter."""


def worst_ms(processes: list[LinearProcess], gains: PidGains) -> float:
    """Largest Ms over several processes."""
    return max(sensitivity_peak(process, gains) for process in processes)


def prove(
    proposal: Tuning, log: LogModel, half_sample_s: float, in_force: PidGains, settings: GuardSettings
) -> Verdict:
    """Decide what may be written.

    Parameters
    ----------
    proposal : settings of the rule at its tightest tau_c. log : the process and its uncertainty.
    half_sample_s : half a sampling interval, the dead time that sampling adds. in_force : gains running now.
    """
    processes = [_sampled(process, half_sample_s) for process in corners(log, settings.corner_std)]
    before = sensitivity_peak(processes[0], in_force)
    tau_c = proposal.tau_c_s or 0.0
    if proposal.gains.direction != in_force.direction:
        return Verdict(Ruling.WRONG_SIGN, None, 0.0, math.inf, math.inf, before, tau_c)
    before_worst = worst_ms(processes, in_force)
    limits_met = False
    for moved, tau_c_tried in _candidates(proposal, log, half_sample_s, in_force, settings):
        if moved is None:
            continue
        gains, share = moved
        limits_met = True
        if change_factor(in_force, gains) < settings.smallest_change:
            return Verdict(Ruling.TOO_SMALL, None, 0.0, before, before_worst, before, tau_c_tried)
        nominal, worst = sensitivity_peak(processes[0], gains), worst_ms(processes, gains)
        if nominal <= settings.ms_nominal and worst <= settings.ms_worst:
            return Verdict(Ruling.ACCEPTED, gains, share, nominal, worst, before, tau_c_tried)
        if before > settings.ms_nominal and _safer(processes, gains, in_force):
            return Verdict(Ruling.SAFER, gains, share, nominal, worst, before, tau_c_tried)
    ruling = Ruling.NOT_ROBUST if limits_met else Ruling.OUTSIDE_LIMITS
    return Verdict(ruling, None, 0.0, before, before_worst, before, tau_c)


def _safer(processes: list[LinearProcess], gains: PidGains, in_force: PidGains) -> bool:
    """Whether Ms falls on the model and rises on no corner (an unstable corner may stay one).

    Where the loop is unstable before and still after the largest step that the limits allow, less of every action is
    the safe direction; the next response takes the next step.
    """
    pairs = [(sensitivity_peak(p, gains), sensitivity_peak(p, in_force)) for p in processes]
    if math.isinf(pairs[0][0]) and math.isinf(pairs[0][1]):
        return all(abs(new) <= abs(old) for new, old in
                   ((gains.kp, in_force.kp), (gains.ki, in_force.ki), (gains.kd, in_force.kd)))  # fmt: skip
    return pairs[0][0] < pairs[0][1] and all(now <= then for now, then in pairs)


def _sampled(process: LinearProcess, half_sample_s: float) -> LinearProcess:
    """The process as a sampled controller sees it: half a sampling interval more dead time (Skogestad 2003, sec. 2)."""
    return replace(process, theta_s=process.theta_s + half_sample_s)


def _candidates(
    proposal: Tuning, log: LogModel, half_sample_s: float, in_force: PidGains, settings: GuardSettings
) -> list[tuple[tuple[PidGains, float] | None, float]]:
    """Gains to try in order with their share of the step, and tau_c; None where the limits leave no room."""
    tau_c = proposal.tau_c_s or 0.0
    found = log.model()
    model = replace(found, theta_s=found.theta_s + half_sample_s)
    theta = without_second_lag(model).theta_s
    tried = []
    for slower in (1.0, math.sqrt(settings.tau_c_max_ratio), settings.tau_c_max_ratio):
        if tau_c * slower > theta * settings.tau_c_max_ratio * (1 + 1e-9) and slower > 1:
            break
        goal = simc(model, tau_c * slower).gains
        tried.append((within_limits(in_force, goal, 1.0, settings), tau_c * slower))
    tried += [(within_limits(in_force, proposal.gains, share, settings), tau_c) for share in (0.5, 0.25)]
    return tried


def within_limits(old: PidGains, new: PidGains, share: float, settings: GuardSettings) -> tuple[PidGains, float] | None:
    """The point a share of the way from old to new (in logarithms), and the share that the limits per change allow.

    All gains go the same share of their way, so the path is straight; None when the absolute limits cannot be kept.
    """
    pairs = [(o, n) for o, n in ((old.kp, new.kp), (old.ki, new.ki), (old.kd, new.kd)) if o and n]
    for o, n in pairs:
        way = math.log(n / o)
        room = math.log(settings.step_up_max if way > 0 else settings.step_down_max)
        share = min(share, room / abs(way)) if way else share
    moved = PidGains(
        *(o * (n / o) ** share if o and n else n for o, n in ((old.kp, new.kp), (old.ki, new.ki), (old.kd, new.kd)))
    )
    return (moved, share) if settings.kc_min <= abs(moved.kp) <= settings.kc_max else None


def change_factor(old: PidGains, new: PidGains) -> float:
    """Largest factor by which one of the gains differs (infinite when one appears or goes)."""
    factors = [
        max(n / o, o / n) if o and n else math.inf
        for o, n in ((old.kp, new.kp), (old.ki, new.ki), (old.kd, new.kd))
        if o or n
    ]
    return max(factors, default=1.0)
