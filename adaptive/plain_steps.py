"""Exact stepping of a loop without dead time: the matrix exponential of the closed loop, as a matrix on q = (X, 1)."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from retuner.adaptive.closed_loop import CutLoop
from retuner.adaptive.sample import FloatArray

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
    return PlainSteps(expm(rate * length), error, area, output, output @ rate, length, start)
