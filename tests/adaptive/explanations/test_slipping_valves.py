"""A valve that slips all the way is seen behind any dead time and over any band; one step of a load is no slip."""

import numpy as np
from pi_loop import Lag, pi_loop, slipping

from retuner.adaptive.explanations.valve_odds import log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import Prepared
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains

ENDLESS = 1e6
"""Lag of a process that integrates."""


def noise(n: int, size: float, seed: int) -> FloatArray:
    return size * np.random.default_rng(seed).standard_normal(n)


def test_a_valve_is_seen_behind_a_dead_time_between_those_of_the_grid() -> None:
    """A slip that comes three samples off explains nothing: of all that were tried none had odds (e^-1.5)."""
    n = 450
    load, sp = 0.03 * np.cumsum(noise(n, 1.0, 11)), np.where(np.arange(n) > 56, 1.0, 0.0)
    seen = pi_loop(PidGains(0.197, 0.0232), Lag(8.5, 20), sp, noise(n, 1e-2, 1), load, valve=slipping(0.4))
    assert log_odds_of_valve([Prepared.at(seen, 1.0)], 1) > 5.0


def test_a_band_is_found_as_closely_as_many_slips_tell_it() -> None:
    """Of bands two hundredths apart each leaves this one's slips half way; it was e^18."""
    n, first, second = 678, Lag(32.0, 4, 0.4), Lag(4.2)
    load = 0.125 * np.cumsum(noise(n, 1.0, 3))
    seen = pi_loop(
        PidGains(7.0, 0.2), lambda u, push: second(first(u, push), 0.0), np.zeros(n), noise(n, 1e-4, 8), load,
        valve=slipping(1.6),
    )  # fmt: skip
    assert log_odds_of_valve([Prepared.at(seen, 1.0)], 1) > 30.0


def test_one_step_of_a_load_is_no_valve_that_slips_once() -> None:
    """It was by e^3.5: what free jumps of a load explain counted less than what a valve's does."""
    n = 572
    load = 0.07 * np.cumsum(noise(n, 1.0, 1)) - 3.7 * (np.arange(n) > 190)
    seen = pi_loop(PidGains(1.89, 0.0101), Lag(ENDLESS, 7, 0.0135 * ENDLESS), np.zeros(n), noise(n, 1e-4, 1), load)
    assert log_odds_of_valve([Prepared.at(seen, 1.0)], 1) < -1.0
