"""A swing that only the loop itself can make: exponential growth, and nothing else that rises."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.signals.growth import GrowthSettings, grows, half_waves, lasting
from retuner.adaptive.signals.sample import LoopSample

BAND, PERIOD, N = 0.04, 40.0, 400
S = GrowthSettings()


def heard(error: Callable[[float], float], noise: float = 0.01, seed: int = 0) -> list[LoopSample]:
    rng = np.random.default_rng(seed)
    return [LoopSample(float(i), 0.0, -error(float(i)) - noise * float(rng.standard_normal()), 0.0) for i in range(N)]


def swing(t_s: float) -> float:
    return math.sin(2 * math.pi * t_s / PERIOD)


@given(rate=st.floats(0.08, 0.5), start=st.floats(0.3, 5.0), seed=st.integers(0, 10))
def test_growth_is_found_with_its_factor_and_period(rate: float, start: float, seed: int) -> None:
    found = grows(heard(lambda t: start * math.exp(2 * rate * t / PERIOD) * swing(t), seed=seed), BAND, S)
    assert found.factor == pytest.approx(math.exp(rate), rel=0.05)
    assert found.period_s == pytest.approx(PERIOD, rel=0.1)
    assert f"{found.factor:.2f}" in found.sentence
    assert found.to_dict()["period_s"] == found.period_s


@pytest.mark.parametrize(
    "error",
    [
        swing,
        lambda t: math.exp(-t / 100) * swing(t),
        lambda t: (1 - math.exp(-t / 60)) * swing(t),
        lambda t: math.sin(math.pi * t / 500) * swing(t),
        lambda t: math.exp(t / 100) * (math.sin(2 * math.pi * t / 17) + math.sin(2 * math.pi * t / 41)),
        lambda t: t / N,
    ],
    ids=["a tone", "decay", "a tone that sets in", "a beat", "two periods", "a ramp"],
)
@pytest.mark.parametrize("seed", range(5))
def test_nothing_else_grows(error: Callable[[float], float], seed: int) -> None:
    assert grows(heard(error, seed=seed), BAND, S) is None


@pytest.mark.parametrize(
    "heights",
    [
        [0.155, 0.183, 0.134, 0.183, 0.189, 0.171, 0.195, 0.147, 0.168, 0.155, 0.152, 0.161, 0.190, 0.230, 0.250],
        [0.636, 0.544, 0.624, 0.713, 0.469, 0.544, 0.600, 0.751, 0.693, 0.952],
    ],
    ids=["a good loop under a tone at 0.6 of its own period", "at 0.9"],
)
def test_a_tone_of_changing_height_is_not_taken_for_growth_from_where_it_was_low(heights: list[float]) -> None:
    """As seen (harm by tones, seed 9542): the last six rise by half and more, but the swing was as high before."""
    half = PERIOD / 2
    last = len(heights) - 1

    def error(t_s: float) -> float:
        return heights[min(int(t_s / half), last)] * swing(t_s)

    samples = heard(error, noise=0.002)[: int(half * (last + 1.7))]
    seen = [wave.height for wave in half_waves(samples, BAND)]
    assert seen == pytest.approx(heights[1:], abs=0.02)
    assert seen[-1] > 1.5 * seen[-6]
    assert grows(samples, BAND, S) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_a_tone_whose_height_wanders_does_not_grow(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(40):
        heights = 1.0 + 0.2 * rng.standard_normal(30)
        samples = heard(lambda t, of=heights: float(of[int(2 * t / PERIOD)]) * swing(t), seed=seed)
        assert not any(grows(samples[:end], BAND, S) for end in range(200, N, 20))


def test_a_load_before_it_does_not_hide_growth() -> None:
    def error(t_s: float) -> float:
        return 3.0 * math.exp(-t_s / 10) if t_s < 40 else 0.3 * math.exp((t_s - 40) / 100) * swing(t_s)

    assert grows(heard(error), BAND, S) is not None


def test_noise_does_not_grow() -> None:
    assert not any(grows(heard(lambda _: 0.0, 0.02, seed), BAND, S) for seed in range(40))


def test_other_gains_or_another_setpoint_begin_anew() -> None:
    samples = heard(lambda t: math.exp(t / 100) * swing(t))
    assert grows(samples, BAND, S) is not None
    assert grows([s._replace(revision=int(s.t_s > 340)) for s in samples], BAND, S) is None
    assert grows([s._replace(sp=float(s.t_s > 340)) for s in samples], BAND, S) is None


def test_half_waves_stand_in_their_order_with_their_heights() -> None:
    found = half_waves(heard(swing, noise=0.0), BAND)
    assert len(found) >= 15
    assert [wave.t_s for wave in found] == sorted(wave.t_s for wave in found)
    assert all(wave.height == pytest.approx(1.0, abs=0.02) for wave in found)


@pytest.mark.parametrize(
    ("error", "lasts"),
    [
        (swing, True),
        (lambda t: 1.5 * swing(t) / (abs(swing(t)) + 0.5), True),
        (lambda t: math.exp(-t / 60) * swing(t), False),
        (lambda t: swing(t) * (t % 100 < 20), False),
        (lambda t: math.copysign(math.exp(-((t % 80) / 8)), math.sin(math.pi * t / 80)), False),
    ],
    ids=["a tone", "one of broad waves", "decay", "a rest between", "load steps to and fro, apart"],
)
def test_a_swing_goes_on_that_is_even_and_without_a_rest(error: Callable[[float], float], lasts: bool) -> None:
    found = lasting(heard(error), BAND, S)
    assert (found is not None) is lasts
    assert found is None or found == pytest.approx(PERIOD, rel=0.1)
