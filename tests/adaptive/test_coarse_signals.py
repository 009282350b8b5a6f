"""What coarse signals look like: a pv in the steps of its sensor, a co that stands still in automatic."""

import math

import numpy as np
import pytest
from loop_bench import Bench, scaled, table

from retuner.adaptive.indexes.condition import Condition, record_condition
from retuner.adaptive.signals.noise import quantum_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore

STEP = 0.1


def coarse() -> Bench:
    return Bench(Retuner(table(scaled(0.4, 0.4)), RetunerSettings(1.0, 10.0, Mode.AUTO)), noise=0.001, step=STEP)


def rise(n: int) -> FloatArray:
    return 1 - np.exp(-np.arange(n) / 8.0)


def test_a_short_response_shows_the_steps_of_its_sensor_though_few_values_come_twice() -> None:
    pv = np.round(rise(30) / 0.03) * 0.03
    assert len(np.unique(pv)) > len(pv) / 2
    assert quantum_sigma(pv) == pytest.approx(0.03 / math.sqrt(12))


@pytest.mark.parametrize("pv", [rise(30), np.arange(30.0), np.random.default_rng(0).standard_normal(30)])
def test_what_is_not_rounded_has_no_steps(pv: FloatArray) -> None:
    assert quantum_sigma(pv) == 0.0


def test_a_sensor_between_two_of_its_steps_is_at_rest_and_its_steps_survive_a_restart() -> None:
    bench = coarse()
    bench.run(1500, sp=1.04)
    assert bench.run(3000, sp=1.04) == []
    finder = bench.retuner.state().finder
    assert finder.rounding == pytest.approx(STEP / math.sqrt(12))
    again = restore(remember(bench.retuner), bench.retuner.settings)
    assert again.state().finder == finder


def test_a_coarse_sensor_is_learned_from_and_its_single_steps_are_no_responses() -> None:
    bench = coarse()
    assert [told.code for told in bench.exercise(2)] == ["accepted"]
    assert bench.retuner.region_models[0].identifiable
    assert bench.retuner.table.gains_of(0).kp > 1.5 * scaled(0.4, 0.4).kp


def test_a_co_that_stands_still_is_manual_only_where_nobody_says_that_it_is_automatic() -> None:
    t = np.arange(400.0)
    co = np.where(t < 300, 50.0, 50.0 + np.minimum((t - 300) / 10, 4))
    pv = np.where(t < 250, 0.0, 1.0) * np.sin(t / 30) + 0.01 * np.random.default_rng(1).standard_normal(400)
    window = Window(t, np.zeros(400), pv, co)
    assert record_condition(window).condition is Condition.MANUAL
    assert record_condition(window, in_auto=True).condition is not Condition.MANUAL
