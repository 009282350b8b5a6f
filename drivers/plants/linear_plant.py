"""Any linear process as a plant, exact for a held output: the virtual device's test plant.

    x+ = Phi x + G1 u[k-d] + G0 u[k-d+1],   pv = C x + D u(t - theta)

Phi, G0, G1 from the matrix exponential; theta = (d - 1) dt + theta', 0 < theta' <= dt, so the delayed input changes
once within the sample, theta' after its start (Astrom & Wittenmark, Computer-Controlled Systems, section 2.3). Exact
for every delay, unlike a Pade approximation or a delay rounded to samples. Realised as a chain of first-order sections,
each lag (or integrator) taking at most one lead, so that time constants may lie decades apart.
"""

import math

import numpy as np

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.drivers.plants.plant import MeasurementNoise, check_step

Matrix = list[list[float]]
ROUNDING = 1e-9  # share of a sample by which a delay may miss a whole number of samples and still count as whole


class LinearPlant:
    """A linear process about an operating point: pv = pv0 + G (co - co0 + load), clipped co.

    Parameters
    ----------
    process : the process; its gain is in pv units per percent.
    start_pv, start_co : operating point at the start, at rest.
    noise : standard deviation of the measurement noise, pv units.
    seed : of that noise.
    co_min, co_max : limits of the actuator, percent.

    Raises
    ------
    ValueError
        More leads than lags and integrators (no causal plant), or co limits without room between them.
    """

    def __init__(
        self,
        process: LinearProcess,
        *,
        start_pv: float = 0.0,
        start_co: float = 50.0,
        noise: float = 0.0,
        seed: int = 0,
        co_min: float = 0.0,
        co_max: float = 100.0,
    ) -> None:
        if not (math.isfinite(start_pv) and math.isfinite(start_co) and co_min < co_max):
            raise ValueError(f"start_pv {start_pv}, start_co {start_co}, co {co_min}..{co_max}: give finite numbers")
        self.process = process
        self._pv0, self._co0, self._limits = start_pv, start_co, (co_min, co_max)
        self._noise = MeasurementNoise(noise, seed)
        self._a, self._b, self._c, self._d = _realise(process)
        self._x = [0.0] * len(self._b)
        self._dt_s = 0.0
        self._steps: _Steps | None = None
        self._inputs: list[float] = []
        self._pv = start_pv

    @property
    def pv(self) -> float:
        """Reading without noise, pv units."""
        return self._pv

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s and read the sensor: see plant.Plant. dt_s must stay that of the first step.

        Raises
        ------
        ValueError
            As plant.Plant says, or dt_s differs from the first step's.
        """
        check_step(co, load, dt_s)
        steps = self._discretised(dt_s)
        low, high = self._limits
        held = min(max(co, low), high) - self._co0 + load
        self._inputs.append(held)
        old, new = self._inputs[0], self._inputs[1]
        x = self._x
        self._x = [
            sum(p * xi for p, xi in zip(row, x, strict=True)) + g1 * old + g0 * new
            for row, g1, g0 in zip(steps.phi, steps.g1, steps.g0, strict=True)
        ]
        self._inputs.pop(0)
        self._pv = self._pv0 + sum(c * xi for c, xi in zip(self._c, self._x, strict=True)) + self._d * new
        return self._pv + self._noise()

    def _discretised(self, dt_s: float) -> "_Steps":
        """The matrices for this sampling interval, made at the first step."""
        if self._steps is None:
            self._dt_s, self._steps = dt_s, _Steps(self._a, self._b, self.process.theta_s, dt_s)
            self._inputs = [0.0] * self._steps.delay_samples
        elif dt_s != self._dt_s:
            raise ValueError(f"dt_s = {dt_s}, but this plant was started with {self._dt_s}; keep one sampling interval")
        return self._steps

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """Output in percent that holds pv: see plant.Plant."""
        moved = 0.0 if self.process.integrators else (pv - self._pv0) / self.process.k
        co = self._co0 + moved - load
        low, high = self._limits
        if not low <= co <= high:
            raise ValueError(f"pv = {pv} needs co = {co:.3g} %; the actuator gives {low} to {high} %")
        return co

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:  # noqa: ARG002  linear: everywhere the same
        """The process itself: see plant.Plant."""
        return self.process


class _Steps:
    """Phi, G0, G1 and the number of past inputs for one sampling interval."""

    def __init__(self, a: FloatArray, b: FloatArray, theta_s: float, dt_s: float) -> None:
        samples = max(math.ceil(theta_s / dt_s - ROUNDING), 1)
        late = min(max(theta_s - (samples - 1) * dt_s, 0.0), dt_s)  # theta' in 0..dt, 0 only where theta is 0
        self.delay_samples = samples
        phi_late, g_late = _held(a, b, late)
        phi_rest, g_rest = _held(a, b, dt_s - late)
        self.phi: Matrix = (phi_rest @ phi_late).tolist()
        self.g1: list[float] = (phi_rest @ g_late).tolist()
        self.g0: list[float] = g_rest.tolist()


def _held(a: FloatArray, b: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """exp(A dt) and its integral times B: the step response over dt (Van Loan's augmented exponential)."""
    n = len(b)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = a, b
    from scipy.linalg import expm

    whole = np.asarray(expm(augmented * dt_s), dtype=np.float64)
    return whole[:n, :n], whole[:n, n]


def _realise(process: LinearProcess) -> tuple[FloatArray, FloatArray, list[float], float]:
    """A, B, C, D of the chain of sections (lead s + 1)/(lag s + 1) and (lead s + 1)/s, gain first, fastest lag last."""
    lags = [*([math.inf] * process.integrators), *sorted((lag for lag in process.lags_s if lag > 0), reverse=True)]
    leads = sorted((lead for lead in process.leads_s if lead), key=abs, reverse=True)
    n = len(lags)
    if len(leads) > n or process.quadratics:
        raise ValueError(f"{len(leads)} leads, {n} lags: not causal, or a pair of poles that swings; add lags, no pair")
    a, b = np.zeros((n, n)), np.zeros(n)
    row, through = np.zeros(n), process.k  # what enters the next section: row x + through u
    for i, lag in enumerate(lags):
        lead = leads[i] if i < len(leads) else 0.0
        decay, gain = (0.0, 1.0) if lag == math.inf else (1.0 / lag, 1.0 / lag)
        a[i, :] = gain * row
        a[i, i] -= decay
        b[i] = gain * through
        # output: state's share plus lead times the state's derivative
        row, through = lead * a[i, :], lead * b[i]
        row[i] += 1.0
    return a, b, row.tolist(), float(through)
