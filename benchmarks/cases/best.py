"""SIMC with perfect knowledge: the half rule on the true process, tau_c = theta, theta + dt/2 for the sampling.

Written apart from retuner's own reduction, which must not be judged by itself. Lags and negative leads only. For pairs
of complex poles SIMC is not made and reaches Ms of 6; there tau_c is raised until Ms is 1.8.
"""

import math
from dataclasses import replace

from retuner.adaptive.margins import sensitivity_peak
from retuner.adaptive.process import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules.simc import ControllerKind, simc
from retuner.schedule.gains import PidGains

MS_OF_COMPLEX_POLES = 1.8
TAU_C_STEP = 1.05


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
        return _integrating(process.k, lags, theta)
    tau1, tau2 = (*lags, 0.0)[:2]
    tau1, tau2 = max(tau1, tau2), min(tau1, tau2)
    return ProcessModel(ProcessType.SOPDT if tau2 else ProcessType.FOPDT, process.k, tau1, tau2, theta)


def _integrating(k: float, lags: list[float], theta: float) -> ProcessModel:
    if lags:
        return ProcessModel(ProcessType.INTEGRATING_LAG, k, 0.0, lags[0], theta)
    return ProcessModel(ProcessType.INTEGRATING, k, 0.0, 0.0, theta)


def later(model: ProcessModel, delay_s: float) -> ProcessModel:
    """The model with that much more dead time."""
    return replace(model, theta_s=model.theta_s + delay_s)


def sampled(process: LinearProcess, dt_s: float) -> LinearProcess:
    """The process as a sampled controller meets it: half a sample more dead time."""
    return replace(process, theta_s=process.theta_s + dt_s / 2)


def best_pi(process: LinearProcess, dt_s: float) -> PidGains:
    """SIMC PI settings."""
    return _tuned(process, later(half_rule(process), dt_s / 2), dt_s, ControllerKind.PI)


def best_pid(process: LinearProcess, dt_s: float) -> PidGains | None:
    """SIMC PID settings, None where the process has no second lag."""
    model = half_rule(process, 2)
    if not model.tau2_s:
        return None
    return _tuned(process, later(model, dt_s / 2), dt_s, ControllerKind.PID)


def _tuned(process: LinearProcess, model: ProcessModel, dt_s: float, kind: ControllerKind) -> PidGains:
    """At tau_c = theta, or at the smallest larger one that keeps Ms where there are complex poles."""
    tau_c = model.theta_s
    found = simc(model, tau_c, kind).gains
    if any(c1 * c1 < 4 * c2 for c1, c2 in process.quadratics):
        while sensitivity_peak(sampled(process, dt_s), found) > MS_OF_COMPLEX_POLES:
            tau_c *= TAU_C_STEP
            found = simc(model, tau_c, kind).gains
    return found
