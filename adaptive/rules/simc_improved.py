"""Improved SIMC PI: tau1 is replaced by tau1 + theta/3 (Grimholt & Skogestad 2012, equations 10 and 11).

    Kc = (tau1 + theta/3) / (k (tau_c + theta))    tau_I = min(tau1 + theta/3, 4 (tau_c + theta))

Series form (PI: the same as ideal). The gain is in the most on a pure delay, where plain SIMC has no proportional
action; on an integrating process nothing changes.
"""

import math

from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.simc import TAU_I_FACTOR, without_second_lag
from retuner.adaptive.rules.tuning import Tuning, tuning

THETA_SHARE = 1 / 3
"""Share of the dead time that joins tau1 (the paper's choice for a pure delay, where it is nearly optimal)."""


def simc_improved(model: ProcessModel, tau_c_s: float | None = None, c: float = TAU_I_FACTOR) -> Tuning:
    """Improved SIMC PI settings; tau_c_s and c as for simc.

    Raises
    ------
    ValueError
        tau_c is missing for a process without dead time, or not positive together with the dead time; the process has
        two integrators, which PI cannot hold.
    """
    model = without_second_lag(model)
    if model.type == ProcessType.DOUBLE_INTEGRATING:
        raise ValueError("a double integrating process needs derivative action; use rule simc")
    if tau_c_s is None:
        if model.theta_s == 0:
            raise ValueError("theta = 0: SIMC's default tau_c = theta does not exist; give tau_c")
        tau_c_s = model.theta_s
    span = tau_c_s + model.theta_s
    if not 0 < span < math.inf or not 0 < c < math.inf:
        raise ValueError(f"tau_c + theta = {span} s and c = {c} must be positive and finite")
    if model.type == ProcessType.INTEGRATING:
        return tuning("simc-improved", "series", 1 / (model.k * span), c * span, 0.0, tau_c_s)
    lag = model.tau1_s + THETA_SHARE * model.theta_s
    if lag == 0:
        raise ValueError("tau1 and theta are both 0: there is no time to tune for; use rule simc")
    return tuning("simc-improved", "series", lag / (model.k * span), min(lag, c * span), 0.0, tau_c_s)


KIND = ControllerKind.PI
"""The rule exists for PI only in the source."""
