"""The response of a loop to unit steps of setpoint and load, exact at every point that is drawn."""

import math
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.closed_loop import cut_loop
from retuner.adaptive.delay_steps import delay_steps
from retuner.adaptive.plain_steps import plain_steps
from retuner.adaptive.process import LinearProcess
from retuner.adaptive.sample import FloatArray
from retuner.schedule.gains import PidGains

POINTS = 600
"""Points drawn, about."""
FINEST = 400
"""Dead times up to which the response is drawn within each dead time too."""


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

    Raises
    ------
    ValueError
        until_s is not positive and finite, or the process has more zeros than poles.
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
