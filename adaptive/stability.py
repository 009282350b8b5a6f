"""Stability of a closed loop by the argument principle, decided at the gain crossovers alone.

L has no poles in the right half plane, so the loop is stable when arg(1 + L) grows by m pi/2 from w = 0+ to
infinity (m poles at the origin; Astrom & Murray 2008, section 9.2). Where |L| < 1, 1 + L stays right of the origin
and its arg is the principal one; where |L| > 1, arg(1 + L) = arg L + arg(1 + 1/L), the second term principal again. So
the change is a sum over the crossovers of the whole turns n by which arg L has left its principal value:

    stable  <=>  sum of n where |L| falls through 1  =  sum of n where it rises through 1

With |L| > 1 in the end (possible without dead time only) the phase at infinity joins in. L(0) <= -1, and any dead time
with |L| >= 1 in the end, are unstable at once. No Pade approximation, no grid in the decision.
"""

import math

from retuner.adaptive.crossovers import turns_at
from retuner.adaptive.open_loop import OpenLoop

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
    return _ends_right(loop, crossovers, turns)


def _ends_right(loop: OpenLoop, crossovers: list[float], turns: int) -> bool:
    """The same for a loop without dead time whose gain stays above 1 for ever."""
    end = loop.phase_at(FAR * max((*crossovers, *loop.corners())))
    expected = -min(loop.excess, 0) * math.pi / 2
    return round((end - expected) / (math.pi / 2)) + 4 * turns == 0
