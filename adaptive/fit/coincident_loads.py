"""Load steps that stand where a setpoint change could have done it, and the model without them.

A load step bought exactly at a setpoint change explains the closed loop's response to it, and leaves the process free
to become a fiction: dead times of minutes in flow loops, each variant sure of itself. What a record says of its process
counts only where a model without such loads says the same:

    coincident    s_j in [t_k - max(3 Ts, T*/2), t_k + theta + max(3 Ts, T*)],   T* = min(T, 5 % of the record)
                  t_k a setpoint change, T the sum of the lags; four times the lag where the process integrates as well
    apart         D = max(|ln kp1/kp2|, |ln ki1/ki2|, |ln theta_e1/theta_e2| / 1.4),   theta_e = theta + tau2/2 + Ts/2
                  kp and ki of the settings that follow

A long dead time widens its own interval, so a fiction cannot move its loads out of it. Which of the two models is right
the record does not say: true loads that fall together with a setpoint change look the same.
"""

import math

import numpy as np
import numpy.typing as npt

from retuner.adaptive.fit.structure import LAG, SECOND, THETA
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

LEAST_CHANGE, LEAST_SIGMAS = 0.02, 2.0
"""A setpoint change counts from this share of pv's range, and from so many standard deviations of its noise."""
MOST_CHANGES = 0.1
"""A setpoint that changes in a larger share of the samples moves all the time: there are no instants to stand at."""
NEAR_SAMPLES = 3.0
"""Sampling intervals round a setpoint change that are as good as the change itself."""
LONGEST_LAG = 0.05
"""Lags count up to this share of the record, or the interval would cover all of it."""
LAG_OF_INTEGRATOR = 4.0
"""The lag of an integrating process counts so many times: its closed loop answers that much later."""
SLACK_OF_TIMES = 1.4
"""Dead times are known less well than gains: their ratio counts by this much less."""


def setpoint_changes(window: Window) -> tuple[float, ...]:
    """Instants of the setpoint changes, s from the window's first sample."""
    steps = np.diff(window.sp)
    changed = steps != 0
    if np.mean(changed) > MOST_CHANGES:
        return ()
    least = max(LEAST_CHANGE * float(np.ptp(window.pv)), LEAST_SIGMAS * noise_sigma(window.pv))
    at = np.flatnonzero(np.abs(steps) > least) + 1
    return tuple((window.t_s[at] - window.t_s[0]).tolist())


def are_coincident(
    type_: ProcessType, x: FloatArray, instants_s: FloatArray, changes_s: tuple[float, ...], span_s: float, dt_s: float
) -> npt.NDArray[np.bool_]:
    """Which of the instants stand at a setpoint change.

    Parameters
    ----------
    type_, x : structure and parameters of the process. instants_s : of load steps. changes_s : of the setpoint.
    span_s, dt_s : length and sampling interval of the record.
    """
    if type_ in LAG:
        lag = math.exp(x[LAG[type_]])
    else:
        lag = LAG_OF_INTEGRATOR * math.exp(x[SECOND[type_]]) if type_ in SECOND else 0.0
    return near(instants_s, changes_s, min(lag, LONGEST_LAG * span_s), math.exp(x[THETA]), dt_s)


def near(
    instants_s: FloatArray, changes_s: tuple[float, ...], lag_s: float, theta_s: float, dt_s: float
) -> npt.NDArray[np.bool_]:
    """Which of the instants lie within the interval round a setpoint change, see the head of this file."""
    before = max(NEAR_SAMPLES * dt_s, lag_s / 2)
    after = theta_s + max(NEAR_SAMPLES * dt_s, lag_s)
    since = np.asarray(instants_s)[..., None] - np.asarray(changes_s)
    inside: npt.NDArray[np.bool_] = ((since >= -before) & (since <= after)).any(axis=-1)
    return inside


def apart(one: ProcessModel, other: ProcessModel, dt_s: float) -> float:
    """D: how far the settings and the dead times of two models lie apart, as a logarithm; infinite for opposite signs.

    dt_s : sampling interval, half of which counts as dead time.
    """
    first, second = (without_second_lag(model).seen_by_controller(dt_s) for model in (one, other))
    ratios = [
        first.theta_s / second.theta_s,
        *(getattr(simc(first).gains, g) / getattr(simc(second).gains, g) for g in ("kp", "ki")),
    ]
    if min(ratios) <= 0:
        return math.inf
    times, *gains = (abs(math.log(ratio)) for ratio in ratios)
    return max(times / SLACK_OF_TIMES, *gains)
