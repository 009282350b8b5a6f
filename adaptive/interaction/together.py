"""Loops on one plant that are closed together: whether all of them are stable, and how robust each is among the others.

    S = (I + G C)^-1,   Ms of loop i = max over w of |S_ii|

S_ii is the sensitivity of loop i with the others closed (Skogestad & Postlethwaite, Multivariable Feedback Control, 2nd
ed. 2005, section 10.6). Stability: det(I + G C) s^n has as many unstable zeros as its argument lacks turns of pi from
w = 0 to infinity (the generalised Nyquist criterion, ibid. section 4.9), for a G without unstable poles.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.interaction.multivariable_fit import ComplexArray, StepAnswers
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass

POINTS = 600  # frequencies that are looked at
BELOW = 1e-3  # lowest of them, over that of the slowest lag or integral time


@dataclass(frozen=True, slots=True)
class Closed:
    """How a loop is closed: its gains, its sample time and the filter of its derivative, seconds."""

    gains: PidGains
    dt_s: float
    filter_s: float = 0.0

    def at(self, w: FloatArray) -> ComplexArray:
        """Frequency response of the controller with its hold."""
        s = 1j * w
        g = self.gains
        derivative = g.kd * s / (1 + s * max(self.filter_s, self.dt_s)) if g.kd else 0.0
        return np.asarray((g.kp + g.ki / s + derivative) * np.exp(-s * self.dt_s / 2))


def together(plant: Sequence[StepAnswers], closed: Sequence[Closed]) -> tuple[float, ...]:
    """Ms of each loop with the others closed; infinite for all where they are not stable together.

    plant : by process value, an element an output, in the order of `closed`.
    """
    slow = [x for row in plant for one in row.elements for x in (one.tau1_s, one.theta_s)]
    slow += [abs(one.gains.kp / one.gains.ki) for one in closed if one.gains.ki]
    w = np.geomspace(BELOW / max(slow), math.pi / min(one.dt_s for one in closed), POINTS)
    g = np.array([[one.at(w) for one in row.elements] for row in plant]).transpose(2, 0, 1)
    c = np.array([one.at(w) for one in closed]).T
    returned = np.eye(len(closed)) + g * c[:, None, :]
    integrals = sum(one.gains.ki != 0.0 for one in closed)
    turned = np.unwrap(np.angle(np.linalg.det(returned) * (1j * w) ** integrals))
    end = float(turned[-1] - turned[0])
    started = math.cos(float(turned[0])) > 0.0  # a negative product at w = 0 is an odd number of unstable zeros
    if not started or abs(end - integrals * math.pi / 2) > math.pi / 2:
        return (math.inf,) * len(closed)
    s = np.linalg.inv(returned)
    return tuple(float(np.max(np.abs(s[:, i, i]))) for i in range(len(closed)))
