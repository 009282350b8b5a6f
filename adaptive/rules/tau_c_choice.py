"""The closed-loop time constant tau_c of a SIMC rule from what is wanted of the loop.

    smooth   Kc = Kc,min = |u0| / |y_max|: the slowest control that still holds y within y_max against the largest
             disturbance u0 (Skogestad 2003 and 2006); tau_c follows from Kc, and tau_I from tau_c by the same rule
    Ms, GM   the smallest tau_c >= 0 whose loop keeps the demanded sensitivity peak or gain margin

For tau_I = tau1 the gain margin is known: GM = (pi/2) (tau_c/theta + 1) (Grimholt & Skogestad 2012, equation 7), so GM
and tau_c say the same thing. In general both are found on the exact loop by bisection in log(tau_c + theta).
"""

import math
from collections.abc import Callable

from retuner.adaptive.loop.margins import gain_margin, sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules.rule import Tuning
from retuner.schedule.gains import PidGains

BISECTIONS = 45
"""Halvings of the range of ln tau_c: to 1e-12."""
SLOWEST = 1e4
"""Largest tau_c tried, in units of the process' own slowest time; beyond it the loop does nothing."""

TauCRule = Callable[[float], Tuning]
"""SIMC settings at a given tau_c in seconds."""


def tau_c_for_ms(rule: TauCRule, process: LinearProcess, ms: float) -> Tuning:
    """Settings with the smallest tau_c >= 0 whose Ms is at most ms.

    Raises
    ------
    ValueError
        ms is not above 1, or no tau_c reaches it exactly.
    """
    if not 1 < ms < math.inf:
        raise ValueError(f"ms = {ms} must be more than 1 and finite; 1.6 is a usual demand")
    return _smallest(rule, process, lambda gains: sensitivity_peak(process, gains) <= ms, f"Ms = {ms:g}")


def tau_c_for_gm(rule: TauCRule, process: LinearProcess, gm: float) -> Tuning:
    """Settings with the smallest tau_c >= 0 whose gain margin is at least gm.

    Raises
    ------
    ValueError
        gm is not above 1, or no tau_c reaches it exactly.
    """
    if not 1 < gm < math.inf:
        raise ValueError(f"gm = {gm} must be more than 1 and finite; 3 is a usual demand")
    return _smallest(rule, process, lambda gains: gain_margin(process, gains) >= gm, f"GM = {gm:g}")


def _smallest(rule: TauCRule, process: LinearProcess, keeps: Callable[[PidGains], bool], what: str) -> Tuning:
    """Bisection on log(tau_c) between values that do not keep the demand and ones that do."""
    times = [process.theta_s, *process.lags_s, *(abs(x) for x in process.leads_s)]
    times += [math.sqrt(c2) for _, c2 in process.quadratics]
    unit = max(times, default=0.0) or 1.0
    low, high = math.log(min((x for x in times if x > 0), default=1.0) / SLOWEST), math.log(unit * SLOWEST)
    if keeps(rule(math.exp(low)).gains):
        raise ValueError(f"{what} is kept at any tau_c, however small; give tau_c")
    if not keeps(rule(math.exp(high)).gains):
        raise ValueError(f"{what} is not reached by any tau_c up to {math.exp(high):.3g} s; ask for less")
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if keeps(rule(math.exp(middle)).gains) else (middle, high)
    return rule(math.exp(high))


def tau_c_smooth(model: ProcessModel, u0: float, y_max: float) -> float:
    """tau_c in seconds of the slowest acceptable controller, Kc = |u0| / |y_max|.

    model : the model that the settings are made from (for PI with the second lag taken up by the half rule).
    u0 : largest disturbance, in co units at the process input. y_max : largest deviation allowed, in pv units.

    Raises
    ------
    ValueError
        u0 or y_max is 0 or not finite, the process is a pure delay (SIMC has no Kc there), or Kc,min is more than the
        process allows (tau_c would be negative).
    """
    for name, value in (("u0", u0), ("ymax", y_max)):
        if value == 0 or not math.isfinite(value):
            raise ValueError(f"{name} = {value} must be a finite number other than 0")
    if model.type == ProcessType.DELAY:
        raise ValueError("SIMC has no proportional gain on a pure delay, so smooth tuning has no answer; give tau_c")
    kc_min = abs(u0) / abs(y_max)
    span = 1 / (abs(model.slope) * kc_min)
    if model.type == ProcessType.DOUBLE_INTEGRATING:
        span = math.sqrt(span) / 2
    if span <= model.theta_s:
        raise ValueError(
            f"Kc,min = |u0|/|ymax| = {kc_min:.4g} needs tau_c = {span - model.theta_s:.4g} s: this process cannot be"
            " held within ymax; allow more or reduce the dead time"
        )
    return span - model.theta_s
