"""The Kalman filter over one region's log-parameters, step by step; the filter is filterpy's, once per response.

    mu ~ N(m, P)                 the region's process, a random walk: P grows with time and with every record
    x = mu + e, e ~ N(0, s^2)    the process as one record shows it: the operating point is never quite the same
    z = R x + v, v ~ N(0, I)     the record, linearised at the optimum of its fit and compressed by QR

The filter predicts x (m, P + q + s^2), updates it with z, and takes what it learned back to mu (one step of the
Rauch-Tung-Striebel smoother, 1965): G = P (P + s^2)^-1, m+ = m + G (x+ - m), P+ = P + G (Px+ - P - s^2) G'. With s = 0
the two are one. Without s, records of setpoints and of loads, which every too simple structure sees differently, would
contradict each other for ever. The mean of a process that moves in one direction is moved on by steady_drift.py.
"""

import math
from dataclasses import replace

import numpy as np

from retuner.adaptive.identification.estimate import LogModel, ModelEstimate, proper_covariance
from retuner.adaptive.signals.sample import FloatArray


def widened(log: LogModel, variance: float) -> LogModel:
    """The prediction with F = I and Q = variance I, thousands of times a decision: P + Q, without a filter for it."""
    return replace(log, p=proper_covariance(log.p + variance * np.eye(len(log.x))))


def back_to_mean(mean: LogModel, prior: LogModel, posterior: LogModel) -> LogModel:
    """What a record's process says of the region's mean (see the head of this file)."""
    gain = mean.p @ np.linalg.inv(prior.p)
    p = proper_covariance(mean.p + gain @ (posterior.p - prior.p) @ gain.T)
    return replace(mean, x=mean.x + gain @ (posterior.x - prior.x), p=p)


def update(prior: LogModel, estimate: ModelEstimate) -> tuple[float, LogModel]:
    """Innovation statistic (chi-square, one degree of freedom a parameter) and posterior for the prior's structure."""
    from filterpy.kalman import KalmanFilter

    d = len(prior.x)
    kf = KalmanFilter(dim_x=d, dim_z=d)
    kf.x, kf.P = prior.x.reshape(d, 1).copy(), prior.p.copy()
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


def gate(freedom: int, deviate: float) -> float:
    """Chi-square value of the same probability as a normal deviate (Wilson & Hilferty 1931, equation 4)."""
    share = 2 / (9 * freedom)
    return float(freedom * (1 - share + deviate * math.sqrt(share)) ** 3)
