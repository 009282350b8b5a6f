"""Processes that vary: against exact held responses, their own linearisation, and the changes drawn for them."""

import numpy as np
import pytest
from cases.plant import HeldPlant
from online import changes
from online.judge import Judge
from online.loop import FixedGains, WatchedLoop
from online.varying import Changing, Local, Range, VaryingPlant

from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

RANGE = Range(Local(2.0, 5.0, 1.0, 1.0), (1, -1, 1))


def moved(plant, u, n):
    return np.array([plant.move(u) for _ in range(n)])


def test_constant_first_order_is_the_exact_held_response():
    local = Local(-3.0, 2.0, 0.0, 1.25)
    process = Changing(local)
    found = moved(VaryingPlant(process.at, process.rest, 0.25), 1.0, 100)
    assert found == pytest.approx(moved(HeldPlant(local.linear(), 0.25), 1.0, 100), abs=1e-12)


@pytest.mark.parametrize("local", [Local(1.0, 5.0, 2.0, 1.0), Local(0.5, 0.0, 1.0, 1.0, integrating=True)])
def test_second_lag_is_right_within_a_thousandth(local):
    process = Changing(local)
    found = moved(VaryingPlant(process.at, process.rest, 0.125), 1.0, 200)
    exact = moved(HeldPlant(local.linear(), 0.125), 1.0, 200)
    assert found == pytest.approx(exact, abs=1e-3 * np.max(np.abs(exact)))


def test_parameters_differ_by_the_factor_over_the_range():
    low, high = RANGE.at(0.0), RANGE.at(100.0)
    assert (high.k / low.k, low.tau1_s / high.tau1_s, high.theta_s / low.theta_s) == pytest.approx((4.0, 4.0, 4.0))
    assert RANGE.at(50.0) == RANGE.middle


@pytest.mark.parametrize("y", [5.0, 30.0, 50.0, 80.0, 99.0])
def test_rest_is_the_integral_of_one_over_the_gain(y):
    slope = (RANGE.rest(y + 1e-4) - RANGE.rest(y - 1e-4)) / 2e-4
    assert slope == pytest.approx(1 / RANGE.at(y).k, rel=1e-6)


@pytest.mark.parametrize("y", [10.0, 50.0, 90.0])
def test_small_steps_show_the_linearisation_there(y):
    plant = VaryingPlant(RANGE.at, RANGE.rest, 0.1, y)
    linear = HeldPlant(RANGE.at(y).linear(), 0.1)
    found, exact = moved(plant, 1e-4, 300), moved(linear, 1e-4, 300)
    assert found == pytest.approx(exact, abs=0.01 * abs(exact[-1]))


def test_a_process_that_becomes_another_moves_as_the_other():
    before, after = Local(1.0, 4.0, 0.0, 1.0), Local(2.0, 4.0, 0.0, 1.0)
    process = Changing(before)
    plant = VaryingPlant(process.at, process.rest, 0.25)
    moved(plant, 1.0, 400)
    process.now = after
    assert moved(plant, 1.0, 400)[-1] == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("kind", ["gain", "delay", "drift"])
def test_a_change_is_by_the_factor_in_one_parameter(kind):
    rng = np.random.default_rng(1)
    local = changes.draw_local(rng)
    target = changes.changed(local, kind, 2.0, rng)
    assert changes.between(local, target, 0.0) == local
    ends = changes.between(local, target, 1.0)
    ratios = [ends.k / local.k, ends.theta_s / local.theta_s, (ends.tau1_s or 1.0) / (local.tau1_s or 1.0)]
    assert sorted(ratios)[-1] == pytest.approx(2.0) or (ends.tau2_s / local.tau2_s == pytest.approx(2.0))
    assert sorted(ratios)[:2] == pytest.approx([1.0, 1.0])


def test_doubling_the_gain_takes_simc_out_of_spec_and_the_new_simc_is_in_it():
    local = Local(1.0, 10.0, 0.0, 1.0)
    before = Judge(local.linear(), 0.125)
    after = Judge(Local(2.0, 10.0, 0.0, 1.0).linear(), 0.125)
    assert not after.of(before.best).in_spec
    assert after.of(after.best).in_spec
    assert after.best.kp == pytest.approx(before.best.kp / 2)


@pytest.mark.slow
def test_a_loop_that_changes_is_run_and_judged_as_what_it_has_become():
    row = changes.run(changes.Task("gain", 3, 0))
    assert len(row["spec"]) == changes.AFTER
    assert row["records"] >= 3
    assert all(ms >= 1.0 for ms in row["ms"])


def test_a_loop_with_an_interpolated_table_runs_the_mean_where_it_is():
    regions = Regions("pv", "-", ("low", "high"), 0.0, (50.0,), 100.0)
    table = GainTable("loop", regions, (PidGains(1.0, 0.1), PidGains(3.0, 0.3)), Lookup.INTERPOLATED)
    loop = WatchedLoop(VaryingPlant(RANGE.at, RANGE.rest, 0.1, 40.0), table, 0.1, FixedGains(), sp0=40.0)
    trace = loop.run(75.0, 0.0, [0.0] * 3)
    (last, _) = trace[-1]
    assert loop.gains == table.at(0, last)
    loop.write(1, PidGains(5.0, 0.3), 75.0, last)
    ((now, _),) = loop.run(75.0, 0.0, [0.0])
    assert loop.gains == loop.table.at(0, now)
    assert loop.gains.kp > table.at(0, now).kp
