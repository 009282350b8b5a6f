"""The open loop L = C G in factors, with its size and unwrapped phase at one frequency or many.

    L(s) = K (1 + b1 s + b2 s^2) prod(1 + lead s) / (s^m prod(1 + lag s) prod(1 + c1 s + c2 s^2))  e^(-theta s)

C = kp + ki/s + kd s/(1 + tau_f s) gives K, b1, b2, one s of s^m if there is integral action, and the lag tau_f.
The phase is a sum of arc tangents, so it is exact and needs no unwrapping however many turns the dead time makes.
"""

import cmath
import math
from typing import NamedTuple

import numpy as np

from retuner.adaptive.process.model import ComplexArray, LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains


class OpenLoop(NamedTuple):
    """L(s) as at the head of this file. A named tuple because on-line work makes one for every model it asks about.

    Parameters
    ----------
    k : K, of either sign. order : m, the number of poles at the origin (-1 for derivative action alone).
    b1, b2 : numerator of the controller. leads, lags : time constants in seconds. quadratics : pairs c1, c2.
    theta : dead time in seconds.
    """

    k: float
    order: int
    b1: float
    b2: float
    leads: tuple[float, ...]
    lags: tuple[float, ...]
    quadratics: tuple[tuple[float, float], ...]
    theta: float

    def at(self, w: float) -> complex:
        """L(jw) at one frequency in rad/s."""
        s = complex(0.0, w)
        value = self.k * (1 + s * (self.b1 + s * self.b2)) / s**self.order * cmath.rect(1.0, -self.theta * w)
        for lead in self.leads:
            value *= 1 + lead * s
        for lag in self.lags:
            value /= 1 + lag * s
        for c1, c2 in self.quadratics:
            value /= 1 + s * (c1 + s * c2)
        return value

    def along(self, w: FloatArray) -> ComplexArray:
        """L(jw) at frequencies w in rad/s, shape (n,)."""
        s = 1j * np.asarray(w, dtype=np.float64)
        value = self.k * (1 + s * (self.b1 + s * self.b2)) / s**self.order * np.exp(-self.theta * s)
        for lead in self.leads:
            value = value * (1 + lead * s)
        for lag in self.lags:
            value = value / (1 + lag * s)
        for c1, c2 in self.quadratics:
            value = value / (1 + s * (c1 + s * c2))
        return np.asarray(value, dtype=np.complex128)

    def log_size(self, w: FloatArray) -> FloatArray:
        """ln |L(jw)|, shape of w."""
        x = np.square(np.asarray(w, dtype=np.float64))
        value = math.log(abs(self.k)) - 0.5 * self.order * np.log(x)
        value = value + 0.5 * np.log((1 - self.b2 * x) ** 2 + self.b1**2 * x)
        for lead in self.leads:
            value = value + 0.5 * np.log1p(lead**2 * x)
        for lag in self.lags:
            value = value - 0.5 * np.log1p(lag**2 * x)
        for c1, c2 in self.quadratics:
            value = value - 0.5 * np.log((1 - c2 * x) ** 2 + c1**2 * x)
        return np.asarray(value, dtype=np.float64)

    def phase(self, w: FloatArray) -> FloatArray:
        """Unwrapped arg L(jw) in rad, shape of w; it begins at -m pi/2 (and pi more where K is negative)."""
        w = np.asarray(w, dtype=np.float64)
        value = -self.order * math.pi / 2 - self.theta * w + np.arctan2(self.b1 * w, 1 - self.b2 * w**2)
        for lead in self.leads:
            value = value + np.arctan(lead * w)
        for lag in self.lags:
            value = value - np.arctan(lag * w)
        for c1, c2 in self.quadratics:
            value = value - np.arctan2(c1 * w, 1 - c2 * w**2)
        return np.asarray(value + (math.pi if self.k < 0 else 0.0), dtype=np.float64)

    def log_size_at(self, w: float) -> float:
        """ln |L(jw)| at one frequency."""
        x = w * w
        value = math.log(abs(self.k)) - self.order * math.log(w)
        squares = ((1 - self.b2 * x) ** 2 + self.b1 * self.b1 * x) or 1e-300
        for lead in self.leads:
            squares *= 1 + lead * lead * x
        value += 0.5 * math.log(squares)
        for lag in self.lags:
            value -= 0.5 * math.log1p(lag * lag * x)
        for c1, c2 in self.quadratics:
            value -= 0.5 * math.log(((1 - c2 * x) ** 2 + c1 * c1 * x) or 1e-300)
        return value

    def phase_at(self, w: float) -> float:
        """Unwrapped arg L(jw) at one frequency, in rad."""
        value = -self.order * math.pi / 2 - self.theta * w + math.atan2(self.b1 * w, 1 - self.b2 * w * w)
        for lead in self.leads:
            value += math.atan(lead * w)
        for lag in self.lags:
            value -= math.atan(lag * w)
        for c1, c2 in self.quadratics:
            value -= math.atan2(c1 * w, 1 - c2 * w * w)
        return value + math.pi if self.k < 0 else value

    @property
    def excess(self) -> int:
        """Poles minus zeros: how |L| falls in the end, as w^-excess."""
        controller = 2 if self.b2 else 1 if self.b1 else 0
        return self.order + len(self.lags) + 2 * len(self.quadratics) - controller - len(self.leads)

    @property
    def high_gain(self) -> float:
        """lim |L| w^excess."""
        value = abs(self.k) * abs(self.b2 or self.b1 or 1.0)
        for lead in self.leads:
            value *= abs(lead)
        for lag in self.lags:
            value /= lag
        for _, c2 in self.quadratics:
            value /= c2
        return value

    @property
    def end_size(self) -> float:
        """lim |L|: 0, a number, or infinite for an improper loop."""
        return 0.0 if self.excess > 0 else self.high_gain if self.excess == 0 else math.inf

    def corners(self) -> list[float]:
        """Frequencies in rad/s between which the loop does all it does."""
        times = [self.theta, *self.lags, *(abs(x) for x in self.leads), abs(self.b1), math.sqrt(abs(self.b2))]
        times += [abs(self.b2 / self.b1)] if self.b1 else []
        times += [math.sqrt(c2) for _, c2 in self.quadratics] + [c1 for c1, _ in self.quadratics]
        found = [1 / x for x in times if x > 0]
        if self.order:
            found.append(abs(self.k) ** (1 / self.order))
        if self.excess:
            found.append(self.high_gain ** (1 / self.excess))
        return [x for x in found if 0 < x < math.inf] or [1.0]


def open_loop(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> OpenLoop:
    """L of a process under these gains.

    tau_f_s : filter time of the derivative in seconds.
    """
    kp, ki, kd = gains.kp, gains.ki, gains.kd
    filtered = kd != 0 and tau_f_s > 0
    if filtered:
        a0, a1, a2 = ki, kp + ki * tau_f_s, kd + kp * tau_f_s
    else:
        a0, a1, a2 = ki, kp, kd
    order = process.integrators + 1
    while a0 == 0:  # no integral action, or derivative alone: a zero at the origin takes away a pole there
        a0, a1, a2, order = a1, a2, 0.0, order - 1
    lags, pairs = process.lags_s, process.quadratics
    if pairs:
        lags = (*lags, *(c1 for c1, c2 in pairs if c2 == 0))
        pairs = tuple(pair for pair in pairs if pair[1])
    if filtered:
        lags = (*lags, tau_f_s)
    if not all(lags):
        lags = tuple(x for x in lags if x)
    leads = process.leads_s if all(process.leads_s) else tuple(x for x in process.leads_s if x)
    return OpenLoop(process.k * a0, order, a1 / a0, a2 / a0, leads, lags, pairs, process.theta_s)
