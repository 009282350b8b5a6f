"""Valves that stick: two published families, with stick band S and jump J in the units of the controller output.

f_s = (S + J)/2 is the static and f_d = (S - J)/2 the kinetic friction. After a reversal the valve rests until the
signal has travelled S, then jumps by J; after a stop in the same direction it rests until the signal has travelled J.

Kano et al. (2004), "Practical model and detection algorithm for valve stiction": a moving valve lags by f_d and stops
when the signal stops or turns. He et al. (2007), "A curve fitting method for detecting valve stiction": friction is
overcome anew at every sample, no state of motion. J > S (overshoot) exists in Kano's model only.
"""

import math
from collections.abc import Callable

import numpy as np

Valve = Callable[[float], float]


def kano(s: float, j: float, start: float = 0.0) -> Valve:
    """Kano's valve at rest at `start`, in the middle of its stick band."""
    return KanoValve(lambda: s, j / s, start)


class KanoValve:
    """Kano's valve; the stick band may differ from one stop to the next (band()), J stays its share of S."""

    def __init__(self, band: Callable[[], float], jump_share: float, start: float) -> None:
        self._band, self._share = band, jump_share
        self._s = band()
        self._u = self._y = start
        self._direction = 0
        self._moving = False

    def __call__(self, u: float) -> float:
        """The valve's position after the signal u."""
        s, change = self._s, u - self._u
        self._u = u
        if self._moving and change * self._direction <= 0:
            self._moving = False
            self._s = s = self._band()
        if not self._moving and abs(u - self._y) > s * (1 + self._share) / 2:
            self._moving, self._direction = True, 1 if u > self._y else -1
        if self._moving:
            self._y = u - self._direction * s * (1 - self._share) / 2
        return self._y


def he(s: float, j: float, start: float = 0.0) -> Valve:
    """He's valve at rest at `start`; J at most S."""
    f_s, f_d = (s + j) / 2, (s - j) / 2
    left, y, last = 0.0, start, start

    def valve(u: float) -> float:
        nonlocal left, y, last
        pushed = left + u - last
        last = u
        if abs(pushed) > f_s:
            y += pushed - math.copysign(f_d, pushed)
            left = math.copysign(f_d, pushed)
        else:
            left = pushed
        return y

    return valve


def backlash(width: float, start: float = 0.0) -> Valve:
    """Play of that width: the valve follows when the signal has crossed it, without a jump."""
    y = start

    def valve(u: float) -> float:
        nonlocal y
        y = min(max(y, u - width / 2), u + width / 2)
        return y

    return valve


def irregular(rng: np.random.Generator, s: float, j: float, spread: float, start: float = 0.0) -> Valve:
    """Kano's valve with another stick band after every stop: it stops at many levels, never twice alike."""
    return KanoValve(lambda: s * float(np.exp(spread * rng.standard_normal())), j / s, start)
