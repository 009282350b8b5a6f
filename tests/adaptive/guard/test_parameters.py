"""Limits per change: what they are per parameter, and that a step stays on the way and within them."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.step_size import (
    Parameter,
    change_factor,
    extent,
    less_of_everything,
    logs,
    step_limit,
    within_limits,
)
from retuner.schedule.gains import PidGains

SETTINGS = GuardSettings()
FACTOR = st.floats(0.01, 100)


def moved(old: PidGains, new: PidGains, settings: GuardSettings = SETTINGS, **options: bool) -> PidGains:
    found = within_limits(old, new, 1.0, settings, **options)
    return found[0]


def test_the_four_parameters_are_the_ideal_form() -> None:
    found = logs(PidGains(-2.0, -0.5, -6.0))
    values = {p: pytest.approx(v) for p, v in (("kc", 2.0), ("tau_I", 4.0), ("tau_D", 3.0), ("kc/tau_I", 0.5))}
    assert {str(p): math.exp(v) for p, v in found.items()} == values
    assert set(logs(PidGains(0.0, 0.5))) == {Parameter.INTEGRAL}
    assert set(logs(PidGains(2.0, 0.0, 6.0))) == {Parameter.KC, Parameter.TAU_D}


@pytest.mark.parametrize(
    ("goal", "wanted"),
    [
        (PidGains(10.0, 0.1), PidGains(2.0, 0.1 * 10**0.0)),  # kc up: twice
        (PidGains(0.01, 0.1), PidGains(0.5, 0.1)),  # kc down at the same kc/tau_I shortens tau_I: that is more action
        (PidGains(0.1, 0.01), PidGains(0.25, 0.025)),  # kc down at the same tau_I: a quarter
        (PidGains(1.0, 10.0), PidGains(1.0, 0.2)),  # tau_I shorter: half
        (PidGains(1.0, 0.001), PidGains(1.0, 0.025)),  # tau_I longer: four times
    ],
)
def test_defaults_are_twice_towards_more_and_a_quarter_towards_less(goal: PidGains, wanted: PidGains) -> None:
    found = moved(PidGains(1.0, 0.1), goal)
    assert (found.kp, found.ki) == (pytest.approx(wanted.kp), pytest.approx(wanted.ki))


def test_the_defaults_are_the_published_ones() -> None:
    s = GuardSettings()
    assert (s.step_up_max, s.step_down_max, s.total_ratio_max) == (2.0, 4.0, 4.0)
    assert (s.ms_nominal, s.ms_worst, s.tau_c_max_ratio) == (1.75, 2.1, 1.3)
    assert s.age_max_s == 30 * 24 * 3600


@pytest.mark.parametrize("parameter", list(Parameter))
@pytest.mark.parametrize("more", [True, False])
def test_every_parameter_can_have_its_own_limit(parameter: Parameter, more: bool) -> None:
    names = {
        Parameter.KC: ("kc_up_max", "kc_down_max"),
        Parameter.TAU_I: ("tau_i_shorter_max", "tau_i_longer_max"),
        Parameter.TAU_D: ("tau_d_up_max", "tau_d_down_max"),
        Parameter.INTEGRAL: ("integral_up_max", "integral_down_max"),
    }
    own = GuardSettings(**{names[parameter][not more]: 1.25})
    for other in Parameter:
        for way in (True, False):
            hit = other == parameter and way == more
            usual = 2.0 if way else 4.0
            assert step_limit(other, more=way, settings=own, alone=True) == (1.25 if hit else usual)


def test_kc_and_tau_i_may_each_go_as_far_as_they_may_alone_and_kc_over_tau_i_with_them() -> None:
    old, far = PidGains(1.0, 0.1), PidGains(4.0, 1.6)
    both = moved(old, far)
    assert (both.kp, both.ki) == (pytest.approx(2.0), pytest.approx(0.4))
    assert moved(old, far, replace(SETTINGS, integral_up_max=2.0)).ki == pytest.approx(0.2)
    assert moved(old, far, replace(SETTINGS, kc_up_max=1.5)).kp == pytest.approx(1.5)
    only = within_limits(PidGains(0.0, 0.1), PidGains(0.0, 1.6), 1.0, SETTINGS)
    assert only[0].ki == pytest.approx(0.2)


def test_only_what_points_to_less_action_is_free_for_an_urgent_step() -> None:
    old = PidGains(1.0, 0.1)
    free = PidGains(0.01, 0.0001)
    assert moved(old, free, less_unlimited=True) == free
    assert moved(old, PidGains(10.0, 0.0001), less_unlimited=True).kp == pytest.approx(2.0)
    assert moved(old, PidGains(0.01, 0.1), less_unlimited=True) == PidGains(0.01, 0.1)  # tau_I follows kc
    assert moved(old, PidGains(1.0, 10.0), less_unlimited=True).ki == pytest.approx(0.2)
    steep = moved(PidGains(1.0, 0.1, 1.0), PidGains(0.5, 0.1, 9.0), less_unlimited=True)
    assert steep.kd / steep.kp == pytest.approx(2.0)


def test_a_gain_that_comes_or_goes_takes_the_same_share() -> None:
    coming = within_limits(PidGains(1.0, 0.1), PidGains(4.0, 0.4, 8.0), 1.0, SETTINGS)
    assert coming[1] == pytest.approx(0.5)
    assert coming[0].kd == pytest.approx(4.0)
    going = within_limits(PidGains(1.0, 0.1, 8.0), PidGains(1.0, 0.1), 0.25, SETTINGS)
    assert going[0].kd == pytest.approx(6.0)
    gone = within_limits(PidGains(1.0, 0.1, 8.0), PidGains(1.0, 0.1), 1.0, SETTINGS)
    assert gone == (PidGains(1.0, 0.1), 1.0)
    alone = within_limits(PidGains(0.0, 0.1), PidGains(1.0, 0.8), 1.0, SETTINGS)
    assert (alone[0].kp, alone[0].ki) == (pytest.approx(1 / 3), pytest.approx(0.2))


def test_absolute_limits_on_kc_leave_no_point() -> None:
    assert within_limits(PidGains(1.0, 0.1), PidGains(2.0, 0.2), 1.0, GuardSettings(kc_max=1.5)) is None
    assert within_limits(PidGains(-1.0, -0.1), PidGains(-0.5, -0.1), 1.0, GuardSettings(kc_min=0.75)) is None


@given(
    o=st.tuples(FACTOR, FACTOR, FACTOR),
    n=st.tuples(FACTOR, FACTOR, FACTOR),
    share=st.floats(0.05, 1),
    sign=st.sampled_from([1, -1]),
)
def test_steps_lie_on_the_straight_way_within_every_limit(o, n, share, sign):
    old, new = (PidGains(*(sign * v for v in values)) for values in (o, n))
    found = within_limits(old, new, share, SETTINGS)
    assert found is not None
    now, gone = found
    assert 0 < gone <= share
    start, goal, here = logs(old), logs(new), logs(now)
    for parameter in Parameter:
        way = goal[parameter] - start[parameter]
        assert here[parameter] - start[parameter] == pytest.approx(gone * way, abs=1e-9)
        more = (way > 0) == (parameter is not Parameter.TAU_I)
        factor = 2.0 if more and parameter is not Parameter.INTEGRAL else 4.0  # kc/tau_I grows as both may together
        assert abs(here[parameter] - start[parameter]) <= math.log(factor) + 1e-9
    assert extent(old, now) == pytest.approx(gone * extent(old, new), abs=1e-9)


def test_change_factor() -> None:
    assert change_factor(PidGains(1, 2), PidGains(2, 2)) == 2
    assert change_factor(PidGains(1, 2), PidGains(1, 0.5)) == 4
    assert change_factor(PidGains(1, 2), PidGains(1, 2, 1)) == math.inf
    assert change_factor(PidGains(1, 2), PidGains(1, 2)) == 1
    assert change_factor(PidGains(-1, -2), PidGains(-2, -2)) == 2
    assert change_factor(PidGains(1, 2), PidGains(-1, -2)) == math.inf, "gains of the other sign are not the same"


def test_less_of_everything() -> None:
    old = PidGains(-1.0, -0.1, -2.0)
    assert less_of_everything(old, old)
    assert less_of_everything(old, PidGains(-0.5, -0.05, -1.0))
    assert less_of_everything(old, PidGains(-0.5, -0.01))
    assert less_of_everything(old, PidGains(-0.01, 0.0, -2.0))
    assert not less_of_everything(old, PidGains(-0.5, -0.1, -1.0))  # tau_I halves
    assert not less_of_everything(old, PidGains(-1.1, -0.1, -1.0))
    assert not less_of_everything(old, PidGains(-1.0, -0.1, -2.1))
    assert not less_of_everything(PidGains(1.0, 0.0), PidGains(0.5, 0.1))


def test_settings_that_leave_no_room_are_refused() -> None:
    with pytest.raises(ValueError, match="ms_nominal = 2 is above ms_worst"):
        GuardSettings(ms_nominal=2.0, ms_worst=1.9)
    with pytest.raises(ValueError, match="kc_min"):
        GuardSettings(kc_min=2.0, kc_max=1.0)
    with pytest.raises(ValueError, match="tau_i_min_s"):
        GuardSettings(tau_i_min_s=2.0, tau_i_max_s=1.0)


def test_opened_limits_are_open_for_every_parameter() -> None:
    opened = GuardSettings(kc_up_max=1.5, tau_i_longer_max=1.2, kc_max=7.0).opened(8.0)
    assert {step_limit(p, more=m, settings=opened) for p in Parameter for m in (True, False)} == {8.0}
    assert opened.total_ratio_max == 8.0
    assert opened.kc_max == 7.0
