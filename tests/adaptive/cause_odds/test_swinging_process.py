"""A process that swings by itself beside those of real lags."""

import math

import numpy as np
import pytest
from pi_loop import Lag, Process, pi_loop

from retuner import PidGains
from retuner.adaptive.cause_odds.swinging_process import robust_on, swinging_processes
from retuner.adaptive.explanations.likely_processes import WorthSettings
from retuner.adaptive.explanations.wandering_load import Prepared
from retuner.adaptive.signals.sample import Window
from retuner.diagnosing import diagnose_windows

GAINS = PidGains(0.165, 0.00275 * 3.0)  # of the record: a sample a second


def pair(w: float, zeta: float) -> Process:
    """A process of gain one with a pair of poles, its input held between samples."""
    r, turn = math.exp(-zeta * w), w * math.sqrt(1.0 - zeta * zeta)
    side = zeta / math.sqrt(1.0 - zeta * zeta) * math.sin(turn)
    top, state = (1.0 - r * (math.cos(turn) + side), r * (r + side - math.cos(turn))), [0.0] * 4

    def process(u: float, load: float) -> float:
        y = 2.0 * r * math.cos(turn) * state[0] - r * r * state[1] + top[0] * (u + load) + top[1] * state[2]
        state[:] = [y, state[0], u + load, 0.0]
        return y

    return process


def loop(process: Process, seed: int = 1) -> Window:
    rng, at = np.random.default_rng(seed), np.arange(900)
    load, sp = np.cumsum(rng.standard_normal(900)) * 0.05, np.where((at > 200) & (at < 550), 5.0, 0.0)
    return pi_loop(GAINS, process, sp, 0.05 * rng.standard_normal(900), load)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_process_that_swings_by_itself_is_seen_and_gets_no_more_action_than_it_bears(seed: int) -> None:
    window = loop(pair(0.15, 0.18), seed)
    found = swinging_processes(Prepared.at(window, 1.0), 1)
    model, odds = max(found, key=lambda one: one[1])
    assert odds > 1.0
    assert 1.0 / model.tau1_s == pytest.approx(0.15, rel=0.25)
    assert not robust_on(found, PidGains(3 * GAINS.kp, 3 * GAINS.ki), 1.0, WorthSettings())
    more = diagnose_windows([window]).recommended
    assert more is None or more.ki < 1.5 * GAINS.ki


def test_one_of_real_lags_is_not_taken_for_it() -> None:
    found = swinging_processes(Prepared.at(loop(Lag(20.0, 4)), 1.0), 1)
    assert max(odds for _, odds in found) < 0.1
