"""The rule's own settings at larger tau_c: the first remedy for what is not robust."""

from collections.abc import Sequence
from dataclasses import replace

from retuner.adaptive.guard.request import ChangeRequest
from retuner.adaptive.guard.settings import GuardSettings
from retuner.adaptive.rules.kinds import ControllerKind
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.rules.tuning import Tuning

STEPS = 3
"""Equal ratios from the proposal's tau_c to the largest."""
RULE = "simc"
"""The rule whose settings the guard can find by itself."""


def slower_settings(request: ChangeRequest, settings: GuardSettings) -> Sequence[Tuning]:
    """In order of tau_c, up to tau_c_max_ratio times the (effective) dead time; none for rules without tau_c."""
    wanted = request.proposal
    if request.slower or wanted.rule != RULE or wanted.tau_c_s is None or not request.models:
        return request.slower
    best = request.models[0].model
    model = replace(best, theta_s=best.theta_s + request.sample_time_s / 2)
    kind = ControllerKind.PID if wanted.gains.kd else ControllerKind.PI
    theta = model.theta_s if kind == ControllerKind.PID else without_second_lag(model).theta_s
    whole = theta * settings.tau_c_max_ratio / wanted.tau_c_s
    if whole <= 1.0:
        return ()
    return [simc(model, wanted.tau_c_s * whole ** (i / STEPS), kind) for i in range(1, STEPS + 1)]
