"""Where the next experiment teaches most: the place whose gain is known least, and a step that shows it there."""

from collections.abc import Sequence
from dataclasses import dataclass

from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.schedule_design.places import Place
from retuner.adaptive.signals.noise import noise_sigma

OVER_NOISE = 20.0
"""Size of the answer over the noise of pv."""
LEAST_SHARE = 0.03
"""And as a share of what pv travels in the records."""
LAGS, DEAD_TIMES = 3.0, 10.0
"""How long the step is held: theta and so many lags, at most so many dead times more (a slow rise shows the slope)."""


@dataclass(frozen=True, slots=True)
class NextExperiment:
    """A step of the controller output in manual, or of the setpoint in automatic, at a place of the variable.

    x : where. co_step : in units of co. sp_step : in units of pv. hold_s : how long. gain_std : of ln Kc there now.
    """

    x: float
    co_step: float
    sp_step: float
    hold_s: float
    gain_std: float

    def to_dict(self) -> dict[str, float]:
        """Keys x, co_step, sp_step, hold_s, gain_std."""
        return {
            "x": self.x,
            "co_step": self.co_step,
            "sp_step": self.sp_step,
            "hold_s": self.hold_s,
            "gain_std": self.gain_std,
        }


def next_experiment(curves: Curves, places: Sequence[Place]) -> NextExperiment:
    """The experiment that teaches most."""
    least = max(places, key=lambda place: place.gain_std)
    model = least.model
    stretches = curves.joint.stretches
    travel = max(float(s.pv.max()) for s in stretches) - min(float(s.pv.min()) for s in stretches)
    noise = max(noise_sigma(s.pv) for s in stretches)
    answer = max(OVER_NOISE * noise, LEAST_SHARE * travel)
    hold = model.theta_s + min(LAGS * (model.tau1_s + model.tau2_s), DEAD_TIMES * (model.theta_s + model.tau2_s))
    lag = model.tau1_s or hold
    reached = abs(model.k) * min(1.0, (hold - model.theta_s) / lag)
    return NextExperiment(least.x, answer / reached, answer, hold, least.gain_std)
