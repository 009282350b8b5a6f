"""What is known of one region's process, from response to response: a Kalman filter over the log-parameters.

    mu ~ N(m, P)                 the region's process, a random walk in time: P grows by q dt
    x = mu + e, e ~ N(0, s^2)    the process as one record shows it: the operating point is never quite the same
    z = R x + v, v ~ N(0, I)     the record, linearised at the optimum of its fit and compressed by QR

The filter predicts x (m, P + q dt + s^2), updates it with z, and takes what it learned back to mu (one step of the
Rauch-Tung-Striebel smoother, 1965): G = P (P + s^2)^-1, m+ = m + G (x+ - m), P+ = P + G (Px+ - P - s^2) G'. With s = 0
the two are one. Without s, records of setpoints and of loads, which every too simple structure sees differently, would
contradict each other for ever.

The state before the update was the prior inside the nonlinear fit that gave R and z, so the update is the last step of
an iterated extended Kalman filter (Bell & Cathey 1993) and its posterior is the fit's own. Feeding the filter
separately fitted points instead was tried and failed: a record of a load alone has a bent ridge of likely parameters,
and its Gaussian dragged the gain to a tenth. The filter is filterpy's; it runs once per response.

A record that contradicts what is known is not believed at once: it is kept as a rival. When the next record agrees
with the rival better than with the belief, the process has changed (or the first record was wrong), and the rival
takes over; when it agrees with the belief, the odd record is forgotten.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from filterpy.kalman import KalmanFilter

from retuner.adaptive.estimate import LogModel, ModelEstimate, proper_covariance
from retuner.adaptive.identify import FitSettings, identify_window
from retuner.adaptive.sample import FloatArray, Window


class Surprise(StrEnum):
    """How a record stood to what was known."""

    FIRST = "first record of this region"
    AGREES = "agrees with what was known"
    ODD = "contradicts what was known; kept as a rival until another record decides"
    CHANGED = "a second record confirms the rival: the process has changed"


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings.

    walk_per_day : how far the logarithms wander in a day, one standard deviation; default 0.1 (10 %).
    scatter : how much the logarithms differ from record to record within a region, one standard deviation: the
        operating point is never quite the same and no structure is quite right; default 0.12 (12 %).
    gate : innovation statistic (3 degrees of freedom) above which a record is odd; default 16.3 (99.9 % of chi-square).
    """

    walk_per_day: float = 0.1
    scatter: float = 0.12
    gate: float = 16.3


@dataclass(frozen=True, slots=True)
class Belief:
    """What is known of a region.

    log : parameters and covariance. records : how many records are in it. t_s : when it was last updated.
    rival : the odd record's own estimate, if the last one was odd.
    """

    log: LogModel
    records: int
    t_s: float
    rival: LogModel | None = None


@dataclass(frozen=True, slots=True)
class Learned:
    """Outcome of one record: the belief now, the estimate that the record gave, how it stood to the old belief."""

    belief: Belief | None
    estimate: ModelEstimate
    surprise: Surprise
    innovation: float


SECONDS_PER_DAY = 86400.0


def learn(belief: Belief | None, window: Window, sign: int, settings: TrackerSettings, fit: FitSettings) -> Learned:
    """Take one record of a region into what is known of it.

    Parameters
    ----------
    belief : what was known, None at first.
    window : the record. sign : of the process gain, from the controller's direction.
    """
    t_s = float(window.t_s[-1])
    if belief is None or belief.log.sign != sign:
        return _first(identify_window(window, sign, None, fit), t_s, settings)
    mean = grown(belief, t_s, settings)
    prior = scattered(mean, settings)
    estimate = identify_window(window, sign, prior, fit)
    innovation, posterior = update(prior, estimate)
    if innovation <= settings.gate:
        log = back_to_mean(mean, prior, posterior)
        return Learned(Belief(log, belief.records + 1, t_s), estimate, Surprise.AGREES, innovation)
    if belief.rival is not None:
        confirmed = _against_rival(belief.rival, window, sign, settings, fit)
        if confirmed is not None:
            log, estimate = confirmed
            return Learned(Belief(log, 2, t_s), estimate, Surprise.CHANGED, innovation)
    alone = identify_window(window, sign, None, fit)
    kept = replace(belief, rival=scattered(alone.log, settings) if alone.identifiable else None)
    return Learned(kept, alone, Surprise.ODD, innovation)


def _first(estimate: ModelEstimate, t_s: float, settings: TrackerSettings) -> Learned:
    """The first record of a region: believed when it is identifiable."""
    belief = Belief(scattered(estimate.log, settings), 1, t_s) if estimate.identifiable else None
    return Learned(belief, estimate, Surprise.FIRST, 0.0)


def _against_rival(
    rival: LogModel, window: Window, sign: int, settings: TrackerSettings, fit: FitSettings
) -> tuple[LogModel, ModelEstimate] | None:
    """The rival updated with the record, and the record's estimate, if the two agree."""
    prior = scattered(rival, settings)
    estimate = identify_window(window, sign, prior, fit)
    innovation, posterior = update(prior, estimate)
    return (back_to_mean(rival, prior, posterior), estimate) if innovation <= settings.gate else None


def grown(belief: Belief, t_s: float, settings: TrackerSettings) -> LogModel:
    """The region's mean at a later time: where it was, a covariance grown by the random walk."""
    days = max(t_s - belief.t_s, 0.0) / SECONDS_PER_DAY
    return _widened(belief.log, settings.walk_per_day**2 * days)


def scattered(log: LogModel, settings: TrackerSettings) -> LogModel:
    """What one record may show when this is known of the mean, or the other way round."""
    return _widened(log, settings.scatter**2)


def predicted(belief: Belief, t_s: float, settings: TrackerSettings) -> LogModel:
    """The process as it may be met at a later time: the prior of the next fit, and what the guard has to prove for."""
    return scattered(grown(belief, t_s, settings), settings)


def _widened(log: LogModel, variance: float) -> LogModel:
    """filterpy's prediction with F = I and Q = variance I."""
    kf = _filter(log)
    kf.predict(Q=variance * np.eye(3))
    return LogModel(kf.x[:, 0].copy(), proper_covariance(kf.P), log.sign)


def back_to_mean(mean: LogModel, prior: LogModel, posterior: LogModel) -> LogModel:
    """What a record's process says of the region's mean (see the head of this file)."""
    gain = mean.p @ np.linalg.inv(prior.p)
    p = mean.p + gain @ (posterior.p - prior.p) @ gain.T
    return LogModel(mean.x + gain @ (posterior.x - mean.x), proper_covariance(p), mean.sign)


def update(prior: LogModel, estimate: ModelEstimate) -> tuple[float, LogModel]:
    """Innovation statistic (chi-square with 3 degrees of freedom) and the posterior."""
    kf = _filter(prior)
    kf.update(estimate.score.reshape(3, 1), R=np.eye(3), H=estimate.information)
    y: FloatArray = kf.y
    statistic = float((y.T @ np.linalg.solve(kf.S, y))[0, 0])
    posterior = LogModel(kf.x[:, 0].copy(), proper_covariance(kf.P), prior.sign)
    return statistic if math.isfinite(statistic) else math.inf, posterior


def _filter(log: LogModel) -> KalmanFilter:
    """A filterpy filter that stands where the estimate stands."""
    kf = KalmanFilter(dim_x=3, dim_z=3)
    kf.x = log.x.reshape(3, 1).copy()
    kf.P = log.p.copy()
    return kf
