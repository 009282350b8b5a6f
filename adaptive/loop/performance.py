"""Performance of a loop: integrated absolute error and total variation of the output, for steps of setpoint and load.

    IAE = integral |r - y| dt,   TV = integral |du/dt| dt (jumps included),   J = 0.5 (IAE_ys/IAE_ys* + IAE_d/IAE_d*)

(Grimholt & Skogestad 2012, equations 5 and 6; IAE* belongs to the best PI controllers at Ms = 1.59, see optimum.py.)
The response is exact: collocation over each dead time, the matrix exponential without one.
As the error's integral z is a state, IAE is the total variation of z: the sum of |z| from one zero of
the error to the next. z stands still at these zeros, so they need not be known well for many digits of IAE.

The steps are of size 1, at the setpoint and at the process input; IAE of the load scales with the process gain.
With a derivative the setpoint's step makes an impulse in u (TV is infinite then): the literature's convention, where a
step of the setpoint is one of an output disturbance. derivative_on_setpoint=False is what controllers mostly do.
"""

import math

import numpy as np

from retuner.adaptive.loop.open_loop import gain_crossovers, grid, is_stable, open_loop
from retuner.adaptive.loop.simulate import DelaySteps, PlainSteps, cut_loop, delay_steps, plain_steps
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

# Total variation of the error's integral (IAE) and of the controller output (TV) along a step response.
#
# The first part of the response is gone through step by step. After that, windows of doubling length are accepted whole
# when the error and du/dt keep their signs and agree with the change of z and u (Simpson's rule), and halved otherwise
# (powers of the step matrix), so that slow tails cost little however short the dead time is.


FIRST_STEPS_LOG2 = 5  # 2^5 steps are gone through one by one
MOST_DOUBLINGS = 48  # windows at the most: 2^48 steps; a loop that has not settled then never will
SETTLED = 1e-8  # share of the sum that a window may add and still end the search
NEGLIGIBLE = 1e-9
"""Share of the sum below which a window is not looked at more closely; rounding makes it useless below."""
MOST_LOOKS = 6000  # windows looked at before the rest is accepted whole: only rounding asks for so many
AGREES = 0.05  # how far Simpson's rule may miss the change over a window that is accepted whole
ERROR, OUTPUT = 0, 1
Point = tuple[float, float]  # A value and its rate


@dataclass(frozen=True, slots=True)
class Variation:
    """error : IAE. output : total variation of u (infinite with an impulse in it)."""

    error: float
    output: float


def variation(
    process: LinearProcess,
    gains: PidGains,
    tau_f_s: float,
    setpoint: float,
    load: float,
    *,
    kick: bool,
    with_output: bool = True,
) -> Variation:
    """IAE and total variation of a stable loop whose error dies out.

    kick : the derivative acts on the setpoint's step. with_output : else TV is left out, as infinite.
    """
    # where there is no dead time, a time of the loop is the unit
    times = [*process.lags_s, *(math.sqrt(c2) for _, c2 in process.quadratics)]
    times += [gains.kp / gains.ki] if gains.ki else []
    unit_s = process.theta_s or max(times, default=0.0) or 1.0
    loop = cut_loop(process, gains, tau_f_s, unit_s)
    stepper: Stepper
    if process.theta_s:
        largest = float(np.max(np.abs(np.linalg.eigvals(loop.a)), initial=0.0))
        fastest = 1 / largest if largest > 1e-12 else math.inf  # time constant of the cut loop, in its unit
        stepper = _DelayStepper(delay_steps(loop, fastest, setpoint, load, kick=kick))
    else:
        stepper = _PlainStepper(plain_steps(loop, setpoint, load, kick=kick))
    impulse = kick and setpoint and loop.kd
    output = math.inf if impulse or not with_output else _total(stepper, OUTPUT)
    return Variation(_total(stepper, ERROR) * unit_s, output)


