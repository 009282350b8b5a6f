"""The open loop L = C G in factors, with its size and unwrapped phase at one frequency or many.

    L(s) = K (1 + b1 s + b2 s^2) prod(1 + lead s) / (s^m prod(1 + lag s) prod(1 + c1 s + c2 s^2))  e^(-theta s)

C = kp + ki/s + kd s/(1 + tau_f s) gives K, b1, b2, one s of s^m if there is integral action, and the lag tau_f.
The phase is a sum of arc tangents, so it is exact and needs no unwrapping however many turns the dead time makes.
"""

import cmath
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from retuner.adaptive.process.model import ComplexArray, LinearProcess
from retuner.adaptive.signals.sample import FloatArray, distinct
from retuner.schedule.gains import PidGains


class OpenLoop(NamedTuple):
    """L(s) as at the head of this file. A named tuple because on-line work makes one for every model it asks about.

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


# ---- Gain and phase crossovers of an open loop, all of them, refined to rounding.
#
# The size and the unwrapped phase of L are known in closed form, so a grid only has to separate the crossovers:
# they are looked for between neighbours of a logarithmic grid over all corners of the loop, which has extra points
# round every resonance and, where the dead time turns the phase fast, steps of a fixed angle. Each is then found to
# rounding.

# The zero of a function between two points where its signs differ (Chandrupatla 1997, Adv. Eng. Software 28, 145).
#
# Inverse quadratic interpolation where the last three points allow it, else bisection. In a file of its own because the
# margins are asked for on line, and scipy.optimize takes longer to load than all of a short command.


RELATIVE = 4e-16  # accuracy asked for, relative to the larger end: rounding
MOST_STEPS = 120


def bracketed_root(f: Callable[[float], float], low: float, high: float, relative: float = RELATIVE) -> float:
    """x with f(x) = 0 between low and high, to this relative accuracy of the larger end.

    Raises ValueError: the signs of f at both ends are the same.
    """
    b, a, fb, fa = low, high, f(low), f(high)
    if fa == 0 or fb == 0:
        return a if fa == 0 else b
    if (fa > 0) == (fb > 0):
        raise ValueError(f"f({low}) = {fb} and f({high}) = {fa} have the same sign: no zero is enclosed")
    share = 0.5
    for _ in range(MOST_STEPS):
        x = a + share * (b - a)
        fx = f(x)
        if (fx > 0) == (fa > 0):
            c, fc = a, fa
        else:
            c, b, fc, fb = b, a, fb, fa
        a, fa = x, fx
        best = a if abs(fa) < abs(fb) else b
        tolerance = relative * max(abs(low), abs(high)) / abs(b - a) if b != a else 1.0
        if fx == 0 or tolerance > 0.5:
            return best
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        share = 0.5
        if phi**2 < xi and (1 - phi) ** 2 < 1 - xi:
            share = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        share = min(1 - tolerance, max(tolerance, share))
    return best


POINTS_PER_DECADE = 60  # density of the grid; time constants bend |L| and its phase over about a decade
DECADES_BEYOND = 1.5  # how far the grid goes beyond the slowest and the fastest corner
BRACKET_STEP = 0.5  # angle in rad by which the dead time turns the phase from one point to the next
DELAY_TURNS = 40  # turns of the dead time for which that holds
RESONANCE_POINTS = 41  # extra points over ten half-widths of a resonance, to either side
MOST_PHASE_CROSSOVERS = 12
"""Phase crossovers that are worth finding: the dead time makes ever more, with ever smaller |L|."""
TANGENT = 1e-3  # an extreme of ln |L| this close to 0 is looked at for a pair of crossovers between two points


def grid(loop: OpenLoop) -> FloatArray:
    """Frequencies in rad/s, increasing, that separate all that the loop does."""
    corners = loop.corners()
    low, high = math.log10(min(corners)) - DECADES_BEYOND, math.log10(max(corners)) + DECADES_BEYOND
    points = [np.logspace(low, high, int((high - low) * POINTS_PER_DECADE) + 2)]
    if loop.theta:
        turns = np.arange(BRACKET_STEP, 2 * math.pi * DELAY_TURNS, BRACKET_STEP) / loop.theta
        points.append(turns[turns < 10**high])
    for c1, c2 in (*loop.quadratics, (loop.b1, loop.b2)):
        if c2 > 0 and c1**2 < c2:
            centre, half_width = 1 / math.sqrt(c2), max(abs(c1), 1e-9 * math.sqrt(c2)) / (2 * c2)
            points.append(centre + half_width * np.linspace(-10, 10, RESONANCE_POINTS))
    w = distinct(np.concatenate(points)) if len(points) > 1 else points[0]
    return w[w > 0]


def _between(f: Callable[[float], float], low: float, high: float) -> float:
    """The zero of f between two grid points; where only rounding put it there, the nearer of them."""
    at_low, at_high = f(low), f(high)
    if at_low * at_high > 0:
        return low if abs(at_low) < abs(at_high) else high
    return bracketed_root(f, low, high)


def gain_crossovers(loop: OpenLoop, w: FloatArray) -> list[float]:
    """Frequencies where |L| = 1, increasing. w : grid of the loop."""
    values, size = loop.log_size(w), loop.log_size_at
    found = [_between(size, float(w[i]), float(w[i + 1])) for i in np.flatnonzero(values[:-1] * values[1:] < 0)]
    found += [float(x) for x in w[values == 0]]
    middle = values[1:-1]
    touching = (np.abs(middle) < TANGENT) & (values[:-2] * middle > 0) & (values[2:] * middle > 0)
    touching &= (np.abs(values[:-2]) > np.abs(middle)) & (np.abs(values[2:]) > np.abs(middle))
    for i in np.flatnonzero(touching) + 1:
        fine = np.geomspace(w[i - 1], w[i + 1], 201)
        sizes = loop.log_size(fine)
        found += [
            _between(size, float(fine[j]), float(fine[j + 1])) for j in np.flatnonzero(sizes[:-1] * sizes[1:] < 0)
        ]
    return sorted(found)


def phase_crossovers(loop: OpenLoop, w: FloatArray) -> list[float]:
    """Frequencies where L is real and negative, increasing, of those with the largest |L| only. w : grid."""
    turns = (loop.phase(w) - math.pi) / (2 * math.pi)
    low, high = turns[:-1], turns[1:]
    level = np.where(high < low, np.ceil(low) - 1, np.floor(low) + 1)  # the next whole turn on the way
    crossed = np.where(high < low, level >= high, level <= high)
    where = np.flatnonzero(crossed)
    if len(where) > MOST_PHASE_CROSSOVERS:
        sizes = loop.log_size(w[where])
        where = np.sort(where[np.argsort(sizes)[::-1][:MOST_PHASE_CROSSOVERS]])
    found = []
    for i in where:
        target = (2 * level[i] + 1) * math.pi

        def miss(x: float, target: float = target) -> float:
            return loop.phase_at(x) - target

        found.append(float(_between(miss, float(w[i]), float(w[i + 1]))))
    return found


# Stability of a closed loop by the argument principle, decided at the gain crossovers alone.
#
# L has no poles in the right half plane, so the loop is stable when arg(1 + L) grows by m pi/2 from w = 0+ to
# infinity (m poles at the origin; Astrom & Murray 2008, section 9.2). Where |L| < 1, 1 + L stays right of the origin
# and its arg is the principal one; where |L| > 1, arg(1 + L) = arg L + arg(1 + 1/L), the second term principal again.
# So the change is a sum over the crossovers of the whole turns n by which arg L has left its principal value:
#
#     stable  <=>  sum of n where |L| falls through 1  =  sum of n where it rises through 1
#
# With |L| > 1 in the end (possible without dead time only) the phase at infinity joins in. L(0) <= -1, and any dead
# time with |L| >= 1 in the end, are unstable at once. No Pade approximation, no grid in the decision.


PHASE_AT_INFINITY = 1e6
"""Frequency over the last crossover at which the phase counts as that at infinity (used without dead time only)."""


def is_stable(loop: OpenLoop, crossovers: list[float]) -> bool:
    """Whether the closed loop is stable. crossovers : all gain crossovers, increasing."""
    if loop.theta and loop.end_size >= 1:
        return False
    if loop.k < 0 and (loop.order > 0 or (loop.order == 0 and loop.k <= -1)):
        return False
    above = loop.order > 0 or (loop.order == 0 and abs(loop.k) > 1)
    turns = 0
    for w in crossovers:
        if abs(loop.at(w) + 1) < 1e-13:
            return False  # on the limit
        # By whole turns the unwrapped phase of L differs from its principal value
        turns += math.ceil(loop.phase_at(w) / (2 * math.pi) - 0.5) * (1 if above else -1)
        above = not above
    if not above:
        return turns == 0
    # The same for a loop without dead time whose gain stays above 1 for ever
    end = loop.phase_at(PHASE_AT_INFINITY * max((*crossovers, *loop.corners())))
    expected = -min(loop.excess, 0) * math.pi / 2
    return round((end - expected) / (math.pi / 2)) + 4 * turns == 0
