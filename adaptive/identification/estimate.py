"""What a fit knows of the process: log-parameters with their covariance, and the model they stand for."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from retuner.adaptive.fit.structure import LAG, SIZE, THETA, model_at
from retuner.adaptive.identification.candidate import MODEL_ERROR
from retuner.adaptive.identification.plausible import OUT, Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

SMALLEST_VARIANCE = 1e-12
"""Least variance of a log-parameter: no record knows a process to a millionth, rounding makes less negative."""
STRUCTURE_STD = 0.05
"""Least deviation of a logarithm, however long the record: a process has more lags than two, a gain that is not the
same everywhere and tomorrow. Without it a third of ln |G| lay within two deviations on drawn processes that no
structure fits, and 82 % of the parameters where one does (benchmarks/identification.py counts these)."""
BENT = 1 - 2 / math.pi
"""Variance of |u| for a standard normal u: what moves the same way on both sides, as a lag does at two equal ones."""


ROUNDING = 1e-9  # negative eigenvalues up to this share of the largest entry are rounding: a row of zeros is no fault


def proper_covariance(p: FloatArray) -> FloatArray:
    """The nearest symmetric matrix whose eigenvalues are at least SMALLEST_VARIANCE; shapes (n, n)."""
    values, vectors = np.linalg.eigh((p + p.T) / 2)
    kept = (vectors * np.maximum(values, SMALLEST_VARIANCE)) @ vectors.T
    return np.asarray((kept + kept.T) / 2, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class LogModel:
    """A process of one of the structures of a fit in logarithms: see fit/structure.py for the order of x.

    x : mean, shape (d,): ln |k'|, ln theta, then ln T, ln c2 and more where the structure has them.
    p : covariance, shape (d, d).
    sign : sign of the gain.
    type : structure.

    Raises ValueError: a value is not finite, a shape does not fit the structure, or the covariance is not symmetric and
    positive.
    """

    x: FloatArray
    p: FloatArray
    sign: int
    type: ProcessType = ProcessType.FOPDT

    def __post_init__(self) -> None:
        if self.type not in SIZE:
            raise ValueError(f"type {self.type} is not one that a fit can have")
        d = SIZE[self.type]
        if self.x.shape != (d,) or self.p.shape != (d, d):
            raise ValueError(f"shapes {self.x.shape}, {self.p.shape}; type {self.type} has ({d},), ({d}, {d})")
        if not (np.all(np.isfinite(self.x)) and np.all(np.isfinite(self.p))):
            raise ValueError("the estimate is not finite")
        if np.min(np.linalg.eigvalsh((self.p + self.p.T) / 2)) < -ROUNDING * max(float(np.max(np.abs(self.p))), 1.0):
            raise ValueError("the covariance has a negative eigenvalue")

    def model(self) -> ProcessModel:
        """The process model at the mean."""
        return model_at(self.type, self.x, self.sign)

    def std(self) -> dict[str, float]:
        """Standard deviations of k, theta and the lags in their own units (first order in the logarithms).

        Those of the record's noise, and what a structure of few numbers leaves out of a process; see STRUCTURE_STD.
        """
        at = _numbers(self.model())
        p = self.p + STRUCTURE_STD**2 * np.eye(len(self.x))
        logs = self.covariance_of(lambda model: np.log([abs(v) for v in _numbers(model).values()]), p)
        return {name: abs(v) * math.sqrt(float(logs[i, i])) for i, (name, v) in enumerate(at.items())}

    def covariance_of(self, f: Callable[[ProcessModel], FloatArray], p: FloatArray | None = None) -> FloatArray:
        """Covariance of something that follows from the model, shape (n, n).

        Taken one standard deviation either way along every axis of p (the covariance itself where none is given). A
        derivative would be infinite where two lags are equal, however well both are known.
        """
        values, vectors = np.linalg.eigh(self.p if p is None else p)
        at = f(self.model())
        found = np.zeros((len(at), len(at)))
        for value, vector in zip(values, vectors.T, strict=True):
            step = math.sqrt(max(float(value), 0.0)) * vector
            up, down = (f(model_at(self.type, self.x + way, self.sign)) - at for way in (step, -step))
            found += np.outer(up - down, up - down) / 4 + BENT * np.outer(up + down, up + down) / 4
        return found

    def gain_uncertainty(self, sample_time_s: float = 0.0) -> float:
        """Standard deviation of ln |C(jw)|: of the SIMC controller that follows, at w = 1/theta where its loop lives.

        A lag-dominant process decides it by k' theta, a delay-dominant one by k.
        sample_time_s : of the controller; without the dead time that it adds, one near zero is never known.
        """
        at = without_second_lag(self.model()).seen_by_controller(sample_time_s).theta_s
        found = self.covariance_of(lambda model: np.array([log_controller(model, sample_time_s, at)]))
        return math.sqrt(float(found[0, 0]))

    def at_bound(self, bound_s: float) -> "LogModel":
        """The model with an effective dead time of at least a bound, which has no spread; 0 for as it is."""
        if not bound_s or without_second_lag(self.model()).theta_s >= bound_s:
            return self
        x, p = self.x.copy(), self.p.copy()
        x[THETA] = math.log(late(self.model(), bound_s).theta_s)
        p[THETA, :] = p[:, THETA] = 0.0
        return replace(self, x=x, p=p)

    def lag_uncertainty(self) -> float:
        """Standard deviation of the logarithm of the (sum of the) lags; infinite for an integrating process."""
        return math.sqrt(float(self.p[LAG[self.type], LAG[self.type]])) if self.type in LAG else math.inf


def late(model: ProcessModel, bound_s: float) -> ProcessModel:
    """The model with an effective dead time of at least a bound."""
    return replace(model, theta_s=model.theta_s + max(bound_s - without_second_lag(model).theta_s, 0.0))


def _numbers(model: ProcessModel) -> dict[str, float]:
    return {"k": model.k, "theta": model.theta_s, **model.times_s}


def log_controller(model: ProcessModel, sample_time_s: float, at_s: float) -> float:
    """ln |C(j / at)| of SIMC's PI controller for a model as a sampled controller sees it."""
    gains = simc(without_second_lag(model).seen_by_controller(sample_time_s)).gains
    return 0.5 * math.log(gains.kp**2 + (gains.ki * at_s) ** 2)


