"""Gain and phase crossovers of an open loop, all of them, refined to rounding.

The size and the unwrapped phase of L are known in closed form, so a grid only has to separate the crossovers: they are
looked for between neighbours of a logarithmic grid over all corners of the loop, which has extra points round every
resonance and, where the dead time turns the phase fast, steps of a fixed angle. Each is then found to rounding.
"""

import math
from collections.abc import Callable

import numpy as np

from retuner.adaptive.open_loop import OpenLoop
from retuner.adaptive.root import bracketed_root
from retuner.adaptive.sample import FloatArray

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

        found.append(_between(miss, float(w[i]), float(w[i + 1])))
    return found


def turns_at(loop: OpenLoop, w: float) -> int:
    """Whole turns by which the unwrapped phase of L at w rad/s differs from its principal value."""
    return math.ceil(loop.phase_at(w) / (2 * math.pi) - 0.5)
