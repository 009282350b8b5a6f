"""SIMC: Skogestad's internal-model-control rules, in their native series form (Skogestad 2003, table 1).

    first order        Kc = tau1 / (k (tau_c + theta))        tau_I = min(tau1, c (tau_c + theta))
    second order       the same                               tau_D = tau2
    pure delay         integral only: Ki = 1 / (k (tau_c + theta))
    integrating        Kc = 1 / (k' (tau_c + theta))          tau_I = c (tau_c + theta)
    integrating + lag  the same                               tau_D = tau2
    double integrating Kc = 1 / (4 k'' (tau_c + theta)^2)     tau_I = tau_D = 4 (tau_c + theta)

c = 4. tau_c = theta is the recommended tight choice. A PI controller for a process with a second lag first puts half of
that lag into the dead time and half into tau1 (the half rule of the same paper, section 2).
"""

import math

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import ControllerKind, Tuning, tuning
from retuner.schedule.gains import PidGains

TAU_I_FACTOR = 4.0
"""c in tau_I = min(tau1, c (tau_c + theta)): 4 gives a load response without slow oscillation (Skogestad 2003)."""
TAU_I_FACTOR_HAUGEN = 1.44
"""Haugen's faster choice of c (appendix A, "Skogestad's method for PID tuning"), at the price of robustness."""
TAU_I_FACTOR_HAUGEN_2010 = 2.0  # Haugen's choice of 2010, as Grimholt & Skogestad (2012, section 4.3) quote it


def simc(
    model: ProcessModel, tau_c_s: float | None = None, kind: ControllerKind = ControllerKind.PI, c: float = TAU_I_FACTOR
) -> Tuning:
    """SIMC settings for any of the six structures.

    model : the process; for PI its second lag is taken up by the half rule.
    tau_c_s : desired closed-loop time constant; default the (effective) dead time.
    kind : PI, or PID where the structure has a second lag. A double integrating process always needs PID.
    c : factor of the integral time's upper bound; 4, or the faster choices 2 and 1.44 that Haugen published.

    Raises ValueError: tau_c is missing for a process without dead time, or not positive together with the dead time; c
    is not positive.
    """
    model = without_second_lag(model) if kind == ControllerKind.PI else model.of_second_order()
    if tau_c_s is None:
        if model.theta_s == 0:
            raise ValueError("theta = 0: SIMC's default tau_c = theta does not exist; give tau_c (--tau-c)")
        tau_c_s = model.theta_s
    span = tau_c_s + model.theta_s
    if not 0 < span < math.inf:
        raise ValueError(f"tau_c + theta = {span} s must be positive and finite; give a larger tau_c")
    if not 0 < c < math.inf:
        raise ValueError(f"c = {c} must be positive and finite; the default is 4")
    # The table at the head of this file; span = tau_c + theta
    if model.type == ProcessType.DELAY:
        return Tuning("simc", "parallel", PidGains(0.0, 1 / (model.k * span)), tau_c_s)
    if model.type == ProcessType.DOUBLE_INTEGRATING:
        kc, tau_i, tau_d = 1 / (4 * model.k * span**2), 4 * span, 4 * span
    else:
        kc, tau_i, tau_d = 1 / (model.slope * span), c * span, model.tau2_s
        if model.tau1_s:
            tau_i = min(model.tau1_s, tau_i)
    return tuning("simc", "series", kc, tau_i, tau_d, tau_c_s)


def without_second_lag(model: ProcessModel) -> ProcessModel:
    """The half rule for tau2: half of it joins the dead time, the other half tau1 (an integrator's is infinite).

    An inverse response joins the dead time whole, and so does a third lag.

    On an integrating process that is the reading which reproduces the margins of the Astrom-Hagglund batch, and the
    limit of a second-order process with a long tau1; Skogestad's example E6 prints the whole of it in the dead time.
    """
    if model.tau3_s:
        long, middle, short = model.lags_s()
        return ProcessModel(ProcessType.FOPDT, model.k, long + middle / 2, 0.0, model.theta_s + middle / 2 + short)
    model = model.without_inverse()
    if model.type == ProcessType.SOPDT:
        half = model.tau2_s / 2
        return ProcessModel(ProcessType.FOPDT, model.k, model.tau1_s + half, 0.0, model.theta_s + half)
    if model.type == ProcessType.INTEGRATING_LAG:
        return ProcessModel(ProcessType.INTEGRATING, model.k, 0.0, 0.0, model.theta_s + model.tau2_s / 2)
    return model


def derivative_pays(model: ProcessModel) -> bool:
    """Whether derivative action is worth its noise: tau2 > theta, or two integrators (Skogestad 2003, section 6)."""
    plain = model.of_second_order()
    return model.type == ProcessType.DOUBLE_INTEGRATING or plain.tau2_s > plain.theta_s
