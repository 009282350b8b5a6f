"""Output-error misfit of a record for a first-order process with dead time: what identification minimises.

    pv = bias + k x(co; tau, theta) + c exp(-(t - t_0)/tau) + sum_j d_j step_j(t; tau) + noise

x is the recorded co through lag and dead time (output error: the recorded input, never the recorded output, so that
measurement noise does not bias the fit, unlike ARX). c is the start from a state that was not rest, and with the bias
it also takes a resting input that is not the resting co. d_j are load steps at unknown times, entering before the lag.
The linear unknowns bias, c, d_j are projected out (variable projection, Golub & Pereyra 1973); the rest is

    p = (ln |k'|, ln theta, ln tau, s_1 ... s_m),   k' = k / tau the slope gain, s_j the load times in seconds.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.held_lag import held_lag, step_through_lag
from retuner.adaptive.sample import FloatArray, Window

PROCESS_PARAMETERS = 3
"""ln |k'|, ln theta, ln tau; what follows them in p are load times."""
AT_REST = 1e-6
"""A start_spread of zero (a record known to begin at rest) counts as this, so that its weight stays finite."""


@dataclass(frozen=True, slots=True)
class OutputError:
    """The misfit of one record.

    window : the record. sigma : noise standard deviation in pv units that residuals are counted in. sign : of k.
    start_spread : prior standard deviation of the start transient c, as a fraction of pv's range in the record.
    """

    window: Window
    sigma: float
    sign: int
    start_spread: float

    def residuals(self, p: FloatArray) -> FloatArray:
        """Residuals in units of sigma after the linear unknowns are projected out, shape (n + 1,).

        The last one is the prior on the start transient.
        """
        basis, target = self.nuisance(p), self.target(p)
        q, _ = np.linalg.qr(basis)
        return np.asarray((target - q @ (q.T @ target)) / self.sigma, dtype=np.float64)

    def target(self, p: FloatArray) -> FloatArray:
        """pv minus what co explains, with a zero for the prior's row; shape (n + 1,)."""
        tau = float(np.exp(p[2]))
        k = self.sign * float(np.exp(p[0])) * tau
        x = held_lag(self.window.t_s, self.window.co, tau, float(np.exp(p[1])))
        return np.append(self.window.pv - k * (x - self.window.co[0]), 0.0)

    def nuisance(self, p: FloatArray) -> FloatArray:
        """Columns of the linear unknowns: bias, start transient, load steps; shape (n + 1, 2 + m)."""
        t, tau = self.window.t_s, float(np.exp(p[2]))
        columns = np.zeros((len(t) + 1, 2 + len(p) - PROCESS_PARAMETERS))
        columns[:-1, 0] = 1.0
        columns[:-1, 1] = np.exp(-(t - t[0]) / tau)
        columns[-1, 1] = self.sigma / (max(self.start_spread, AT_REST) * float(np.ptp(self.window.pv)))
        columns[:-1, 2:] = step_through_lag(t, p[PROCESS_PARAMETERS:], tau)
        return columns

    def explained(self, p: FloatArray) -> FloatArray:
        """The fitted pv, shape (n,)."""
        return np.asarray(self.window.pv - self.residuals(p)[:-1] * self.sigma, dtype=np.float64)

    def jacobian(self, p: FloatArray) -> FloatArray:
        """Derivative of the residuals by p, central differences, shape (n + 1, len(p))."""
        steps = np.full(len(p), 1e-5)
        steps[PROCESS_PARAMETERS:] = 1e-3 * self.window.sample_time_s
        columns = []
        for j, h in enumerate(steps):
            up, down = p.copy(), p.copy()
            up[j], down[j] = p[j] + h, p[j] - h
            columns.append((self.residuals(up) - self.residuals(down)) / (2 * h))
        return np.stack(columns, axis=1)
