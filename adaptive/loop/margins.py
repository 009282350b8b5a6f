"""Robustness of a loop: stability, gain, phase and delay margin, Ms and Mt, with the dead time exact.

    L = C G,   S = 1 / (1 + L),   T = L / (1 + L),   Ms = max |S|,   Mt = max |T|

No Pade approximation. Crossovers are found on L's closed-form size and phase (open_loop.py), stability follows from
them (stability.py). A grid only finds where the peaks of |S| and |T| are; each is then refined. The limits at zero and
infinite frequency count too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.loop.open_loop import (
    PHASE_AT_INFINITY,
    OpenLoop,
    gain_crossovers,
    grid,
    is_stable,
    open_loop,
    phase_crossovers,
)
from retuner.adaptive.loop.sensitivity import falling_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

EDGE = 50.0
"""Ms from which its digits say nothing: the loop is at the edge of instability, its gain margin at most some 1.02."""
PEAKS_LOOKED_AT = 6
"""How many local peaks of the grid are refined, from the highest down."""
ZOOMS, ZOOM_POINTS = 5, 21
"""Refinements of a peak: each cuts its bracket to a tenth, so the value is right to about 1e-10."""
ZOOM_SHARES = np.linspace(0.0, 1.0, ZOOM_POINTS)
"""Where the points of a refinement lie in their bracket, in logarithms."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Robustness of one loop. Frequencies in rad/s; infinite where there is no crossing.

    stable : the closed loop is stable; if not, ms and mt are infinite and the margins are not to be used.
    ms, mt : maximum of the sensitivity and of the complementary sensitivity.
    gm : factor by which the gain may rise. pm_deg : smallest phase margin. delay_margin_s : dead time to spare.
    w180 : phase crossover at which gm is read. wc : gain crossover at which pm_deg is read.
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
        """Keys as in every JSON output; null where a value is infinite, and for all of an unstable loop."""
        values = {
            "ms": self.ms,
            "mt": self.mt,
            "gm": self.gm,
            "pm_deg": self.pm_deg,
            "delay_margin": self.delay_margin_s,
            "w180": self.w180,
            "wc": self.wc,
        }
        known: dict[str, float | bool | None] = {
            name: value if self.stable and math.isfinite(value) else None for name, value in values.items()
        }
        return known | {"stable": self.stable}


UNSTABLE = Margins(
    stable=False, ms=math.inf, mt=math.inf, gm=0.0, pm_deg=0.0, delay_margin_s=0.0, w180=math.inf, wc=math.inf
)


