"""The Cramer-Rao bound of ln Kc: how well any unbiased estimator could know the controller gain from a record.

The Fisher information of the true structure under white noise, with the recorded co as input (in closed loop this is
the prediction-error information: what co owes to past noise is known). Unknown besides the process are the bias, the
size and place of every load step, and for an integrating process the resting input.
"""

import math
from dataclasses import replace

import numpy as np

from cases.best import half_rule, later, simc_of
from cases.case import FloatArray, IdentificationCase
from cases.plant import HeldPlant
from retuner.adaptive.process.model import LinearProcess

PLAIN = frozenset({"open-loop step", "open-loop steps", "setpoint", "load", "setpoint and load", "several", "pid"})
"""Groups with nothing but steps and white noise."""
STEP = 1e-4


def kc_bound(case: IdentificationCase) -> float:
    """Smallest standard deviation of ln Kc; NaN where a record has more unknowns than are modelled here."""
    if case.group not in PLAIN or case.note.get("drift"):
        return math.nan
    t = case.record.t
    n, dt = len(t), case.dt_s
    loads = [(case.note[f"load_at{i}"], case.note[f"load{i}"]) for i in range(int(case.note.get("loads", 0)))]
    theta = np.array([0.0] * _free(case.process) + [0.0, 0.0] * len(loads))
    scale = float(np.ptp(case.record.pv))

    def output(p: FloatArray) -> FloatArray:
        process = _moved(case.process, p)
        u = case.record.co - case.record.co[0]
        for i, (at, size) in enumerate(loads):
            shift, stretch = p[_free(case.process) + 2 * i : _free(case.process) + 2 * i + 2]
            u = u + size * (1 + stretch) * np.clip(np.arange(n) + 1 - at - shift, 0, 1)
        plant = HeldPlant(process, dt)
        return np.array([0.0, *(plant.move(float(x)) for x in u[:-1])])

    columns = [np.ones(n) * scale]
    if case.process.integrators:
        columns.append(np.arange(n) * scale / n)
    base = np.eye(len(theta)) * STEP
    columns += [(output(theta + e) - output(theta - e)) / (2 * STEP) for e in base]
    jacobian = np.column_stack(columns) / case.noise
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0  # the logarithm of a dead time of zero
    covariance = np.linalg.pinv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    first = len(columns) - len(theta)
    free = slice(first, first + _free(case.process))
    gradient = np.array(
        [
            (_ln_kc(_moved(case.process, e), dt) - _ln_kc(_moved(case.process, -e), dt)) / (2 * STEP)
            for e in np.eye(_free(case.process)) * STEP
        ]
    )
    return float(math.sqrt(gradient @ covariance[free, free] @ gradient))


def _free(process: LinearProcess) -> int:
    """Number of process parameters: gain, dead time, lags."""
    return 2 + len(process.lags_s)


def _moved(process: LinearProcess, p: FloatArray) -> LinearProcess:
    """The process with its parameters' logarithms moved by p."""
    factor = np.exp(p[: _free(process)])
    lags = tuple(float(x * f) for x, f in zip(process.lags_s, factor[2:], strict=True))
    return replace(process, k=process.k * float(factor[0]), theta_s=process.theta_s * float(factor[1]), lags_s=lags)


def _ln_kc(process: LinearProcess, dt_s: float) -> float:
    """Of SIMC PI."""
    model = later(half_rule(process), dt_s / 2)
    return math.log(abs(simc_of(model, model.theta_s).kp))
