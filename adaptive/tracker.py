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

All of this is kept per structure (fit/structure.py), each with the sum of what its records said for it, n ln sigma^2
plus the cost of loads and colour: information criteria add up, so the structure may change at any time and none is
discarded for good; what is known is that of the structure which leads.

A record that contradicts what is known is not believed at once: it is kept as a rival. When the next record agrees
with the rival better than with the belief, the process has changed (or the first record was wrong), and the rival
takes over; when it agrees with the belief, the odd record is forgotten.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from filterpy.kalman import KalmanFilter

from retuner.adaptive.belief import Belief, Known, RecordPoint, remembered
from retuner.adaptive.estimate import LogModel, ModelEstimate, proper_covariance
from retuner.adaptive.fit.candidate import Candidate
from retuner.adaptive.fit.refine import Prior
from retuner.adaptive.fit.update import with_priors
from retuner.adaptive.identify import FitSettings, estimate_of, fitted, identify_window
from retuner.adaptive.process import ProcessType
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
    gate : innovation statistic above which a record is odd, as the one-sided normal deviate of its probability; 2 to 6,
        default 4.5: what no structure explains of a real record passes 3.09 (99.9 % of chi-square) now and then, and a
        gain or delay that has doubled lies far beyond 4.5.
    most_lead : evidence by which a structure may lead at the most, so that another may take over; default 60.
    """

    walk_per_day: float = 0.1
    scatter: float = 0.12
    gate: float = 4.5
    most_lead: float = 60.0


@dataclass(frozen=True, slots=True)
class Learned:
    """Outcome of one record: the belief now, the estimate that the record gave, how it stood to the old belief."""

    belief: Belief | None
    estimate: ModelEstimate
    surprise: Surprise
    innovation: float


SECONDS_PER_DAY = 86400.0

Logs = Mapping[ProcessType, LogModel]


def learn(
    belief: Belief | None,
    window: Window,
    sign: int,
    settings: TrackerSettings,
    fit: FitSettings,
    at: tuple[float, float] = (0.0, 0.0),
) -> Learned:
    """Take one record of a region into what is known of it.

    Parameters
    ----------
    belief : what was known, None at first.
    window : the record. sign : of the process gain, from the controller's direction.
    at : where the record lay, in the table's scheduling variables.
    """
    t_s = float(window.t_s[-1])
    if belief is None or belief.log.sign != sign:
        return _first(identify_window(window, sign, None, fit), t_s, settings, at)
    means = {t: grown(log, t_s - belief.t_s, settings) for t, log in belief.logs().items()}
    priors = {t: scattered(log, settings) for t, log in means.items()}
    found = fitted(window, (sign,), fit)
    alone = estimate_of(found, float(window.t_s[0]), {}, fit)
    innovation, _ = update(priors[belief.log.type], alone)
    points = remembered(belief.points, RecordPoint(t_s, *at, alone.log, innovation))
    if innovation <= gate(len(belief.log.x), settings.gate):
        estimate = _updated(found, window, priors, fit)
        known = _taken_in(belief.known, means, priors, estimate, settings)
        taken = Belief(known, belief.records + 1, t_s, None, points, estimate.plausible)
        return Learned(taken, estimate, Surprise.AGREES, innovation)
    if belief.rival is not None:
        doubted = surprise_of(priors[belief.log.type], alone)
        confirmed = _against_rival(belief.rival, doubted, found, alone, window, settings, fit)
        if confirmed is not None:
            known, estimate = confirmed
            changed = Belief(known, 2, t_s, None, points[-2:], estimate.plausible)
            return Learned(changed, estimate, Surprise.CHANGED, innovation)
    kept = replace(belief, rival=_believed(alone, settings) if alone.identifiable else None, points=points)
    return Learned(kept, alone, Surprise.ODD, innovation)


def gate(freedom: int, deviate: float) -> float:
    """Chi-square value of the same probability as a normal deviate (Wilson & Hilferty 1931, equation 4)."""
    share = 2 / (9 * freedom)
    return float(freedom * (1 - share + deviate * math.sqrt(share)) ** 3)


def _first(estimate: ModelEstimate, t_s: float, settings: TrackerSettings, at: tuple[float, float]) -> Learned:
    """The first record of a region: believed when it is identifiable."""
    belief = None
    if estimate.identifiable:
        points = (RecordPoint(t_s, *at, estimate.log, 0.0),)
        belief = Belief(_believed(estimate, settings), 1, t_s, None, points, estimate.plausible)
    return Learned(belief, estimate, Surprise.FIRST, 0.0)


def _believed(estimate: ModelEstimate, settings: TrackerSettings) -> tuple[Known, ...]:
    """A record by itself as a belief: what it shows is the region's mean within the scatter."""
    return _led([Known(scattered(a.log, settings), a.evidence) for a in estimate.alternatives], estimate, settings)


