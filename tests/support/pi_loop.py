"""A loop under PI control, sample by sample, as tests make their records."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from retuner.adaptive.signals.sample import FloatArray, LoopSample, Window
from retuner.schedule.gains import PidGains

Process = Callable[[float, float], float]  # From the output that was sent a sample ago, and the load now, to pv now


class Lag:
    """A process: gain, dead time and lag in samples, at rest under the output `at`."""

    def __init__(self, lag: float, dead: int = 0, k: float = 1.0, at: float = 0.0) -> None:
        self._share, self._k, self._late, self._y = 1.0 - math.exp(-1.0 / lag), k, [at] * dead, k * at

    def __call__(self, u: float, load: float) -> float:
        """The next sample; the load is at the input, behind the dead time."""
        self._late.append(u)
        self._y += self._share * (self._k * (self._late.pop(0) + load) - self._y)
        return self._y


def slipping(band: float) -> Callable[[float], float]:
    """A valve that stays until co is a band away, and then goes all the way."""
    at = 0.0

    def valve(co: float) -> float:
        nonlocal at
        at = co if abs(co - at) > band else at
        return at

    return valve


def pi_loop(
    gains: PidGains, process: Process, sp: FloatArray, noise: FloatArray, load: ArrayLike = 0.0, *, co0: float = 0.0,
    dt: float = 1.0, valve: Callable[[float], float] = float,
) -> Window:  # fmt: skip
    """The record of a loop from rest at co0. noise : on pv as the controller sees it. load, noise : one a sample."""
    n, integral, sent = len(sp), co0, valve(co0)
    pv, co = np.zeros(n), np.zeros(n)
    for i, (wanted, more, push) in enumerate(zip(sp, noise, np.broadcast_to(load, n), strict=True)):
        pv[i] = process(sent, push) + more
        integral += gains.ki * dt * (wanted - pv[i])
        co[i] = gains.kp * (wanted - pv[i]) + integral
        sent = valve(co[i])
    return Window(dt * np.arange(n), np.asarray(sp, dtype=np.float64), pv, co)


def samples_of(window: Window) -> list[LoopSample]:
    """As telemetry brings them, one by one."""
    return [LoopSample(*row) for row in np.column_stack([window.t_s, window.sp, window.pv, window.co]).tolist()]


def written(path: Path, window: Window, names: Sequence[str] = ("t", "sp", "pv", "co")) -> Path:
    """The record as a file of columns."""
    columns = np.column_stack([window.t_s, window.sp, window.pv, window.co])
    np.savetxt(path, columns, delimiter=",", header=",".join(names), comments="")
    return path
