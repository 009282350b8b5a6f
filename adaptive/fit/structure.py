"""The seven structures that a fit chooses between, as points of one family (dynamics.py).

    x = (ln k', ln theta [, ln T] [, ln c2] [, ln |b| or ln d]),   T = tau1 + tau2, c2 = tau1 tau2 / T, in seconds
    b the time constant of a zero, 1 - b s: above 0 pv answers the wrong way first, below 0 it leads: jumps, then creeps
    d > 0 a third lag, 1/(1 + d s): what lacks one is explained by load steps that never were

Logarithms, because time constants and gains are known to a factor, and because a scale of time or of units then only
shifts x. Complex poles are in it (c2 > T/4): two lags fitted to a process that swings was the one lasting structural
error of the estimation study.
"""

import math

import numpy as np

from retuner.adaptive.fit.dynamics import Dynamics
from retuner.adaptive.process.model import ZERO_SIDE, ProcessModel, ProcessType
from retuner.adaptive.signals.sample import FloatArray

SLOPE, THETA = 0, 1  # places of ln k' and ln theta in x
INVERSE = {ProcessType.SOPDT_INVERSE: 4, ProcessType.SOPDT_LEAD: 4}  # place of ln |b|, where the structure has it
LAG = {ProcessType.FOPDT: 2, ProcessType.SOPDT: 2, ProcessType.TOPDT: 2, **dict.fromkeys(INVERSE, 2)}
"""Place of ln T, where the structure has it."""
SECOND = {ProcessType.SOPDT: 3, ProcessType.INTEGRATING_LAG: 2, ProcessType.TOPDT: 3, **dict.fromkeys(INVERSE, 3)}
"""Place of ln c2, where the structure has it."""
THIRD = {ProcessType.TOPDT: 4}  # place of ln d, where the structure has it
SIZE = {
    ProcessType.FOPDT: 3,
    ProcessType.SOPDT: 4,
    ProcessType.INTEGRATING: 2,
    ProcessType.INTEGRATING_LAG: 3,
    ProcessType.SOPDT_INVERSE: 5,
    ProcessType.SOPDT_LEAD: 5,
    ProcessType.TOPDT: 5,
}
"""Number of parameters."""
LEAST_ZETA = 0.15
"""Damping below which nothing is fitted: what rings longer is a tone, or a loop at its limit. At 0.35 a process at 0.34
and one at 0.2 looked alike, and neither got the settings that it could have."""


def leads(type_: ProcessType) -> bool:
    """Whether a structure has a lead. What leads does so by two ways of first order, so its poles are real."""
    return ZERO_SIDE.get(type_, 0) < 0


def dynamics_at(type_: ProcessType, x: FloatArray) -> Dynamics:
    """The delay-free dynamics at the parameters x, shape (SIZE,) or longer, before a third lag."""
    c2 = math.exp(x[SECOND[type_]]) if type_ in SECOND else 0.0
    c0 = math.exp(-x[LAG[type_]]) if type_ in LAG else 0.0
    return Dynamics(c2, c0, inverse_s=inverse_s(type_, x))


def inverse_s(type_: ProcessType, x: FloatArray) -> float:
    """b of a zero 1 - b s, s; 0 where the structure has none."""
    return ZERO_SIDE[type_] * math.exp(x[INVERSE[type_]]) if type_ in INVERSE else 0.0


def model_at(type_: ProcessType, x: FloatArray, sign: int) -> ProcessModel:
    """The process model at the parameters x; sign is that of the gain."""
    slope, theta = sign * math.exp(x[SLOPE]), math.exp(x[THETA])
    if type_ == ProcessType.INTEGRATING:
        return ProcessModel(type_, slope, theta_s=theta)
    if type_ == ProcessType.INTEGRATING_LAG:
        return ProcessModel(type_, slope, 0.0, math.exp(x[SECOND[type_]]), theta)
    total = math.exp(x[LAG[type_]])
    if type_ == ProcessType.FOPDT:
        return ProcessModel(type_, slope * total, total, 0.0, theta)
    c2 = math.exp(x[SECOND[type_]])
    d = 1 - 4 * c2 / total
    inverse = inverse_s(type_, x)
    third = math.exp(x[THIRD[type_]]) if type_ in THIRD else 0.0
    if d < 0:
        tau = math.sqrt(c2 * total)
        return ProcessModel(type_, slope * total, tau, tau, theta, min(total / (2 * tau), 1.0), inverse, third)
    root = math.sqrt(d)
    tau1 = total * (1 + root) / 2
    return ProcessModel(type_, slope * total, tau1, min(2 * c2 / (1 + root), tau1), theta, 1.0, inverse, third)


def parameters_of(model: ProcessModel) -> FloatArray:
    """x of a model of one of the structures; the inverse of model_at.

    Raises ValueError: the model has another structure, no dead time, or a second lag of zero where its structure has
    one.
    """
    if model.type not in SIZE:
        raise ValueError(f"type {model.type} is not one that a fit can have")
    if not model.theta_s > 0:
        raise ValueError(f"theta_s = {model.theta_s}: a fit needs a dead time above zero")
    pair = model.tau1_s * model.tau2_s
    total = 2 * model.zeta * model.tau1_s if model.zeta < 1 else model.tau1_s + model.tau2_s
    own = abs(model.inverse_s) or model.tau3_s
    each = (total, pair / total if total else 0.0, own) if model.type in LAG else (model.tau2_s,)
    lags = each[: SIZE[model.type] - len((SLOPE, THETA))]
    if min(lags, default=1.0) <= 0:
        raise ValueError(f"{model.type} with a lag of zero: give the simpler type")
    slope = abs(model.k) / total if model.type in LAG else abs(model.k)
    return np.asarray(np.log([slope, model.theta_s, *lags]), dtype=np.float64)


def swing_excess(type_: ProcessType, x: FloatArray) -> float:
    """How far ln(c2 / T) lies beyond the least damping; zero within it."""
    if not (type_ in LAG and type_ in SECOND):
        return 0.0
    most = -math.log(4 * (1.0 if leads(type_) else LEAST_ZETA) ** 2)
    return max(0.0, float(x[SECOND[type_]] - x[LAG[type_]]) - most)
