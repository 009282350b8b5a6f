"""Which cause margins name, and how the rule's Ms limit feeds the guard."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive.diagnosis.cause import Cause, CauseSettings, Diagnosis, over_words, tuning_cause
from retuner.adaptive.diagnosis.tuning_verdict import weighed
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, by_integral, robust_simc
from retuner.adaptive.rules.simc import simc

SETTINGS = GuardSettings()
MODEL = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 5.0)
BEST = simc(MODEL).gains


def times(gains: PidGains, kp: float, ki: float) -> PidGains:
    return PidGains(gains.kp * kp, gains.ki * ki, gains.kd)


CAUSES = CauseSettings()


@pytest.mark.parametrize(
    ("kp", "ki", "cause"),
    [
        (1.0, 1.0, Cause.OK),
        (2.0, 2.0, Cause.AGGRESSIVE),
        (5.0, 5.0, Cause.AGGRESSIVE),
        (0.25, 0.25, Cause.SLUGGISH),
        (1.0, 0.3, Cause.SLUGGISH),
        (0.3, 1.5, Cause.SLOW_INTEGRATING),
    ],
)
def test_margins_tell_the_causes_apart(kp: float, ki: float, cause: Cause) -> None:
    found = tuning_cause(MODEL, times(BEST, kp, ki), BEST, 0.05, CAUSES)
    assert found.cause == cause
    assert found.retune == (cause != Cause.OK)
    assert 0.5 <= found.confidence <= 1
    assert found.to_dict()["cause"] == cause.value


def test_a_gain_too_small_beside_a_long_dead_time_is_a_cause_where_loads_cost_more() -> None:
    """Unlike ours, noise_changes 12503: a third of the gain at the same integral gain, J 1.32, was "ok" for good."""
    process, limits = ProcessModel(ProcessType.FOPDT, 5.96, 4.5, 0.0, 7.0), CauseSettings(slack=1.15)
    best = by_integral(process).gains
    found = tuning_cause(process, PidGains(0.25 * best.kp, best.ki), best, 0.05, limits)
    assert found.cause is Cause.SLOW_INTEGRATING
    assert "after a load the IAE is 1.4 times the rule's" in found.reason
    dead = replace(process, tau1_s=0.35)  # next to no lag: the gain hardly counts
    best = by_integral(dead).gains
    assert tuning_cause(dead, PidGains(0.25 * best.kp, 0.9 * best.ki), best, 0.05, limits).cause is Cause.OK


def test_a_loop_without_integral_action_is_told_as_that() -> None:
    found = tuning_cause(MODEL, PidGains(BEST.kp, 0.0), BEST, 0.05, CAUSES)
    assert found.cause is Cause.SLUGGISH
    assert found.reason.startswith("without integral action a load leaves an offset (Ms ")


def test_a_diagnosis_refuses_what_is_no_number() -> None:
    with pytest.raises(ValueError, match="confidence"):
        Diagnosis(Cause.OK, 1.2, {}, "")
    with pytest.raises(ValueError, match="ms is not a number"):
        Diagnosis(Cause.OK, 1.0, {"ms": math.nan}, "")


@pytest.mark.parametrize(("theta", "told"), [(0.1, False), (5.0, True)])
def test_how_much_slower_is_told_only_where_a_dead_time_shows(loop: Callable, theta: float, told: bool) -> None:
    estimate = identify_window(loop(sp=1.0, noise=0.01).run(1), 1)
    models = (Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, theta), 0.0),)
    estimate = replace(estimate, plausible=models)
    best = robust_simc(estimate, 1.0, RobustSettings())
    found = weighed(estimate, PidGains(0.5, 0.01), best, 1.0, CAUSES)
    assert found.cause == Cause.SLUGGISH
    assert ("times slower" in found.reason) == told
    assert ("ki_ratio" in found.evidence) == told


def test_models_that_name_the_gain_and_models_that_name_the_integral_all_ask_for_less(loop: Callable) -> None:
    """A loop at Ms 3 stayed there for good: half of its models named the one, half the other."""
    estimate = identify_window(loop(sp=1.0, noise=0.01).run(1), 1)
    gains = PidGains(3.0, 0.35)
    lag, more = (ProcessModel(ProcessType.FOPDT, k, 50.0, 0.0, 5.0) for k in (1.0, 1.6))
    swings = [tuning_cause(m.seen_by_controller(1.0), gains, gains, 0.1, CAUSES) for m in (lag, more)]
    assert {one.cause for one in swings} == {Cause.AGGRESSIVE, Cause.SLOW_INTEGRATING}
    estimate = replace(estimate, plausible=(Plausible(lag, 0.0), Plausible(more, 0.2)))
    found = weighed(estimate, gains, robust_simc(estimate, 1.0, RobustSettings()), 1.0, CAUSES)
    assert found.cause is swings[0].cause, "the likelier one gives the name"
    assert found.confidence == 1.0


@pytest.mark.parametrize(("ms", "told"), [(1.853, "Ms 1.85"), (1.803, "Ms 1.803"), (1.8003, "Ms 1.8003")])
def test_a_number_over_its_limit_is_told_as_one_that_is(ms: float, told: str) -> None:
    assert over_words(ms, 1.8) == f"{told} is over 1.8"
