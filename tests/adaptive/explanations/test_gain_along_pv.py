"""A gain that changes along pv: told by its likelihood, in any unit, and only where two ranges of pv are seen."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pi_loop import Lag, pi_loop

from retuner.adaptive.cause_odds.odds import diagnose_records
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.explanations.gain_along_pv import GainAlongPv, gain_along_pv
from retuner.adaptive.explanations.wandering_load import Prepared
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

STEPS = (20.0, 24.0, 20.0, 32.0, 48.0, 52.0, 48.0, 30.0)


def tank(ratio: float, steps: tuple[float, ...] = STEPS, hold: int = 60) -> Window:
    """PI on a lag of 10 s with 2 s dead time, its static gain 0.5 up to pv 40 and ratio times that above."""
    noise, first = 0.05 * np.random.default_rng(3).standard_normal(hold * len(steps)), steps[0]

    def curve(u: float) -> float:
        return 0.5 * u if u < 80.0 else 40.0 + 0.5 * ratio * (u - 80.0)

    co0 = 2.0 * first if first < 40.0 else 80.0 + (first - 40.0) / (0.5 * ratio)
    process = Lag(10.0, 2, at=first)
    return pi_loop(PidGains(1.0, 1.0 / 12.0), process, np.repeat(steps, hold), noise, co0=co0, valve=curve)


def weighed(*windows: Window) -> GainAlongPv:
    return gain_along_pv([Prepared.at(window, window.sample_time_s) for window in windows], 1, [1.0] * len(windows))


@pytest.mark.parametrize("ratio", [3.0, 1.0 / 3.0])
def test_a_gain_that_triples_or_falls_to_a_third_is_told_with_its_direction(ratio: float) -> None:
    found = weighed(tank(ratio))
    assert found.log_bayes > 1.0
    assert (found.ratio > 1.0) is (ratio > 1.0)
    assert found.low == pytest.approx(20.0, abs=1.0)


def test_a_linear_loop_is_not_told_so() -> None:
    assert weighed(tank(1.0)).log_bayes < -5.0


def test_odd_rows_of_one_setpoint_step_are_not_bent_into_place() -> None:
    linear = tank(1.0, (20.0, 24.0), 120)
    pv = linear.pv.copy()
    pv[123:126] += (1.5, -1.0, 1.5)
    assert weighed(replace(linear, pv=pv)).log_bayes < 0.0


def test_a_gain_that_loads_go_through_as_well_is_told() -> None:
    rng, y, total = np.random.default_rng(2), 0.0, 0.0
    load, sp = np.cumsum(rng.standard_normal(400)) * 0.05, np.repeat([0.0, 4.0, 8.0, 4.0], 100)
    pv, co = np.zeros(400), np.zeros(400)
    for i in range(400):
        pv[i] = y
        total += 0.02 * (sp[i] - y)
        co[i] = sp[i] - y + total
        y += 0.1 * math.exp(0.15 * (y - 4.0)) * (co[i] + load[i])
    found = weighed(Window(np.arange(400.0), sp, pv, co))
    assert found.log_bayes > 5.0
    assert found.ratio > 1.0


def test_two_records_of_either_range_tell_what_neither_does() -> None:
    low, high = tank(3.0, (20.0, 24.0, 20.0, 26.0)), tank(3.0, (48.0, 52.0, 48.0, 54.0))
    assert weighed(low).log_bayes < 0.0
    assert weighed(high).log_bayes < 0.0
    assert weighed(low, high).log_bayes > 5.0


@pytest.mark.parametrize("scale", [1e-3, 1.8, -1.0])
def test_units_mean_nothing(scale: float) -> None:
    window = tank(3.0)
    other = replace(window, pv=scale * window.pv + 32.0, co=scale * 0.16 * window.co + 4.0)
    assert weighed(other).log_bayes == pytest.approx(weighed(window).log_bayes, abs=1e-6)


def test_the_odds_name_it_and_say_what_to_do() -> None:
    told = diagnose_records([tank(3.0)], PidGains(1.0, 1.0 / 12.0)).found.diagnosis
    assert told.cause == Cause.NONLINEAR
    assert not told.retune
    assert told.evidence["gain_ratio"] > 2.0
    assert "retuner schedule" in told.reason
