"""A loop under a load that wanders, for the tests of this folder."""

import math

import numpy as np

from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

PRIOR = {"ok": 0.4, "aggressive": 0.25, "slow_integrating": 0.05, "sluggish": 0.3}


def loop_record(
    process: tuple[float, int, float], gains: PidGains, seed: int, n: int = 600, step: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A loop on gain, dead time in samples and lag, under a load that wanders: setpoint, pv, co."""
    k, dead, lag = process
    rng = np.random.default_rng(seed)
    pole, total, y = math.exp(-1 / lag), 0.0, 0.0
    load = np.cumsum(rng.standard_normal(n)) * 0.1
    sp = np.where((np.arange(n) > n // 4) & (np.arange(n) < n // 2), step, 0.0)
    pv, co = np.zeros(n), np.zeros(n)
    for i in range(n):
        y = pole * y + (1 - pole) * k * ((co[i - 1 - dead] if i > dead else 0.0) + load[i])
        pv[i] = y + 0.02 * rng.standard_normal()
        total += gains.ki * (sp[i] - pv[i])
        co[i] = gains.kp * (sp[i] - pv[i]) + total
    return sp, pv, co
