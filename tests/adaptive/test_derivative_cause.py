"""What may be said of a controller with derivative action by a model that has no second lag."""

from retuner.adaptive.diagnosis.cause import Cause, CauseSettings, tuning_cause
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains, from_form

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


def test_a_loop_that_no_second_lag_would_make_robust_is_the_tunings_fault_with_derivative_action_too() -> None:
    process = ProcessModel(ProcessType.FOPDT, 63.0, 690.0, 0.0, 130.0)
    gains = PidGains(0.0098, 0.000075, 0.3)  # tau_I a fifth of the lag, and a derivative that hardly acts
    assert sensitivity_peak(process.linear(), gains) > 2.0
    found = tuning_cause(process, gains, simc(process).gains, 0.05, CAUSES)
    assert (found.cause, found.retune) == (Cause.SLOW_INTEGRATING, True)
    growing = PidGains(gains.kp * 20, gains.ki * 20, gains.kd)
    assert tuning_cause(process, growing, simc(process).gains, 0.05, CAUSES).cause == Cause.AGGRESSIVE


def test_an_integrating_process_with_derivative_action_is_asked_with_a_lag_as_well() -> None:
    process = ProcessModel(ProcessType.INTEGRATING, 0.01, theta_s=10.0)
    swinging = PidGains(4.0, 0.2, 5.0)
    assert tuning_cause(process, swinging, simc(process).gains, 0.05, CAUSES).cause == Cause.SLOW_INTEGRATING
    good = from_form("series", 8.0, 45.0, 9.0)  # SIMC's PID where 9 of the 10 s are a lag, and more
    lagged = ProcessModel(ProcessType.INTEGRATING_LAG, 0.01, 0.0, 9.0, 5.5)
    assert sensitivity_peak(lagged.linear(), good) < 1.8 < sensitivity_peak(process.linear(), good)
    assert tuning_cause(process, good, simc(process).gains, 0.05, CAUSES).cause == Cause.UNKNOWN


def test_a_second_lag_that_the_record_names_answers_in_place_of_one_that_might_hide() -> None:
    reduced = ProcessModel(ProcessType.FOPDT, 53.2, 22.8, 0.0, 18.8)
    gains = PidGains(0.0249, 0.000272, 0.171)  # a lag of half the dead time would make it robust
    asked = (reduced, gains, simc(reduced).gains, 0.05, CAUSES)
    assert tuning_cause(*asked).cause == Cause.UNKNOWN
    short = ProcessModel(ProcessType.SOPDT, 53.2, 22.8, 0.3, 18.5)
    assert tuning_cause(*asked, (short,)).cause == Cause.AGGRESSIVE
    long = ProcessModel(ProcessType.SOPDT, 53.2, 22.8, 8.0, 10.8)
    assert tuning_cause(*asked, (short, long)).cause == Cause.UNKNOWN
