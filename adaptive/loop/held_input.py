"""A process stepped from sample to sample under an output that is held between them: exact, dead time included.

    x+ = Phi x + G1 u[k-d] + G0 u[k-d+1],   pv = C x + D u(t - theta)

Phi, G0, G1 from the matrix exponential; theta = (d - 1) dt + theta', 0 < theta' <= dt, so the delayed input changes
once within the sample, theta' after its start (Astrom & Wittenmark, Computer-Controlled Systems, section 2.3).
"""

import math
from typing import NamedTuple

import numpy as np

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.process.state_space import StateSpace, state_space
from retuner.adaptive.signals.sample import FloatArray

ROUNDING = 1e-9
"""Share of a sample by which a dead time may miss a whole number of samples and still count as whole."""


class HeldMatrices(NamedTuple):
    """The matrices of the head of this file: phi (n, n), g1, g0, c (n,), d, and d of the delay in samples."""

    phi: FloatArray
    g1: FloatArray
    g0: FloatArray
    c: FloatArray
    d: float
    delay: int


class HeldInput:
    """A linear process at rest, about the operating point pv = 0, co = 0.

    Parameters
    ----------
    process : the process. dt_s : sampling interval, seconds, more than 0.

    Raises
    ------
    ValueError
        dt_s is not positive and finite, or the process has more zeros than poles.
    """

    def __init__(self, process: LinearProcess, dt_s: float) -> None:
        if not 0.0 < dt_s < math.inf:
            raise ValueError(f"dt_s = {dt_s} must be a positive finite number of seconds")
        space = state_space(process, dt_s)
        samples = max(math.ceil(process.theta_s / dt_s - ROUNDING), 1)
        late = min(max(process.theta_s / dt_s - (samples - 1), 0.0), 1.0)
        phi_late, g_late = _held(space, late)
        phi_rest, g_rest = _held(space, 1.0 - late)
        self._phi, self._g1, self._g0 = phi_rest @ phi_late, phi_rest @ g_late, g_rest
        self._space = space
        self._x = np.zeros(len(space.b))
        self._inputs = [0.0] * samples
        self._at = 0

    @property
    def matrices(self) -> HeldMatrices:
        """What it steps with."""
        return HeldMatrices(self._phi, self._g1, self._g0, self._space.c, self._space.d, len(self._inputs))

    def step(self, co: float) -> float:
        """Hold co for one interval; pv at its end."""
        old = self._inputs[self._at]
        self._inputs[self._at] = co
        self._at = (self._at + 1) % len(self._inputs)
        new = self._inputs[self._at]
        self._x = self._phi @ self._x + self._g1 * old + self._g0 * new
        return float(self._space.c @ self._x) + self._space.d * new

    def over(self, co: FloatArray) -> FloatArray:
        """pv at the times of n outputs, each held until the next one: shape (n,), the first 0."""
        found = np.zeros(len(co))
        for i, held in enumerate(co[:-1].tolist()):
            found[i + 1] = self.step(held)
        return found


def _held(space: StateSpace, share: float) -> tuple[FloatArray, FloatArray]:
    """exp(A h) and its integral times B for a share h of an interval (Van Loan's augmented exponential)."""
    n = len(space.b)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = space.a, space.b
    from scipy.linalg import expm

    whole = np.asarray(expm(augmented * share), dtype=np.float64)
    return whole[:n, :n], whole[:n, n]