def margins(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> Margins:
    """All margins of a process under these gains.

    Parameters
    ----------
    process : as ProcessModel.linear() or LinearProcess gives it. gains : of the controller, co units per pv unit.
    tau_f_s : filter time of the derivative in seconds.

    Returns
    -------
    Margins
        Ms, Mt, gain margin, phase margin in degrees and delay margin in seconds; `stable` is False for a loop without
        them.

    Examples
    --------
    >>> from retuner import LinearProcess, PidGains
    >>> round(margins(LinearProcess(k=2.0, lags_s=(30.0,), theta_s=5.0), PidGains(1.5, 0.05)).ms, 2)
    1.59
    """
    loop = open_loop(process, gains, tau_f_s)
    w = grid(loop)
    crossed = gain_crossovers(loop, w)
    if not is_stable(loop, crossed):
        return UNSTABLE
    w180s = phase_crossovers(loop, w)
    at_zero, at_end = _ends(loop)
    points = np.sort(np.concatenate([w, crossed, w180s]))
    ms = _peak(lambda x: 1 / np.abs(1 + loop.along(x)), points, at_zero[0], at_end[0])
    mt = _peak(lambda x: 1 / np.abs(1 + 1 / loop.along(x)), points, at_zero[1], at_end[1])
    w180, gm = _gain_margin(loop, w180s)
    wc, pm_rad, delay_s = _phase_margin(loop, crossed)
    return Margins(
        stable=True, ms=ms, mt=mt, gm=gm, pm_deg=math.degrees(pm_rad), delay_margin_s=delay_s, w180=w180, wc=wc
    )


def sensitivity_peak(process: LinearProcess, gains: PidGains, tau_f_s: float = 0.0) -> float:
    """Ms alone, infinite when the closed loop is unstable: what the guard asks for many models."""
    loop = open_loop(process, gains, tau_f_s)
    quick = falling_peak(loop)
    if quick is not None:
        return quick
    w = grid(loop)
    crossed = gain_crossovers(loop, w)
    if not is_stable(loop, crossed):
        return math.inf
    points = np.sort(np.concatenate([w, crossed, phase_crossovers(loop, w)]))
    at_zero, at_end = _ends(loop)
    return _peak(lambda x: 1 / np.abs(1 + loop.along(x)), points, at_zero[0], at_end[0])


def gain_margin(process: LinearProcess, gains: PidGains) -> float:
    """GM alone, 0 when the closed loop is unstable."""
    loop = open_loop(process, gains)
    w = grid(loop)
    return _gain_margin(loop, phase_crossovers(loop, w))[1] if is_stable(loop, gain_crossovers(loop, w)) else 0.0


def _ends(loop: OpenLoop) -> tuple[tuple[float, float], tuple[float, float]]:
    """|S| and |T| at zero frequency, and their largest values in the limit of high frequency."""
    if loop.order > 0:
        zero = (0.0, 1.0)
    else:
        start = loop.k if loop.order == 0 else 0.0
        zero = (1 / abs(1 + start), abs(start / (1 + start)))
    size = loop.end_size
    if size == math.inf:
        return zero, (0.0, 1.0)
    if loop.theta or size == 0:
        return zero, (1 / (1 - size), size / (1 - size))
    sign = math.cos(loop.phase_at(PHASE_AT_INFINITY * max(loop.corners())))
    end = math.copysign(size, sign)
    return zero, (1 / abs(1 + end), abs(end / (1 + end)))


def _peak(size: Callable[[FloatArray], FloatArray], w: FloatArray, *limits: float) -> float:
    """Largest value of size(w): the highest local peaks of the points, refined, and the limits at the ends.

    Infinite where a value is not a number: Python's max passes over one, and what cannot be told would be robust.
    """
    values = size(w)
    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    highest = inner[np.argsort(values[inner])[::-1][:PEAKS_LOOKED_AT]]
    found = [*limits, float(np.max(values))]
    for i in highest:
        fine, heights = w[i - 1 : i + 2], values[i - 1 : i + 2]
        for _ in range(ZOOMS):
            j = int(np.argmax(heights))
            low, high = float(fine[max(j - 1, 0)]), float(fine[min(j + 1, len(fine) - 1)])
            fine = low * (high / low) ** ZOOM_SHARES  # np.geomspace looks at its arguments for longer than it computes
            heights = size(fine)
        found.append(float(np.max(heights)))
    return math.inf if any(map(math.isnan, found)) else max(found)


def _gain_margin(loop: OpenLoop, crossings: list[float]) -> tuple[float, float]:
    """Smallest factor by which the gain may rise, and the phase crossover where it would do harm."""
    sizes = [(abs(loop.at(w)), -w) for w in crossings]
    size, minus_w = max((pair for pair in sizes if pair[0] < 1), default=(0.0, -math.inf))
    if loop.theta and loop.end_size > size:
        return math.inf, 1 / loop.end_size
    return -minus_w, 1 / size if size else math.inf


def _phase_margin(loop: OpenLoop, crossings: list[float]) -> tuple[float, float, float]:
    """Gain crossover, smallest phase margin in rad, smallest dead time in s that may be added."""
    if not crossings:
        return math.inf, math.inf, 0.0 if loop.end_size >= 1 else math.inf
    angles = [math.atan2(-value.imag, -value.real) for value in map(loop.at, crossings)]
    pm, wc = min((abs(angle), w) for angle, w in zip(angles, crossings, strict=True))
    delay = min(angle % (2 * math.pi) / w for angle, w in zip(angles, crossings, strict=True))
    return wc, pm, 0.0 if loop.end_size >= 1 else delay


# Ultimate gain and period of a process: where a proportional controller brings it to the limit of stability.
#
# Exact: w180 is found on the closed-form phase, with the dead time in it.
#
# Ku = 1 / |G(j w180)|,   Pu = 2 pi / w180,   w180 the crossover of phase -180 degrees with the largest |G|


JUST_BELOW = 1 - 1e-6
"""Share of Ku at which the loop must still be stable."""


def ultimate(process: LinearProcess) -> tuple[float, float]:
    """Ku in co units per pv unit (negative for a reverse-acting process) and Pu in seconds.

    Raises
    ------
    ValueError
        Proportional control never makes the process swing, or never makes it stable.
    """
    sign = math.copysign(1.0, process.k)
    loop = open_loop(process, PidGains(sign, 0.0))
    sizes = [(abs(loop.at(w)), w) for w in phase_crossovers(loop, grid(loop))]
    if not sizes:
        raise ValueError("this process has no ultimate gain: its phase never falls to -180 degrees; use another rule")
    size, w = max(sizes)
    gain = sign / size
    if not margins(process, PidGains(gain * JUST_BELOW, 0.0)).stable:
        raise ValueError("this process is not held by proportional control, so it has no ultimate gain")
    return gain, 2 * math.pi / w
