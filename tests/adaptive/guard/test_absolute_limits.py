"""Limits in absolute numbers: each is checked where somebody has set it, and only there."""

import math
from dataclasses import replace

import pytest
from guard_cases import GAINS, request

from retuner.adaptive.guard import GuardSettings
from retuner.adaptive.guard.checks import Check, limit_checks
from retuner.schedule.gains import IdealGains, PidGains

PID = IdealGains(GAINS.kp, GAINS.kp / GAINS.ki, 4.0).to_parallel()


def checks(gains: PidGains, settings: GuardSettings, in_force: PidGains = GAINS) -> dict[str, Check]:
    return {check.name: check for check in limit_checks(request(in_force), gains, settings)}


@pytest.mark.parametrize(
    ("name", "limits", "key"),
    [
        ("kc_min", {"kc_min": 0.01}, 0.01),
        ("kc_max", {"kc_max": 99.0}, 99.0),
        ("tau_i_max", {"tau_i_max_s": 300.0}, 300.0),
        ("tau_d_max", {"tau_d_max_s": 30.0}, 30.0),
    ],
)
def test_a_limit_is_checked_where_it_is_set(name: str, limits: dict[str, float], key: float) -> None:
    assert name not in checks(PID, GuardSettings(), PID)
    assert checks(PID, GuardSettings(**limits), PID)[name].limit == key


def test_a_derivative_may_fall_to_nothing_without_leaving_the_commissioned_range() -> None:
    small = IdealGains(GAINS.kp, GAINS.kp / GAINS.ki, 0.5).to_parallel()
    settings = replace(GuardSettings(), tau_d_max_s=math.inf)
    total = checks(small, settings, PID)["total_tau_d"]
    assert total.value == pytest.approx(8.0)
    assert total.limit == settings.total_ratio_max
    up = checks(PID, settings, small)["total_tau_d"]  # no shortest derivative time gives more room upwards
    assert (up.limit, up.value) == (settings.total_ratio_max, pytest.approx(8.0))
