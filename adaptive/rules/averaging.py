"""Averaging level control: the tank may move, so that the flow out of it need not.

    Kc = 2 |u0| / (e |ymax|)        tau_I = 4 / (k' Kc)

u0 is the largest step of the flow in, in co units, ymax how far the level may go for it. On an integrating process
without dead time the loop then has the double pole -k' Kc/2: a step u0 moves the level by k' u0 t e^(-k' Kc t/2), whose
largest value, at t = 2/(k' Kc), is 2 u0/(e Kc) = ymax. The flow out follows with an overshoot of e^-2 = 14 %, and no
slower controller holds the level. Marlin, Process Control (2nd edition 1995), section 18.3: 0.736 = 2/e, zeta = 1.
"""

import math
from dataclasses import replace

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import ControllerKind, Rule, Tuning, Wishes, tuning

PI = ControllerKind.PI
PEAK = 2.0 / math.e  # Largest level times Kc, over the step of flow that moves it
SLOW_ENOUGH = 8.0  # 1/(k' Kc) over the dead time from which a dead time hardly moves the peak: by a tenth


def averaging(model: ProcessModel, kind: ControllerKind = PI, wishes: Wishes | None = None) -> Tuning:
    """Settings for a tank.

    model : integrating. kind : PI, the only one. wishes : u0, co units, and y_max, pv units.

    Raises ValueError: u0 or y_max is missing or not a positive finite number, or the settings are faster than tight
    control.
    """
    del kind
    u0, y_max = (wishes.u0, wishes.y_max) if wishes is not None else (None, None)
    if u0 is None or y_max is None:
        raise ValueError("rule averaging needs u0 (largest step of the flow in, co units) and ymax (room of the level)")
    for name, value in (("u0", u0), ("ymax", y_max)):
        if not 0 < abs(value) < math.inf:
            raise ValueError(f"{name} = {value} must be a finite number other than 0")
    kc = math.copysign(PEAK * abs(u0 / y_max), model.k)
    slowness_s = 1.0 / (model.k * kc)
    if slowness_s < 2.0 * model.theta_s:
        raise ValueError(
            f"ymax = {y_max:g} leaves the level no room to average: these settings are faster than tight control with "
            f"theta = {model.theta_s:g} s; use rule simc"
        )
    late = f"theta = {model.theta_s:g} s is not small against 1/(k' Kc) = {slowness_s:.4g} s"
    notes = (f"{late}: the level goes somewhat beyond ymax",) if slowness_s < SLOW_ENOUGH * model.theta_s else ()
    return replace(tuning("averaging", "series", kc, 4.0 * slowness_s, 0.0, None), notes=notes)


RULES = (
    Rule("averaging", "series", {PI: ("Kc = 2 |u0|/(e |ymax|)", "tau_I = 4/(k' Kc)")},
         "Marlin 1995, Process Control, section 18.3",
         "a tank that may move and a flow that must not; theta well below 1/(k' Kc)",
         types=(ProcessType.INTEGRATING,), wishes=("u0", "y_max"), from_model=averaging),
)  # fmt: skip
