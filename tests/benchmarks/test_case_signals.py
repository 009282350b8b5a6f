"""Valves, upsets and compression behave as their models say."""

import numpy as np
import pytest
from cases.signals import SHAPES, exceptions, he, held, kano, narrow_band, oscillation, swinging_door

UP, DOWN = np.linspace(0, 10, 2001), np.linspace(10, 0, 2001)
STEP = 10 / 2000


def travelled(valve, signal):
    return np.array([valve(float(u)) for u in signal])


@pytest.mark.parametrize(("s", "j"), [(2.0, 0.5), (2.0, 2.0), (3.0, 1.0), (1.0, 1.3)])
def test_kano_rests_for_the_stick_band_and_then_jumps(s, j):
    valve = kano(s, j)
    up, down = travelled(valve, UP), travelled(valve, DOWN)
    assert up[-1] == pytest.approx(10 - (s - j) / 2)
    breaks = int(np.flatnonzero(down != up[-1])[0])
    assert 10 - DOWN[breaks] == pytest.approx(s, abs=2 * STEP)
    assert up[-1] - down[breaks] == pytest.approx(j, abs=2 * STEP)
    assert np.ptp(down[breaks:] - DOWN[breaks:]) < 1e-9


@pytest.mark.parametrize(("s", "j"), [(2.0, 0.5), (2.0, 2.0)])
def test_he_rests_for_the_stick_band_after_a_reversal(s, j):
    valve = he(s, j)
    up, down = travelled(valve, UP), travelled(valve, DOWN)
    breaks = int(np.flatnonzero(down != up[-1])[0])
    assert s - 2 * STEP <= 10 - DOWN[breaks] <= s + j + 2 * STEP  # it stopped anywhere up to J before its next slip
    assert up[-1] - down[breaks] == pytest.approx(j, abs=2 * STEP)
    assert np.max(np.abs(down - DOWN)) <= (s + j) / 2 + 2 * STEP


@pytest.mark.parametrize("shape", SHAPES)
def test_outside_oscillations_have_their_period_and_size(shape):
    wave = oscillation(np.random.default_rng(5), 4000, 80.0, shape)
    assert np.max(np.abs(wave)) == pytest.approx(1.0, abs=0.06) or shape in {"filtered-square", "pulses"}
    assert 0.5 < np.max(np.abs(wave)) <= 1.0
    steady = wave[800:]
    assert np.allclose(steady[80:], steady[:-80], atol=1e-6)


def test_narrow_band_load_has_its_frequency_and_unit_variance():
    wave = narrow_band(np.random.default_rng(2), 20000, 50.0, 0.05)
    power = np.abs(np.fft.rfft(wave)) ** 2
    assert np.std(wave) == pytest.approx(1.0)
    assert np.argmax(power) / 20000 == pytest.approx(1 / 50, rel=0.1)


def test_compression_stays_within_its_deviation():
    rng = np.random.default_rng(1)
    t = np.arange(500.0)
    x = np.sin(t / 20) + 0.02 * rng.standard_normal(500)
    lines, last = swinging_door(t, x, 0.1), held(x, exceptions(x, 0.1))
    assert np.max(np.abs(lines - x)) <= 0.2
    assert np.max(np.abs(last - x)) <= 0.1
    assert len(np.unique(last)) < 150
    assert np.count_nonzero(np.abs(np.diff(lines, 2)) > 1e-9) < 150
