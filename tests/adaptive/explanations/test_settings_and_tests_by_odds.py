"""Settings by what they are worth over the odds, the overshoot as evidence, valves, and the tests that would decide."""

import math

import numpy as np
import pytest
from drawn_loop import PRIOR, loop_record
from pi_loop import Lag, pi_loop, slipping

from retuner import LinearProcess, PidGains
from retuner.adaptive.explanations.deciding_test import deciding_test, valve_test
from retuner.adaptive.explanations.likely_processes import WorthSettings, harmless
from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    FREQUENCIES,
    GAINS,
    control_law,
    gain_unit,
    iae_over_ie,
    shapes,
    units,
)
from retuner.adaptive.explanations.proposed_test import DecidingTest, TestKind
from retuner.adaptive.explanations.settings_by_odds import likely_processes, worthwhile
from retuner.adaptive.explanations.tone import likeliest_tone
from retuner.adaptive.explanations.tuning_odds import TuningLimits, TuningOdds, tuning_odds
from retuner.adaptive.explanations.valve_odds import log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import Prepared, log_likelihood
from retuner.adaptive.loop.margins import sensitivity_peak

TRUTH = LinearProcess(1.0, (20.0,), (), 4.5)


def any_change(_: PidGains) -> bool:
    return True


def odds_of(kc: float, *, seed: int = 5, step: float = 4.0) -> tuple[TuningOdds, Prepared]:
    gains = PidGains(kc, kc / 20.0)
    _, pv, co = loop_record((1.0, 4, 20.0), gains, seed=seed, step=step)
    record = Prepared(pv - pv[0], co - co[0], 0.0, 1.0)
    return tuning_odds(log_likelihood(record, 1, gain_unit(gains, 1.0)), gains, 1.0, PRIOR, TuningLimits()), record


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("kc", [0.3, 4.2])
def test_settings_are_robust_on_nearly_all_odds_and_on_the_truth(kc: float, seed: int) -> None:
    odds, _ = odds_of(kc, seed=seed)
    settings = WorthSettings()
    found = worthwhile(odds, settings, any_change)
    assert found is not None
    gains = found.tuning.gains
    likely = likely_processes(odds, settings.processes)
    peaks = likely.peaks(gains)
    assert harmless(likely.weights, likely.peaks(odds.gains), peaks, settings)
    assert sensitivity_peak(TRUTH, gains) < 2.1
    assert (gains.kp > kc) is (kc < 1.0)
    assert gains.kp <= settings.most_at_once * kc * (1 + 1e-9)
    assert gains.ki <= gains.kp / 20.0 * (1 + 1e-9), "an integral time shorter than the one in force"
    assert found.sure <= found.likely


def test_a_level_loop_gets_simcs_integral_time_at_the_gain_that_a_record_carries() -> None:
    """k' Kc tau_I is 0.03, and ten times the gain would be SIMC's: with its tau_I at three times it was 1.2, not 4."""
    slope, gains = 0.001, PidGains(1.0, 1.0 / 30.0)
    unit, shape = gain_unit(gains, 1.0), next(i for i, one in enumerate(shapes()) if one.integrates and not one.second)
    certain = np.full((len(shapes()), len(DEAD_TIMES), len(GAINS)), -1e3)
    certain[shape, DEAD_TIMES.index(5.0), int(np.argmin(np.abs(GAINS * units()[shape] / unit - slope)))] = 0.0
    odds = tuning_odds(certain, gains, 1.0, PRIOR, TuningLimits())
    settings = WorthSettings()
    found = worthwhile(odds, settings, any_change)
    assert found is not None
    new = found.tuning.gains
    assert new.kp == pytest.approx(settings.most_at_once * gains.kp)
    assert abs(found.models[0].k) * new.kp**2 / new.ki == pytest.approx(4.0, rel=0.05)


def test_a_level_loop_gets_the_integral_time_of_the_middle_of_the_odds_and_not_the_shortest() -> None:
    slope, gains = 0.001, PidGains(1.0, 1.0 / 30.0)
    shape = next(i for i, one in enumerate(shapes()) if one.integrates and not one.second)
    slopes = (GAINS * units()[shape] / gain_unit(gains, 1.0)).ravel()
    at = int(np.argmin(np.abs(slopes - slope)))
    even = np.full((len(shapes()), len(DEAD_TIMES), len(GAINS)), -1e3)
    even[shape, DEAD_TIMES.index(5.0), [at - 2, at, at + 2]] = 0.0
    found = worthwhile(tuning_odds(even, gains, 1.0, PRIOR, TuningLimits()), WorthSettings(), any_change)
    assert found is not None
    new = found.tuning.gains
    assert slopes[at] * new.kp**2 / new.ki == pytest.approx(4.0, rel=0.05)
    assert slopes[at + 2] > 1.2 * slopes[at]


