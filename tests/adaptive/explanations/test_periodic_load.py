"""A load from outside that repeats, ramps or steps: told from a valve that makes the same picture."""

import math
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.cause_odds import odds
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.explanations.periodic_load import log_odds_of_repeating
from retuner.adaptive.explanations.slip_odds import log_odds_of_slips
from retuner.adaptive.explanations.valve_odds import WEIGHT, log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import Prepared
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.diagnosing import diagnose_windows
from retuner.schedule.gains import PidGains

N, GAIN, RESET, PERIOD = 600, 0.5, 0.25, 151.3


def load(shape: str) -> FloatArray:
    part = (np.arange(N) + 31.7) / PERIOD % 1.0
    ramps = {"triangle": np.abs(part - 0.5), "skewed": np.where(part < 0.7, part / 1.4, (1.0 - part) / 0.6)}
    moves = 40.0 * ramps[shape] if shape in ramps else 3.0 * np.sign(part - 0.4)
    return moves - moves[0]


def record(moves: FloatArray, band: float = 0.0, seed: int = 1) -> Prepared:
    """PI on a lag of 3 samples, behind a valve that slips all the way when co is a band away from it."""
    rng = np.random.default_rng(seed)
    pv, co = np.zeros(N), np.zeros(N)
    y = total = valve = 0.0
    for i in range(N):
        pv[i] = y + 0.1 * rng.standard_normal()
        total -= RESET * pv[i]
        co[i] = total - GAIN * pv[i]
        if abs(co[i] - valve) >= band:
            valve = co[i]
        y = math.exp(-1 / 3.0) * (y - valve - moves[i]) + valve + moves[i]
    return Prepared(pv - pv[0], co - co[0], 0.0, 1.0)


def told(of: Prepared) -> Diagnosis:
    window = Window(np.arange(float(N)), np.full(N, 50.0), 50.0 + of.pv, 40.0 + of.co)
    return diagnose_windows([window], gains=PidGains(GAIN, RESET)).diagnosis


@pytest.mark.parametrize("shape", ["triangle", "skewed", "square"])
def test_a_load_that_repeats_is_seen_with_its_period(shape: str) -> None:
    found = record(load(shape))
    repeats, period_s = log_odds_of_repeating(found, 1)
    assert WEIGHT * repeats > max(log_odds_of_valve([found], 1), WEIGHT * log_odds_of_slips(found, 1), 7.0)
    assert period_s == pytest.approx(PERIOD, rel=0.01)


def test_a_slow_triangle_under_a_fast_loop_is_named_outside_with_its_period() -> None:
    """It was a sticking valve with 97 %: pv is a square under a triangle of co, as it is behind one."""
    found = told(record(load("triangle")))
    assert found.cause is Cause.EXTERNAL
    assert found.causes["stiction"] < 0.1
    assert found.evidence["swing_s"] == pytest.approx(PERIOD, rel=0.01)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_valve_that_makes_the_same_picture_stays_one(seed: int) -> None:
    drift = 0.02 * np.cumsum(np.random.default_rng(seed).standard_normal(N)) + 1.3
    found = record(drift, band=3.0, seed=seed)
    valve = max(log_odds_of_valve([found], 1) / WEIGHT, log_odds_of_slips(found, 1))
    assert log_odds_of_repeating(found, 1)[0] < valve
    assert told(found).cause is Cause.STICTION


def test_a_load_that_wanders_or_turns_once_does_not_repeat() -> None:
    wanders = 0.3 * np.cumsum(np.random.default_rng(4).standard_normal(N))
    for moves in (wanders, 0.2 * np.abs(np.arange(N) - 250.0)):
        assert log_odds_of_repeating(record(moves), 1)[0] < 0.0


def test_a_round_and_a_half_is_no_load_that_repeats() -> None:
    """Of real sticking valves such crops had odds for one."""
    whole = record(load("square"))
    short = Prepared(whole.pv[:235], whole.co[:235], 0.0, 1.0)
    assert log_odds_of_repeating(short, 1)[0] <= 0.0


def test_signals_that_stand_say_nothing() -> None:
    moves, still = np.random.default_rng(1).standard_normal(100), np.zeros(100)
    for pv, co in ((moves, still), (still, moves)):
        assert log_odds_of_repeating(Prepared(pv, co, 0.0, 1.0), 1)[0] == -math.inf


def test_where_the_setpoint_steps_no_load_that_repeats_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A valve that followed each setpoint step late was a load from outside with 85 %."""

    def asked(*_: object) -> None:
        pytest.fail("a load that repeats was asked for")

    monkeypatch.setattr(odds, "log_odds_of_repeating", asked)
    of = record(load("triangle"))
    sp = np.where(np.arange(N) < N // 2, 50.0, 60.0)
    window = Window(np.arange(float(N)), sp, 50.0 + of.pv, 40.0 + of.co)
    diagnose_windows([window], gains=PidGains(GAIN, RESET))
    with pytest.raises(pytest.fail.Exception):
        diagnose_windows([replace(window, sp=np.full(N, 50.0))], gains=PidGains(GAIN, RESET))
