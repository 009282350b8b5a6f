"""Robustness of a loop: stability, gain, phase and delay margin, Ms and Mt, with the dead time exact.

    L = C G,   S = 1 / (1 + L),   T = L / (1 + L),   Ms = max |S|,   Mt = max |T|

Stability by the argument principle: with n poles of L at the origin and none to the right, the closed loop is stable
when arg(1 + L) grows by n pi/2 from w = 0+ to infinity (Astrom & Murray 2008, section 9.2). No Pade approximation.
The grid only finds where the extremes and crossings are; each is then refined on ever finer grids round it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.process import ComplexArray, LinearProcess
from retuner.adaptive.sample import FloatArray
from retuner.schedule.gains import PidGains

POINTS_PER_DECADE = 80
"""Density of the first grid; a loop's arg(1 + L) turns by well under pi between two points."""
DECADES_BEYOND = 3.0
"""How far the grid goes beyond the slowest and the fastest frequency that the loop contains."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Robustness of one loop. Frequencies in rad/s; infinite where there is no crossing.

    stable : the closed loop is stable; if not, ms and mt are infinite and the margins are not to be used.
    ms, mt : maximum of the sensitivity and of the complementary sensitivity.
    gm : gain margin (factor). pm_deg : phase margin. delay_margin_s : dead time that may be added.
    w180, wc : first phase crossover, last gain crossover.
    """

    stable: bool
    ms: float
    mt: float
    gm: float
    pm_deg: float
    delay_margin_s: float
    w180: float
    wc: float

    def to_dict(self) -> dict[str, float | bool | None]:
        """Keys as in every JSON output; null where a value is infinite."""
        values = {
            "ms": self.ms,
            "mt": self.mt,
            "gm": self.gm,
            "pm_deg": self.pm_deg,
            "delay_margin": self.delay_margin_s,
            "w180": self.w180,
            "wc": self.wc,
        }
        finite: dict[str, float | bool | None] = {k: v if math.isfinite(v) else None for k, v in values.items()}
        return finite | {"stable": self.stable}


def controller_response(gains: PidGains, w: FloatArray, tau_f_s: float = 0.0) -> ComplexArray:
    """C(jw) of the feedback path, shape of w: kp + ki/s + kd s / (tau_f s + 1)."""
    s = 1j * w
    return np.asarray(gains.kp + gains.ki / s + gains.kd * s / (1 + tau_f_s * s), dtype=np.complex128)


