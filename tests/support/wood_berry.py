"""Wood and Berry's distillation column: two loops on one plant, its published gains, and records of both."""

import math

import numpy as np

from retuner.adaptive.interaction.common_windows import OneLoopRecord
from retuner.adaptive.interaction.multivariable_fit import Element, StepAnswers
from retuner.schedule.gains import PidGains

MINUTE = 60.0
WOOD_BERRY = (((12.8, 16.7, 1.0), (-18.9, 21.0, 3.0)), ((6.6, 10.9, 7.0), (-19.4, 14.4, 3.0)))
"""Wood & Berry, Chem. Eng. Sci. 28 (1973) 1707-1717: k, lag and dead time in minutes."""
BLT = (PidGains.from_ideal(0.375, 8.29 * MINUTE), PidGains.from_ideal(-0.075, 23.6 * MINUTE))
"""Luyben, Ind. Eng. Chem. Process Des. Dev. 25 (1986) 654-660, table II."""
DT_S = 30.0


def column() -> tuple[StepAnswers, ...]:
    """Wood and Berry's."""
    return tuple(
        StepAnswers(tuple(Element(k, a * MINUTE, 0.0, b * MINUTE) for k, a, b in row), 0.0) for row in WOOD_BERRY
    )


def records(
    noise: float, moves: tuple[int, ...] = (0, 1, 0, 1), gains: tuple[PidGains, ...] = BLT
) -> list[OneLoopRecord]:
    """The column under these gains, the setpoints stepped in turn, 120 minutes apart; noise in pv units."""
    rng, n = np.random.default_rng(7), int(120 * MINUTE / DT_S)
    late = [[int(b * MINUTE / DT_S) for _, _, b in row] for row in WOOD_BERRY]
    held = [[math.exp(-DT_S / (a * MINUTE)) for _, a, _ in row] for row in WOOD_BERRY]
    total = n * (len(moves) + 1)
    sp, pv, co = np.zeros((2, total)), np.zeros((2, total)), np.zeros((2, total))
    inner, integral = np.zeros((2, 2)), np.zeros(2)
    for i in range(total):
        for at, loop in enumerate(moves):
            sp[loop, i] += (1.0 if at % 4 < 2 else -1.0) * (i >= n * (at + 1))
        pv[:, i] = inner.sum(axis=1) + noise * rng.standard_normal(2)
        e = sp[:, i] - pv[:, i]
        integral += [g.ki * x * DT_S for g, x in zip(gains, e, strict=True)]
        co[:, i] = [g.kp * x + held for g, x, held in zip(gains, e, integral, strict=True)]
        for a in range(2):
            for b in range(2):
                u = co[b, i - late[a][b]] if i >= late[a][b] else 0.0
                inner[a, b] = WOOD_BERRY[a][b][0] * u * (1 - held[a][b]) + held[a][b] * inner[a, b]
    return [OneLoopRecord(sp[i], pv[i], co[i]) for i in range(2)]
