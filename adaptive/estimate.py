"""What a fit knows of the process: log-parameters with their covariance, and the model they stand for."""

import math
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.adaptive.sample import FloatArray

SMALLEST_VARIANCE = 1e-12
"""Of a log-parameter: no record knows a process to a millionth, and rounding makes smaller ones negative."""


def proper_covariance(p: FloatArray) -> FloatArray:
    """The nearest symmetric matrix whose eigenvalues are at least SMALLEST_VARIANCE; shapes (n, n)."""
    values, vectors = np.linalg.eigh((p + p.T) / 2)
    kept = (vectors * np.maximum(values, SMALLEST_VARIANCE)) @ vectors.T
    return np.asarray((kept + kept.T) / 2, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class LogModel:
    """First order + dead time in logarithms: x = (ln |k'|, ln theta, ln tau), k' = k / tau.

    Parameters
    ----------
    x : mean, shape (3,).
    p : covariance, shape (3, 3).
    sign : sign of the gain.

    Raises
    ------
    ValueError
        A value is not finite or the covariance is not symmetric and positive.
    """

    x: FloatArray
    p: FloatArray
    sign: int

    def __post_init__(self) -> None:
        if self.x.shape != (3,) or self.p.shape != (3, 3):
            raise ValueError(f"shapes {self.x.shape}, {self.p.shape}; a first-order model has (3,), (3, 3)")
        if not (np.all(np.isfinite(self.x)) and np.all(np.isfinite(self.p))):
            raise ValueError("the estimate is not finite")
        if np.min(np.linalg.eigvalsh((self.p + self.p.T) / 2)) < 0:
            raise ValueError("the covariance has a negative eigenvalue")

    def model(self) -> ProcessModel:
        """The process model at the mean."""
        return model_at(self.x, self.sign)

    def std(self) -> dict[str, float]:
        """Standard deviations of k, tau1 and theta in their own units (first order in the logarithms)."""
        model = self.model()
        to_k = np.array([1.0, 0.0, 1.0])  # ln k = ln k' + ln tau
        return {
            "k": abs(model.k) * math.sqrt(float(to_k @ self.p @ to_k)),
            "tau1": model.tau1_s * math.sqrt(float(self.p[2, 2])),
            "theta": model.theta_s * math.sqrt(float(self.p[1, 1])),
        }

    def gain_uncertainty(self) -> float:
        """Standard deviation of ln |G(j/theta)|: of the process gain where the tuned loop lives, hence of Kc.

        A lag-dominant process shows k' theta there, a delay-dominant one k.
        """
        lagging = 1 / (1 + math.exp(2 * float(self.x[1] - self.x[2])))  # r^2 / (1 + r^2), r = tau / theta
        a = np.array([1.0, lagging, 1 - lagging])
        return math.sqrt(float(a @ self.p @ a))


def model_at(x: FloatArray, sign: int) -> ProcessModel:
    """The process model at log-parameters x, shape (3,)."""
    slope, theta, tau = (float(v) for v in np.exp(x))
    return ProcessModel(ProcessType.FOPDT, sign * slope * tau, tau, 0.0, theta)


@dataclass(frozen=True, slots=True)
class ModelEstimate:
    """The outcome of identification of one record.

    log : parameters and covariance, prior included where there was one.
    identifiable : whether the settings that follow are known well enough; reason says why or why not.
    load_times_s : when load steps entered. residual_std, noise_std : of the fit, and of the noise by itself, pv units.
    deviance : misfit over sigma squared at the optimum (prior included).
    information, score : the record's information linearised at the optimum, shapes (3, 3) and (3,), as R and z of
        R x = z + unit noise (compressed by QR), for the Kalman filter.
    """

    log: LogModel
    identifiable: bool
    reason: str
    load_times_s: tuple[float, ...]
    residual_std: float
    noise_std: float
    deviance: float
    information: FloatArray
    score: FloatArray

    def to_dict(self) -> dict[str, object]:
        """Keys identifiable, model, std, reason, loads, residual, noise."""
        return {
            "identifiable": self.identifiable,
            "model": self.log.model().to_dict(),
            "std": self.log.std(),
            "reason": self.reason,
            "loads": list(self.load_times_s),
            "residual": self.residual_std,
            "noise": self.noise_std,
        }
