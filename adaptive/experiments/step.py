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
from enum import StrEnum
from itertools import pairwise

import numpy as np

from retuner.adaptive.experiments.plan import CLEAR_MOVE_STDS, crossing, peak, smoothed
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import Tuning, tuning
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

T1_SHARE = 1 - math.exp(-1 / 3)
T2_SHARE = 1 - math.exp(-1)
SAME_LEVEL = 0.05
"""co within this share of the step belongs to a level (a controller at rest passes noise on); more is another move."""
REST_SHARE = 0.1  # the final level is the mean over this last share of the record
DRIFT_SHARE, REST_DRIFT = 0.2, 0.05
"""pv is at rest when over the last fifth of the record it moves by less than this share of its change."""
SLOPE_ERROR = 0.05  # the steepest slope is taken over enough samples that noise moves it by about this share
RAMP_PART = 3
"""The slope of a ramp is taken over a third of the record: over a few samples the steepest is that with most noise."""
STARTED = 0.02  # the response has started at this share of its change, or at the edge of the noise where that is wider


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

    co_change, pv_change : A and B. pv_before : level of pv before it.
    t_s, pv : the record from the step on, time counted from it, pv smoothed just enough.
    sigma, sigma_left : standard deviation of pv's noise as recorded, and as smoothed.
    """

    co_change: float
    pv_change: float
    pv_before: float
    t_s: FloatArray
    pv: FloatArray
    sigma: float
    sigma_left: float


def step_response(window: Window, *, rest: bool = True) -> RecordedStep:
    """Find the step in a record.

    rest : whether pv has to have come to rest at the end.

    Raises ValueError: co does not make exactly one step, pv was not recorded before it, hardly answers, or has not come
    to rest.
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
    if abs(b) <= CLEAR_MOVE_STDS * sigma:
        raise ValueError(
            f"pv answers the step by {b:.3g}, and its noise has a standard deviation of {sigma:.2g}; make a larger step"
        )
    last = window.pv[-max(int(DRIFT_SHARE * (len(window.pv) - i)), 3) :]
    moved = float(np.polyfit(np.linspace(-0.5, 0.5, len(last)), last, 1)[0])
    if rest and abs(moved) > max(REST_DRIFT * abs(b), CLEAR_MOVE_STDS * sigma * math.sqrt(12 / len(last))):
        raise ValueError(
            f"pv has not come to rest: it still moves by {moved:.3g} over the last fifth of the record; "
            "record longer, or use the fit"
        )
    t = window.t_s[i:] - window.t_s[i]
    pv, left = smoothed(window.pv[i:], b)
    return RecordedStep(a, b, before, t, pv, sigma, left)


