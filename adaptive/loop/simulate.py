"""Exact stepping of a loop with dead time: one dead time after the other (the method of steps).

Within one dead time the process input is known, since it left the controller a dead time earlier, so the states follow
a linear differential equation with a given input. It is solved by Radau collocation of order 2p - 1 on elements graded
towards the start of the step, where fast lags leave their boundary layers. All of it is linear, so one dead time
is one matrix on the vector

    q = (X, u at all nodes of the last dead time, weight of the impulse waiting, 1)

and powers of that matrix step as far as one likes. Nothing is approximated but by polynomials of high degree: the error
is far below 1e-6 (Bellen & Zennaro, Numerical methods for delay differential equations, 2003, chapter 4).
"""

import math
from functools import cache
from operator import mul
from typing import NamedTuple

import numpy as np

from retuner.adaptive.process.model import LinearProcess, exponentials, state_space
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

# A closed loop, cut open at the dead time:  dX/dt = A X + B v + R r,  u = U X + V v + W r,  y = C X + D v.
#
# X holds the process states, the integral z of the error, and the derivative's filter state; v is what arrives at the
# process a dead time after it left the controller, plus the load. Time counts in units of unit_s.
#
#     e = r - y,   dz/dt = e,   u = kp e + ki z + kd de/dt    (with filter: kd (e - x_f)/tau_f, dx_f/dt = (e -
# x_f)/tau_f)
#
# Without a filter the derivative of a step is an impulse of weight kd: `impulse` is how one impulse in v makes the next
# in u, -kd C B. The setpoint's own step makes the first one when the derivative acts on the error, as in the
# literature.


@dataclass(frozen=True, slots=True)
class CutLoop:
    """See the head of this file; n states, of which z is the one with index `z`.

    a, b, r : (n, n), (n,), (n,). c, d : output. u, v, w : controller output. impulse, kd : as above (kd 0 with filter).
    """

    a: FloatArray
    b: FloatArray
    r: FloatArray
    c: FloatArray
    d: float
    u: FloatArray
    v: float
    w: float
    z: int
    kd: float
    impulse: float


def cut_loop(process: LinearProcess, gains: PidGains, tau_f_s: float, unit_s: float) -> CutLoop:
    """The loop, cut open.

    Raises ValueError: the process has more zeros than poles; or it answers at once (as many zeros as poles) and the
    derivative has no filter, so the controller output would not be a function.
    """
    plant = state_space(process, unit_s)
    kp, ki, kd, tau_f = gains.kp, gains.ki * unit_s, gains.kd / unit_s, tau_f_s / unit_s
    filtered = kd != 0 and tau_f > 0
    if kd and not filtered and plant.d:
        raise ValueError("derivative action on a process that answers at once needs a filter time; give tau_f")
    m = len(plant.b)
    n = m + 1 + filtered
    a, b, r, c, u = np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    a[:m, :m], b[:m], c[:m] = plant.a, plant.b, plant.c
    a[m], b[m], r[m] = -c, -plant.d, 1.0
    u[m] = ki
    u -= kp * c
    v, w = -kp * plant.d, kp
    if filtered:
        a[n - 1], b[n - 1], r[n - 1] = -c / tau_f, -plant.d / tau_f, 1 / tau_f
        a[n - 1, n - 1] -= 1 / tau_f
        u += kd * a[n - 1]
        v, w = v + kd * b[n - 1], w + kd * r[n - 1]
        return CutLoop(a, b, r, c, plant.d, u, v, w, m, 0.0, 0.0)
    straight = float(c @ b)
    u -= kd * (c @ a)
    return CutLoop(a, b, r, c, plant.d, u, v - kd * straight, w, m, kd, -kd * straight)


NODES = 9  # nodes p in an element
FINE = 33  # points in an element at which signals are looked at
LAYER = 3.0  # first element over the fastest time constant; 9 nodes resolve exp(-3 x) to 1e-9
GRADING = 4.0  # ratio of the lengths of neighbouring elements
FASTEST = 1e-5  # time constants below this share of the dead time are not resolved; they hold no area worth counting


@dataclass(frozen=True, slots=True)
class Collocation:
    """Matrices of an element of length 1: from values at the p nodes to the integral there, and to fine points.

    integral : (p, p). fine, slope, sums : (FINE, p) value, derivative and integral at the fine points.
    """

    integral: FloatArray
    fine: FloatArray
    slope: FloatArray
    sums: FloatArray


