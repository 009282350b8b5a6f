"""Indexes of shape, non-linearity and movement on waves whose values are known."""

import math

import numpy as np
import pytest

from retuner.adaptive.indexes.harmonics import half_wave_shape, phase_deg, refined_frequency, tones
from retuner.adaptive.indexes.jumps import flat_share, jump_share
from retuner.adaptive.indexes.shapes import cross_correlation, ellipse, kurtosis, yamashita

PERIOD = 40.0
T = np.arange(1000.0)
W = 2 * math.pi / PERIOD


@pytest.mark.parametrize(
    ("kind", "third", "distortion", "even", "share", "peak"),
    [
        ("sine", 0, 0, 0, 1, 1.5),
        ("triangle", 1 / 9, math.hypot(1 / 9, 1 / 25), 0, 8 / math.pi**2 * 6 / 2 / (math.pi**2 / 4) / 1, 1.8),
        ("square", 1 / 3, math.hypot(1 / 3, 1 / 5), 0, 8 / math.pi**2, 1.0),
        ("saw", 1 / 3, math.sqrt(1 / 4 + 1 / 9 + 1 / 16 + 1 / 25), math.hypot(1 / 2, 1 / 4), 6 / math.pi**2, 1.8),
    ],
)
def test_fourier_series_of_the_waves(kind, third, distortion, even, share, peak, wave):
    found = tones(T, W, wave(kind))
    assert found is not None
    assert found[0].third == pytest.approx(third, abs=0.01)
    assert found[0].distortion == pytest.approx(distortion, abs=0.02)
    assert found[0].even == pytest.approx(even, abs=0.01)
    assert found[0].share == pytest.approx(share, abs=0.01)
    assert kurtosis(wave(kind)) == pytest.approx(peak, abs=0.02)


def test_kurtosis_of_noise_and_of_a_constant(rng):
    assert kurtosis(rng.normal(size=20000)) == pytest.approx(3.0, abs=0.15)
    assert kurtosis(np.full(100, 2.0)) is None


@pytest.mark.parametrize("degrees", [-170, -90, -45, 0, 60])
@pytest.mark.parametrize("direction", [1, -1])
def test_phase_and_frequency(rng, degrees, direction):
    period = 37.3
    w = 2 * math.pi / period
    co = 3 * np.sin(w * T) + 0.1 * rng.normal(size=1000)
    pv = direction * np.sin(w * T + math.radians(degrees)) + 0.1 * rng.normal(size=1000)
    refined = refined_frequency(T, pv, w * 1.02)
    assert refined == pytest.approx(w, rel=1e-3)
    found = tones(T, refined, pv, co)
    assert found is not None
    assert phase_deg(*found, direction) == pytest.approx(degrees, abs=2)


def test_tones_of_a_constant_are_none():
    assert tones(T, W, np.ones(1000)) is None


@pytest.mark.parametrize(
    ("kind", "low", "high"), [("sine", 0, 0.05), ("triangle", 0.95, 1), ("square", 0.3, 0.5), ("saw", 0.8, 1)]
)
def test_triangle_index(kind, low, high, wave):
    found = half_wave_shape(wave(kind), 0.2)
    assert found is not None
    assert low <= found.triangle_index <= high
    assert found.half_waves >= 20
    assert found.asymmetry == pytest.approx(0.4 if kind == "saw" else 0.0, abs=0.051 if kind != "square" else 0.5)


@pytest.mark.parametrize("tau", [0.1, 0.5, 2.0])
def test_relay_index_of_a_first_order_relay_cycle(tau, wave):
    """The half waves of a relay loop on a first-order process with delay, drawn from its formula."""
    switch = tau * math.log((1 + math.exp(1 / tau)) / 2)
    s = np.arange(1000) / 20 % 1.0
    peak = 1 - math.exp(-switch / tau)
    half = np.where(s < switch, 1 - np.exp(-s / tau), -1 + (1 + peak) * np.exp(-(s - switch) / tau))
    x = half * np.where(np.arange(1000) / 20 % 2 < 1, 1, -1)
    found = half_wave_shape(x, 0.05)
    assert found is not None
    assert found.relay_index > 0.6
    sine = half_wave_shape(wave("sine"), 0.2)
    assert sine is not None
    assert sine.relay_index < -0.8


