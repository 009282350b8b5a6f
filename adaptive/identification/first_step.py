"""How far settings may go at once: no farther than what the record was asked.

Each event shows a process once, and no record shows more than so much of it. Settings with more than three times the
gain in force an event, or the integral action, are an aim then. What is given is a first step towards it: the same rule
with the tau_c at which Kc has grown so far, so that the integral time fits the gain on the way as well, and no more
integral action than that either. A gain that is cut is cut at once: that way lies safety.
"""

from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.simc import simc, without_second_lag
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

MOST_AT_ONCE = 3.0  # factor on Kc, and on Ki, that one event carries
MOST_OF_A_RECORD = 10.0  # most that one record counts for, however many steps are in it


@dataclass(frozen=True, slots=True)
class FirstStep:
    """Settings to be set now, and those that they lead to. factor : of the aim, the larger of those on Kc and on Ki.

    carried : the factor that the record carries at once.
    """

    now: RobustTuning
    aim: RobustTuning
    factor: float
    carried: float

    @property
    def sentence(self) -> str:
        """Why not all at once."""
        return (
            f"this record does not carry {self.factor:.1f} times the gain or integral action at once; a first step of "
            f"{self.carried:g} times at most is for the next record to confirm"
        )


def first_step(
    aim: RobustTuning, in_force: PidGains, events: float, process: ProcessModel, sample_time_s: float
) -> FirstStep | None:
    """The first step towards an aim; None where it may be reached at once.

    aim : settings that the model asks for. in_force : gains now. events : setpoint and load steps in the record.
    process : the most likely model. sample_time_s : half of it is dead time.
    """
    most = min(MOST_AT_ONCE * max(events, 1.0), MOST_OF_A_RECORD)
    wanted = aim.tuning.gains
    factor = wanted.kp / in_force.kp if in_force.kp else 0.0
    of_integral = wanted.ki / in_force.ki if in_force.ki else 0.0
    if max(factor, of_integral) <= most:
        return None
    model = process.seen_by_controller(sample_time_s)
    plain, tuning = without_second_lag(model), aim.tuning
    if factor > most:
        span = 1 / (plain.slope * most * in_force.kp)
        share = most * in_force.kp / wanted.kp
        calmer = replace(tuning, gains=PidGains(share * wanted.kp, share * wanted.ki, share * wanted.kd))
        tuning = simc(model, span - plain.theta_s) if span > 2 * plain.theta_s and not wanted.kd else calmer
    gains = tuning.gains
    if in_force.ki and gains.ki / in_force.ki > most:
        share = 1.0 if in_force.kp else most * in_force.ki / gains.ki  # without P in force nothing else bounds it
        tuning = replace(tuning, gains=PidGains(share * gains.kp, most * in_force.ki, share * gains.kd))
    ms = sensitivity_peak(model.linear(), tuning.gains)
    return FirstStep(RobustTuning(tuning, ms, max(ms, aim.ms_worst)), aim, max(factor, of_integral), most)
