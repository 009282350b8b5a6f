"""What may be said of a controller with derivative action by a model that has no second lag."""

from retuner.adaptive.diagnosis.cause import Cause, CauseSettings, tuning_cause
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.schedule.forms import from_form
from retuner.schedule.gains import PidGains

CAUSES = CauseSettings()


def test_a_good_loop_with_derivative_action_is_not_called_unstable_by_a_model_without_a_second_lag() -> None:
    gains = from_form("series", 5.0, 40.0, 20.0)  # SIMC's PID for exp(-5 s) / ((50 s + 1) (20 s + 1))
    truth = ProcessModel(ProcessType.SOPDT, 1.0, 50.0, 20.0, 5.0)
    assert sensitivity_peak(truth.linear(), gains) < 1.75
    reduced = ProcessModel(ProcessType.FOPDT, 1.0, 60.0, 0.0, 15.0)  # what a first-order fit sees of it
    found = tuning_cause(reduced, gains, simc(reduced).gains, 0.05, CAUSES)
    assert (found.cause, found.retune) == (Cause.UNKNOWN, False)
    assert "derivative" in found.reason
    without = tuning_cause(reduced, PidGains(gains.kp, gains.ki), simc(reduced).gains, 0.05, CAUSES)
    assert without.cause == Cause.AGGRESSIVE
