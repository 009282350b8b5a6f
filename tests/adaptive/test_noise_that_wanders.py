"""The noise of a loop: honest where it is coloured or its sensor coarse."""

import math

import numpy as np
import pytest

from retuner.adaptive.signals.noise import coloured_sigma, noise_sigma
from retuner.adaptive.signals.recogniser import START_BANDS
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.rest import wander_before
from retuner.adaptive.signals.sample import FloatArray, LoopSample

N = 1200


def noise(memory: float, seed: int, n: int = N) -> FloatArray:
    """Autoregressive noise of standard deviation one. memory : its time constant in samples, 0 for white."""
    rng = np.random.default_rng(seed)
    rho = math.exp(-1 / memory) if memory else 0.0
    found = np.zeros(n)
    found[0] = rng.standard_normal()
    for i in range(1, n):
        found[i] = rho * found[i - 1] + math.sqrt(1 - rho**2) * rng.standard_normal()
    return found


@pytest.mark.parametrize("memory", [1, 2, 4, 8, 16])
def test_noise_with_a_memory_is_told_whole_where_neighbours_show_a_part(memory: float) -> None:
    told = [coloured_sigma(noise(memory, seed), N) for seed in range(20)]
    assert np.median(told) == pytest.approx(1.0, rel=0.3)
    assert np.median([noise_sigma(noise(memory, seed)) for seed in range(20)]) < 0.81


def test_white_noise_is_left_to_the_differences_of_neighbours() -> None:
    told = [coloured_sigma(noise(0, seed), 100) for seed in range(50)]
    assert np.mean(np.array(told) > 0) <= 0.1


@pytest.mark.parametrize("quantum", [0.5, 1.0])
def test_a_coarse_sensor_does_not_hide_noise_with_a_memory(quantum: float) -> None:
    told = [coloured_sigma(np.round(noise(8, seed) / quantum) * quantum, N) for seed in range(20)]
    assert np.median(told) == pytest.approx(1.0, rel=0.4)


def test_what_is_slower_than_asked_for_is_no_noise() -> None:
    slow = np.linspace(0, 1, N) ** 2 * 50 + noise(0, 3)
    assert coloured_sigma(slow, 16) == 0.0


def loop(pv: FloatArray, sp_at: int) -> list[LoopSample]:
    """At rest, with the setpoint stepped late."""
    return [LoopSample(float(i), 40.0 if i >= sp_at else 0.0, float(y), 50.0) for i, y in enumerate(pv)]


def step_at(t_s: float, band: float) -> Response:
    return Response(t_s, float(N - 1), (), Ending.QUIET, True, band)


def test_what_wanders_before_a_step_is_told_and_a_motion_there_is_not_taken_for_it() -> None:
    pv, band = noise(8, 4), 4 * noise_sigma(noise(8, 4))
    assert START_BANDS * band < 3.0  # the band is so narrow that the noise leaves it
    assert wander_before(loop(pv, 800), step_at(800.0, band)) == pytest.approx(1.0, rel=0.35)
    moved = pv + np.where(np.arange(N) < 700, 30.0 * np.sin(np.arange(N) / 9), 0.0)
    assert wander_before(loop(moved, 800), step_at(800.0, band)) < 2.0
    assert wander_before(loop(pv, 30), step_at(30.0, band)) == 0.0  # too short to tell


def test_levels_of_a_sensor_are_a_quantum_even_where_the_end_of_its_range_cuts_one_off() -> None:
    pv = np.clip(np.round((3.0 * np.sin(np.arange(N) / 60) + 0.3 * noise(0, 5)) / 2.0) * 2.0, -5.0, 2.7)
    assert len(np.unique(pv)) <= 5
    assert noise_sigma(pv) >= 2.0 / math.sqrt(12.0)
    smooth = np.concatenate([np.zeros(N - 40), np.linspace(0.0, 1.0, 40) ** 1.7])  # levels of a motion, seen once each
    assert noise_sigma(smooth) == 0.0
