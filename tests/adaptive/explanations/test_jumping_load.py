"""Where a load jumps or turns a corner, its jumps are no process's doing, and no valve's."""

import math

import numpy as np
import pytest
from pi_loop import Lag, pi_loop, slipping

from retuner.adaptive.explanations.jumping_load import LOADS as THAT_JUMP
from retuner.adaptive.explanations.jumping_load import UNIQUE, whitened, with_jumps
from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, LAGS, shapes
from retuner.adaptive.explanations.valve_odds import log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import TEMPER, Prepared, log_likelihood
from retuner.adaptive.fit import engine
from retuner.adaptive.valve.plateaus import LAGS as OF_PLATEAUS
from retuner.adaptive.valve.plateaus import steps_chosen, through_lag
from retuner.schedule.gains import PidGains

N, GAIN = 400, 1.2
LOADS = {
    "jumps": np.repeat([0.0, 3.0, -2.0, 1.0, 4.0], N // 5),
    "turns corners": np.interp(np.arange(N), [0, 90, 170, 300, N], [0.0, 4.0, -2.0, 3.0, 0.0]),
    "pulses": 4.0 * np.isin(np.arange(N) // 40, (2, 6)),
    "wanders": 0.05 * np.cumsum(np.random.default_rng(1).standard_normal(N)),
}


def record(
    load: str, kp: float = 0.6, ki: float = 0.05, lag: float = 15.0, noise: float = 0.03, slips: float = 0.0
) -> Prepared:
    """PI on a lag behind a valve that slips all the way once co is so far from it, under a load at its input."""
    white, valve = noise * np.random.default_rng(1).standard_normal(N), slipping(slips)
    found = pi_loop(PidGains(kp, ki), Lag(lag, k=GAIN), np.zeros(N), white, LOADS[load], valve=valve)
    return Prepared(found.pv - found.pv[0], found.co - found.co[0], 0.0, 1.0)


def compared(of: Prepared) -> tuple[np.ndarray, np.ndarray]:
    walk = log_likelihood(of, 1, 0.6)
    return walk, with_jumps(of, walk, 1, 0.6)


@pytest.mark.parametrize(("load", "lead"), [("jumps", 15.0), ("turns corners", 3.0)])
def test_jumps_of_a_load_make_its_process_likelier(load: str, lead: float) -> None:
    walk, jumping = compared(record(load, noise=0.01))
    assert jumping.max() > walk.max() + lead
    near, (row, _, gain) = LAGS.index(15.0), np.unravel_index(int(np.argmax(jumping)), jumping.shape)
    if load == "jumps":
        assert shapes()[row].lag in LAGS[near - 1 : near + 2]
        assert 0.5 < GAINS[gain] / (GAIN * 0.6) < 2.0


def test_a_load_that_only_wanders_needs_no_jumps() -> None:
    walk, jumping = compared(record("wanders"))
    assert np.all(jumping >= walk - math.log(2.0) - 1e-9)
    assert jumping.max() < walk.max() + 6.0 / TEMPER


def test_a_dead_time_longer_than_the_record_is_a_hypothesis_as_any_other() -> None:
    rows = 60
    pv = np.cumsum(np.random.default_rng(12201).normal(size=rows + 5))
    of = Prepared(pv[:rows] - pv[0], pv[5] - pv[5:], 0.0, 1.0)  # co knows pv before it comes: no dead time explains it
    walk, jumping = compared(of)
    likeliest = np.unravel_index(np.argmax(walk.reshape(len(walk), -1), axis=1), walk.shape[1:])[0]
    assert np.any(np.array(DEAD_TIMES)[likeliest] >= rows)
    assert np.all(np.isfinite(jumping))
    assert np.all(jumping >= walk - math.log(2.0) - 1e-9)


def test_both_engines_say_the_same() -> None:
    of = record("jumps")
    _, one = compared(of)
    with engine.using("numpy"):
        _, other = compared(of)
    assert other == pytest.approx(one, abs=1e-5)


def test_jumps_of_a_load_are_no_valve_and_one_that_slips_is_seen_under_them() -> None:
    """Where a load only wanders the first three were valves by e^8, e^4 and e^2, and the last one by e^9."""
    free = (
        record("jumps", 0.3, 0.01, 60.0, 0.01),
        record("pulses", 0.1, 0.004, noise=0.01),
        record("pulses", noise=0.01),
    )
    assert all(log_odds_of_valve([one], 1) < 0.0 for one in free)
    assert log_odds_of_valve([record("pulses", noise=0.01, slips=2.0)], 1) > 15.0


@pytest.mark.parametrize("load", THAT_JUMP)
@pytest.mark.parametrize("second", [0.0, 6.0])
def test_shocks_are_found_by_recursion_as_by_products_with_each(load: tuple[float, int], second: float) -> None:
    of = record("jumps")
    y, basis, response, form = whitened(of, 15.0, load, of.co, second)
    with engine.using("numpy"):
        by_transforms = whitened(of, 15.0, load, of.co, second)
    np.testing.assert_allclose(y, by_transforms[0], atol=1e-9 * np.max(np.abs(y)))
    np.testing.assert_allclose(response, by_transforms[2], atol=1e-8)
    np.testing.assert_allclose(basis @ (basis.T @ y), by_transforms[1] @ (by_transforms[1].T @ y), atol=1e-8)
    rows, left = steps_chosen(y, response, basis, UNIQUE, 8, form)
    one_by_one = steps_chosen(y, response, basis, UNIQUE, 8)
    assert rows == one_by_one[0]
    np.testing.assert_allclose(left, one_by_one[1], rtol=1e-9)


@pytest.mark.parametrize("lag", OF_PLATEAUS)
def test_steps_through_a_lag_are_found_by_recursion_as_by_products_with_each(lag: float) -> None:
    pv, (lacks, stays) = record("pulses").pv, (1.0, math.exp(-1.0 / lag)) if lag else (0.0, 0.0)
    rise, basis = 1.0 - lacks * stays ** np.arange(N), np.full((N, 1), N**-0.5)
    rows, left = steps_chosen(pv, rise, basis, UNIQUE, 8, through_lag(lacks, stays))
    one_by_one = steps_chosen(pv, rise, basis, UNIQUE, 8)
    assert rows == one_by_one[0]
    np.testing.assert_allclose(left, one_by_one[1], rtol=1e-9)
