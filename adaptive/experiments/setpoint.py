"""Closed-loop setpoint step under proportional control: the overshoot tells the process.

Measured from the old level: dy_s the setpoint step, dy_p the first peak at t_p after it, dy_u the first undershoot.
    dy_inf = 0.45 (dy_p + dy_u)   D = (dy_p - dy_inf)/dy_inf   B = |(dy_s - dy_inf)/dy_inf|   b = dy_inf/dy_s
    A = 1.152 D^2 - 1.607 D + 1
in two steps, a model:   r = 2 A/B,  k = 1/(Kc0 B),  theta = t_p (0.309 + 0.209 e^(-0.61 r)),  tau1 = r theta
directly, PI settings:   Kc = Kc0 A/F,  tau_I = min(0.86 A |b/(1 - b)| t_p, 2.44 t_p F),  |b/(1 - b)| = 1/B
(two-step: Skogestad & Grimholt 2012, section 5.3.2; direct: Shamsuzzoha & Skogestad 2010, eqs. 15 and 22.) F = 1 is
about SIMC at tau_c = theta, F > 1 is slower. Fitted to overshoots D of 0.1 to 0.6; 0.3 is recommended. Where pv reaches
the setpoint (B near 0) the process integrates; the limits are theta = 0.309 t_p and k' = k/tau1 = 1/(2 A Kc0 theta).
"""

import math
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.experiments.plan import CLEAR, peak, smoothed
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import Tuning, tuning
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

LARGEST_D = 0.6
"""Largest overshoot for which the correlations were made (Shamsuzzoha & Skogestad 2010, section 3)."""
UNDERSHOOT_BY = 3.5
"""The first undershoot lies at about 2 t_p, and before this many t_p however strong the damping (delay and one lag)."""
LARGEST_UNDERSHOOT = 0.85
"""dy_u / dy_p above this: the overshoot is below about 0.15, and 0.45 (dy_p + dy_u) is no more the final level."""
INTEGRATING_B = 0.02
"""A steady offset below this share of the response cannot be told from none; tau1 would be beyond 40 theta."""


@dataclass(frozen=True, slots=True)
class Overshoot:
    """What is read off the response; in pv units and seconds, counted from the old level and the time of the step.

    dy_s, dy_p, dy_u : setpoint step, first peak, first undershoot. t_p_s : time of the peak.

    Raises
    ------
    ValueError
        A number is not finite, or these are not a peak beyond its undershoot in the direction of the step.
    """

    dy_s: float
    dy_p: float
    dy_u: float
    t_p_s: float

    def __post_init__(self) -> None:
        for name in ("dy_s", "dy_p", "dy_u", "t_p_s"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)} is not a finite number")
        if self.dy_s == 0 or self.t_p_s <= 0:
            raise ValueError(f"dy_s = {self.dy_s}, t_p = {self.t_p_s}: there must be a step, and a peak after it")
        if not 0 < self.dy_u / self.dy_s < self.dy_p / self.dy_s:
            raise ValueError(
                f"dy_p = {self.dy_p:g}, dy_u = {self.dy_u:g}: the peak must lie beyond the undershoot, "
                "both on the side of the setpoint step"
            )

    @property
    def dy_inf(self) -> float:
        """Final level, without waiting for it."""
        return 0.45 * (self.dy_p + self.dy_u)

    @property
    def d(self) -> float:
        """Overshoot D."""
        return (self.dy_p - self.dy_inf) / self.dy_inf

    @property
    def b(self) -> float:
        """Relative offset B; 0 where pv reaches the setpoint."""
        return abs((self.dy_s - self.dy_inf) / self.dy_inf)

    @property
    def a(self) -> float:
        """The factor A(D)."""
        return 1.152 * self.d**2 - 1.607 * self.d + 1

    def valid(self) -> str:
        """Empty, or in one line why the correlations do not hold for this overshoot."""
        if self.dy_u / self.dy_p > LARGEST_UNDERSHOOT:
            return f"the peak is only {self.dy_p / self.dy_u:.2f} times the undershoot; repeat with a larger gain"
        if self.d > LARGEST_D:
            return f"overshoot {self.d:.0%} is beyond {LARGEST_D:.0%}; repeat with a smaller gain"
        return ""