def gain_spread(around: Sequence[Plausible], sample_time_s: float) -> float:
    """Spread of ln |C(jw)| over the models that a record allows, as a standard deviation: weights exp(-excess / 2)."""
    at = without_second_lag(around[0].model).seen_by_controller(sample_time_s).theta_s
    values = np.array([log_controller(a.model, sample_time_s, at) for a in around])
    weights = np.exp(-np.array([a.excess for a in around]) / 2)
    mean = float(weights @ values / np.sum(weights))
    return math.sqrt(float(weights @ (values - mean) ** 2 / np.sum(weights)))


@dataclass(frozen=True, slots=True)
class Alternative:
    """What a record says when its process has one of the structures.

    log : parameters and covariance, prior included where there was one.
    evidence : n ln sigma^2 + what the load steps and the colour of the remainder cost (Schwarz 1978); without the cost
        of the process parameters, which is paid once for all records of a process. Smaller is better.
    information, score : the record's information linearised at the optimum, shapes (d, d) and (d,), as R and z of
        R x = z + unit noise (compressed by QR), for the Kalman filter.
    samples : n.
    """

    log: LogModel
    evidence: float
    information: FloatArray
    score: FloatArray
    samples: int

    @property
    def criterion(self) -> float:
        """The evidence with the cost of the process parameters."""
        return self.evidence + len(self.log.x) * math.log(self.samples)


@dataclass(frozen=True, slots=True)
class RivalModel:
    """Another model of the same record, without load steps at setpoint changes (fit/record.py).

    model : the process. apart : how far the two are from each other, D of that page, >= 0, may be infinite.
    change_s : the setpoint change at which the winner has a load step.
    """

    model: ProcessModel
    apart: float
    change_s: float

    def __post_init__(self) -> None:
        if not self.apart >= 0 or not math.isfinite(self.change_s):
            raise ValueError(f"apart = {self.apart} must be 0 or more, and change_s = {self.change_s} finite")

    @property
    def sentence(self) -> str:
        """What the two models leave open."""
        return (
            f"pv after the setpoint change at {self.change_s:.5g} s is explained by a load step or by the process; "
            f"the gains of these two models differ by a factor of {factor_text(self.apart)}"
        )

    def to_dict(self) -> dict[str, object]:
        """Keys model, apart (as a factor, null for opposite signs), at."""
        ratio = math.exp(min(self.apart, MOST_LOG))
        return {"model": self.model.to_dict(), "apart": ratio if self.apart < MOST_LOG else None, "at": self.change_s}