@pytest.mark.parametrize("damping", [0.3, 0.4, 0.5, 0.7, 1.5])
def test_iae_after_a_load_step_is_that_of_a_second_order_loop(damping: float) -> None:
    """An integrator under PI control: an impulse response of second order, IAE ki = coth(pi z / 2 sqrt(1 - z^2))."""
    w0 = 0.02
    gains = PidGains(2.0 * damping * w0, w0**2)
    found = iae_over_ie(1.0 / (1j * FREQUENCIES)[None], control_law(gains, 1.0))
    turn = math.pi * damping / (2.0 * math.sqrt(1.0 - damping**2)) if damping < 1.0 else math.inf
    assert found == pytest.approx(-math.log(math.tanh(turn)), abs=0.02)


def test_a_loop_in_order_needs_no_other_settings() -> None:
    odds, _ = odds_of(2.2)
    assert worthwhile(odds, WorthSettings(), any_change) is None


def test_a_loop_far_too_tight_is_calmed_where_no_set_is_sure() -> None:
    odds, _ = odds_of(5.0)
    found = worthwhile(odds, WorthSettings(), lambda new: new.kp < 5.0)
    assert found is not None
    share = found.tuning.gains.kp / 5.0
    assert 0.15 <= share <= 0.6
    assert sensitivity_peak(TRUTH, found.tuning.gains) < 2.1


def record_through_valve(band: float, step: float, seed: int = 2, n: int = 700, tone: float = 0.0) -> Prepared:
    """A setpoint step out and back under a load that wanders, through a valve that stays until co is a band away."""
    rng, i = np.random.default_rng(seed), np.arange(n)
    turned = np.cumsum(0.1 + 0.015 * np.sin(i / 90.0))
    load = np.cumsum(rng.standard_normal(n)) * 0.05 + tone * (np.sin(turned) + 0.4 * np.sin(2.0 * turned + 1.0))
    sp, noise = np.where((i >= 200) & (i < 450), step, 0.0), 0.02 * rng.standard_normal(n)
    found = pi_loop(PidGains(1.5, 0.075), Lag(10.0), sp, noise, np.append(0.0, load[:-1]), valve=slipping(band))
    return Prepared(found.pv - found.pv[0], found.co - found.co[0], 0.0, 1.0)


@pytest.mark.parametrize(("band", "step"), [(0.0, 0.0), (1.5, 0.0), (0.0, 3.0), (1.3, 3.0)])
def test_a_valve_that_sticks_is_seen_under_a_load_and_a_free_one_is_not(band: float, step: float) -> None:
    found = log_odds_of_valve([record_through_valve(band, step)], 1)
    assert (found > (10.0 if step else 1.0)) if band else (found < 0.0)


@pytest.mark.parametrize(("band", "step", "size"), [(0.0, 0.0, 1.0), (0.0, 0.0, 3.0), (1.0, 4.0, 3.0), (1.5, 0.0, 3.0)])
def test_a_tone_speaks_against_a_free_valve_and_does_not_hide_one_that_sticks(band, step, size):
    record = record_through_valve(band, step, tone=size)
    alone, beside = log_odds_of_valve([record], 1), log_odds_of_valve([record], 1, likeliest_tone(-record.pv))
    assert (alone > 10.0 and beside > 10.0) if band else (beside < -5.0)


def test_records_of_one_valve_say_more_together_than_those_of_two() -> None:
    """Its band is the same in all of them, in units of co, whatever co's range is in each."""
    first, same, other = (record_through_valve(*one) for one in ((0.9, 0.0, 3), (0.9, 8.0, 4), (0.35, 8.0, 4)))
    alone = [log_odds_of_valve([one], 1) for one in (first, same, other)]
    together, apart = log_odds_of_valve([first, same], 1), log_odds_of_valve([first, other], 1)
    assert together > alone[0] + alone[1] + 1.0
    assert apart < alone[0] + alone[2]


