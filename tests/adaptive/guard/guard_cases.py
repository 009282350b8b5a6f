"""Requests that the guard's tests share: e^-5s 2/(50 s + 1), sampled every second, and what is believed of it."""

import numpy as np

from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.model_set import allowed
from retuner.adaptive.guard.request import ChangeRequest
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import simc

SETTINGS = GuardSettings()
MODEL = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 5.0)
SAMPLED = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 5.5)
BEST = simc(SAMPLED)
GAINS = BEST.gains


def known(std: float = 0.02, model: ProcessModel = MODEL) -> tuple[Plausible, ...]:
    """The model with every log-parameter known to a standard deviation."""
    x = parameters_of(model)
    log = LogModel(x, std**2 * np.eye(len(x)), 1 if model.k > 0 else -1, model.type)
    return allowed(log, (), 0.0, SETTINGS)


def times(kp: float, ki: float, kd: float = 1.0, gains: PidGains = GAINS) -> PidGains:
    return PidGains(gains.kp * kp, gains.ki * ki, gains.kd * kd)


def request(
    in_force: PidGains,
    proposal: Tuning = BEST,
    models: tuple[Plausible, ...] | None = None,
    commissioned: PidGains | None = None,
) -> ChangeRequest:
    """A request with the loop commissioned as it runs; the rest by dataclasses.replace."""
    return ChangeRequest(in_force, commissioned or in_force, proposal, known() if models is None else models, 1.0)