def model_by(method: StepMethod, response: RecordedStep) -> ProcessModel:
    """First order (for "slope" integrating) + dead time by a named method; see the head of this file.

    Raises ValueError: the response is faster than the samples.
    """
    if method == StepMethod.SLOPE:
        slope, t, pv = _steepest(response, len(response.t_s) // RAMP_PART)
        theta = max(t - (pv - response.pv_before) / slope, 0.0)
        return ProcessModel(ProcessType.INTEGRATING, slope / response.co_change, theta_s=theta)
    if method == StepMethod.TWO_POINT:
        t2 = _share_time(response, T2_SHARE)
        tau = 1.5 * (t2 - _share_time(response, T1_SHARE))
        theta = t2 - tau
    elif method == StepMethod.TANGENT:
        slope, t, pv = _steepest(response)
        tau, theta = response.pv_change / slope, t - (pv - response.pv_before) / slope
    elif method == StepMethod.REACTION_CURVE:
        tau, theta = response.pv_change / _steepest(response)[0], _start(response)
    else:
        theta = _start(response)
        tau = _share_time(response, T2_SHARE) - theta
    if tau <= 0:
        raise ValueError(f"{method}: the response is over within a sample; record faster")
    return ProcessModel(ProcessType.FOPDT, response.pv_change / response.co_change, tau, 0.0, max(theta, 0.0))


def _share_time(response: RecordedStep, share: float) -> float:
    level = response.pv_before + share * response.pv_change
    return crossing(response.t_s, response.pv, level, rising=response.pv_change > 0)


def _start(response: RecordedStep) -> float:
    """Time until the response starts: where it leaves the old level for good."""
    share = max(STARTED, min(CLEAR_MOVE_STDS * response.sigma_left / abs(response.pv_change), 0.5))
    return _share_time(response, share)


def _steepest(response: RecordedStep, fewest: int = 3) -> tuple[float, float, float]:
    """Steepest slope towards the new level with a point of its tangent: slope, time, pv.

    fewest : samples that the slope is taken over at least.
    A straight line is fitted to as few samples as keep the noise out of its slope, whose standard deviation is
    sigma sqrt(12)/(dt m^1.5) over m samples.
    """
    t, pv = response.t_s, response.pv
    dt = median(np.diff(t))
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


# ---- Closed-loop setpoint step under proportional control: the overshoot tells the process.
#
# Measured from the old level: dy_s the setpoint step, dy_p the first peak at t_p after it, dy_u the first undershoot.
#     dy_inf = 0.45 (dy_p + dy_u)   D = (dy_p - dy_inf)/dy_inf   B = |(dy_s - dy_inf)/dy_inf|   b = dy_inf/dy_s
#     A = 1.152 D^2 - 1.607 D + 1
# in two steps, a model:   r = 2 A/B,  k = 1/(Kc0 B),  theta = t_p (0.309 + 0.209 e^(-0.61 r)),  tau1 = r theta
# directly, PI settings:   Kc = Kc0 A/F,  tau_I = min(0.86 A |b/(1 - b)| t_p, 2.44 t_p F),  |b/(1 - b)| = 1/B
# (two-step: Skogestad & Grimholt 2012, section 5.3.2; direct: Shamsuzzoha & Skogestad 2010, eqs. 15 and 22.) F is 1
# here, which is about SIMC at tau_c = theta. Fitted to overshoots D of 0.1 to 0.6; 0.3 is recommended. Where pv
# reaches the setpoint (B near 0) the process integrates; the limits are theta = 0.309 t_p and
# k' = k/tau1 = 1/(2 A Kc0 theta).

LARGEST_D = 0.6  # largest overshoot for which the correlations were made (Shamsuzzoha & Skogestad 2010, section 3)
UNDERSHOOT_BY = 3.5
"""The first undershoot lies at about 2 t_p, and before this many t_p however strong the damping (delay and one lag)."""
LARGEST_UNDERSHOOT = 0.85
"""dy_u / dy_p above this: the overshoot is below about 0.15, and 0.45 (dy_p + dy_u) is no more the final level."""
INTEGRATING_B = 0.02
"""A steady offset below this share of the response cannot be told from none; tau1 would be beyond 40 theta."""


@dataclass(frozen=True, slots=True)
class Overshoot:
    """What is read off the response; in pv units and seconds, counted from the old level and the time of the step.

    dy_s, dy_p, dy_u : setpoint step, first peak, first undershoot. t_p_s : time of the peak.

    Raises ValueError: a number is not finite, or these are not a peak beyond its undershoot in the direction of the
    step.
    """

    dy_s: float
    dy_p: float
    dy_u: float
    t_p_s: float

    def __post_init__(self) -> None:
        for name in ("dy_s", "dy_p", "dy_u", "t_p_s"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)} is not a finite number")
        if self.dy_s == 0 or self.t_p_s <= 0:
            raise ValueError(f"dy_s = {self.dy_s}, t_p = {self.t_p_s}: there must be a step, and a peak after it")
        if not 0 < self.dy_u / self.dy_s < self.dy_p / self.dy_s:
            raise ValueError(
                f"dy_p = {self.dy_p:g}, dy_u = {self.dy_u:g}: the peak must lie beyond the undershoot, "
                "both on the side of the setpoint step"
            )

    @property
    def dy_inf(self) -> float:
        """Final level, without waiting for it."""
        return 0.45 * (self.dy_p + self.dy_u)

    @property
    def d(self) -> float:
        """Overshoot D."""
        return (self.dy_p - self.dy_inf) / self.dy_inf

    @property
    def b(self) -> float:
        """Relative offset B; 0 where pv reaches the setpoint."""
        return abs((self.dy_s - self.dy_inf) / self.dy_inf)

    @property
    def a(self) -> float:
        """The factor A(D)."""
        return 1.152 * self.d**2 - 1.607 * self.d + 1

    def valid(self) -> str:
        """Empty, or in one line why the correlations do not hold for this overshoot."""
        if self.dy_u / self.dy_p > LARGEST_UNDERSHOOT:
            return f"the peak is only {self.dy_p / self.dy_u:.2f} times the undershoot; repeat with a larger gain"
        if self.d > LARGEST_D:
            return f"overshoot {self.d:.0%} is beyond {LARGEST_D:.0%}; repeat with a smaller gain"
        return ""


