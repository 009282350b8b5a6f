"""The one family of processes: exact at and between the samples, for every structure in it."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.signal import lsim, lti

from retuner.adaptive.fit.dynamics import Dynamics, SamplingInstants

MEMBERS = {
    "first": (0.0, 0.1),
    "two lags": (2.0, 0.1),
    "equal lags": (2.5, 0.1),
    "swings": (6.0, 0.1),
    "integrating": (0.0, 0.0),
    "integrating with lag": (3.0, 0.0),
}


def reference(c2: float, c0: float) -> lti:
    return lti([1.0], [c2, 1.0, c0] if c2 else [1.0, c0])


@pytest.mark.parametrize("member", MEMBERS)
def test_held_input_step_ramp_and_impulse_are_those_of_the_transfer_function(member: str) -> None:
    c2, c0 = MEMBERS[member]
    dynamics, t = Dynamics(c2, c0), np.arange(400) * 0.25
    u = np.cumsum(np.random.default_rng(1).standard_normal(400))
    u -= u[0]
    system = reference(c2, c0)
    held = lsim(system, u, t, interp=False)[1]
    np.testing.assert_allclose(dynamics.held(SamplingInstants.of(t), u, 0.0), held, atol=1e-6 * np.max(np.abs(held)))
    step = lsim(system, np.ones(400), t, interp=False)[1]
    np.testing.assert_allclose(dynamics.step(t), step, atol=1e-7 * np.max(step))
    ramp = lsim(system, t, t)[1]
    np.testing.assert_allclose(dynamics.ramp(t), ramp, atol=1e-7 * np.max(ramp))
    fine = (dynamics.step(t + 1e-5) - dynamics.step(t)) / 1e-5
    np.testing.assert_allclose(dynamics.impulse(t)[1:], fine[1:], atol=2e-5)


@pytest.mark.parametrize("member", MEMBERS)
@pytest.mark.parametrize("lag", [0.3, 10.0, 7.0])
def test_a_rounded_step_is_a_step_through_one_more_lag(member: str, lag: float) -> None:
    c2, c0 = MEMBERS[member]
    t = np.arange(400) * 0.25
    denominator = np.polymul([c2, 1.0, c0] if c2 else [1.0, c0], [lag, 1.0])
    expected = lsim(lti([1.0], denominator), np.ones(400), t, interp=False)[1]
    np.testing.assert_allclose(Dynamics(c2, c0).rounded_step(t, lag), expected, atol=1e-4 * np.max(expected))


@example(c2=0.0, c0=5e-324, theta=0.0, seed=1)  # the smallest rate there is
@given(c2=st.just(0.0) | st.floats(1e-6, 20), c0=st.floats(0, 2), theta=st.floats(0, 30), seed=st.integers(0, 1000))
def test_even_and_uneven_sampling_agree(c2: float, c0: float, theta: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, coarse = np.arange(40.0), rng.standard_normal(40)
    coarse -= coarse[0]
    uneven = np.sort(np.concatenate([t, rng.uniform(0, 39, 17)]))
    held = coarse[np.searchsorted(t, uneven, side="right") - 1]
    dynamics = Dynamics(c2, c0)
    on_grid = np.isin(uneven, t)
    found = dynamics.held(SamplingInstants.of(uneven), held, theta)[on_grid]
    expected = dynamics.held(SamplingInstants.of(t), coarse, theta)
    np.testing.assert_allclose(found, expected, atol=1e-6 * (1 + np.max(np.abs(expected))))


@given(theta=st.floats(0, 500), tau=st.floats(0.01, 1e4))
def test_the_dead_time_may_be_any_real_number(theta: float, tau: float) -> None:
    t = np.arange(200.0)
    u = np.where(t >= 5, 1.0, 0.0)
    since = t - 5 - theta
    expected = np.where(since > 0, tau * -np.expm1(-np.maximum(since, 0) / tau), 0.0)
    np.testing.assert_allclose(
        Dynamics(0.0, 1 / tau).held(SamplingInstants.of(t), u, theta), expected, rtol=1e-9, atol=1e-9
    )


def test_long_dead_times_and_short_lags_do_not_overflow() -> None:
    t = np.arange(2000.0)
    u = np.where(t < 5, 0.0, 1.0)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        moved = Dynamics(0.0, 1 / 0.3).held(SamplingInstants.of(t), u, 1500.0)
        uneven = Dynamics(0.001, 1 / 0.3).held(SamplingInstants(t, None), u, 1500.0)
    assert moved[1504] == pytest.approx(0.0)
    assert moved[1600] == pytest.approx(0.3)
    assert uneven[1600] == pytest.approx(0.3)