def test_a_setpoint_step_far_over_the_noise_makes_no_valve_of_a_dead_time_between_the_grid() -> None:
    """At a quarter of a sample from the grid, an eighth of a valve's band had a factor of e^3.7 and 97 %."""
    n, gains, rng = 540, PidGains(5.8, 0.24), np.random.default_rng(1)
    level, pv, co = np.zeros(4 * n + 16), np.zeros(n), np.zeros(n)
    y = total = 0.0
    for i in range(n):
        pv[i] = y + 0.002 * rng.standard_normal()
        error = (1.2 if 40 <= i < 290 else 0.0) - pv[i]
        total += gains.ki * error
        co[i] = gains.kp * error + total
        for part in range(4):
            level[4 * i + part + 9] = co[i]  # nine quarters of a sample late
            y += 0.031 / 4 * level[4 * i + part]
    assert log_odds_of_valve([Prepared(pv - pv[0], co - co[0], 0.0, 10.0)], 1) < -5.0


@pytest.mark.parametrize("seed", range(3))
def test_a_record_that_shows_no_process_speaks_neither_for_nor_against_a_valve(seed: int) -> None:
    """Only the likeliest few of 260 valves were counted: ln B was -1.1 to -4 where each is as likely as none."""
    rng, n = np.random.default_rng(seed), 400
    pv, co = (np.cumsum(rng.standard_normal(n)) for _ in range(2))
    assert abs(log_odds_of_valve([Prepared(pv - pv[0], co - co[0], 0.0, 1.0)], 1)) < 0.5


def test_a_valve_that_never_moves_is_no_valve() -> None:
    record = Prepared(np.random.default_rng(1).standard_normal(100), np.zeros(100), 0.0, 1.0)
    assert log_odds_of_valve([record], 1) == 0.0


def test_the_deciding_test_grows_with_the_load_and_has_the_units_of_pv() -> None:
    odds, record = odds_of(1.0, step=0.0)
    error_std = float(np.std(record.pv))
    found = deciding_test(odds, record, error_std)
    assert found is not None
    assert found.kind is TestKind.SETPOINT
    assert 0.25 <= found.decides <= 1.0
    assert found.hold_s >= 30.0
    scaled = Prepared(1000.0 * record.pv, record.co, 0.0, 1.0)
    likelihood = log_likelihood(scaled, 1, gain_unit(odds.gains, 1.0) / 1000.0)
    same = tuning_odds(likelihood, PidGains(odds.gains.kp / 1000, odds.gains.ki / 1000), 1.0, PRIOR, TuningLimits())
    other = deciding_test(same, scaled, 1000.0 * error_std)
    assert other is not None
    assert other.size == pytest.approx(1000.0 * found.size, rel=0.02)
    assert other.decides == pytest.approx(found.decides, abs=0.02)


def test_no_test_is_proposed_that_hardly_decides_anything() -> None:
    odds, record = odds_of(1.0, step=0.0)
    assert deciding_test(odds, record, 1e-3 * float(np.std(record.pv))) is None
    assert valve_test(odds, record, 1e-3 * float(np.std(record.co))) is None


def test_no_test_is_larger_than_co_has_room_for() -> None:
    """A valve at 51 % was to be opened by twice 110 %, and a fan's pressure to be doubled."""
    odds, record = odds_of(1.0, step=0.0)
    error_std, co_std = float(np.std(record.pv)), float(np.std(record.co))
    free, open_valve = deciding_test(odds, record, error_std), valve_test(odds, record, co_std)
    assert free is not None
    assert open_valve is not None
    tight, half_open = deciding_test(odds, record, error_std, 0.6 * free.size), valve_test(odds, record, co_std, 2.5)
    assert tight is None or tight.size * odds.gains.kp <= 0.6 * free.size < free.size
    assert half_open is None or half_open.size <= 1.25
    assert deciding_test(odds, record, error_std, 0.1 * error_std) is None


def test_the_valve_test_is_in_units_of_co() -> None:
    odds, record = odds_of(1.0, step=0.0)
    found = valve_test(odds, record, float(np.std(record.co)))
    assert found is not None
    assert found.kind is TestKind.VALVE
    assert 0.5 * np.std(record.co) < found.size < 10 * np.std(record.co)
    assert 0.0 < found.decides <= 1.0
    assert found.to_dict() == {"kind": "valve", "size": found.size, "hold_s": found.hold_s, "decides": found.decides}
    assert DecidingTest(TestKind.SETPOINT, 1.0, 2.0, 0.5).to_dict()["kind"] == "setpoint"
