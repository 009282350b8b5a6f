"""How far settings may go at once: no farther than what the record was asked.

One event shows a process once. Settings whose gain is more than three times the one in force are an aim then, and what
is given is a first step towards it: the same rule with the tau_c at which Kc is three times what it was, so that the
integral time fits the gain on the way as well. A gain that is cut is cut at once: that way lies safety.
"""

from dataclasses import dataclass

from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.schedule.gains import PidGains

MOST_AT_ONCE = 3.0
"""Factor on Kc that one event carries."""


@dataclass(frozen=True, slots=True)
class FirstStep:
    """Settings to be set now, and those that they lead to. factor : on Kc, of the aim."""

    now: RobustTuning
    aim: RobustTuning
    factor: float

    @property
    def sentence(self) -> str:
        """Why not all at once."""
        return (
            f"one event does not carry {self.factor:.1f} times the gain at once: a first step of "
            f"{MOST_AT_ONCE:g} times, to be confirmed by the next record"
        )


def first_step(
    aim: RobustTuning, in_force: PidGains, events: float, process: ProcessModel, sample_time_s: float
) -> FirstStep | None:
    """The first step towards an aim; None where it may be reached at once.

    Parameters
    ----------
    aim : settings that the model asks for. in_force : gains now. events : setpoint and load steps in the record.
    process : the most likely model. sample_time_s : half of it is dead time.
    """
    if events > 1 or not in_force.kp:
        return None
    factor = aim.tuning.gains.kp / in_force.kp
    if factor <= MOST_AT_ONCE:
        return None
    model = process.seen_by_controller(sample_time_s)
    plain = without_second_lag(model)
    span = 1 / (plain.slope * MOST_AT_ONCE * in_force.kp)
    if span <= 2 * plain.theta_s:
        return None
    tuning = simc(model, span - plain.theta_s)
    ms = sensitivity_peak(model.linear(), tuning.gains)
    return FirstStep(RobustTuning(tuning, ms, max(ms, aim.ms_worst)), aim, factor)
