"""A process that runs away by itself: its unstable pole, as a setpoint step shows it under gains that held the loop.

    pv = T(G) sp,   T = G C / (1 + G C),   G = k' e^(-theta s) / ((s + p)(1 + tau s))

p > 0 is a lag, p = 0 an integrator, p < 0 runs away. pv fitted against co cannot tell: in it a process that runs away
does so, while the loop stood. So the closed loop is fitted, with the control law that ran (indirect identification, Van
den Hof & Schrama 1993): whatever the gains in force would not have held is no explanation.

The structures that settings follow from have no such pole. An integrator takes its place, and less gain looks safer on
it, where it lets the process go. There is no rule for it here: it is asked whether a change is safer on it as well.
"""

import math
from functools import lru_cache
from itertools import product

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

SIGMAS = 4.0  # standard deviations by which the pole must lie on the wrong side
MODEL_ERROR = 0.003  # share of the step that no model explains
EXPLAINED = 1.5  # what the fit may leave, in times the noise
FEWEST_STEP_SAMPLES = 12  # samples after the step of which it may be asked
MOST_SAMPLES = 1500  # the first samples after the step, so many of them
UNEVEN = 0.5  # how far an interval may be from the usual one, as a share of it
POLES = (0.1, -0.05, -0.2)  # first guesses of the pole times the time that pv takes for half a setpoint step
LEAST = 1e-9  # least product of a pole and a time; a smaller one counts as none
APART = 1e-4  # distance by which two equal poles are set apart
LOST = 10.0  # Residual, in steps, of a process that the gains would not have held
LONGER = 4  # lengths of the record for which a loop with other gains is followed
GONE = 0.01  # share of a setpoint step that is none


@dataclass(frozen=True, slots=True)
class UnstableProcess:
    """k : slope gain, pv units per co unit and second. pole_per_s : below 0. tau_s : lag. theta_s : dead time with
    half a sampling interval for the hold.
    """

    k: float
    pole_per_s: float
    tau_s: float
    theta_s: float

    @property
    def grows_s(self) -> float:
        """Time in which what is left alone grows by a factor of e, seconds."""
        return -1.0 / self.pole_per_s

    def ms(self, law: SampledLaw) -> float:
        """Peak of the sensitivity under gains that hold it."""
        times = [self.theta_s, self.tau_s, self.grows_s]
        w = np.geomspace(WIDE[0] / max(times), WIDE[1] / max(self.theta_s, law.dt_s), POINTS)
        s = 1j * w
        g = self.k * np.exp(-self.theta_s * s) / ((s + self.pole_per_s) * (1 + self.tau_s * s))
        c = law.gains.kp + law.gains.ki / s + law.gains.kd * s / (1 + law.filter_s * s)
        return float(np.max(1 / np.abs(1 + g * c)))

    def is_held(self, law: SampledLaw, samples: int) -> bool:
        """Whether gains hold it, in so many samples: what is left of a setpoint step falls, or is gone."""
        still = replace(self, theta_s=max(self.theta_s - law.dt_s / 2, 0.0))
        left = np.abs(1.0 - _answer(still, law, samples))
        before, last = (float(np.max(part)) for part in np.array_split(left, 4)[2:])
        return math.isfinite(last) and (last < before or last < GONE)


WIDE, POINTS = (0.03, 6.0), 600
"""Frequencies at which Ms is looked for, times the longest and over the shortest time; how many."""


