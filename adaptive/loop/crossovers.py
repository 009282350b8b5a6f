"""Gain and phase crossovers of an open loop, all of them, refined to rounding.

The size and the unwrapped phase of L are known in closed form, so a grid only has to separate the crossovers: they are
looked for between neighbours of a logarithmic grid over all corners of the loop, which has extra points round every
resonance and, where the dead time turns the phase fast, steps of a fixed angle. Each is then found to rounding.
"""

import math
from collections.abc import Callable

import numpy as np

from retuner.adaptive.loop.open_loop import OpenLoop
from retuner.adaptive.signals.sample import FloatArray

# The zero of a function between two points where its signs differ (Chandrupatla 1997, Adv. Eng. Software 28, 145).
#
# Inverse quadratic interpolation where the last three points allow it, else bisection. In a file of its own because the
# margins are asked for on line, and scipy.optimize takes longer to load than all of a short command.


RELATIVE = 4e-16
"""Accuracy asked for, relative to the larger end: rounding."""
MOST_STEPS = 120


def bracketed_root(f: Callable[[float], float], low: float, high: float, relative: float = RELATIVE) -> float:
    """x with f(x) = 0 between low and high, to this relative accuracy of the larger end.

    Raises
    ------
    ValueError
        The signs of f at both ends are the same.
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


POINTS_PER_DECADE = 60
"""Density of the grid; time constants bend |L| and its phase over about a decade."""
DECADES_BEYOND = 1.5
"""How far the grid goes beyond the slowest and the fastest corner."""
DELAY_STEP = 0.5
"""Angle in rad by which the dead time turns the phase from one point to the next."""
DELAY_TURNS = 40
"""Turns of the dead time for which that holds."""
RESONANCE_POINTS = 41
"""Extra points over ten half-widths of a resonance, to either side."""
MOST_PHASE_CROSSOVERS = 12
"""Phase crossovers that are worth finding: the dead time makes ever more, with ever smaller |L|."""
TANGENT = 1e-3
"""An extreme of ln |L| this close to 0 is looked at for a pair of crossovers between two points."""


def grid(loop: OpenLoop) -> FloatArray:
    """Frequencies in rad/s, increasing, that separate all that the loop does."""
    corners = loop.corners()
    low, high = math.log10(min(corners)) - DECADES_BEYOND, math.log10(max(corners)) + DECADES_BEYOND
    points = [np.logspace(low, high, int((high - low) * POINTS_PER_DECADE) + 2)]
    if loop.theta:
        turns = np.arange(DELAY_STEP, 2 * math.pi * DELAY_TURNS, DELAY_STEP) / loop.theta
        points.append(turns[turns < 10**high])
    for c1, c2 in (*loop.quadratics, (loop.b1, loop.b2)):
        if c2 > 0 and c1**2 < c2:
            centre, half_width = 1 / math.sqrt(c2), max(abs(c1), 1e-9 * math.sqrt(c2)) / (2 * c2)
            points.append(centre + half_width * np.linspace(-10, 10, RESONANCE_POINTS))
    w = np.unique(np.concatenate(points)) if len(points) > 1 else points[0]
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


def turns_at(loop: OpenLoop, w: float) -> int:
    """Whole turns by which the unwrapped phase of L at w rad/s differs from its principal value."""
    return math.ceil(loop.phase_at(w) / (2 * math.pi) - 0.5)


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


FAR = 1e6
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
        turns += turns_at(loop, w) * (1 if above else -1)
        above = not above
    if not above:
        return turns == 0
    # The same for a loop without dead time whose gain stays above 1 for ever
    end = loop.phase_at(FAR * max((*crossovers, *loop.corners())))
    expected = -min(loop.excess, 0) * math.pi / 2
    return round((end - expected) / (math.pi / 2)) + 4 * turns == 0