def test_half_waves_need_two_periods_and_four_samples(rng, wave):
    assert half_wave_shape(wave("sine", n=50), 0.2) is None
    assert half_wave_shape(wave("sine", period=6.0), 0.2) is None
    assert half_wave_shape(rng.normal(size=500), 10.0) is None


def test_horch_odd_and_even(wave):
    valve = cross_correlation(wave("square"), wave("triangle", phase=-0.25))  # co is the integral of pv
    assert valve is not None
    assert valve.dtau > 0.9
    assert valve.drho > 0.75
    tone = cross_correlation(-wave("sine"), wave("sine"))
    assert tone == pytest.approx((0.0, 0.0), abs=0.02)
    assert cross_correlation(np.zeros(100), wave("sine", n=100)) is None


def test_ellipse_of_two_sines_and_of_a_square_wave_over_a_triangle(rng, wave):
    for phase in (30, 90, 150):
        found = ellipse(np.sin(W * T - math.radians(phase)), 2 * np.sin(W * T))
        assert found is not None
        assert found.stick_band == pytest.approx(4 * abs(math.sin(math.radians(phase))), rel=0.01)
        assert found.roundness < 0.05
    found = ellipse(wave("square"), wave("triangle", phase=-0.25))
    assert found is not None
    assert found.roundness == pytest.approx(math.sqrt(9 / 5 - 1) / 2, abs=0.03)  # std of 3 u^2, u even in -1..1, over 2
    noise = ellipse(rng.normal(size=20000), rng.normal(size=20000))
    assert noise is not None
    assert noise.roundness == pytest.approx(1.0, abs=0.05)
    assert ellipse(T, T) is None
    assert ellipse(wave("sine"), wave("sine")) is None


def test_yamashita_by_hand_by_chance_and_with_a_stuck_valve(rng, wave):
    # increments of co: + + 0 - -, of pv: 0 + 0 0 -  ->  moving 4, standing with co moving 2 (IS then II, DS then DD)
    co = np.cumsum([0, 1, 1, 0, -1, -1.0])
    pv = np.cumsum([0, 0, 1, 0, 0, -1.0])
    assert yamashita(pv, co) == (pytest.approx(0.5), pytest.approx(0.5))
    # IS followed by DD: pv goes with co's turn, no valve does that
    assert yamashita(np.array([0, 0, -1.0]), np.array([0, 1, 0.0])) == (pytest.approx(0.5), pytest.approx(0.0))
    by_chance = yamashita(rng.normal(size=20000), rng.normal(size=20000))
    assert by_chance is not None
    assert by_chance[0] == pytest.approx(0.25, abs=0.02)
    stuck = yamashita(wave("square"), wave("triangle", phase=-0.25))
    assert stuck is not None
    assert min(stuck) > 0.8
    assert yamashita(np.ones(10), np.ones(10)) is None


def test_jumps_and_flat_stretches(rng, wave):
    square, triangle = wave("square"), wave("triangle", phase=-0.25)
    assert jump_share(square, triangle) == pytest.approx(1 - 0.05, abs=0.01)
    assert flat_share(square, triangle, 2) > 0.85
    assert flat_share(wave("sine", phase=-0.1), wave("sine"), 2) == pytest.approx(0, abs=0.1)
    # the largest twentieth of |N(0,1)| holds exp(-1.96^2 / 2) of the travel
    noise = jump_share(rng.normal(size=40001), T.repeat(41)[:40001] * 0 + np.arange(40001))
    assert noise == pytest.approx(math.exp(-(1.96**2) / 2) - 0.05, abs=0.01)
    assert jump_share(np.ones(100), np.ones(100)) is None
    assert flat_share(np.ones(100), np.ones(100), 5) is None