def measure(window: Window) -> Overshoot:
    """Read peak and undershoot off a record with one setpoint step.

    Raises ValueError: the setpoint does not make exactly one step, or pv shows no peak after it, or the record ends
    soon after that.
    """
    moves = np.flatnonzero(np.diff(window.sp))
    if moves.size != 1:
        raise ValueError(f"the setpoint makes {moves.size} steps; this method needs exactly one")
    i = int(moves[0]) + 1
    dy_s = float(window.sp[i] - window.sp[i - 1])
    t = window.t_s[i:] - window.t_s[i]
    before = float(np.mean(window.pv[: i + 1]))
    sign = math.copysign(1.0, dy_s)
    raw = (window.pv[i:] - before) * sign
    y, left = smoothed(raw, float(np.ptp(raw)))
    clear = 2 * CLEAR_MOVE_STDS * max(left, noise_sigma(y))  # both ends of a move back are the extremes of many samples
    top = _first_peak(y, clear)
    if top is None:
        raise ValueError("pv shows no overshoot: no peak that it clearly comes back from; repeat with a larger gain")
    t_p, dy_p = _refined(t, y, top)
    end = int(np.searchsorted(t, UNDERSHOOT_BY * t_p))
    bottom = top + int(np.argmin(y[top:end]))
    if bottom == len(y) - 1:
        raise ValueError("pv still falls after its peak at the end of the record; record longer")
    _, under = _refined(t, -y, bottom)
    return Overshoot(dy_s, dy_p * sign, -under * sign, t_p)


def _first_peak(y: FloatArray, clear: float) -> int | None:
    """Index of the first largest value that y comes back from by more than the noise."""
    best = 0
    for i in range(len(y)):
        if y[i] > y[best]:
            best = i
        elif best > 0 and y[best] - y[i] > clear:
            return best
    return None


def _refined(t: FloatArray, y: FloatArray, i: int) -> tuple[float, float]:
    low = max(i - 1, 0)
    return peak(t[low : i + 2], y[low : i + 2])


def two_step_model(overshoot: Overshoot, kc0: float) -> ProcessModel:
    """First order + dead time (or integrating) from the response under gain kc0.

    Raises ValueError: kc0 is 0 or not finite, or the overshoot is outside the range of the correlations.
    """
    _check(overshoot, kc0)
    a, b, t_p = overshoot.a, overshoot.b, overshoot.t_p_s
    if b < INTEGRATING_B:
        theta = 0.309 * t_p
        return ProcessModel(ProcessType.INTEGRATING, 1 / (2 * a * kc0 * theta), theta_s=theta)
    r = 2 * a / b
    theta = t_p * (0.309 + 0.209 * math.exp(-0.61 * r))
    return ProcessModel(ProcessType.FOPDT, 1 / (kc0 * b), r * theta, 0.0, theta)


def direct_settings(overshoot: Overshoot, kc0: float) -> Tuning:
    """PI settings without a model, as those of SIMC at tau_c = theta (a detuning F of 1).

    Raises ValueError: kc0 is 0 or not finite, or the overshoot is outside the range of the correlations.
    """
    _check(overshoot, kc0)
    t_p, longest = overshoot.t_p_s, 2.44 * overshoot.t_p_s
    tau_i = min(0.86 * overshoot.a / overshoot.b * t_p, longest) if overshoot.b else longest
    return tuning("setpoint-overshoot", "series", kc0 * overshoot.a, tau_i, 0.0, None)


def _check(overshoot: Overshoot, kc0: float) -> None:
    """Refuse what the correlations say nothing about."""
    if not (math.isfinite(kc0) and kc0):
        raise ValueError(f"kc0 = {kc0}: give the proportional gain of the experiment, negative when reverse-acting")
    wrong = overshoot.valid()
    if wrong:
        raise ValueError(wrong)


