"""Period, regularity, decay, idle and setpoint indexes on signals whose values are known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.indexes.autocovariance import (
    autocovariance,
    crossings,
    decay_ratio,
    detrended,
    iae_detection,
    regularity,
    running_mean,
)
from retuner.adaptive.indexes.setpoint_responses import idle_index, setpoint_responses


@given(st.integers(1, 2000), st.floats(0.01, 0.99), st.floats(0, 0.5))
def test_crossings_of_a_ramp_are_where_it_is_zero(n, place, band):
    x = np.arange(n + 2) - place * (n + 1)
    at = crossings(x, band if abs(x[0]) > band < abs(x[-1]) else 0.0)
    if x[0] < 0 < x[-1]:
        assert at == pytest.approx([place * (n + 1)])


def test_noise_inside_the_band_makes_no_crossings(rng):
    slow = np.sin(2 * np.pi * np.arange(1000) / 100)
    assert len(crossings(slow + 0.1 * rng.normal(size=1000), 0.4)) == 19
    assert len(crossings(slow + 0.1 * rng.normal(size=1000))) > 19
    assert crossings(0.1 * rng.normal(size=1000), 0.9).size == 0
    assert crossings(np.zeros(5)).size == 0


def test_autocovariance_is_the_sum_it_says(rng):
    x = rng.normal(size=50)
    level = x - x.mean()
    r = autocovariance(x)
    for k in (0, 1, 7, 25):
        assert r[k] == pytest.approx(level[: 50 - k] @ level[k:] / (50 - k) / (level @ level / 50))
    assert not np.any(autocovariance(np.full(20, 3.0)))


def test_running_mean_is_the_mean_of_what_is_there():
    assert running_mean(np.arange(6.0), 3) == pytest.approx([0.5, 1, 2, 3, 4, 4.5])


@pytest.mark.parametrize("period", [9.0, 40.0, 100.0])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_period_of_a_sine_even_under_noise_and_drift(rng, period, noise):
    i = np.arange(1000)
    found = regularity(np.sin(2 * np.pi * i / period) + noise * rng.normal(size=1000) + 0.01 * i)
    assert found.lasting
    assert found.period == pytest.approx(period, rel=0.02)
    assert found.cycles == pytest.approx(1000 / period, rel=0.02)


def test_a_slow_drift_does_not_hide_an_oscillation(rng):
    drift = np.cumsum(rng.normal(size=1500))
    found = regularity(0.3 * np.std(drift) * np.sin(2 * np.pi * np.arange(1500) / 25) + drift)
    assert found.lasting
    assert found.period == pytest.approx(25, rel=0.06)


def test_noise_and_random_walks_do_not_oscillate(rng):
    def false_alarms(make) -> int:
        found = [regularity(make()) for _ in range(100)]
        return sum(f is not None and f.lasting for f in found)

    assert false_alarms(lambda: rng.normal(size=800)) == 0
    assert false_alarms(lambda: np.cumsum(rng.normal(size=800))) <= 5


@pytest.mark.parametrize("zeta", [0.03, 0.05, 0.1])
def test_decay_ratio_of_a_free_decay(zeta):
    wd = 2 * math.pi / 50
    i = np.arange(round(5 * 50 / (2 * math.pi * zeta)))
    x = np.exp(-zeta / math.sqrt(1 - zeta**2) * wd * i) * np.cos(wd * i)
    assert decay_ratio(x) == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)), abs=0.06)


def test_decay_ratio_of_a_lasting_oscillation_is_one():
    assert decay_ratio(np.sin(np.arange(1000) / 7)) == pytest.approx(1.0, abs=0.01)
    assert decay_ratio(np.zeros(100)) is None


def test_iae_limit_is_that_of_half_a_sine_wave():
    t = np.arange(0, 100, 0.01)
    w = 2 * math.pi / 10
    just_over = iae_detection(t, 1.001 * np.sin(w * t + 0.3), 1.0, w)
    just_under = iae_detection(t, 0.999 * np.sin(w * t + 0.3), 1.0, w)
    assert (just_over[0], just_under[0]) == (19, 0)
    # 18 half periods of memory exp(-1/100) behind the last: a geometric sum
    q = math.exp(-0.5 / 50)
    assert just_over[1] == pytest.approx((1 - q**19) / (1 - q), rel=1e-3)
    assert just_over[1] > 10 > just_under[1]


def test_two_load_disturbances_are_no_oscillation():
    t = np.arange(0.0, 500.0)
    e = 5 * np.exp(-np.abs(t - 100) / 10) - 5 * np.exp(-np.abs(t - 300) / 10)
    loads, count = iae_detection(t, e, 0.5, 2 * math.pi / 20)
    assert 1 <= loads <= 2
    assert count < 10
    with pytest.raises(ValueError, match="amplitude = 0"):
        iae_detection(t, e, 0.0, 1.0)


def test_idle_index_of_a_sluggish_a_fast_and_a_noisy_record(rng):
    i = np.arange(400.0)
    # sluggish after a load: pv comes back while co still moves the same way
    assert idle_index(np.exp(-i / 80), np.exp(-i / 80) * 3, 1, 5) == 1.0
    assert idle_index(np.exp(-i / 80), -np.exp(-i / 80), 1, 5) == -1.0
    assert idle_index(np.exp(-i / 80), np.exp(-i / 80), -1, 5) == -1.0
    # an undamped swing with pv a quarter period behind: half the time each
    assert idle_index(np.sin(i / 10), np.cos(i / 10), 1, 2) == pytest.approx(0.0, abs=0.05)
    assert idle_index(rng.normal(size=400), rng.normal(size=400), 1, 5) is None


@pytest.mark.parametrize("zeta", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("size", [3.0, -0.2])
def test_overshoot_and_damping_of_second_order_responses(zeta, size):
    t = np.arange(0, 60, 0.05)
    wd = math.sqrt(1 - zeta**2)
    y = 1 - np.exp(-zeta * t) * (np.cos(wd * t) + zeta / wd * np.sin(wd * t))
    sp = 7.0 + size * np.concatenate([np.zeros(100), np.ones(1200), np.zeros(1200)])
    pv = 7.0 + size * np.concatenate([np.zeros(100), y, 1 - y])
    found = setpoint_responses(sp, pv)
    o = math.exp(-math.pi * zeta / wd)
    assert found.steps == 2
    assert found.overshoot == pytest.approx(o, abs=2e-3)
    assert found.damping == pytest.approx((o**2 + o) / (1 + o), abs=3e-3)  # = o


def test_a_first_order_response_has_no_overshoot_and_a_moving_setpoint_no_responses(rng):
    t = np.arange(300.0)
    sp = np.where(t < 50, 0.0, 1.0)
    pv = np.where(t < 50, 0.0, 1 - np.exp(-(t - 50) / 20)) + 0.01 * rng.normal(size=300)
    found = setpoint_responses(sp, pv)
    assert (found.overshoot, found.damping) == (0.0, None)
    assert setpoint_responses(rng.normal(size=300), pv) is None
    assert setpoint_responses(np.zeros(300), pv) is None
    assert setpoint_responses(sp, pv + 3.0 * np.sin(t)) is None  # not at rest before the step


def test_detrended_takes_level_and_slope_away():
    assert detrended(3 + 0.1 * np.arange(50)) == pytest.approx(np.zeros(50), abs=1e-12)