MOST_LOG = math.log(1000)  # factors above a thousand are not told apart
FULL_LOG = math.log(10)  # factors from ten on are told in whole numbers


def factor_text(log: float) -> str:
    """A logarithm as the factor people think in; a large one without the decimals that nobody knows."""
    return f"{math.exp(log):.{2 if log < FULL_LOG else 0}f}" if log < MOST_LOG else "over 1000"


MOST_DIGITS = 6
WHOLE = 10.0  # Factors from here on are shown without decimals
"""Digits after which two factors are told as they are."""


def factors_text(log: float, limit: float) -> tuple[str, str]:
    """A logarithm and the limit that it is over, as factors with digits enough to tell them apart."""
    factor = math.exp(min(log, MOST_LOG))
    for digits in range(1 if factor >= WHOLE else 2, MOST_DIGITS):
        texts = f"{factor:.{0 if factor >= WHOLE else digits}f}", f"{math.exp(limit):.{digits}f}"
        if texts[0] != texts[1]:
            break
    return (texts[0] if log < MOST_LOG else factor_text(log)), texts[1]


@dataclass(frozen=True, slots=True)
class ModelEstimate:
    """The outcome of identification of one record.

    identifiable : whether the settings that follow are known well enough; reason says why or why not.
    load_times_s : when load steps entered. residual_std, noise_std : of the fit, and of the noise by itself, pv units.
    alternatives : the structures, best first. coloured : order of the whitening filter that the remainder asked for.
    plausible : models that the record (and the prior) still allow, the best first.
    explained : share of pv's variance that the model explains.
    ramp_s : for how long the load moved, where it came as a ramp; 0 for steps.
    rival : the model without load steps at setpoint changes, where the winner has such.
    bound_s : dead time that is taken where none is seen (dead_time_bound.py); 0 where it is seen.
    """

    identifiable: bool
    reason: str
    load_times_s: tuple[float, ...]
    residual_std: float
    noise_std: float
    alternatives: tuple[Alternative, ...]
    coloured: int = 0
    plausible: tuple[Plausible, ...] = ()
    explained: float = 1.0
    rival: RivalModel | None = None
    ramp_s: float = 0.0
    bound_s: float = 0.0

    @property
    def best(self) -> Alternative:
        """The structure that was chosen."""
        return self.alternatives[0]

    @property
    def log(self) -> LogModel:
        """The estimate's parameters in logarithms, with the dead time at its bound."""
        return self.best.log.at_bound(self.bound_s)

    def unexplained(self, pv_range: float) -> float:
        """What the fit leaves over the noise, or over how inexact any model is where that is larger.

        pv_range : of the record, pv units.
        """
        return self.residual_std / max(self.noise_std, MODEL_ERROR * pv_range)

    def is_contested(self, limit: float) -> bool:
        """Whether a rival model lies farther away than a limit, as a logarithm."""
        return self.rival is not None and self.rival.apart > limit

    def of(self, type_: ProcessType) -> Alternative:
        """A structure by name."""
        return next(a for a in self.alternatives if a.log.type == type_)

    def to_dict(self) -> dict[str, object]:
        """Keys identifiable, model, std, reason, loads, residual, noise, coloured, rival."""
        names = "reason loads=load_times_s residual=residual_std noise=noise_std coloured rival"
        known = {"identifiable": self.identifiable, "model": self.log.model().to_dict(), "std": self.log.std()}
        return known | plain_values(self, names)


MOST_LOG_STEP = math.log(2.0)
"""Farthest that age or a covariance moves a model in any log-parameter: beyond, a Gaussian says nothing."""


def spread(log: LogModel, out: float = OUT) -> tuple[Plausible, ...]:
    """The mean and both ends of every principal axis of the covariance, for the proof of what rests on nothing else.

    out : how far the ends are, standard deviations.
    """
    values, vectors = np.linalg.eigh(log.p)
    axes = out * vectors * np.sqrt(np.maximum(values, 0.0))
    axes = axes * np.minimum(1.0, MOST_LOG_STEP / np.maximum(np.max(np.abs(axes), axis=0), MOST_LOG_STEP))
    ends = [log.x + side * axes[:, j] for j in range(len(log.x)) for side in (1.0, -1.0)]
    best = Plausible(model_at(log.type, log.x, log.sign), 0.0)
    return (best, *(Plausible(model_at(log.type, x, log.sign), out**2) for x in ends))