@cache
def collocation() -> Collocation:
    """Radau IIA nodes (zeros of P_p - P_{p-1}, right end included) and their matrices, by Legendre polynomials."""
    from numpy.polynomial import legendre  # beside its use: few commands step a loop

    zeros = legendre.legroots(np.concatenate([np.zeros(NODES - 1), [-1.0, 1.0]]))
    x = np.sort(np.real(zeros))
    values = legendre.legvander(x, NODES - 1)
    unit = np.eye(NODES)
    points, integrals = np.linspace(-1, 1, FINE), [legendre.legint(row, lbnd=-1) for row in unit]
    integral = np.array([legendre.legval(x, row) for row in integrals]).T / 2
    sums = np.array([legendre.legval(points, row) for row in integrals]).T / 2
    slopes = np.array([legendre.legval(points, legendre.legder(row)) for row in unit]).T * 2
    inverse = np.linalg.inv(values)
    fine = legendre.legvander(points, NODES - 1)
    return Collocation(integral @ inverse, fine @ inverse, slopes @ inverse, sums @ inverse)


def elements(fastest: float) -> FloatArray:
    """Lengths of the elements of one dead time (sum 1) when the fastest time constant is this share of it."""
    length = LAYER * max(fastest, FASTEST)
    if length >= 1:
        return np.array([1.0])
    count = max(1, math.ceil(math.log(1 / length, GRADING)))
    edges = np.concatenate([[0.0], np.geomspace(length, 1.0, count + 1)])
    return np.diff(edges)


@dataclass(frozen=True, slots=True)
class DelaySteps:
    """One dead time as matrices on q (see the head of this file).

    step : q to the next q. error, area, output, rate : (elements, FINE, len(q)) e, z, u and du/dt at the fine points.
    rate_start : (len(q),) du/dt at the start of the dead time, free of the rounding that a short element makes.
    lengths : (elements,). start : q at time 0. kick : weight of the impulse that leaves the controller at time 0.
    """

    step: FloatArray
    error: FloatArray
    area: FloatArray
    output: FloatArray
    rate: FloatArray
    rate_start: FloatArray
    lengths: FloatArray
    start: FloatArray
    kick: float


def delay_steps(loop: CutLoop, fastest: float, setpoint: float, load: float, *, kick: bool) -> DelaySteps:
    """The matrices for a step of the setpoint and of the load; time in dead times.

    fastest : smallest time constant of loop.a. kick : the derivative acts on the setpoint's step too.
    """
    c, lengths, n = collocation(), elements(fastest), len(loop.b)
    size = n + len(lengths) * NODES + 2
    x = np.zeros((n, size))  # the states as a function of q
    x[:, :n] = np.eye(n)
    x[:, size - 2] = loop.b
    constant = np.zeros(size)
    constant[-1] = setpoint
    errors, areas, outputs = [], [], []
    for i, h in enumerate(lengths):
        v = np.zeros((NODES, size))
        v[:, n + i * NODES : n + (i + 1) * NODES] = np.eye(NODES)
        v[:, -1] = load
        states = _element(loop, x, v, float(h), setpoint)
        error = constant - np.tensordot(loop.c, states, (0, 1)) - loop.d * v
        errors.append(c.fine @ error)
        areas.append(x[loop.z] + h * (c.sums @ error))
        outputs.append(np.tensordot(loop.u, states, (0, 1)) + loop.v * v + loop.w * constant)
        x = states[-1]
    # q to the next q, from the states at the end of the dead time and the output at all its nodes
    step = np.zeros((size, size))
    step[:n], step[n : size - 2], step[-1, -1] = x, np.concatenate(outputs), 1.0
    step[size - 2, size - 2] = loop.impulse
    return DelaySteps(
        step=step,
        error=np.stack(errors),
        area=np.stack(areas),
        output=np.stack([c.fine @ output for output in outputs]),
        rate=np.stack([(c.slope / h) @ output for h, output in zip(lengths, outputs, strict=True)]),
        rate_start=_rate_at_start(loop, float(lengths[0]), size, setpoint, load),
        lengths=lengths,
        start=np.eye(size)[-1],
        kick=loop.kd * setpoint if kick else 0.0,
    )


def _rate_at_start(loop: CutLoop, h: float, size: int, setpoint: float, load: float) -> FloatArray:
    """du/dt at the start of the dead time from the differential equation: U dX/dt + V dv/dt."""
    c, n = collocation(), len(loop.b)
    x, v, slope = np.zeros((n, size)), np.zeros(size), np.zeros(size)
    x[:, :n], x[:, size - 2] = np.eye(n), loop.b
    v[n : n + NODES], v[-1] = c.fine[0], load
    slope[n : n + NODES] = c.slope[0] / h
    moving = loop.a @ x + np.outer(loop.b, v)
    moving[:, -1] += loop.r * setpoint
    return np.asarray(loop.u @ moving + loop.v * slope, dtype=np.float64)