# ---- Ultimate gain from the swing itself: period and decay of pv under proportional control (Ziegler & Nichols 1942).
#
# At the ultimate gain the swing neither grows nor dies: Ku is the controller's gain, Pu the period. Where the amplitude
# falls to a quarter in a period, gain and period are Kq and Pq of the quarter-decay rule (Harriott 1964).
# Periods are read between upward crossings of the mean; a crossing counts only after pv has been on the other side by
# more than the noise. The decay is the geometric mean of the ratios of successive half-heights.

FEWEST_PERIODS = 3  # whole periods from which a period and a decay are given
SUSTAINED = (0.9, 1.1)  # ratio of successive amplitudes within which a swing is sustained
QUARTER = (0.18, 0.35)  # ratio of successive amplitudes that counts as quarter decay


@dataclass(frozen=True, slots=True)
class Swing:
    """An oscillation of pv.

    period_s, period_std_s : mean and standard deviation over the periods. amplitude : half the height, mean.
    decay : ratio of one period's height to the one before. periods : how many.
    """

    period_s: float
    period_std_s: float
    amplitude: float
    decay: float
    periods: int

    @property
    def sustained(self) -> bool:
        """Whether it neither grows nor dies."""
        return SUSTAINED[0] <= self.decay <= SUSTAINED[1]

    @property
    def quarter_decay(self) -> bool:
        """Whether it dies by about a quarter a period."""
        return QUARTER[0] <= self.decay <= QUARTER[1]

    def verdict(self) -> str:
        """What the gain of the experiment was, in words."""
        if self.sustained:
            return "sustained: the gain is the ultimate gain Ku"
        if self.quarter_decay:
            return f"each swing is {self.decay:.2f} of the one before: quarter decay, the gain is Kq"
        if self.decay > 1:
            return f"each swing is {self.decay:.2f} times the one before: lower the gain towards Ku"
        return f"each swing is {self.decay:.2f} of the one before: raise the gain towards Ku"

    def to_dict(self) -> dict[str, float | int | bool]:
        """Keys as in the JSON output of `retuner experiment ultimate`."""
        names = "period=period_s period_std=period_std_s amplitude decay periods sustained quarter_decay"
        return plain_values(self, names)


def swing(window: Window) -> Swing:
    """Read period and decay off a record. Raises ValueError: pv does not swing, or for fewer than three periods."""
    # The level about which pv swings: the mean of the last half, where a start has died out
    level = float(np.mean(window.pv[len(window.pv) // 2 :]))
    t_s, y = window.t_s, window.pv - level
    band = CLEAR_MOVE_STDS * noise_sigma(y)
    times, indices = [], []  # of upward crossings of zero, the times interpolated
    armed = False
    for i in range(1, len(y)):
        if y[i] < -band or (band == 0 and y[i] < 0):
            armed = True
        if armed and y[i] >= band and y[i] > 0:
            j = i - int(np.argmax(y[i - 1 :: -1] <= 0))  # back to the sample after the last one below
            share = -y[j - 1] / (y[j] - y[j - 1]) if y[j] != y[j - 1] else 0.0
            times.append(float(t_s[j - 1] + share * (t_s[j] - t_s[j - 1])))
            indices.append(j)
            armed = False
    periods = np.diff(np.array(times))
    heights = np.array([float(np.ptp(window.pv[a:b])) / 2 for a, b in pairwise(indices)])
    whole = heights > 2 * CLEAR_MOVE_STDS * noise_sigma(window.pv)  # a swing in the noise shows no period any more
    last = len(whole) if np.all(whole) else int(np.argmin(whole))
    periods, heights = periods[:last], heights[:last]
    if last < FEWEST_PERIODS:
        raise ValueError(
            f"pv oscillates for {last} periods beyond its noise, and {FEWEST_PERIODS} are needed: record "
            "longer, or raise the gain"
        )
    decay = float((heights[-1] / heights[0]) ** (1 / (len(heights) - 1)))
    return Swing(float(np.mean(periods)), float(np.std(periods)), float(np.mean(heights)), decay, len(periods))