def unstable_process(window: Window, law: SampledLaw) -> UnstableProcess | None:
    """The process, where a setpoint step from rest shows that it runs away by itself; else None.

    window : it holds one setpoint step. law : that ran.
    """
    moves, spacing = np.flatnonzero(np.diff(window.sp)), np.diff(window.t_s)
    usual = median(spacing)
    if len(moves) != 1 or float(np.max(np.abs(spacing - usual))) > UNEVEN * usual:
        return None
    at = int(moves[0]) + 1
    size = float(window.sp[at] - window.sp[at - 1])
    pv = (window.pv[at : at + MOST_SAMPLES] - window.sp[0]) / size
    noise = max(noise_sigma(window.pv) / abs(size), MODEL_ERROR)
    for share in SHARES:
        part = pv[: round(share * len(pv))]
        if len(part) < FEWEST_STEP_SAMPLES:
            return None
        fit, most = _Fit(part, law), len(part) * (EXPLAINED * noise) ** 2
        best = (math.inf, np.empty(0), math.inf)
        # The likeliest first guesses of ln k', ln theta, ln tau and the pole, by the time pv takes for half the step
        half_s = fit.law.dt_s * (int(np.argmax(fit.pv >= HALF)) + 1)
        guessed = [
            np.array(
                [math.log(strength / (abs(fit.law.gains.kp) * half_s)), math.log(dead * half_s), lag, pole / half_s]
            )
            for dead, strength, share, pole in product(DEAD, STRENGTHS, LAGS, POLES)
            for lag in [math.log(share * half_s)]
        ]
        for start in sorted(guessed, key=lambda x: float(np.sum(fit.left(x) ** 2)))[:STARTS]:
            cost, x, std = fit.refined(start)
            if cost <= most and x[3] > SIGMAS * std:  # one that does not run away explains it
                return None
            best = min(best, (cost, x, std), key=lambda one: one[0])
        cost, x, std = best
        if cost <= most:  # else a load may have come since
            shown = fit.process(x)
            held = math.isfinite(_answer(shown, law, len(pv))[-1])  # to the end, not only in this part
            return replace(shown, theta_s=shown.theta_s + law.dt_s / 2) if held and x[3] + SIGMAS * std < 0 else None
    return None


SHARES = tuple(0.5**i for i in range(8))
"""Parts of what followed on the step that are looked at, until one is explained: a load ends it, and of a process that
runs away faster the further pv goes only the beginning is linear.
"""


def worse_on(
    found: UnstableProcess, now: SampledLaw, gains: PidGains, samples: int, limit: float
) -> tuple[float, float] | None:
    """Ms before and after, where other gains are no change for the better on it, or where it runs away FASTER; None
    where they are.

    samples : of the record. limit : of Ms, under which it may grow.
    """
    law = replace(now, gains=gains)
    for process in (found, replace(found, pole_per_s=FASTER * found.pole_per_s)):
        before = process.ms(now)
        after = process.ms(law) if process.is_held(law, LONGER * samples) else math.inf
        if after > max(before, limit):
            return before, after
    return None


FASTER = 1.25  # A reaction that heats itself runs away the faster, the further pv goes


HALF = 0.5
DEAD, LAGS, STRENGTHS = (0.3, 0.8), (0.1, 0.5), (0.1, 0.2, 0.4, 0.8, 1.6)
"""First guesses of the dead time and of the lag over that time, and of kp k' times it."""
STARTS = 3  # first guesses that are refined


def _answer(process: UnstableProcess, law: SampledLaw, n: int) -> FloatArray:
    """pv at n samples after a unit setpoint step; not finite from where the loop has run away.

    process : without the half sampling interval of the hold. Its two poles stand side by side, each moved on exactly by
    the two outputs that reach it within an interval.
    """
    g, dt, fast = law.gains, law.dt_s, 1.0 / process.tau_s
    slow = process.pole_per_s if abs(process.pole_per_s - fast) > APART * fast else fast * (1 + APART)
    whole = int(process.theta_s / dt)
    early = process.theta_s - whole * dt
    a, a_old, a_new = _moved(slow, dt, early)
    b, b_old, b_new = _moved(fast, dt, early)
    size, follow = process.k / (1 - slow * process.tau_s), dt / (law.filter_s + dt)
    if (engine := compiled()) is not None:
        controller = (follow, dt, g.kp, g.ki, g.kd, law.b)
        return np.asarray(engine.held((a, a_old, a_new, b, b_old, b_new, size, *controller, whole, LOST), n))
    pv, out, past = [math.nan] * n, [0.0] * (n + whole + 2), whole + 1
    x = y = integral = rate = last = 0.0
    for i in range(n):
        now = size * (x - y)
        if not abs(now) < LOST:
            break
        pv[i] = now
        rate += follow * ((now - last) / dt - rate)
        last = now
        out[past + i] = g.kp * (law.b - now) + integral - g.kd * rate
        integral += g.ki * dt * (1.0 - now)
        old, new = out[i], out[i + 1]
        x, y = a * x + a_old * old + a_new * new, b * y + b_old * old + b_new * new
    return np.array(pv)


