"""SIMC with perfect knowledge: the half rule on the true process, tau_c = theta, theta + dt/2 for the sampling.

Written apart from retuner's own rule and reduction, which must not be judged by themselves. Lags and negative leads
only. For pairs of complex poles SIMC is not made and reaches Ms of 6; there tau_c is raised until Ms is 1.8.
"""

import math
from dataclasses import replace

from cases.robustness import robustness
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.schedule.gains import PidGains, from_form

MS_OF_COMPLEX_POLES = 1.8
TAU_C_STEP = 1.05
TAU_I_FACTOR = 4.0


def half_rule(process: LinearProcess, order: int = 1) -> ProcessModel:
    """Model of first or second order (Skogestad 2003, section 2).

    A pair of poles 1 + c1 s + c2 s^2 counts as two lags of sqrt(c2), which have the same size and, at 1/sqrt(c2), the
    same phase.
    """
    pairs = [math.sqrt(c2) for _, c2 in process.quadratics for _ in range(2)]
    lags = sorted([*(x for x in process.lags_s if x > 0), *pairs], reverse=True)
    theta = process.theta_s + sum(-x for x in process.leads_s if x < 0)
    kept = order - process.integrators  # an integrator is the first lag of an integrating process
    if kept < len(lags):
        neglected = lags[kept]
        theta += sum(lags[kept + 1 :]) + (neglected if kept == 0 else neglected / 2)
        if kept > 0:
            lags = [*lags[: kept - 1], lags[kept - 1] + neglected / 2]
    lags = lags[:kept]
    if process.integrators:
        if lags:
            return ProcessModel(ProcessType.INTEGRATING_LAG, process.k, 0.0, lags[0], theta)
        return ProcessModel(ProcessType.INTEGRATING, process.k, 0.0, 0.0, theta)
    tau1, tau2 = (*lags, 0.0)[:2]
    tau1, tau2 = max(tau1, tau2), min(tau1, tau2)
    return ProcessModel(ProcessType.SOPDT if tau2 else ProcessType.FOPDT, process.k, tau1, tau2, theta)


def later(model: ProcessModel, delay_s: float) -> ProcessModel:
    """The model with that much more dead time."""
    return replace(model, theta_s=model.theta_s + delay_s)


def sampled(process: LinearProcess, dt_s: float) -> LinearProcess:
    """The process as a sampled controller meets it: half a sample more dead time."""
    return replace(process, theta_s=process.theta_s + dt_s / 2)


def simc_of(model: ProcessModel, tau_c_s: float) -> PidGains:
    """Table 1 of Skogestad (2003), series form."""
    span = tau_c_s + model.theta_s
    tau_i = min(model.tau1_s, TAU_I_FACTOR * span) if model.tau1_s else TAU_I_FACTOR * span
    return from_form("series", 1 / (model.slope * span), tau_i, model.tau2_s)


def best_pi(process: LinearProcess, dt_s: float) -> PidGains:
    """SIMC PI settings."""
    return _tuned(process, later(half_rule(process), dt_s / 2), dt_s)


def best_pid(process: LinearProcess, dt_s: float) -> PidGains | None:
    """SIMC PID settings, None where the process has no second lag."""
    model = half_rule(process, 2)
    return _tuned(process, later(model, dt_s / 2), dt_s) if model.tau2_s else None


def _tuned(process: LinearProcess, model: ProcessModel, dt_s: float) -> PidGains:
    """At tau_c = theta, or at the smallest larger one that keeps Ms where there are complex poles."""
    tau_c = model.theta_s
    found = simc_of(model, tau_c)
    if any(c1 * c1 < 4 * c2 for c1, c2 in process.quadratics):
        while robustness(sampled(process, dt_s), found).ms > MS_OF_COMPLEX_POLES:
            tau_c *= TAU_C_STEP
            found = simc_of(model, tau_c)
    return found
