"""A load that swings: found at its frequency, likelier than one that wanders alone, and no reason to cut the gain."""

import math
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.cause_odds import odds
from retuner.adaptive.cause_odds.odds import diagnose_records
from retuner.adaptive.cause_odds.odds_settings import OddsSettings
from retuner.adaptive.cause_odds.swinging_load import likelihood_swinging, swing_frequency
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.explanations.wandering_load import Prepared, log_likelihood
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

PERIOD, N = 24.0, 480
SETPOINT = np.repeat([0.0, 20.0, 5.0, 25.0], N // 4)
GAINS = PidGains(1.6, 0.08)
"""Ms 1.35 on the loop below."""


def swung(*, load: float = 1.0, seed: int = 2) -> Window:
    """PI on a lag of 20 s with 4 s dead time: three setpoint steps, and a load through a resonance of PERIOD."""
    rng = np.random.default_rng(seed)
    w, r = 2.0 * math.pi / PERIOD, math.exp(-0.05 * 2.0 * math.pi / PERIOD)
    push = np.zeros(N)
    for i in range(N):
        before, two = (push[i - k] if i >= k else 0.0 for k in (1, 2))
        push[i] = 2.0 * r * math.cos(w) * before - r * r * two + load * rng.standard_normal()
    pole, total, y = math.exp(-1 / 20.0), 0.0, 0.0
    pv, co = np.zeros(N), np.zeros(N)
    for i in range(N):
        y = pole * y + (1 - pole) * ((co[i - 5] if i > 4 else 0.0) + push[i])
        pv[i] = y + 0.1 * rng.standard_normal()
        total += GAINS.ki * (SETPOINT[i] - pv[i])
        co[i] = GAINS.kp * (SETPOINT[i] - pv[i]) + total
    return Window(np.arange(float(N)), SETPOINT, pv, co)


def test_the_frequency_is_found_and_the_swing_is_likelier() -> None:
    record = Prepared.at(swung(), 1.0)
    alone = log_likelihood(record, 1, GAINS.kp)
    w = swing_frequency(record, SETPOINT, alone)
    assert w is not None
    assert 2.0 * math.pi / w == pytest.approx(PERIOD, rel=0.1)
    assert np.max(likelihood_swinging(record, 1, GAINS.kp, w)) > np.max(alone) + 3.0


def test_a_load_that_does_not_swing_is_not_taken_for_one() -> None:
    window = swung(load=0.0)
    walk = np.cumsum(np.random.default_rng(3).standard_normal(N)) * 0.5
    record = Prepared.at(replace(window, pv=window.pv + walk), 1.0)
    assert swing_frequency(record, SETPOINT, log_likelihood(record, 1, GAINS.kp)) is None


def test_a_swing_counts_against_load_steps_and_the_less_the_less_the_setpoint_moves() -> None:
    """Under a tone that setpoint steps moved by 26 % gains were cut by 85 %: from 30 % on a swing was asked for."""
    asked, less = (odds._walk([swung()], GAINS, 1, OddsSettings(swings_moved=share)) for share in (1e-3, 0.999))
    assert 0.2 < asked.moved < 0.999
    assert asked.swung > less.swung > 1.0
    assert asked.swung - less.swung < -math.log(asked.moved) + 0.1
    alone = odds._under_walk(replace(asked, swung=0.0), None, 0.0, 0.0, OddsSettings())[1]
    assert odds._under_walk(asked, None, 0.0, 0.0, OddsSettings())[1] > alone + 1.0


@pytest.mark.slow
def test_a_loop_in_order_under_it_keeps_its_gains() -> None:
    found = diagnose_records([swung()], GAINS)
    assert found.found.diagnosis.cause in {Cause.EXTERNAL, Cause.OK}
    assert found.settings is None
    assert sum(found.found.diagnosis.causes.values()) == pytest.approx(1.0)