def margins(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> Margins:
    """All margins of a process under these gains.

    tau_f_s : filter time of the derivative in seconds.
    """

    def loop(w: FloatArray) -> ComplexArray:
        return controller_response(gains, w, tau_f_s) * process.response(w)

    w = _grid(process, gains)
    l_jw = loop(w)
    if not _stable(process, gains, loop, w, l_jw):
        return Margins(
            stable=False, ms=math.inf, mt=math.inf, gm=0.0, pm_deg=0.0, delay_margin_s=0.0, w180=math.inf, wc=math.inf
        )
    ms = _peak(lambda x: 1 / np.abs(1 + loop(x)), w)
    mt = _peak(lambda x: np.abs(loop(x) / (1 + loop(x))), w)
    w180, gm = _gain_margin(loop, w, l_jw)
    wc, pm_rad, delay_s = _phase_margin(loop, w, l_jw)
    return Margins(
        stable=True, ms=ms, mt=mt, gm=gm, pm_deg=math.degrees(pm_rad), delay_margin_s=delay_s, w180=w180, wc=wc
    )


def sensitivity_peak(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> float:
    """Ms alone, infinite when the closed loop is unstable: what the guard asks for many models."""

    def loop(w: FloatArray) -> ComplexArray:
        return controller_response(gains, w, tau_f_s) * process.response(w)

    w = _grid(process, gains)
    if not _stable(process, gains, loop, w, loop(w)):
        return math.inf
    return _peak(lambda x: 1 / np.abs(1 + loop(x)), w)


def _grid(process: LinearProcess, gains: PidGains) -> FloatArray:
    """Logarithmic grid round every frequency that the loop contains."""
    times = [process.theta_s, *process.lags_s, *(abs(x) for x in process.leads_s)]
    if gains.kp:
        times += [abs(gains.kp / gains.ki) if gains.ki else 0.0, abs(gains.kd / gains.kp)]
    corners = [1 / x for x in times if x > 0]
    corners += [
        (abs(process.k * g)) ** (1 / n)
        for g, n in ((gains.ki, process.integrators + 1), (gains.kp, process.integrators))
        if g and n
    ]
    corners = corners or [1.0]
    low, high = math.log10(min(corners)) - DECADES_BEYOND, math.log10(max(corners)) + DECADES_BEYOND
    return np.logspace(low, high, int((high - low) * POINTS_PER_DECADE) + 1)


def _stable(
    process: LinearProcess,
    gains: PidGains,
    loop: Callable[[FloatArray], ComplexArray],
    w: FloatArray,
    l_jw: ComplexArray,
) -> bool:
    """Nyquist's criterion (see the head of this file)."""
    size = np.abs(l_jw)
    if size[-1] >= 1:  # the loop gain does not fall at high frequency: any delay makes this unstable
        return False
    last = min(int(np.flatnonzero(size >= 0.5)[-1]) + 2 if np.any(size >= 0.5) else 2, len(w) - 1)
    turned = _turn(loop, w[: last + 1], 1 + l_jw[: last + 1])
    end = float(np.angle(1 + l_jw[last]))  # from here on 1 + L stays right of the origin, and ends at arg 0
    poles_at_zero = process.integrators + (1 if gains.ki else 0)
    expected = poles_at_zero * math.pi / 2
    return abs(turned - end - expected) < math.pi / 2


def _turn(loop: Callable[[FloatArray], ComplexArray], w: FloatArray, f: ComplexArray) -> float:
    """Total change of arg f along the grid; steps of more than pi/2 are looked at more closely."""
    steps = np.angle(f[1:] / f[:-1])
    total = float(np.sum(steps))
    for i in np.flatnonzero(np.abs(steps) > math.pi / 2):
        fine = 1 + loop(np.geomspace(w[i], w[i + 1], 400))
        total += float(np.sum(np.angle(fine[1:] / fine[:-1]))) - float(steps[i])
    return total


def _peak(size: Callable[[FloatArray], FloatArray], w: FloatArray) -> float:
    """Largest value of size(w), refined round the best grid point (supremum at the ends included)."""
    values = size(w)
    for _ in range(4):
        i = int(np.argmax(values))
        w = np.geomspace(w[max(i - 1, 0)], w[min(i + 1, len(w) - 1)], 25)
        values = size(w)
    return float(np.max(values))


def _crossings(f: Callable[[FloatArray], FloatArray], w: FloatArray, values: FloatArray) -> list[float]:
    """Frequencies where f changes sign, refined."""
    found = []
    for i in np.flatnonzero(values[:-1] * values[1:] <= 0):
        low, high = float(w[i]), float(w[i + 1])
        for _ in range(5):
            fine = np.geomspace(low, high, 25)
            signs = np.signbit(f(fine))
            change = np.flatnonzero(signs[1:] != signs[:-1])
            if not change.size:
                break
            low, high = float(fine[change[0]]), float(fine[change[0] + 1])
        found.append(math.sqrt(low * high))
    return found


def _gain_margin(loop: Callable[[FloatArray], ComplexArray], w: FloatArray, l_jw: ComplexArray) -> tuple[float, float]:
    """First phase crossover and the smallest factor by which the gain may rise."""
    crossings = [x for x in _crossings(lambda v: loop(v).imag, w, l_jw.imag) if loop(np.array([x]))[0].real < 0]
    if not crossings:
        return math.inf, math.inf
    sizes = np.abs(loop(np.array(crossings)))
    above = [1 / x for x in sizes if x < 1]
    return crossings[0], float(min(above, default=math.inf))


def _phase_margin(
    loop: Callable[[FloatArray], ComplexArray], w: FloatArray, l_jw: ComplexArray
) -> tuple[float, float, float]:
    """Last gain crossover, smallest phase margin in rad, smallest dead time in s that may be added."""
    crossings = _crossings(lambda v: np.log(np.abs(loop(v))), w, np.log(np.abs(l_jw)))
    if not crossings:
        return math.inf, math.inf, math.inf
    phases = np.angle(-loop(np.array(crossings)))
    turns = [float(p) % (2 * math.pi) for p in phases]
    delay = min(p / x for p, x in zip(turns, crossings, strict=True))
    return crossings[-1], min(abs(float(p)) for p in phases), delay
