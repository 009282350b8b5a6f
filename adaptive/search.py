"""Where to start the fit: a coarse search over lag, dead time and load times.

All lasting failures of output-error fits are local optima, so the starts cover the plane of (tau, theta) on a grid; at
every node the gain and the other linear unknowns are solved for, and load steps are added one by one where they take
away most of the misfit. The best nodes become starts of the refinement.
"""

import numpy as np

from retuner.adaptive.held_lag import held_lag, step_through_lag
from retuner.adaptive.output_error import OutputError
from retuner.adaptive.sample import FloatArray, Window

TAU_NODES = 9
THETA_NODES = 7
LOAD_NODES = 48
"""Candidates for lag, dead time and the time of a load step."""
MOST_ROWS = 400
"""The search looks at no more samples than this; the refinement uses all."""
TAU_RANGE = (2.0, 3.0)
"""Lags searched: from this many sampling intervals to this many record lengths."""
THETA_RANGE = (0.3, 0.3)
"""Dead times searched: from this many sampling intervals to this share of the record."""
LOAD_GAIN = 10.0
"""A load step must lower the deviance (in units of the noise) by this and more to be a candidate at all."""


def starts(misfit: OutputError, most_loads: int, count: int) -> list[FloatArray]:
    """The best `count` starting points p for every number of load steps from 0 to most_loads."""
    window = misfit.window.condensed(MOST_ROWS)
    dt, span = window.sample_time_s, float(window.t_s[-1] - window.t_s[0])
    dt_full = misfit.window.sample_time_s
    taus = np.geomspace(TAU_RANGE[0] * dt_full, TAU_RANGE[1] * span, TAU_NODES)
    thetas = np.geomspace(THETA_RANGE[0] * dt_full, max(THETA_RANGE[1] * span, dt), THETA_NODES)
    at = np.linspace(window.t_s[0], window.t_s[-1], LOAD_NODES + 2)[1:-1]
    nodes: list[list[tuple[float, FloatArray]]] = [[] for _ in range(most_loads + 1)]
    for tau in taus:
        steps = step_through_lag(window.t_s, at, tau)
        for theta in thetas:
            for loads, found in enumerate(_node(misfit, window, float(tau), float(theta), at, steps, most_loads)):
                nodes[loads].append(found)
    return [p for ranked in nodes for _, p in sorted(ranked, key=lambda f: f[0])[:count]]


def _node(
    misfit: OutputError, window: Window, tau: float, theta: float, at: FloatArray, steps: FloatArray, most_loads: int
) -> list[tuple[float, FloatArray]]:
    """Deviance and p at one node, with 0, 1, ... load steps."""
    x = held_lag(window.t_s, window.co, tau, theta) - window.co[0]
    base = [np.ones_like(x), np.exp(-(window.t_s - window.t_s[0]) / tau)]
    chosen: list[int] = []
    found = []
    while True:
        columns = np.stack([x, *base, *(steps[:, j] for j in chosen)], axis=1)
        q, r = np.linalg.qr(columns)
        rest = window.pv - q @ (q.T @ window.pv)
        gain = float(np.linalg.lstsq(r, q.T @ window.pv, rcond=None)[0][0]) / tau
        slope = max(gain * misfit.sign, 1e-3 * abs(gain) + 1e-12)  # a gain of the wrong sign starts near zero
        p = np.array([np.log(slope), np.log(theta), np.log(tau), *sorted(at[chosen])])
        found.append((float(rest @ rest), p))
        if len(chosen) == most_loads:
            return found
        free = steps - q @ (q.T @ steps)
        size = np.einsum("ij,ij->j", free, free)
        taken = np.where(size > 1e-9 * len(x), (rest @ free) ** 2 / np.maximum(size, 1e-300), 0.0)
        best = int(np.argmax(taken))
        if taken[best] < LOAD_GAIN * misfit.sigma**2:
            return found
        chosen.append(best)
