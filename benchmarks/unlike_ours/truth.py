"""What is true of a loop: stability, Ms and J, from the exact process; and what a PI controller could do there.

Stability by Mikhailov's criterion on den(s) den_c(s) (1 + L(s)), Ms on a grid of frequencies, both with half a sample
of dead time for the hold. J = mean of the IAE after a setpoint and after a load step over those of the reference. The
reference is the PI controller of least J among those of Ms 1.55 (or 5 % over the least possible, where that is more).
In spec: Ms <= max(1.8, 1.03 reference's), J <= 1.25.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import polynomial

from unlike_ours.process import Array, Linear, LinearLive

MS_AIM, MS_LIMIT, J_LIMIT = 1.55, 1.8, 1.25


@dataclass(frozen=True)
class Tuned:
    """A controller: parallel gains, filter of the derivative, setpoint weight, derivative on the error."""

    kp: float
    ki: float
    kd: float = 0.0
    tau_f: float = 0.0
    b: float = 1.0


@dataclass(frozen=True)
class Found:
    """ms : infinite when unstable. j : relative to the reference."""

    ms: float
    j: float


class Truth:
    """The truth about one process, sampled at dt."""

    def __init__(self, process: Linear, dt: float) -> None:
        self.process, self.dt = process.later(dt / 2), dt
        self.plain = process
        self.w = grid(self.process)
        self.g = self.process.at(self.w)
        self.known: dict[Tuned, Found] = {}
        self.iae: dict[tuple[Tuned, float], tuple[float, float]] = {}
        self.horizon = 0.0
        sign = float(np.sign(self.process.num[0]))
        w_c = cross(self.w, sign * self.g)
        size = 1 / abs(np.interp(w_c, self.w, np.abs(self.g)))
        kps = sign * size * np.logspace(-1.8, 0.3, 50)
        found: list[tuple[float, Tuned]] = []
        for ti in np.logspace(-0.5, 2.0, 14) / w_c:
            found += [(self.ms(t), t) for t in (Tuned(float(kp), float(kp / ti)) for kp in kps)]
        least = min(ms for ms, _ in found)
        aim = max(MS_AIM, 1.05 * least)
        by_ti: dict[float, Tuned] = {}
        for ms, tuned in found:
            key = round(tuned.kp / tuned.ki, 9)
            if ms <= aim and (key not in by_ti or abs(tuned.kp) > abs(by_ti[key].kp)):
                by_ti[key] = tuned
        self.horizon = 60 / w_c
        rows = [(tuned, self._iaes(tuned)) for tuned in by_ti.values()]
        low = [min(iaes[i] for _, iaes in rows) for i in (0, 1)]
        best = min(rows, key=lambda row: row[1][0] / low[0] + row[1][1] / low[1])[0]
        c = best.kp + best.ki / (1j * self.w)
        s = 1 / np.abs(1 + self.g * c)
        self.best, self.w_peak, self.ms_best = best, float(self.w[int(np.argmax(s))]), float(s.max())
        self.ms_limit = max(MS_LIMIT, 1.03 * self.ms_best)

    @property
    def scale(self) -> float:
        """Effective dead time, seconds: one over the frequency where the reference's sensitivity peaks."""
        return 1.0 / self.w_peak

    def of(self, tuned: Tuned) -> Found:
        """What these gains do."""
        if tuned not in self.known:
            ms, j = self.ms(tuned), math.inf
            if math.isfinite(ms):
                best = self._iaes(replace(self.best, b=tuned.b))
                j = sum(a / b for a, b in zip(self._iaes(tuned), best, strict=True)) / 2
            self.known[tuned] = Found(ms, j)
        return self.known[tuned]

    def in_spec(self, tuned: Tuned) -> bool:
        """Whether both limits are met."""
        found = self.of(tuned)
        return found.ms <= self.ms_limit and found.j <= J_LIMIT

    def ms(self, tuned: Tuned) -> float:
        """Peak of the sensitivity; infinite when unstable."""
        s = 1j * self.w
        den_c = polynomial.polymul((0.0, 1.0), (1.0, tuned.tau_f)) if tuned.ki else np.array([1.0, tuned.tau_f])
        c = tuned.kp + (tuned.ki / s) + tuned.kd * s / (tuned.tau_f * s + 1)
        one = 1 + self.g * c
        if unstable(one, s, self.process.den, den_c):
            return math.inf
        return float(np.max(1 / np.abs(one)))

    def _iaes(self, tuned: Tuned) -> tuple[float, float]:
        """After a setpoint and after a load step of one."""
        slow = 8 * abs(tuned.kp / tuned.ki) if tuned.ki else 0.0
        gain = abs(self.process.num[0] / self.process.den[0]) if self.process.den[0] else math.inf
        slow += 6 / abs(gain * tuned.ki) if tuned.ki and math.isfinite(gain) else 0.0
        horizon = max(self.horizon, min(slow, 40 * self.horizon))
        dt = max(self.dt, horizon / 3000)
        key = (tuned, dt)
        if key not in self.iae:
            after_sp, after_load = (simulated(self.plain, tuned, dt, int(horizon / dt), which) for which in (1, 0))
            self.iae[key] = (after_sp, after_load)
        return self.iae[key]


def simulated(process: Linear, tuned: Tuned, dt: float, n: int, setpoint: int) -> float:
    """IAE after a step of one in the setpoint, or else in the load."""
    live = LinearLive(process, dt)
    total = pv = integral = rate = 0.0
    last, sp, d = 0.0, float(setpoint), float(1 - setpoint)
    for _ in range(n):
        rate = (tuned.tau_f * rate + pv - last) / (tuned.tau_f + dt)
        last = pv
        u = tuned.kp * (tuned.b * sp - pv) + integral - tuned.kd * rate
        integral += tuned.ki * (sp - pv) * dt
        total += abs(sp - pv)
        pv = live.move(u, d)
        if abs(pv) > 1e6:
            return math.inf
    return total * dt


def grid(process: Linear) -> Array:
    """Frequencies, rad/s, dense enough for the dead time."""
    roots = np.abs(np.concatenate([polynomial.polyroots(process.den), polynomial.polyroots(process.num)]))
    roots = roots[roots > 1e-12]
    times = [*(1 / roots), max(process.theta, 1e-9)]
    low, high = 0.001 / max(times), 60 / max(min(times), 0.02 * max(process.theta, *times))
    even = np.linspace(low, min(high, 60 / max(process.theta, 1e-9)), 500)
    return np.unique(np.concatenate([np.logspace(math.log10(low), math.log10(high), 500), even]))


def cross(w: Array, g: Array) -> float:
    """Where the phase has fallen to -150 degrees: a scale of frequency for any process. g : of a positive gain."""
    phase = np.unwrap(np.angle(g))
    top = int(np.argmax(phase[: np.flatnonzero(phase >= phase.max() - 1e-9)[-1] + 1]))
    phase -= 2 * math.pi * round(float(phase[top]) / (2 * math.pi))
    below = np.flatnonzero(phase[top:] < math.radians(-150))
    return float(w[top + below[0]] if len(below) else w[len(w) // 2])


def unstable(one: Array, s: Array, den: tuple[float, ...], den_c: Array) -> bool:
    """Mikhailov: den den_c (1 + L) turns by a quarter of a turn for each of its roots on the left."""
    whole = polynomial.polyval(s, polynomial.polymul(den, np.trim_zeros(den_c, "b")))
    order = len(den) + len(np.trim_zeros(den_c, "b")) - 2
    turned = np.unwrap(np.angle(whole * one))
    return round((order * math.pi / 2 - float(turned[-1] - turned[0])) / math.pi) > 0
