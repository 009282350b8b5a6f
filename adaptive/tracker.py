"""What is known of one region's process, from response to response: a Kalman filter over the log-parameters.

    predict   m stays, P grows by q dt + s^2     (a random walk in the logarithms, and scatter between records)
    update    z = R x + v, v ~ N(0, I)           (the record linearised at the optimum of its fit, compressed by QR)

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

from retuner.adaptive.estimate import LogModel, ModelEstimate
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
        operating point is never quite the same and no structure is quite right; default 0.07 (7 %).
    gate : innovation statistic (3 degrees of freedom) above which a record is odd; default 16.3 (99.9 % of chi-square).
    """

    walk_per_day: float = 0.1
    scatter: float = 0.07
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
        return _first(identify_window(window, sign, None, fit), t_s)
    prior = predicted(belief, t_s, settings)
    estimate = identify_window(window, sign, prior, fit)
    innovation, posterior = update(prior, estimate)
    if innovation <= settings.gate:
        return Learned(Belief(posterior, belief.records + 1, t_s), estimate, Surprise.AGREES, innovation)
    if belief.rival is not None:
        rival = _against_rival(belief.rival, window, sign, settings, fit)
        if rival is not None:
            return Learned(Belief(rival.log, 2, t_s), rival, Surprise.CHANGED, innovation)
    alone = identify_window(window, sign, None, fit)
    kept = replace(belief, rival=alone.log if alone.identifiable else None)
    return Learned(kept, alone, Surprise.ODD, innovation)


def _first(estimate: ModelEstimate, t_s: float) -> Learned:
    """The first record of a region: believed when it is identifiable."""
    belief = Belief(estimate.log, 1, t_s) if estimate.identifiable else None
    return Learned(belief, estimate, Surprise.FIRST, 0.0)


def _against_rival(
    rival: LogModel, window: Window, sign: int, settings: TrackerSettings, fit: FitSettings
) -> ModelEstimate | None:
    """The estimate with the rival as prior, if the record agrees with it."""
    estimate = identify_window(window, sign, rival, fit)
    innovation, posterior = update(rival, estimate)
    return replace(estimate, log=posterior) if innovation <= settings.gate else None


def predicted(belief: Belief, t_s: float, settings: TrackerSettings) -> LogModel:
    """The belief at a later time: the same mean, a covariance grown by the random walk."""
    days = max(t_s - belief.t_s, 0.0) / SECONDS_PER_DAY
    kf = _filter(belief.log)
    kf.predict(Q=(settings.walk_per_day**2 * days + settings.scatter**2) * np.eye(3))
    return LogModel(kf.x[:, 0].copy(), kf.P.copy(), belief.log.sign)


def update(prior: LogModel, estimate: ModelEstimate) -> tuple[float, LogModel]:
    """Innovation statistic (chi-square with 3 degrees of freedom) and the posterior."""
    kf = _filter(prior)
    kf.update(estimate.score.reshape(3, 1), R=np.eye(3), H=estimate.information)
    y: FloatArray = kf.y
    statistic = float((y.T @ np.linalg.solve(kf.S, y))[0, 0])
    covariance = (kf.P + kf.P.T) / 2
    return statistic if math.isfinite(statistic) else math.inf, LogModel(kf.x[:, 0].copy(), covariance, prior.sign)


def _filter(log: LogModel) -> KalmanFilter:
    """A filterpy filter that stands where the estimate stands."""
    kf = KalmanFilter(dim_x=3, dim_z=3)
    kf.x = log.x.reshape(3, 1).copy()
    kf.P = log.p.copy()
    return kf
