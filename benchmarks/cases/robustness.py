"""Stability, Ms and gain margin of a true loop, written apart from retuner's own margins, which are being judged.

    L = C G,   Ms = max 1/|1 + L|,   gain margin = least factor on L that reaches -1

Stable by the argument principle: with n poles of L at the origin and none to the right, arg(1 + L) grows by n pi/2 from
w = 0+ on (Astrom & Murray 2008, section 9.2). The dead time is exact.
"""

import math
from dataclasses import dataclass

import numpy as np

from cases.case import FloatArray
from retuner.adaptive.process.model import ComplexArray, LinearProcess
from retuner.schedule.gains import PidGains

POINTS_PER_DECADE = 150
DECADES_BEYOND = 3.0
TURN_OF_DELAY = 0.3
"""Largest turn of the dead time, rad, between two points of the grid while |L| is above SMALL."""
SMALL = 0.3


@dataclass(frozen=True, slots=True)
class Robustness:
    """ms is infinite for an unstable loop; gm is infinite where the loop never turns to -180 degrees."""

    ms: float
    gm: float

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""
        return math.isfinite(self.ms)


def robustness(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> Robustness:
    """Of a process under these gains; tau_f_s filters the derivative."""
    w = _grid(process, gains)
    loop = _loop(process, gains, tau_f_s, w)
    big = np.flatnonzero(np.abs(loop) > SMALL)
    if big.size and big[-1] == len(w) - 1 and abs(loop[-1]) >= 1:
        return Robustness(math.inf, 0.0)
    last = int(big[-1]) + 1 if big.size else 1
    if process.theta_s:
        step = TURN_OF_DELAY / process.theta_s
        count = int(min((w[last - 1] - w[0]) / step, 2e5)) + 1
        w = np.union1d(w, w[0] + step * np.arange(count))
        loop = _loop(process, gains, tau_f_s, w)
        last = int(np.flatnonzero(np.abs(loop) > SMALL)[-1]) + 1 if big.size else 1
    near = (1 + loop)[: min(last + 1, len(w))]
    turned = float(np.sum(np.angle(near[1:] / near[:-1]))) - float(np.angle(near[-1]))
    poles = process.integrators + (1 if gains.ki else 0)
    if abs(turned - poles * math.pi / 2) > math.pi / 2:
        return Robustness(math.inf, 0.0)
    return Robustness(_peak(process, gains, tau_f_s, w, loop), _gain_margin(loop))


def _loop(process: LinearProcess, gains: PidGains, tau_f_s: float, w: FloatArray) -> ComplexArray:
    s = 1j * w
    return (gains.kp + gains.ki / s + gains.kd * s / (1 + tau_f_s * s)) * process.response(w)


def _grid(process: LinearProcess, gains: PidGains) -> FloatArray:
    """Logarithmic, round every frequency of the loop."""
    times = [process.theta_s, *process.lags_s, *(abs(x) for x in process.leads_s)]
    times += [math.sqrt(c2) for _, c2 in process.quadratics]
    times += [abs(gains.kp / gains.ki)] if gains.ki and gains.kp else []
    corners = [1 / x for x in times if x > 0]
    corners += [
        abs(process.k * g) ** (1 / n)
        for g, n in ((gains.ki, process.integrators + 1), (gains.kp, process.integrators))
        if g and n
    ]
    low, high = math.log10(min(corners)) - DECADES_BEYOND, math.log10(max(corners)) + DECADES_BEYOND
    return np.logspace(low, high, int((high - low) * POINTS_PER_DECADE) + 1)


def _peak(process: LinearProcess, gains: PidGains, tau_f_s: float, w: FloatArray, loop: ComplexArray) -> float:
    """Largest |S|, looked at closely round the grid's best."""
    values = 1 / np.abs(1 + loop)
    i = int(np.argmax(values))
    fine = np.geomspace(w[max(i - 1, 0)], w[min(i + 1, len(w) - 1)], 60)
    return float(max(np.max(values), np.max(1 / np.abs(1 + _loop(process, gains, tau_f_s, fine)))))


def _gain_margin(loop: ComplexArray) -> float:
    """Between two points the crossing of the real axis is found on the straight line."""
    x, y = loop.real, loop.imag
    at = np.flatnonzero(y[:-1] * y[1:] < 0)
    crossing = x[at] - y[at] * (x[at + 1] - x[at]) / (y[at + 1] - y[at])
    inside = crossing[(crossing < 0) & (crossing > -1)]
    return float(1 / np.max(-inside)) if inside.size else math.inf
