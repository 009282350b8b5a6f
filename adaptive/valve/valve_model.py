"""Valves that stick or have play: the two published two-parameter models, S the stick band, J the slip jump, co units.

    f_s = (S + J)/2 static and f_d = (S - J)/2 kinetic friction

    Kano et al. (2004)   at rest: stays until |u - y| > f_s; in motion: y = u - d f_d, and rests when u stops or turns
    He et al. (2007)     friction is overcome anew at every sample: y moves by the push less f_d whenever the push,
                         what was left plus the change of u, exceeds f_s

After a reversal Kano's valve rests until co has travelled S, He's until S to S + J, then it jumps by J; going on in
one direction, Kano's follows and He's moves in steps of J. J = 0 is backlash. Real valves do either (Garcia 2008).
"""

import math
from enum import StrEnum
from itertools import pairwise

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass


class Family(StrEnum):
    """Which of the two models."""

    KANO = "kano"
    HE = "he"


@dataclass(frozen=True, slots=True)
class StuckValve:
    """A valve.

    family : model. stick : S > 0. jump : J, 0 <= J <= 2 S (S at the most in He's model).
    start : where the valve stands in its band when the record begins, -1 to 1 in units of f_s.

    Raises ValueError: a number is outside its range.
    """

    family: Family
    stick: float
    jump: float
    start: float = 0.0

    def __post_init__(self) -> None:
        most = 2 * self.stick if self.family == Family.KANO else self.stick
        if not (0 < self.stick < math.inf and 0 <= self.jump <= most * (1 + 1e-12)):
            raise ValueError(f"stiction band {self.stick}, jump {self.jump}: band above 0, jump up to {most}")
        if not -1 <= self.start <= 1:
            raise ValueError(f"start {self.start} is outside the band, -1 to 1")

    def position(self, co: FloatArray) -> FloatArray:
        """Position of the valve for the controller output co, shape (n,)."""
        f_static, f_kinetic = (self.stick + self.jump) / 2, (self.stick - self.jump) / 2
        if (engine := compiled()) is not None:
            moved: FloatArray = engine.valve_travel(self.numbers(), co) + (co[0] + self.start * f_static)
            return moved
        run = _kano if self.family == Family.KANO else _he
        return np.array(run(co.tolist(), f_static, f_kinetic, self.start * f_static))

    def numbers(self) -> tuple[float, float, float, float]:
        """Family (0 Kano, 1 He), stick, jump and start, as the compiled engine takes them."""
        return float(self.family == Family.HE), self.stick, self.jump, self.start


def _kano(co: list[float], f_static: float, f_kinetic: float, start: float) -> list[float]:
    y, direction, moving = co[0] + start, 0, False
    found = [y]
    for before, u in pairwise(co):
        change = u - before
        if moving and change * direction <= 0:
            moving = False
        if not moving and abs(u - y) > f_static:
            moving, direction = True, 1 if u > y else -1
        if moving:
            y = u - direction * f_kinetic
        found.append(y)
    return found


def _he(co: list[float], f_static: float, f_kinetic: float, start: float) -> list[float]:
    y, left = co[0] + start, -start
    found = [y]
    for before, u in pairwise(co):
        push = left + u - before
        if push > f_static or -push > f_static:
            left = math.copysign(f_kinetic, push)
            y += push - left
        else:
            left = push
        found.append(y)
    return found
