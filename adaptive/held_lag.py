"""Exact response of a first-order lag with any dead time to a held input.

    tau dx/dt = u(t - theta) - x,   u(t) = u_i for t_i <= t < t_(i+1)

The input is constant between samples, so x is known exactly at the samples and between them: the delay-free lag is
run once through the samples, and a dead time of any real size only moves the instants at which it is read. That is
why the dead time can be a continuous unknown of a fit (a delay counted in samples is not, and a Pade one is not exact).
"""

import numpy as np
from scipy.signal import lfilter

from retuner.adaptive.sample import FloatArray

EVEN = 1e-6
"""Sampling intervals that differ by less than this fraction count as equal (the fast path)."""


def states_at_samples(t_s: FloatArray, u: FloatArray, tau_s: float) -> FloatArray:
    """x at the samples without dead time, x(t_0) = u_0; shapes (n,)."""
    dt = np.diff(t_s)
    v = u - u[0]
    if np.ptp(dt) <= EVEN * dt[0]:
        a = float(np.exp(-dt[0] / tau_s))
        x = np.asarray(lfilter([0.0, 1.0 - a], [1.0, -a], v), dtype=np.float64)
    else:
        x = np.array(_run(np.exp(-dt / tau_s).tolist(), v.tolist()))
    return x + float(u[0])


def _run(decay: list[float], v: list[float]) -> list[float]:
    """The same recursion for uneven sampling, in plain floats."""
    x = 0.0
    out = [x]
    for a, held in zip(decay, v[:-1], strict=True):
        x = held + (x - held) * a
        out.append(x)
    return out


def held_lag(t_s: FloatArray, u: FloatArray, tau_s: float, theta_s: float) -> FloatArray:
    """x(t_i) for the lag tau_s and the dead time theta_s, at rest with u_0 before the first sample; shapes (n,).

    tau_s : lag in seconds, > 0. theta_s : dead time in seconds, >= 0, any real number.
    """
    x = states_at_samples(t_s, u, tau_s)
    read_at = t_s - theta_s
    i = np.searchsorted(t_s, read_at, side="right") - 1
    before = i < 0
    i = np.maximum(i, 0)
    since = np.maximum(read_at - t_s[i], 0.0)  # before the first sample nothing has moved; exp would overflow there
    moved = u[i] + (x[i] - u[i]) * np.exp(-since / tau_s)
    return np.where(before, u[0], moved)


def step_through_lag(t_s: FloatArray, at_s: FloatArray, tau_s: float) -> FloatArray:
    """Unit steps at the times at_s (shape (m,)) seen through the lag, shape (n, m)."""
    since = np.maximum(t_s[:, None] - at_s[None, :], 0.0)
    return np.asarray(-np.expm1(-since / tau_s), dtype=np.float64)