@lru_cache(maxsize=64)  # a slope by one number leaves the other pole, or both, where they were
def _moved(pole: float, dt_s: float, early_s: float) -> tuple[float, float, float]:
    """A pole over an interval: what stays, and what an output adds in its early part, and in the rest."""
    late_s = dt_s - early_s
    return math.exp(-pole * dt_s), math.exp(-pole * late_s) * _risen(pole, early_s), _risen(pole, late_s)


def _risen(pole: float, t_s: float) -> float:
    """(1 - e^(-p t)) / p."""
    return t_s if abs(pole) * t_s < LEAST else -math.expm1(-pole * t_s) / pole


class _Fit:
    """pv after a unit step, and the law that ran: its direction is that of the process."""

    def __init__(self, pv: FloatArray, law: SampledLaw) -> None:
        self.pv, self.law, self.sign = pv, law, law.gains.direction
        self.last = (b"", pv)  # a point and its residuals: slopes are asked for where residuals were

    def process(self, x: FloatArray) -> UnstableProcess:
        """The process at a point; its dead time no longer than the record, its pole no faster than a sample."""
        k, theta, tau = (math.exp(min(max(value, -LARGEST_LN_PARAMETER), LARGEST_LN_PARAMETER)) for value in x[:3])
        fastest = 1.0 / self.law.dt_s
        theta = min(theta, len(self.pv) * self.law.dt_s)
        return UnstableProcess(self.sign * k, min(max(float(x[3]), -fastest), fastest), tau, theta)

    def left(self, x: FloatArray) -> FloatArray:
        """Residuals in steps."""
        if self.last[0] != x.tobytes():
            said = _answer(self.process(x), self.law, len(self.pv))
            self.last = x.tobytes(), np.where(np.isfinite(said), self.pv - said, LOST)
        return self.last[1]

    def slopes(self, x: FloatArray) -> FloatArray:
        """Slopes of the residuals, by scipy's own steps: its way to them takes longer than the answers."""
        moved = x + np.diag(FORWARD * np.where(x < 0.0, -1.0, 1.0) * np.maximum(1.0, np.abs(x)))
        left = self.left(x)
        return np.array([(self.left(one) - left) / (one[i] - x[i]) for i, one in enumerate(moved)]).T

    def refined(self, start: FloatArray) -> tuple[float, FloatArray, float]:
        """Sum of squares, point, and standard deviation of the pole."""
        from scipy.optimize import least_squares

        scale = np.array([1.0, 1.0, 1.0, abs(start[3])])
        done = least_squares(self.left, start, self.slopes, x_scale=scale, method="lm", max_nfev=MOST_TRIES)
        x, left = np.asarray(done.x, dtype=np.float64), np.asarray(done.fun, dtype=np.float64)
        slopes = np.asarray(done.jac, dtype=np.float64) * scale
        cost = float(left @ left)
        along = float(left[1:] @ left[:-1]) / max(cost, LEAST**2)
        variance = cost / max(len(left) - len(x), 1) * (1 + max(along, 0.0)) / max(1 - along, TINY)
        try:
            covariance = np.linalg.inv(slopes.T @ slopes)
        except np.linalg.LinAlgError:
            return cost, x, math.inf
        return cost, x, float(scale[3]) * math.sqrt(max(float(covariance[3, 3]) * variance, 0.0))


LARGEST_LN_PARAMETER = 40.0  # largest logarithm of a parameter
MOST_TRIES = 150  # evaluations of one refinement, those for its slopes not among them
FORWARD = math.sqrt(np.finfo(np.float64).eps)  # of a parameter, or of one: a step over which a slope is taken
TINY = 0.01  # least share that white noise has in a remainder
