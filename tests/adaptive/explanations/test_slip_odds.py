"""A valve whose slips have times of their own, under a load that wanders: seen where there is one, and only there."""

import math

import numpy as np
import pytest
from effort import sized
from pi_loop import Lag, pi_loop

from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.explanations.slip_odds import log_odds_of_slips
from retuner.adaptive.explanations.valve_odds import WEIGHT, log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import Prepared
from retuner.adaptive.fit import engine
from retuner.adaptive.signals.sample import Window
from retuner.diagnosing import diagnose_windows
from retuner.schedule.gains import PidGains

N, GAIN, RESET = 500, 1.2, 0.12


def record(seed: int, band: float, load: str = "wanders") -> Prepared:
    """PI on a lag of 8 samples behind a valve that sticks over another band at every stop, 0 for one that is free."""
    rng = np.random.default_rng(seed)
    moves = 0.03 * np.cumsum(rng.standard_normal(N))
    if load == "jumps":
        moves += np.repeat(rng.choice([-1.5, 1.5], 5).cumsum(), N // 5)
    if load == "turns a corner":
        moves = 0.02 * np.abs(np.arange(N) - 250.0)
    pv, co = np.zeros(N), np.zeros(N)
    y = total = valve = 0.0
    needed = band
    for i in range(N):
        pv[i] = y + 0.02 * rng.standard_normal()
        total -= RESET * pv[i]
        co[i] = total - GAIN * pv[i]
        if abs(co[i] - valve) >= needed:
            valve, needed = co[i], band * math.exp(0.5 * rng.standard_normal())
        y = math.exp(-1 / 8.0) * (y - valve - moves[i]) + valve + moves[i]
    return Prepared(pv - pv[0], co - co[0], 0.0, 1.0)


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_a_valve_with_another_band_at_every_stop_is_seen(seed: int) -> None:
    found = record(seed, 1.2)
    assert log_odds_of_slips(found, 1) > max(3.0, log_odds_of_valve([found], 1) / WEIGHT)


@pytest.mark.parametrize("seed", [1, 5, 7][: sized(1, 2, 3)])
def test_a_diagnosis_names_such_a_valve(seed: int) -> None:
    """By valves of one band these records were of a loop in order, or too slow, with a tenth for a valve."""
    found = record(seed, 1.2)
    window = Window(np.arange(float(N)), np.full(N, 50.0), 50.0 + found.pv, 40.0 + found.co)
    told = diagnose_windows([window], gains=PidGains(GAIN, RESET)).diagnosis
    assert told.cause is Cause.STICTION
    assert told.causes["stiction"] > 0.9


def test_slips_are_placed_behind_the_process_that_suits_them() -> None:
    """Behind the points of the grid they stayed some rows off, and were worth e^3."""
    rng, n, at, needed = np.random.default_rng(1), 625, 0.0, 1.2

    def valve(co: float) -> float:
        nonlocal at, needed
        if abs(co - at) >= needed:
            at, needed = 0.6 * co + 0.4 * at, 1.2 * math.exp(0.5 * rng.standard_normal())
        return at

    noise, load = 0.02 * rng.standard_normal(n), 0.02 * np.cumsum(rng.standard_normal(n))
    seen = pi_loop(PidGains(0.9, 0.15), Lag(3.3, 1), np.zeros(n), noise, load, valve=valve)
    assert log_odds_of_slips(Prepared.at(seen, 1.0), 1) > 8.0


@pytest.mark.parametrize("load", ["wanders", "jumps", "turns a corner"])
def test_a_free_valve_is_none_whatever_the_load_does(load: str) -> None:
    assert log_odds_of_slips(record(4, 0.0, load), 1) < 0.0


def test_a_valve_is_none_where_the_process_would_have_the_wrong_sign() -> None:
    assert log_odds_of_slips(record(1, 1.2), -1) < 0.0


def test_an_output_that_stands_says_nothing() -> None:
    pv = np.random.default_rng(1).standard_normal(100)
    assert log_odds_of_slips(Prepared(pv, np.zeros(100), 0.0, 1.0), 1) == -math.inf


def test_the_compiled_engine_says_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    found = record(2, 1.2)
    by_engine = log_odds_of_slips(found, 1)
    with monkeypatch.context() as without:
        without.setattr(engine, "compiled", lambda: None)
        assert log_odds_of_slips(found, 1) == pytest.approx(by_engine, abs=1e-3)
