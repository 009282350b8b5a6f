"""What a model asks of its controller, as two numbers with their covariance: (ln |Kc|, ln tau_I) of SIMC.

Models of different structures cannot be compared by their parameters; the settings that follow from them can, and they
are what a gain table is about. SIMC (Skogestad 2003, section 4) with tau_c = theta gives both; half a sampling interval
is added to the delay, as everywhere on line. The covariance is that of the log-parameters, taken across by the
derivatives (first order, central differences).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from retuner.adaptive.estimate import LOG_STEP, LogModel, proper_covariance
from retuner.adaptive.fit.structure import model_at
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.adaptive.sample import FloatArray
from retuner.schedule.forms import to_ideal

SIZE = 2


@dataclass(frozen=True, slots=True)
class Features:
    """z : (ln |Kc|, ln tau_I in s), shape (2,). p : its covariance, shape (2, 2)."""

    z: FloatArray
    p: FloatArray


def features(log: LogModel, half_sample_s: float) -> Features:
    """The two numbers of an estimate. half_sample_s : half the controller's sampling interval, s."""
    jacobian = np.zeros((SIZE, len(log.x)))
    for j in range(len(log.x)):
        step = np.zeros(len(log.x))
        step[j] = LOG_STEP
        up, down = (_asked(log, log.x + way * step, half_sample_s) for way in (1.0, -1.0))
        jacobian[:, j] = (up - down) / (2 * LOG_STEP)
    return Features(_asked(log, log.x, half_sample_s), proper_covariance(jacobian @ log.p @ jacobian.T))


def _asked(log: LogModel, x: FloatArray, half_sample_s: float) -> FloatArray:
    """(ln |Kc|, ln tau_I) at a point; the gain is that of the ideal form, kp."""
    found = model_at(log.type, x, log.sign)
    model = without_second_lag(replace(found, theta_s=found.theta_s + half_sample_s))
    ideal = to_ideal(simc(model, model.theta_s).gains)
    assert ideal.tau_i_s is not None
    return np.array([math.log(abs(ideal.kc)), math.log(ideal.tau_i_s)])
