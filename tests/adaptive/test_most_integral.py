"""The PI controller of most integral action at an Ms: what it keeps, and that no other tau_I has more."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.most_integral import most_integral
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.schedule.gains import PidGains


@given(
    dead=st.floats(0.05, 5.0),
    lag=st.floats(0.1, 5.0),
    zeta=st.floats(0.1, 1.0),
    ms=st.floats(1.3, 2.0),
    k=st.sampled_from([3.0, -0.2]),
)
@settings(max_examples=20, deadline=None)
def test_ms_is_what_was_asked_for_and_no_other_tau_i_has_more_integral(
    dead: float, lag: float, zeta: float, ms: float, k: float
) -> None:
    process = LinearProcess(k, (), (), dead, 0, ((2 * zeta * lag, lag**2),))
    found = most_integral(process, ms)
    assert sensitivity_peak(process, found) == pytest.approx(ms, rel=0.015)
    assert found.kp * k > 0
    for factor in (
        0.7,
        1.4,
    ):  # as much integral action by another tau_I has a larger Ms, but for 3 % that are given away
        other = PidGains(found.kp * factor, found.ki * 1.06)
        assert sensitivity_peak(process, other) > ms * 0.995


def test_a_pure_dead_time_gets_a_tau_i_of_a_third_of_it_and_more() -> None:
    """SIMC's improved rule has tau_I = theta/3 and ki = 1/(2 k theta) there (Grimholt & Skogestad 2012), at less Ms."""
    found = most_integral(LinearProcess(2.0, (), (), 5.0), 1.59)
    assert 5.0 / 3 < found.kp / found.ki < 5.0 / 2
    assert 0.5 < found.ki * 2.0 * 5.0 < 0.65


def test_what_has_no_such_controller_is_refused() -> None:
    with pytest.raises(ValueError, match="integrating"):
        most_integral(LinearProcess(1.0, (), (), 1.0, 1), 1.6)
    with pytest.raises(ValueError, match="ms"):
        most_integral(LinearProcess(1.0, (1.0,), (), 1.0), 1.0)
    with pytest.raises(ValueError, match="nothing limits"):
        most_integral(LinearProcess(1.0, (1.0,)), 1.6)


def test_at_a_lag_of_one_dead_time_both_rules_meet() -> None:
    just_under, just_over = (ProcessModel(ProcessType.FOPDT, 1.0, tau, 0.0, 10.0) for tau in (9.99, 10.01))
    one, other = (robust_simc_on(m, (), 0.0, RobustSettings()).tuning.gains for m in (just_under, just_over))
    assert math.log(one.ki / other.ki) == pytest.approx(0.0, abs=0.1)
    assert math.log(one.kp / other.kp) == pytest.approx(0.0, abs=0.15)


def test_doubt_about_the_dead_time_makes_it_calmer() -> None:
    best = ProcessModel(ProcessType.FOPDT, 1.0, 2.0, 0.0, 10.0)
    longer = Plausible(ProcessModel(ProcessType.FOPDT, 1.0, 2.0, 0.0, 14.0), 1.0)
    sure, unsure = (robust_simc_on(best, other, 0.5, RobustSettings()) for other in ((), (longer,)))
    assert unsure.tuning.gains.ki < 0.95 * sure.tuning.gains.ki
    assert unsure.ms_worst <= RobustSettings().ms_worst + 0.01


def test_an_almost_pure_dead_time_can_be_reached_by_limited_steps() -> None:
    """SIMC's tau_I is a thirteenth of what is asked for here, and its gain with it: out of reach of any limit."""
    model = ProcessModel(ProcessType.FOPDT, 3.2, 1.35, 0.0, 17.6)
    given_, by_simc = robust_simc_on(model, (), 0.5, RobustSettings()).tuning.gains, simc(model).gains
    assert given_.ki == pytest.approx(by_simc.ki, rel=0.2)
    assert 4 < given_.kp / by_simc.kp < 10
