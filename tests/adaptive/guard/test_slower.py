"""The first remedy: the rule's own settings at larger tau_c, as the same kind of controller."""

from dataclasses import astuple, replace

import pytest
from guard_cases import GAINS, SAMPLED, SETTINGS, known, request, times

from retuner.adaptive.guard import GuardSettings, prove
from retuner.adaptive.guard.proof import STEPS, slower_settings
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.rule import ControllerKind, Tuning
from retuner.adaptive.rules.simc import simc


def test_equal_ratios_up_to_the_largest_tau_c() -> None:
    found = slower_settings(request(GAINS), SETTINGS)
    assert [t.tau_c_s for t in found] == pytest.approx([5.5 * 1.3 ** (i / STEPS) for i in (1, 2, 3)])
    assert all(astuple(t.gains) == pytest.approx(astuple(simc(SAMPLED, t.tau_c_s).gains)) for t in found)
    halfway = simc(SAMPLED, 5.5 * 1.2)
    rest = slower_settings(request(GAINS, halfway), SETTINGS)
    assert rest[-1].tau_c_s == pytest.approx(5.5 * 1.3)
    assert slower_settings(request(GAINS, simc(SAMPLED, 5.5 * 1.4)), SETTINGS) == ()


def test_a_pid_proposal_is_slowed_as_pid_with_its_own_dead_time() -> None:
    model = ProcessModel(ProcessType.SOPDT, 2.0, 50.0, 20.0, 5.0)
    later = replace(model, theta_s=5.5)
    wanted = simc(later, None, ControllerKind.PID)
    found = slower_settings(request(GAINS, wanted, known(0.02, model)), SETTINGS)
    assert found[-1].tau_c_s == pytest.approx(5.5 * 1.3)
    slowest = simc(later, 5.5 * 1.3, ControllerKind.PID).gains
    assert astuple(found[-1].gains) == pytest.approx(astuple(slowest))
    assert found[-1].gains.kd != 0.0
    plain = slower_settings(request(GAINS, simc(later), known(0.02, model)), SETTINGS)
    assert plain[-1].tau_c_s == pytest.approx((5.5 + 10.0) * 1.3)
    assert all(t.gains.kd == 0.0 for t in plain)


def test_a_third_lag_is_dead_time_of_a_slower_pid_proposal_by_the_half_rule() -> None:
    model = ProcessModel(ProcessType.TOPDT, 2.0, 50.0, 20.0, 5.0, tau3_s=8.0)
    wanted = simc(replace(model, theta_s=5.5), None, ControllerKind.PID)
    assert wanted.tau_c_s == pytest.approx(5.5 + 8.0 / 2)
    found = slower_settings(request(GAINS, wanted, known(0.02, model)), SETTINGS)
    assert found[-1].tau_c_s == pytest.approx(1.3 * wanted.tau_c_s)


def test_what_a_rule_brings_is_proved_like_any_other() -> None:
    hot = Tuning("amigo", "parallel", times(2.0, 2.0), 3.0)
    calm = Tuning("amigo", "parallel", times(0.9, 0.9), 9.0)
    verdict = prove(replace(request(times(0.6, 0.6), hot), slower=(calm,)), SETTINGS)
    assert verdict.gains == calm.gains
    assert verdict.tau_c_s == 9.0
    assert prove(request(times(0.6, 0.6), hot), GuardSettings(tau_c_max_ratio=3.0)).tau_c_s == 3.0
