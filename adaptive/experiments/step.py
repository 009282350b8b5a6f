"""Open-loop step: first order + dead time read off the response by the methods with names.

    two-point       tau = 1.5 (T2 - T1),  theta = T2 - tau      T1, T2 at 28.3 and 63.2 % of the change
                    (Smith 1972; the lambda-tuning bump test: 28.3 % = 1 - e^(-1/3), 63.2 % = 1 - e^(-1))
    tangent         tau = B/S, theta where the tangent at the inflection leaves the old level (Ziegler & Nichols 1942)
    reaction-curve  tau = B/S, theta until the response starts                                (Cohen & Coon 1953)
    63-percent      theta until the response starts, tau the further time to 63.2 %           (Skogestad 2003)
    slope           integrating: k' = S/A, theta as for the tangent; takes a response that has not come to rest
                    (Ziegler & Nichols 1942: unit reaction rate and lag; Skogestad 2003: slope after take-off)

k = B/A with A the change of co, B that of pv, S the steepest slope. They need one clean step and, but for the last, a
response that has come to rest; the fit (identify) needs neither and says how sure it is, so it is the default and these
are for comparison.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from retuner.adaptive.experiments.plan import CLEAR, crossing, smoothed
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

T1_SHARE = 1 - math.exp(-1 / 3)
T2_SHARE = 1 - math.exp(-1)
SAME_LEVEL = 0.05
"""co within this share of the step belongs to a level (a controller at rest passes noise on); more is another move."""
REST_SHARE = 0.1
"""The final level is the mean over this last share of the record."""
DRIFT_SHARE, REST_DRIFT = 0.2, 0.05
"""pv is at rest when over the last fifth of the record it moves by less than this share of its change."""
SLOPE_ERROR = 0.05
"""The steepest slope is taken over enough samples that noise moves it by about this share."""
RAMP_PART = 3
"""The slope of a ramp is taken over a third of the record: over a few samples the steepest is that with most noise."""
STARTED = 0.02
"""The response has started at this share of its change, or at the edge of the noise where that is wider."""


class StepMethod(StrEnum):
    """Graphical methods under the names that the command line uses."""

    TWO_POINT = "two-point"
    TANGENT = "tangent"
    REACTION_CURVE = "reaction-curve"
    PERCENT_63 = "63-percent"
    SLOPE = "slope"


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """One clean step and the response to it.

    at_s : time of the step. co_change, pv_change : A and B. pv_before, pv_after : levels of pv.
    t_s, pv : the record from the step on, time counted from it, pv smoothed just enough.
    sigma, sigma_left : standard deviation of pv's noise as recorded, and as smoothed.
    """

    at_s: float
    co_change: float
    pv_change: float
    pv_before: float
    pv_after: float
    t_s: FloatArray
    pv: FloatArray
    sigma: float
    sigma_left: float


def step_response(window: Window, *, rest: bool = True) -> RecordedStep:
    """Find the step in a record.

    rest : whether pv has to have come to rest at the end.

    Raises
    ------
    ValueError
        co does not make exactly one step, pv was not recorded before it, hardly answers, or has not come to rest.
    """
    # Index of the first sample with the new co
    change = float(window.co[-1] - window.co[0])
    if change == 0:
        raise ValueError("co ends where it began: this record has no step; the fit takes any move")
    near_old = np.abs(window.co - window.co[0]) <= SAME_LEVEL * abs(change)
    near_new = np.abs(window.co - window.co[-1]) <= SAME_LEVEL * abs(change)
    i = int(np.argmax(~near_old))
    if i < 1 or not (np.all(near_old[:i]) and np.all(near_new[i:])):
        raise ValueError("co makes more than one step; the graphical methods need exactly one, the fit takes any move")
    a = float(np.mean(window.co[i:]) - np.mean(window.co[:i]))
    sigma = noise_sigma(window.pv)
    # what pv reads at the step's own sample it owes to the output before it
    before = float(np.mean(window.pv[: i + 1]))
    tail = window.pv[-max(int(REST_SHARE * (len(window.pv) - i)), 2) :]
    after = float(np.mean(tail))
    b = after - before
    if abs(b) <= CLEAR * sigma:
        raise ValueError(
            f"pv answers the step by {b:.3g}, and its noise has a standard deviation of {sigma:.2g}; make a larger step"
        )
    last = window.pv[-max(int(DRIFT_SHARE * (len(window.pv) - i)), 3) :]
    moved = float(np.polyfit(np.linspace(-0.5, 0.5, len(last)), last, 1)[0])
    if rest and abs(moved) > max(REST_DRIFT * abs(b), CLEAR * sigma * math.sqrt(12 / len(last))):
        raise ValueError(
            f"pv has not come to rest: it still moves by {moved:.3g} over the last fifth of the record; "
            "record longer, or use the fit"
        )
    t = window.t_s[i:] - window.t_s[i]
    pv, left = smoothed(window.pv[i:], b)
    return RecordedStep(float(window.t_s[i]), a, b, before, after, t, pv, sigma, left)


def model_by(method: StepMethod, response: RecordedStep) -> ProcessModel:
    """First order (for "slope" integrating) + dead time by a named method; see the head of this file.

    Raises
    ------
    ValueError
        The response is faster than the samples.
    """
    if method == StepMethod.SLOPE:
        slope, t, pv = _steepest(response, len(response.t_s) // RAMP_PART)
        theta = max(t - (pv - response.pv_before) / slope, 0.0)
        return ProcessModel(ProcessType.INTEGRATING, slope / response.co_change, theta_s=theta)
    work = {
        StepMethod.TWO_POINT: _two_point,
        StepMethod.TANGENT: _tangent,
        StepMethod.REACTION_CURVE: _reaction_curve,
        StepMethod.PERCENT_63: _percent_63,
    }
    tau, theta = work[method](response)
    if tau <= 0:
        raise ValueError(f"{method}: the response is over within a sample; record faster")
    return ProcessModel(ProcessType.FOPDT, response.pv_change / response.co_change, tau, 0.0, max(theta, 0.0))


def _share_time(response: RecordedStep, share: float) -> float:
    """Time after the step at which a share of the change has happened."""
    level = response.pv_before + share * response.pv_change
    return crossing(response.t_s, response.pv, level, rising=response.pv_change > 0)


def _two_point(response: RecordedStep) -> tuple[float, float]:
    t1, t2 = _share_time(response, T1_SHARE), _share_time(response, T2_SHARE)
    tau = 1.5 * (t2 - t1)
    return tau, t2 - tau


def _percent_63(response: RecordedStep) -> tuple[float, float]:
    theta = _start(response)
    return _share_time(response, T2_SHARE) - theta, theta


def _tangent(response: RecordedStep) -> tuple[float, float]:
    slope, t, pv = _steepest(response)
    return response.pv_change / slope, t - (pv - response.pv_before) / slope


def _reaction_curve(response: RecordedStep) -> tuple[float, float]:
    return response.pv_change / _steepest(response)[0], _start(response)


def _start(response: RecordedStep) -> float:
    """Time until the response starts: where it leaves the old level for good."""
    share = max(STARTED, min(CLEAR * response.sigma_left / abs(response.pv_change), 0.5))
    return _share_time(response, share)


def _steepest(response: RecordedStep, fewest: int = 3) -> tuple[float, float, float]:
    """Steepest slope towards the new level with a point of its tangent: slope, time, pv.

    fewest : samples that the slope is taken over at least.
    A straight line is fitted to as few samples as keep the noise out of its slope, whose standard deviation is
    sigma sqrt(12)/(dt m^1.5) over m samples.
    """
    t, pv = response.t_s, response.pv
    dt = float(np.median(np.diff(t)))
    rise = max(1.5 * (_share_time(response, T2_SHARE) - _share_time(response, T1_SHARE)), dt)
    wanted = (math.sqrt(12) * response.sigma * rise / (SLOPE_ERROR * abs(response.pv_change) * dt)) ** (2 / 3)
    m = int(min(max(fewest, min(max(3.0, wanted), max(rise / (2 * dt), 3.0))), len(t)))
    best = (0.0, 0.0, 0.0)
    sign = math.copysign(1.0, response.pv_change)
    for i in range(len(t) - m + 1):
        part_t, part = t[i : i + m], pv[i : i + m]
        middle, level = float(np.mean(part_t)), float(np.mean(part))
        slope = float((part_t - middle) @ (part - level) / ((part_t - middle) @ (part_t - middle)))
        if slope * sign > best[0] * sign:
            best = (slope, middle, level)
    return best
