"""A process with a known course over its pv, in a loop with PI control, for the tests beside it.

dy/dt = c u(t - theta) - y / 60 - growth y^2 / 2        slope gain c everywhere, 1 / tau = 1 / 60 + growth y
"""

import math

import numpy as np

from retuner.adaptive.signals.sample import Window

C, THETA_S, SLOWEST_S = 0.05, 5.0, 60.0
GROWTH = 1 / 3000  # tau falls from 60 s at 0 to 20 s at 100
SETPOINTS = (20.0, 35.0, 50.0, 65.0, 80.0, 60.0, 45.0, 25.0)
HOLD_S = 150
FINE = 4  # Steps in a sample


def tau_s(y: float, growth: float = GROWTH) -> float:
    """The lag at y."""
    return 1 / (1 / SLOWEST_S + growth * y)


def rest(y: float, growth: float) -> float:
    """The output that holds y."""
    return (y / SLOWEST_S + growth * y * y / 2) / C


def record(growth: float = GROWTH, seed: int = 5, noise: float = 0.15, load: float = 0.0) -> Window:
    """Setpoint steps over the range, PI control. load : in units of co, from the middle of the record on."""
    rng = np.random.default_rng(seed)
    n = HOLD_S * len(SETPOINTS)
    sp = np.repeat(SETPOINTS, HOLD_S)
    y, late = SETPOINTS[0], round(THETA_S)
    integral = rest(y, growth)
    co, pv = np.empty(n), np.empty(n)
    past = [integral] * late
    kp, ki = 1.2, 1.2 / 40
    for i in range(n):
        pv[i] = y + rng.normal(0.0, noise)
        error = sp[i] - pv[i]
        integral += ki * error
        co[i] = kp * error + integral
        past.append(co[i])
        u = past[-1 - late] + (load if i >= n * 9 // 16 else 0.0)
        for _ in range(FINE):
            y += (C * u - y / SLOWEST_S - growth * y * y / 2) / FINE
    return Window(np.arange(n, dtype=np.float64), sp, pv, co)


def slow_sine(n: int) -> np.ndarray:
    """A signal that has nothing to do with the process."""
    return 50 + 30 * np.sin(2 * math.pi * np.arange(n) / (n / 3.7))
