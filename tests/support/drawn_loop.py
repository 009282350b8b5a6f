"""A loop under a load that wanders, for the tests of this folder."""

import numpy as np
from pi_loop import Lag, pi_loop

from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

PRIOR = {"ok": 0.4, "aggressive": 0.25, "slow_integrating": 0.05, "sluggish": 0.3}


def loop_record(
    process: tuple[float, int, float], gains: PidGains, seed: int, n: int = 600, step: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A loop on gain, dead time in samples and lag, under a load that wanders: setpoint, pv, co."""
    (k, dead, lag), rng = process, np.random.default_rng(seed)
    load, noise = np.cumsum(rng.standard_normal(n)) * 0.1, 0.02 * rng.standard_normal(n)
    sp = np.where((np.arange(n) > n // 4) & (np.arange(n) < n // 2), step, 0.0)
    found = pi_loop(gains, Lag(lag, dead, k), sp, noise, load)
    return found.sp, found.pv, found.co