def _taken_in(
    known: tuple[Known, ...], means: Logs, priors: Logs, estimate: ModelEstimate, settings: TrackerSettings
) -> tuple[Known, ...]:
    """Every structure updated by the record."""
    before = {k.log.type: k.evidence for k in known}
    after = []
    for alternative in estimate.alternatives:
        type_ = alternative.log.type
        _, posterior = update(priors[type_], estimate)
        log = back_to_mean(means[type_], priors[type_], posterior)
        after.append(Known(log, before[type_] + alternative.evidence))
    return _led(after, estimate, settings)


def _led(known: list[Known], estimate: ModelEstimate, settings: TrackerSettings) -> tuple[Known, ...]:
    """The leading structure first, the others no farther behind than is allowed."""

    def criterion(k: Known) -> float:
        return k.evidence + len(k.log.x) * math.log(estimate.best.samples)

    ranked = sorted(known, key=criterion)
    lead = criterion(ranked[0])
    return tuple(replace(k, evidence=k.evidence - max(criterion(k) - lead - settings.most_lead, 0.0)) for k in ranked)


def _updated(found: list[Candidate], window: Window, priors: Logs, fit: FitSettings) -> ModelEstimate:
    """The record's fits repeated with the priors in them."""
    known = {t: Prior.of(log.x, log.p) for t, log in priors.items()}
    return estimate_of(with_priors(found, known), float(window.t_s[0]), known, fit)


def _against_rival(
    rival: tuple[Known, ...],
    doubted: float,
    found: list[Candidate],
    alone: ModelEstimate,
    window: Window,
    settings: TrackerSettings,
    fit: FitSettings,
) -> tuple[tuple[Known, ...], ModelEstimate] | None:
    """The rival updated with the record, and the record's estimate, if the two agree."""
    means = {k.log.type: k.log for k in rival}
    priors = {t: scattered(log, settings) for t, log in means.items()}
    prior = priors[rival[0].log.type]
    innovation, _ = update(prior, alone)
    if innovation > gate(len(prior.x), settings.gate) or surprise_of(prior, alone) >= doubted:
        return None
    estimate = _updated(found, window, priors, fit)
    return _taken_in(rival, means, priors, estimate, settings), estimate


def grown(log: LogModel, elapsed_s: float, settings: TrackerSettings) -> LogModel:
    """The region's mean at a later time: where it was, a covariance grown by the random walk."""
    return _widened(log, settings.walk_per_day**2 * max(elapsed_s, 0.0) / SECONDS_PER_DAY)


def scattered(log: LogModel, settings: TrackerSettings) -> LogModel:
    """What one record may show when this is known of the mean, or the other way round."""
    return _widened(log, settings.scatter**2)


def predicted(belief: Belief, t_s: float, settings: TrackerSettings) -> LogModel:
    """The process as it may be met at a later time: the prior of the next fit, and what the guard has to prove for."""
    return scattered(grown(belief.log, t_s - belief.t_s, settings), settings)


def _widened(log: LogModel, variance: float) -> LogModel:
    """filterpy's prediction with F = I and Q = variance I."""
    kf = _filter(log)
    kf.predict(Q=variance * np.eye(len(log.x)))
    return replace(log, x=kf.x[:, 0].copy(), p=proper_covariance(kf.P))


def back_to_mean(mean: LogModel, prior: LogModel, posterior: LogModel) -> LogModel:
    """What a record's process says of the region's mean (see the head of this file)."""
    gain = mean.p @ np.linalg.inv(prior.p)
    p = mean.p + gain @ (posterior.p - prior.p) @ gain.T
    return replace(mean, x=mean.x + gain @ (posterior.x - mean.x), p=proper_covariance(p))


def update(prior: LogModel, estimate: ModelEstimate) -> tuple[float, LogModel]:
    """Innovation statistic (chi-square, one degree of freedom a parameter) and posterior for the prior's structure."""
    kf, d = _filter(prior), len(prior.x)
    record = estimate.of(prior.type)
    kf.update(record.score.reshape(d, 1), R=np.eye(d), H=record.information)
    y: FloatArray = kf.y
    statistic = float((y.T @ np.linalg.solve(kf.S, y))[0, 0])
    posterior = replace(prior, x=kf.x[:, 0].copy(), p=proper_covariance(kf.P))
    return statistic if math.isfinite(statistic) else math.inf, posterior


def surprise_of(prior: LogModel, alone: ModelEstimate) -> float:
    """-2 ln of the likelihood of a record under a prior, up to a constant: y' S^-1 y + ln det S + evidence.

    The determinant makes a vague prior pay for agreeing with everything; a rival must predict, not merely allow.
    """
    record = alone.of(prior.type)
    s = record.information @ prior.p @ record.information.T + np.eye(len(prior.x))
    y = record.score - record.information @ prior.x
    return float(y @ np.linalg.solve(s, y) + np.linalg.slogdet(s)[1]) + record.evidence


def _filter(log: LogModel) -> KalmanFilter:
    """A filterpy filter that stands where the estimate stands."""
    d = len(log.x)
    kf = KalmanFilter(dim_x=d, dim_z=d)
    kf.x = log.x.reshape(d, 1).copy()
    kf.P = log.p.copy()
    return kf