def _element(loop: CutLoop, x: FloatArray, v: FloatArray, h: float, setpoint: float) -> FloatArray:
    """States at the nodes, (NODES, n, len(q)), from the states x at the element's start and the input v there."""
    q = collocation().integral
    n, size = x.shape
    forced = np.einsum("i,jk->jik", loop.b, v)
    forced[:, :, -1] += loop.r * setpoint
    right = np.broadcast_to(x, (NODES, n, size)) + h * np.tensordot(q, forced, (1, 0))
    left = np.eye(NODES * n) - h * np.kron(q, loop.a)
    solved = np.linalg.solve(left, right.reshape(NODES * n, size))
    return np.asarray(solved.reshape(NODES, n, size), dtype=np.float64)


# Exact stepping of a loop without dead time: the matrix exponential of the closed loop, as a matrix on q = (X, 1).


STEP_SHARE = 0.02
"""Step over the inverse of the fastest closed-loop pole: an extreme within a step is then missed by 1e-6 at most."""


@dataclass(frozen=True, slots=True)
class PlainSteps:
    """One short step as a matrix on q = (X, 1).

    step : q to the next q. error, area, output, rate : rows that give e, z, u, du/dt.
    length : of the step, in the unit. start : q just after time 0.
    """

    step: FloatArray
    error: FloatArray
    area: FloatArray
    output: FloatArray
    rate: FloatArray
    length: float
    start: FloatArray


def plain_steps(loop: CutLoop, setpoint: float, load: float, *, kick: bool) -> PlainSteps:
    """The matrices for a step of setpoint and load; kick : the derivative acts on the setpoint's step too."""
    n = len(loop.b)
    gain = 1 / (1 - loop.v)  # u = U X + W r + V (u + load), solved for u
    output = np.append(gain * loop.u, gain * (loop.w * setpoint + loop.v * load))
    v_row = output.copy()
    v_row[-1] += load
    rate = np.zeros((n + 1, n + 1))
    rate[:n, :n] = loop.a
    rate[:n] += np.outer(loop.b, v_row)
    rate[:n, -1] += loop.r * setpoint
    error = -np.append(loop.c, 0.0) - loop.d * v_row
    error[-1] += setpoint
    length = STEP_SHARE / max(float(np.max(np.abs(np.linalg.eigvals(rate)))), 1e-12)
    start = np.zeros(n + 1)
    start[-1] = 1.0
    if kick and loop.kd:
        start[:n] = loop.b * loop.kd * setpoint * gain
    area = np.zeros(n + 1)
    area[loop.z] = 1.0
    return PlainSteps(exponentials(rate[None] * length)[0], error, area, output, output @ rate, length, start)


# The response of a loop to unit steps of setpoint and load, exact at every point that is drawn.


POINTS = 600  # points drawn, about
FINEST = 400  # dead times up to which the response is drawn within each dead time too


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Time in seconds, process value and controller output, each of shape (n,), for a unit step."""

    t: FloatArray
    pv: FloatArray
    co: FloatArray


def step_response(
    process: LinearProcess, gains: PidGains, until_s: float, tau_f_s: float = 0.0, *, load: bool = False
) -> StepResponse:
    """Response to a unit step of the setpoint, or of the load at the process input, from rest.

    A derivative without filter acts on the process value only, since the impulse of a setpoint's step cannot be drawn.

    Raises ValueError: until_s is not positive and finite, or the process has more zeros than poles.
    """
    if not 0 < until_s < math.inf:
        raise ValueError(f"until_s = {until_s} must be positive and finite")
    setpoint, disturbance = (0.0, 1.0) if load else (1.0, 0.0)
    if not process.theta_s:
        loop = cut_loop(process, gains, tau_f_s, until_s)
        plain = plain_steps(loop, setpoint, disturbance, kick=False)
        rows, q = np.stack([plain.error, plain.output]), plain.start
        e, u, t = _sampled(plain.step, rows, q, 1 / plain.length)
        return StepResponse(t * until_s * plain.length, setpoint - e, u)
    loop = cut_loop(process, gains, tau_f_s, process.theta_s)
    rates = np.abs(np.linalg.eigvals(loop.a))
    fastest = 1 / max(float(np.max(rates)), 1e-9)
    steps = delay_steps(loop, fastest, setpoint, disturbance, kick=False)
    count = until_s / process.theta_s
    if count > FINEST:
        rows = np.stack([steps.error[0, 0], steps.output[0, 0]])
        e, u, t = _sampled(steps.step, rows, steps.start, count)
    else:
        states = [steps.start]
        for _ in range(math.ceil(count) - 1):
            states.append(steps.step @ states[-1])
        along = np.array(states)
        e, u = (np.einsum("efs,ns->nef", m, along).ravel() for m in (steps.error, steps.output))
        within = np.linspace(0, 1, steps.error.shape[1])
        edges = np.cumsum(steps.lengths) - steps.lengths
        once = (edges[:, None] + steps.lengths[:, None] * within).ravel()
        t = (np.arange(len(states))[:, None] + once).ravel()
    late = process.theta_s if load else 0.0  # the load passes the dead time before anything is seen
    return StepResponse(t * process.theta_s + late, setpoint - e, u)


def _sampled(
    step: FloatArray, rows: FloatArray, q: FloatArray, count: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Signals at about POINTS multiples of the step up to count steps: two signals and the number of the step."""
    stride = max(1, round(count / POINTS))
    jump = np.linalg.matrix_power(step, stride)
    states = [q]
    for _ in range(min(math.ceil(count / stride), 2 * POINTS)):
        states.append(jump @ states[-1])
    signals = rows @ np.array(states).T
    return signals[0], signals[1], stride * np.arange(len(states), dtype=np.float64)


