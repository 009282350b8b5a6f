"""A linear process under a held input, exact for any dead time, a step at a time.

    x+ = Phi x + G1 u[k-d] + G0 u[k-d+1],   y = C x

theta = (d - 1) h + theta', 0 < theta' <= h: the delayed input changes once within the step (Astrom & Wittenmark,
Computer-Controlled Systems, section 2.3). Sections in series, so that time constants may lie decades apart.
"""

import math

import numpy as np
from scipy.linalg import expm

from cases.case import FloatArray
from retuner.adaptive.process.model import LinearProcess

ROUNDING = 1e-9
"""Share of a step by which a dead time may miss a whole number of steps and still count as whole."""

Section = tuple[FloatArray, FloatArray, FloatArray]


def realise(process: LinearProcess) -> Section:
    """A, B, C of the process without its dead time: sections in series, each lead on a lag or a pair."""
    leads = sorted((x for x in process.leads_s if x), key=abs)
    sections: list[tuple[FloatArray, FloatArray, FloatArray, float]] = []
    spare = len(leads) - sum(lag > 0 for lag in process.lags_s)
    for i, (c1, c2) in enumerate(process.quadratics):
        row = np.array([1.0, leads.pop(0) if i < spare else 0.0])
        sections.append((np.array([[0.0, 1.0], [-1 / c2, -c1 / c2]]), np.array([0, 1 / c2]), row, 0.0))
    for lag in sorted((x for x in process.lags_s if x > 0), reverse=True):
        lead = leads.pop() if leads else 0.0
        sections.append((np.array([[-1 / lag]]), np.array([1 / lag]), np.array([1 - lead / lag]), lead / lag))
    sections += [(np.zeros((1, 1)), np.ones(1), np.ones(1), 0.0)] * process.integrators
    if leads or not any(d == 0 for *_, d in sections):
        raise ValueError(f"{process}: as many leads as lags, no room for a held input")
    a, b, c, d = np.zeros((0, 0)), np.zeros(0), np.zeros(0), process.k
    for a2, b2, c2_row, d2 in sections:
        n, m = len(a), len(a2)
        whole = np.zeros((n + m, n + m))
        whole[:n, :n], whole[n:, n:], whole[n:, :n] = a, a2, np.outer(b2, c)
        a, b, c, d = whole, np.concatenate([b, b2 * d]), np.concatenate([d2 * c, c2_row]), d2 * d
    return a, b, c


class HeldPlant:
    """The process in steps of h_s, about zero; `move` holds an input for one step."""

    def __init__(self, process: LinearProcess, h_s: float) -> None:
        a, b, c = realise(process)
        samples = max(math.ceil(process.theta_s / h_s - ROUNDING), 1)
        late = min(max(process.theta_s - (samples - 1) * h_s, 0.0), h_s)
        phi_late, g_late = _held(a, b, late)
        phi_rest, g_rest = _held(a, b, h_s - late)
        n = len(b)
        self._whole = np.column_stack([phi_rest @ phi_late, phi_rest @ g_late, g_rest])
        self._c, self._n = c, n
        self._z = np.zeros(n + 2)
        self._past = [0.0] * (samples + 1)
        self._at = 0

    def move(self, u: float) -> float:
        """Hold the input u for one step; the output at its end."""
        past, at, z, n = self._past, self._at, self._z, self._n
        past[at] = u
        at = at + 1 if at + 1 < len(past) else 0
        self._at = at
        z[n] = past[at - len(past)]
        z[n + 1] = past[at + 1 - len(past)]
        z[:n] = self._whole @ z
        return float(self._c @ z[:n])


def _held(a: FloatArray, b: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """exp(A dt) and its integral times B (Van Loan's augmented exponential)."""
    n = len(b)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = a, b
    whole = np.asarray(expm(augmented * dt_s), dtype=np.float64)
    return whole[:n, :n], whole[:n, n]