class _DelayStepper:
    """The simulation with dead time: one step is one dead time, looked at on fine points."""

    looks = 0

    def __init__(self, steps: DelaySteps) -> None:
        self.steps, self.step, self.length = steps, steps.step, 1.0
        self.spacing = steps.lengths[:, None] / (steps.area.shape[1] - 1)

    def _along(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """z, e, u, du/dt at the fine points, each (steps, elements, fine), for q of shape (steps, len(q))."""
        s = self.steps
        z, e, u, rate = (np.einsum("efs,ns->nef", m, q) for m in (s.area, s.error, s.output, s.rate))
        return z, e, u, rate

    def first(self) -> tuple[FloatArray, float, float]:
        rows = [self.steps.start]
        for i in range(1 << FIRST_STEPS_LOG2):
            rows.append(self.step @ rows[-1])
            if i == 0:
                rows[-1][-2] += self.steps.kick
        z, e, u, rate = self._along(np.array(rows[:-1]))
        ends = u.reshape(-1, u.shape[2])
        jumps = abs(float(ends[0, 0])) + float(np.sum(np.abs(ends[1:, 0] - ends[:-1, -1])))
        return rows[-1], _gain(z, e, self.spacing), _gain(u, rate, self.spacing) + jumps

    def over(self, q: FloatArray) -> tuple[float, float]:
        z, e, u, rate = self._along(q[None])
        ends = u[0]
        jumps = abs(float(ends[0, 0]) - float(q[-3])) + float(np.sum(np.abs(ends[1:, 0] - ends[:-1, -1])))
        return _gain(z, e, self.spacing), _gain(u, rate, self.spacing) + jumps

    def signals(self, q: FloatArray) -> tuple[Point, Point]:
        s = self.steps
        error = float(s.area[0, 0] @ q), float(s.error[0, 0] @ q)
        return error, (float(s.output[0, 0] @ q), float(s.rate_start @ q))


def _gain(value: FloatArray, rate: FloatArray, spacing: FloatArray) -> float:
    """Total variation of a value with known rate on fine points: monotone pieces between the zeros of the rate."""
    change = np.abs(np.diff(value, axis=-1))
    turning = rate[..., :-1] * rate[..., 1:] < 0
    if np.any(turning):
        before, after = rate[..., :-1][turning], rate[..., 1:][turning]
        to_zero = (np.broadcast_to(spacing, turning.shape)[turning]) * before / (before - after)
        top = value[..., :-1][turning] + 0.5 * before * to_zero
        change[turning] = np.abs(top - value[..., :-1][turning]) + np.abs(value[..., 1:][turning] - top)
    return float(np.sum(change))


def _gain_of_two(start: float, rate: float, end: float, last_rate: float, length: float) -> float:
    if rate * last_rate >= 0:
        return abs(end - start)
    top = start + 0.5 * rate * length * rate / (rate - last_rate)
    return abs(top - start) + abs(end - top)


class _PlainStepper:
    """Without dead time: steps so short that their ends say all."""

    looks = 0

    def __init__(self, steps: PlainSteps) -> None:
        self.steps, self.step, self.length = steps, steps.step, steps.length

    def first(self) -> tuple[FloatArray, float, float]:
        q, area, travel = self.steps.start, 0.0, abs(float(self.steps.output @ self.steps.start))
        for _ in range(1 << FIRST_STEPS_LOG2):
            gained = self.over(q)
            area, travel, q = area + gained[0], travel + gained[1], self.step @ q
        return q, area, travel

    def over(self, q: FloatArray) -> tuple[float, float]:
        start, end = self.signals(q), self.signals(self.step @ q)
        error, output = (_gain_of_two(*start[i], *end[i], self.length) for i in (ERROR, OUTPUT))
        return error, output

    def signals(self, q: FloatArray) -> tuple[Point, Point]:
        s = self.steps
        return (float(s.area @ q), float(s.error @ q)), (float(s.output @ q), float(s.rate @ q))


Stepper = _DelayStepper | _PlainStepper
"""A response by steps of the matrix `step`.

first : q after the first 2^FIRST_STEPS_LOG2 steps, and the variation of z and u until then. over : their variation
over the step from q. signals : z with its rate e, and u with its rate, at q.
"""


def _total(stepper: Stepper, signal: int) -> float:
    """IAE (signal ERROR) or TV (signal OUTPUT) in the stepper's unit of time."""
    powers, stepper.looks = [stepper.step], 0
    q, *gains = stepper.first()
    sum_ = gains[signal]
    for window in range(FIRST_STEPS_LOG2, MOST_DOUBLINGS):
        while len(powers) <= window:
            powers.append(powers[-1] @ powers[-1])
        gained, q = _over_window(stepper, powers, window, q, signal, sum_ * NEGLIGIBLE)
        sum_ += gained
        if gained <= SETTLED * sum_:
            return sum_
    return math.inf


def _over_window(
    stepper: Stepper, powers: list[FloatArray], j: int, q: FloatArray, signal: int, negligible: float
) -> tuple[float, FloatArray]:
    """Variation of z or u over 2^j steps from q, and q at the end."""
    if j == 0:
        return stepper.over(q)[signal], stepper.step @ q
    half = powers[j - 1] @ q
    end = powers[j - 1] @ half
    points = [stepper.signals(x)[signal] for x in (q, half, end)]
    stepper.looks += 1
    whole = _whole(points, stepper.length * 2.0**j, negligible)
    if whole is None and stepper.looks > MOST_LOOKS:
        whole = abs(points[2][0] - points[0][0])
    if whole is not None:
        return whole, end
    first, _ = _over_window(stepper, powers, j - 1, q, signal, negligible)
    second, _ = _over_window(stepper, powers, j - 1, half, signal, negligible)
    return first + second, end


def _whole(points: list[tuple[float, float]], length: float, negligible: float) -> float | None:
    """Variation over a window from values and rates at three points; None when it has to be looked at more closely."""
    start, middle, end = points
    rates = (start[1], middle[1], end[1])
    if max(map(abs, rates)) * length <= negligible:
        return abs(end[0] - middle[0]) + abs(middle[0] - start[0])
    if min(rates) < 0 < max(rates):
        return None
    change = end[0] - start[0]
    miss = change - length * (rates[0] + 4 * rates[1] + rates[2]) / 6
    return abs(change) if abs(miss) <= AGREES * abs(change) else None


@dataclass(frozen=True, slots=True)
class Performance:
    """What unit steps cost; infinite where the error never dies out, or where the loop is unstable.

    iae_setpoint : pv units times seconds per pv unit. iae_load : pv units times seconds per co unit at the input.
    tv_setpoint, tv_load : total variation of co per unit of the step.
    """

    iae_setpoint: float
    iae_load: float
    tv_setpoint: float
    tv_load: float

    def to_dict(self) -> dict[str, float | None]:
        """Keys iae_setpoint, iae_load, tv_setpoint, tv_load; null where infinite."""
        return plain_values(self, "iae_setpoint iae_load tv_setpoint tv_load")


NEVER = Variation(math.inf, math.inf)
NEEDLESS_DELAY = 1e-5  # Dead time over the inverse of the highest gain crossover below which it counts as a lag


def performance(
    process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0, *, derivative_on_setpoint: bool = True
) -> Performance:
    """IAE and TV of a step of the setpoint and of a load at the process's input, both of size 1.

    Parameters
    ----------
    process, gains : as for `margins`. tau_f_s : filter time of the derivative in seconds. derivative_on_setpoint :
        whether the derivative acts on the error, not on pv alone.

    Returns
    -------
    Performance
        IAE in pv units times seconds, TV in co units; infinite for a loop that is not stable.

    Raises
    ------
    ValueError
        The process has more zeros than poles, or as many and the derivative has no filter.
    """
    loop = open_loop(process, gains, tau_f_s)
    crossed = gain_crossovers(loop, grid(loop))
    if not is_stable(loop, crossed):
        return Performance(math.inf, math.inf, math.inf, math.inf)
    needless = loop.excess >= 1 and process.theta_s * max(crossed, default=0.0) <= NEEDLESS_DELAY
    if process.theta_s and needless:
        process = replace(process, theta_s=0.0, lags_s=(*process.lags_s, process.theta_s))
    setpoint = setpoint_variation(process, gains, tau_f_s, derivative_on_setpoint=derivative_on_setpoint)
    load = load_variation(process, gains, tau_f_s)
    return Performance(setpoint.error, load.error, setpoint.output, load.output)


def setpoint_variation(
    process: LinearProcess,
    gains: PidGains,
    tau_f_s: float = 0.0,
    *,
    derivative_on_setpoint: bool = True,
    with_output: bool = True,
) -> Variation:
    """IAE and TV of a unit setpoint step of a loop that is known to be stable; without TV it is faster."""
    if process.integrators + (1 if gains.ki else 0) == 0 or not (gains.kp or gains.ki):
        return NEVER  # an offset remains
    return variation(process, gains, tau_f_s, 1.0, 0.0, kick=derivative_on_setpoint, with_output=with_output)


def load_variation(
    process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0, *, with_output: bool = True
) -> Variation:
    """IAE and TV of a unit load step at the process input of a loop that is known to be stable."""
    if not gains.ki:
        return NEVER
    return variation(process, gains, tau_f_s, 0.0, 1.0, kick=False, with_output=with_output)


def weighted_cost(found: Performance, best_setpoint: float, best_load: float) -> float:
    """J of these numbers against the reference values IAE_ys*, IAE_d*.

    Raises ValueError: a reference is not positive and finite.
    """
    for value in (best_setpoint, best_load):
        if not 0 < value < math.inf:
            raise ValueError(f"reference IAE = {value} must be positive and finite")
    return 0.5 * (found.iae_setpoint / best_setpoint + found.iae_load / best_load)