# ---- A process stepped from sample to sample under an output that is held between them: exact, dead time included.
#
#     x+ = Phi x + G1 u[k-d] + G0 u[k-d+1],   pv = C x + D u(t - theta)
#
# Phi, G0, G1 from the matrix exponential; theta = (d - 1) dt + theta', 0 < theta' <= dt, so the delayed input changes
# once within the sample, theta' after its start (Astrom & Wittenmark, Computer-Controlled Systems, section 2.3).

ROUNDING = 1e-9  # share of a sample by which a dead time may miss a whole number of samples and still count as whole


class HeldMatrices(NamedTuple):
    """The matrices of the head of this file: phi (n, n), g1, g0, c (n,), d, and d of the delay in samples."""

    phi: FloatArray
    g1: FloatArray
    g0: FloatArray
    c: FloatArray
    d: float
    delay: int


class HeldInput:
    """A linear process at rest, about the operating point pv = 0, co = 0.

    process : the process. dt_s : sampling interval, seconds, more than 0.

    Raises ValueError: dt_s is not positive and finite, or the process has more zeros than poles.
    """

    def __init__(self, process: LinearProcess, dt_s: float) -> None:
        if not 0.0 < dt_s < math.inf:
            raise ValueError(f"dt_s = {dt_s} must be a positive finite number of seconds")
        space = state_space(process, dt_s)
        samples = max(math.ceil(process.theta_s / dt_s - ROUNDING), 1)
        late = min(max(process.theta_s / dt_s - (samples - 1), 0.0), 1.0)
        phi_late, g_late = held_over(space.a, space.b, late)
        phi_rest, g_rest = held_over(space.a, space.b, 1.0 - late)
        self.matrices = HeldMatrices(phi_rest @ phi_late, phi_rest @ g_late, g_rest, space.c, space.d, samples)
        """What it steps with: in plain numbers, which is faster than arrays of a few states."""
        self._rows = list(zip(*(part.tolist() for part in self.matrices[:3]), strict=True))
        self._out: list[float] = space.c.tolist()
        self._x = [0.0] * len(space.b)
        self._inputs = [0.0] * samples
        self._at = 0

    def step(self, co: float) -> float:
        """Hold co for one interval; pv at its end."""
        old, x = self._inputs[self._at], self._x
        self._inputs[self._at] = co
        self._at = (self._at + 1) % len(self._inputs)
        new = self._inputs[self._at]
        self._x = [sum(map(mul, row, x)) + g1 * old + g0 * new for row, g1, g0 in self._rows]
        return float(sum(map(mul, self._out, self._x)) + self.matrices.d * new)


def held_over(a: FloatArray, b: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """exp(A h) and its integral times B over a length h: the augmented exponential of Van Loan (1978).

    a : (n, n). b : (n,) of one input, or (n, m) of several.
    """
    n, m = len(b), b.reshape(len(b), -1).shape[1] if b.size else 1
    augmented = np.zeros((n + m, n + m))
    augmented[:n, :n], augmented[:n, n:] = a, b.reshape(n, m)
    whole = exponentials(augmented[None] * length)[0]
    return whole[:n, :n], whole[:n, n:].reshape(b.shape)
