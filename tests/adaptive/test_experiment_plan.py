"""The pure step functions of experiments on demand: rest, relay, when enough has been seen, settings out of range."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.experiments.plan import (
    Kind,
    Plan,
    RelayState,
    Rest,
    at_rest,
    enough,
    relay_output,
    relay_start,
    relay_step,
)
from retuner.adaptive.signals.sample import LoopSample

PLAN = Plan(Kind.RELAY, 10.0, 0.0, 100.0, rest_samples=30)
REST = Rest(50.0, 40.0, 0.1, 0.3)


def samples(pv: list[float], co: float = 40.0, sp: float = 50.0) -> list[LoopSample]:
    return [LoopSample(float(i), sp, value, co) for i, value in enumerate(pv)]


def noisy(n: int, sigma: float, slope: float = 0.0, seed: int = 1) -> list[float]:
    rng = np.random.default_rng(seed)
    return (50.0 + sigma * rng.standard_normal(n) + slope * np.arange(n)).tolist()


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.5])
def test_a_steady_loop_is_at_rest_whatever_its_noise(sigma: float) -> None:
    seen = [at_rest(PLAN, samples(noisy(60, sigma, seed=seed))) for seed in range(50)]
    assert sum(rest is not None for rest in seen) >= 48
    rest = next(r for r in seen if r is not None)
    assert rest.pv == pytest.approx(50.0, abs=0.5)
    assert rest.hysteresis == pytest.approx(3 * rest.sigma)


@given(slope=st.floats(0.05, 2.0), sign=st.sampled_from([-1, 1]))
def test_a_drifting_loop_is_not(slope: float, sign: int) -> None:
    assert at_rest(PLAN, samples(noisy(60, 0.01, sign * slope))) is None


def test_rest_needs_its_samples_and_one_setpoint_and_mode() -> None:
    assert at_rest(PLAN, samples([50.0] * 29)) is None
    moved = samples([50.0] * 20) + samples([50.0] * 20, sp=51.0)
    assert at_rest(PLAN, moved) is None
    assert at_rest(PLAN, samples([50.0] * 40)) == Rest(50.0, 40.0, 0.0, 0.0)
    assert at_rest(replace(PLAN, hysteresis=0.7), samples([50.0] * 40)) == Rest(50.0, 40.0, 0.0, 0.7)


@given(pv=st.floats(40.0, 60.0), high=st.booleans(), direction=st.sampled_from([-1, 1]))
def test_the_relay_switches_outside_its_hysteresis_only_and_towards_the_reference(
    pv: float, high: bool, direction: int
) -> None:
    before = RelayState(high, 3)
    after = relay_step(before, pv, REST, direction)
    if abs(pv - 50.0) <= 0.3:
        assert after == before
    else:
        assert after.high == ((pv < 50.0) == (direction == 1))
        assert after.switches == 3 + (after.high != high)


@given(bias=st.floats(0.0, 0.8), amplitude=st.floats(0.1, 20.0))
def test_relay_levels_keep_the_amplitude(bias: float, amplitude: float) -> None:
    plan = replace(PLAN, bias=bias, amplitude=amplitude)
    high = relay_output(plan, RelayState(True, 0), REST)
    low = relay_output(plan, RelayState(False, 0), REST)
    assert (high - low) / 2 == pytest.approx(amplitude)
    assert high - 40.0 >= 40.0 - low - 1e-9
    assert (low, high) == pytest.approx(plan.co_levels(40.0))
    assert relay_start().high


def first_order(n: int, tau: float, gain: float = 5.0, delay: int = 5) -> list[float]:
    t = np.maximum(np.arange(n) - delay, 0)
    return (50.0 + gain * (1 - np.exp(-t / tau))).tolist()


@pytest.mark.parametrize("sigma", [0.0, 0.1])
@pytest.mark.parametrize("tau", [10.0, 40.0])
def test_a_step_is_over_when_the_response_has_come_to_rest_and_not_before(tau: float, sigma: float) -> None:
    plan, rest = Plan(Kind.STEP, 5.0, 0.0, 100.0), Rest(50.0, 40.0, sigma, 0.0)
    noise = sigma * np.random.default_rng(4).standard_normal(1000)
    pv = (np.array(first_order(1000, tau)) + noise).tolist()
    ends = next(n for n in range(1, 1000) if enough(plan, samples(pv[:n]), rest, relay_start()))
    assert 3 * tau < ends < 9 * tau + 40
    assert abs(pv[ends] - 55.0) < 0.3 + 4 * sigma


def test_a_dead_time_is_not_rest() -> None:
    plan = Plan(Kind.STEP, 5.0, 0.0, 100.0)
    assert not enough(plan, samples(noisy(500, 0.1)), REST, relay_start())


def test_a_ramp_is_over_when_it_has_gone_far_enough_of_its_band() -> None:
    plan = Plan(Kind.STEP, 5.0, 0.0, 60.0)
    pv = [50.0 + 0.1 * i for i in range(200)]
    assert not enough(plan, samples(pv[:55]), REST, relay_start())
    assert enough(plan, samples(pv[:65]), REST, relay_start())


def test_a_swinging_setpoint_response_is_over_after_some_turns_and_a_peak_is_no_rest() -> None:
    plan = Plan(Kind.SETPOINT, 1.0, 0.0, 100.0)
    t = np.arange(600)
    sustained = (51.0 - np.cos(2 * math.pi * t / 60)).tolist()
    ends = next(n for n in range(1, 600) if enough(plan, samples(sustained[:n]), Rest(50, 40, 0.0, 0.0), relay_start()))
    assert 100 < ends < 250
    dying = (51.0 - np.cos(2 * math.pi * t / 60) * np.exp(-t / 40)).tolist()
    ends = next(n for n in range(1, 600) if enough(plan, samples(dying[:n]), Rest(50, 40, 0.02, 0.0), relay_start()))
    assert ends > 90  # beyond the undershoot at 60


@pytest.mark.parametrize("cycles", [2, 7])
def test_a_relay_is_over_after_its_cycles(cycles: int) -> None:
    plan = replace(PLAN, cycles=cycles)
    assert not enough(plan, samples([50.0] * 9), REST, RelayState(True, 2 * cycles + 2))
    assert enough(plan, samples([50.0] * 9), REST, RelayState(True, 2 * cycles + 3))


@given(pv=st.floats(1.0, 99.0), deviation=st.floats(0.01, 200.0))
def test_the_band_about_rest_is_never_wider_than_either_limit(pv: float, deviation: float) -> None:
    plan = replace(PLAN, deviation=deviation).about(pv)
    assert PLAN.pv_low <= plan.pv_low < pv < plan.pv_high <= PLAN.pv_high
    assert plan.pv_high - plan.pv_low <= 2 * deviation * (1 + 1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("amplitude", 0.0), ("amplitude", -1.0), ("amplitude", math.inf), ("pv_low", math.nan), ("pv_low", 100.0),
        ("time_s", 0.0), ("rest_time_s", -1.0), ("cycles", 1), ("cycles", 51), ("rest_samples", 9), ("bias", -0.1),
        ("bias", 0.9), ("hysteresis", -1.0), ("hysteresis", math.inf), ("kc0", 0.0), ("kc0", math.nan),
        ("deviation", 0.0), ("deviation", math.nan), ("bias", math.nan),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}|band") as refused:
        replace(PLAN, **{name: value})  # type: ignore[arg-type]  # one field by name
    assert "\n" not in str(refused.value)
