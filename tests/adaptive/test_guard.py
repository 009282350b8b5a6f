"""The guard: what may pass, what may not, and that nothing passes unproved."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_cause import CauseSettings, tuning_cause
from retuner.adaptive.estimate import LogModel
from retuner.adaptive.guard import GuardSettings, Ruling, change_factor, corners, prove, within_limits, worst_ms
from retuner.adaptive.margins import sensitivity_peak
from retuner.adaptive.process import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc, simc_at_most_ms
from retuner.schedule.gains import PidGains

SETTINGS = GuardSettings()
MODEL = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 5.0)
BEST = simc(MODEL).gains


def known(std: float = 0.02, sign: int = 1) -> LogModel:
    return LogModel(np.log([2.0 / 50, 5.0, 50.0]), std**2 * np.eye(3), sign)


def times(gains: PidGains, kp: float, ki: float) -> PidGains:
    return PidGains(gains.kp * kp, gains.ki * ki, gains.kd)


def test_a_good_step_passes_whole() -> None:
    verdict = prove(simc(MODEL), known(), 0.0, times(BEST, 0.6, 0.6), SETTINGS)
    assert verdict.ruling == Ruling.ACCEPTED
    assert verdict.step == 1.0
    assert verdict.gains is not None
    assert verdict.gains.kp == pytest.approx(BEST.kp)
    assert verdict.ms_nominal == pytest.approx(1.609, abs=1e-3)
    assert verdict.ms_worst > verdict.ms_nominal


def test_a_sluggish_loop_gets_twice_the_gain_and_no_more() -> None:
    verdict = prove(simc(MODEL), known(), 0.0, times(BEST, 0.1, 0.1), SETTINGS)
    assert verdict.gains is not None
    assert verdict.gains.kp == pytest.approx(0.2 * BEST.kp)
    assert verdict.step == pytest.approx(math.log(2) / math.log(10))


def test_an_unsure_model_refuses_or_slows() -> None:
    unsure = prove(simc(MODEL), known(0.6), 0.0, times(BEST, 0.9, 0.5), SETTINGS)
    assert unsure.ruling == Ruling.NOT_ROBUST
    assert unsure.gains is None
    between = prove(simc(MODEL), known(0.2), 0.0, times(BEST, 0.5, 0.5), SETTINGS)
    assert between.gains is not None
    assert between.tau_c_s > 5.0
    assert between.ms_worst <= SETTINGS.ms_worst


def test_a_loop_over_its_limit_may_always_be_made_safer() -> None:
    wild = times(BEST, 4.0, 8.0)
    verdict = prove(simc(MODEL), known(0.6), 0.0, wild, SETTINGS)
    assert verdict.ruling == Ruling.SAFER
    assert verdict.gains is not None
    assert sensitivity_peak(MODEL.linear(), verdict.gains) < sensitivity_peak(MODEL.linear(), wild)


def test_an_unstable_loop_takes_the_largest_step_to_less_action_even_if_that_is_not_enough() -> None:
    wild = times(BEST, 12.0, 200.0)
    verdict = prove(simc(MODEL), known(), 0.0, wild, SETTINGS)
    assert verdict.ruling == Ruling.SAFER
    assert verdict.gains is not None
    assert math.isinf(verdict.ms_nominal)
    assert verdict.gains.kp < wild.kp
    assert verdict.gains.ki == pytest.approx(wild.ki / SETTINGS.step_down_max)


def test_the_wrong_direction_is_refused() -> None:
    verdict = prove(simc(MODEL), known(), 0.0, times(BEST, -1.0, -1.0), SETTINGS)
    assert verdict.ruling == Ruling.WRONG_SIGN
    assert not verdict.accepted


def test_absolute_limits_are_kept() -> None:
    verdict = prove(simc(MODEL), known(), 0.0, times(BEST, 0.6, 0.6), GuardSettings(kc_max=0.5 * BEST.kp))
    assert verdict.ruling == Ruling.OUTSIDE_LIMITS
    assert verdict.gains is None


def test_a_change_not_worth_a_write_is_none() -> None:
    verdict = prove(simc(MODEL), known(), 0.0, times(BEST, 0.97, 0.98), SETTINGS)
    assert verdict.ruling == Ruling.TOO_SMALL


@given(kp=st.floats(0.02, 50), ki=st.floats(0.02, 50), std=st.floats(0.001, 0.6), sign=st.sampled_from([1, -1]))
def test_nothing_passes_unproved(kp: float, ki: float, std: float, sign: int) -> None:
    model = ProcessModel(ProcessType.FOPDT, sign * 2.0, 50.0, 0.0, 5.0)
    in_force = times(BEST, sign * kp, sign * ki)
    log = known(std, sign)
    verdict = prove(simc(model), log, 0.0, in_force, SETTINGS)
    if verdict.gains is None:
        return
    old, new = (abs(in_force.kp), abs(in_force.ki)), (abs(verdict.gains.kp), abs(verdict.gains.ki))
    for before, after in zip(old, new, strict=True):
        assert after <= before * SETTINGS.step_up_max * (1 + 1e-9)
        assert after >= before / SETTINGS.step_down_max * (1 - 1e-9)
    ms = sensitivity_peak(model.linear(), verdict.gains)
    worst = worst_ms(corners(log, SETTINGS.corner_std), verdict.gains)
    if verdict.ruling == Ruling.ACCEPTED:
        assert ms <= SETTINGS.ms_nominal
        assert worst <= SETTINGS.ms_worst
    else:
        assert verdict.ruling == Ruling.SAFER
        assert ms < sensitivity_peak(model.linear(), in_force) or new <= old


@given(
    o=st.tuples(st.floats(0.01, 100), st.floats(0.01, 100)), n=st.tuples(st.floats(0.01, 100), st.floats(0.01, 100)),
    share=st.floats(0.05, 1),
)  # fmt: skip
def test_steps_lie_between_old_and_new(o: tuple[float, float], n: tuple[float, float], share: float) -> None:
    moved = within_limits(PidGains(*o), PidGains(*n), share, SETTINGS)
    assert moved is not None
    for old, new, now in zip(o, n, (moved[0].kp, moved[0].ki), strict=True):
        assert min(old, new) * (1 - 1e-9) <= now <= max(old, new) * (1 + 1e-9)


def test_change_factor() -> None:
    assert change_factor(PidGains(1, 2), PidGains(2, 2)) == 2
    assert change_factor(PidGains(1, 2), PidGains(1, 2, 1)) == math.inf
    assert change_factor(PidGains(1, 2), PidGains(1, 2)) == 1


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


def test_a_diagnosis_refuses_what_is_no_number() -> None:
    with pytest.raises(ValueError, match="confidence"):
        Diagnosis(Cause.OK, 1.2, {}, "")
    with pytest.raises(ValueError, match="ms is not a number"):
        Diagnosis(Cause.OK, 1.0, {"ms": math.nan}, "")


def test_simc_with_ms_limit_feeds_the_guard() -> None:
    lagging = ProcessModel(ProcessType.INTEGRATING, 0.04, theta_s=5.0)
    tuning, ms = simc_at_most_ms(lagging, SETTINGS.ms_nominal, SETTINGS.tau_c_max_ratio)
    assert ms <= SETTINGS.ms_nominal
    assert tuning.tau_c_s == pytest.approx(5.0)
