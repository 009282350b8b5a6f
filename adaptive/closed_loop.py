"""A closed loop, cut open at the dead time:  dX/dt = A X + B v + R r,  u = U X + V v + W r,  y = C X + D v.

X holds the process states, the integral z of the error, and the derivative's filter state; v is what arrives at the
process a dead time after it left the controller, plus the load. Time counts in units of unit_s.

    e = r - y,   dz/dt = e,   u = kp e + ki z + kd de/dt    (with filter: kd (e - x_f)/tau_f, dx_f/dt = (e - x_f)/tau_f)

Without a filter the derivative of a step is an impulse of weight kd: `impulse` is how one impulse in v makes the next
in u, -kd C B. The setpoint's own step makes the first one when the derivative acts on the error, as in the literature.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.process import LinearProcess
from retuner.adaptive.sample import FloatArray
from retuner.adaptive.state_space import state_space
from retuner.schedule.gains import PidGains


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

    Raises
    ------
    ValueError
        The process has more zeros than poles; or it answers at once (as many zeros as poles) and the derivative has no
        filter, so the controller output would not be a function.
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