def measure(window: Window) -> Overshoot:
    """Read peak and undershoot off a record with one setpoint step.

    Raises
    ------
    ValueError
        The setpoint does not make exactly one step, or pv shows no peak after it, or the record ends soon after that.
    """
    i, dy_s = _setpoint_step(window.sp)
    t = window.t_s[i:] - window.t_s[i]
    before = float(np.mean(window.pv[: i + 1]))
    sign = math.copysign(1.0, dy_s)
    raw = (window.pv[i:] - before) * sign
    y, left = smoothed(raw, float(np.ptp(raw)))
    clear = 2 * CLEAR * max(left, noise_sigma(y))  # both ends of a move back are the extremes of many samples
    top = _first_peak(y, clear)
    if top is None:
        raise ValueError("pv shows no overshoot: no peak that it clearly comes back from; repeat with a larger gain")
    t_p, dy_p = _refined(t, y, top)
    end = int(np.searchsorted(t, UNDERSHOOT_BY * t_p))
    bottom = top + int(np.argmin(y[top:end]))
    if bottom == len(y) - 1:
        raise ValueError("pv still falls after its peak at the end of the record; record longer")
    _, under = _refined(t, -y, bottom)
    return Overshoot(dy_s, dy_p * sign, -under * sign, t_p)


def _setpoint_step(sp: FloatArray) -> tuple[int, float]:
    """Index of the first sample with the new setpoint, and the size of the step."""
    moves = np.flatnonzero(np.diff(sp))
    if moves.size != 1:
        raise ValueError(f"the setpoint makes {moves.size} steps; this method needs exactly one")
    i = int(moves[0]) + 1
    return i, float(sp[i] - sp[i - 1])


def _first_peak(y: FloatArray, clear: float) -> int | None:
    """Index of the first largest value that y comes back from by more than the noise."""
    best = 0
    for i in range(len(y)):
        if y[i] > y[best]:
            best = i
        elif best > 0 and y[best] - y[i] > clear:
            return best
    return None


def _refined(t: FloatArray, y: FloatArray, i: int) -> tuple[float, float]:
    low = max(i - 1, 0)
    return peak(t[low : i + 2], y[low : i + 2])


def two_step_model(overshoot: Overshoot, kc0: float) -> ProcessModel:
    """First order + dead time (or integrating) from the response under gain kc0.

    Raises
    ------
    ValueError
        kc0 is 0 or not finite, or the overshoot is outside the range of the correlations.
    """
    _check(overshoot, kc0)
    a, b, t_p = overshoot.a, overshoot.b, overshoot.t_p_s
    if b < INTEGRATING_B:
        theta = 0.309 * t_p
        return ProcessModel(ProcessType.INTEGRATING, 1 / (2 * a * kc0 * theta), theta_s=theta)
    r = 2 * a / b
    theta = t_p * (0.309 + 0.209 * math.exp(-0.61 * r))
    return ProcessModel(ProcessType.FOPDT, 1 / (kc0 * b), r * theta, 0.0, theta)


def direct_settings(overshoot: Overshoot, kc0: float, detuning: float = 1.0) -> Tuning:
    """PI settings without a model; detuning is F.

    Raises
    ------
    ValueError
        kc0 is 0 or not finite, F is not positive, or the overshoot is outside the range of the correlations.
    """
    _check(overshoot, kc0)
    if not 0 < detuning < math.inf:
        raise ValueError(f"detuning F = {detuning}: give a positive number, 1 for SIMC's tau_c = theta")
    t_p, longest = overshoot.t_p_s, 2.44 * overshoot.t_p_s * detuning
    tau_i = min(0.86 * overshoot.a / overshoot.b * t_p, longest) if overshoot.b else longest
    return tuning("setpoint-overshoot", "series", kc0 * overshoot.a / detuning, tau_i, 0.0, None)


def _check(overshoot: Overshoot, kc0: float) -> None:
    """Refuse what the correlations say nothing about."""
    if not (math.isfinite(kc0) and kc0):
        raise ValueError(f"kc0 = {kc0}: give the proportional gain of the experiment, negative when reverse-acting")
    wrong = overshoot.valid()
    if wrong:
        raise ValueError(wrong)
