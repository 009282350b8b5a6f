"""A whole record knows no less than its parts: a long trend of a plain tank, and a valve that is no process."""

from pathlib import Path

import numpy as np
import pytest

from retuner import PidGains, ProcessModel, identify, simulate
from retuner.adaptive.identification import identify as identify_module
from retuner.adaptive.identification.identify import FitSettings, identify_window
from retuner.adaptive.identification.in_parts import MOST_FITTED, MOST_PARTS, identify_parts, moved_most, parts_of
from retuner.adaptive.signals.sample import Window

GAINS = PidGains(2.0, 2.0 / 160.0)
FLOW = Path(__file__).parents[1] / "data" / "plant" / "FIC10201_1110_2.csv"


def tank(theta_s: float, gap_s: float, noise: float = 0.02) -> Window:
    """Gain 1.2, lag 40 s: four setpoint steps and three loads in turn, a row a second."""
    setpoint = [(0.0, 50.0), (gap_s, 55.0), (3 * gap_s, 50.0), (5 * gap_s, 58.0), (7 * gap_s, 50.0)]
    loads = [(0.0, 0.0), (2 * gap_s, 4.0), (4 * gap_s, -3.0), (6 * gap_s, 3.0)]
    model = ProcessModel("fopdt", k=1.2, tau1_s=40.0, theta_s=theta_s)
    return simulate(model, GAINS, setpoint=setpoint, loads=loads, until_s=8 * gap_s, noise=noise).window


@pytest.mark.slow
@pytest.mark.parametrize(("theta_s", "gap_s"), [(0.0, 250.0), (2.0, 250.0), (2.0, 600.0), (4.0, 250.0), (4.0, 600.0)])
def test_a_long_trend_of_a_plain_tank_is_identified_as_its_first_part_is(theta_s: float, gap_s: float) -> None:
    record = tank(theta_s, gap_s)
    found = identify(record.t_s, record.sp, record.pv, record.co, gains=GAINS)
    assert found.identifiable
    assert found.model.k == pytest.approx(1.2, rel=0.02)
    assert found.model.tau1_s == pytest.approx(40.0, rel=0.03)
    assert found.model.theta_s == pytest.approx(max(theta_s, 1.0), abs=0.3)


def test_parts_hold_the_whole_record_and_are_long_enough() -> None:
    record = tank(2.0, 250.0)
    parts = parts_of(record, 1500)
    assert sum(len(part.t_s) for part in parts) == len(record.t_s)
    assert 2 <= len(parts) <= MOST_PARTS
    assert min(len(part.t_s) for part in parts) >= len(record.t_s) // MOST_PARTS


def test_of_a_long_record_those_parts_are_fitted_in_which_pv_moves_most() -> None:
    """200,000 rows were fitted in 137 parts, for a minute."""
    record = tank(2.0, 250.0)
    still = Window(record.t_s, record.sp, np.full(len(record.pv), 50.0), record.co)
    small = Window(record.t_s, record.sp, 50.0 + 0.1 * (record.pv - 50.0), record.co)
    assert moved_most([still, small, record]) == [small, record]
    assert moved_most([small] * 90 + [record] * MOST_FITTED + [small]) == [record] * MOST_FITTED


def test_parts_that_contradict_each_other_know_nothing_together() -> None:
    record = tank(2.0, 250.0)
    half = len(record.t_s) // 2
    pv = np.where(np.arange(len(record.t_s)) < half, record.pv, 50.0 + 4.0 * (record.pv - 50.0))
    changed = Window(record.t_s, record.sp, pv, record.co)
    assert identify_parts(changed, 1) is None


def test_a_record_is_not_condensed_until_its_dead_time_is_shorter_than_a_row() -> None:
    """10,000 rows every 2 s: 1,500 of them lie 14 s apart, and the dead time of 4 s was called too short."""
    model = ProcessModel("fopdt", k=1.2, tau1_s=60.0, theta_s=4.0)
    setpoint = [(2000.0 * i, 50.0 + 6.0 * (i % 2)) for i in range(10)]
    record = simulate(model, GAINS, setpoint=setpoint, until_s=20_000.0, dt_s=2.0, noise=0.05).window
    assert len(record.t_s) == 10_000
    found = identify_window(record)
    assert found.identifiable
    assert found.log.model().theta_s == pytest.approx(4.0, abs=1.0)
    short = identify_window(record, settings=FitSettings(most_samples=1500))
    assert short.log.model() == found.log.model()


def test_a_record_of_too_many_rows_is_told_its_own_interval_and_not_that_of_the_fit(monkeypatch):
    model = ProcessModel("fopdt", k=1.2, tau1_s=60.0, theta_s=4.0)
    record = simulate(model, GAINS, setpoint=[(0.0, 50.0), (100.0, 56.0)], until_s=6_000.0, dt_s=2.0, noise=0.05).window
    monkeypatch.setattr(identify_module, "MOST_ROWS", 300)
    found = identify_window(record, settings=FitSettings(most_samples=300))
    assert not found.identifiable
    assert "condensed to rows of 20 s (logged every 2 s): identify a shorter part" in found.reason


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_three_sharp_loads_are_told_as_their_first_one_is(seed: int) -> None:
    rng, n = np.random.default_rng(seed), 480
    pv, co, past, x, integral = np.empty(n), np.empty(n), [0.0] * 4, 0.0, 0.0
    load = sum(np.where(np.arange(n) >= at, size, 0.0) for at, size in ((40, 1.2), (190, -0.8), (330, 1.0)))
    for i in range(n):  # 1.7 e^-3s / (13 s + 1) under gains that are far too small
        pv[i] = x + 0.02 * rng.standard_normal()
        integral -= 0.21 / 58.0 * pv[i]
        co[i] = integral - 0.21 * pv[i]
        past.append(co[i])
        x += (1.7 * (past.pop(0) + load[i]) - x) / 13.0
    found = identify_window(Window(np.arange(n) * 1.0, np.full(n, 50.0), 50.0 + pv, 40.0 + co), 1)
    model = found.log.model()
    assert (model.k, model.tau1_s) == pytest.approx((1.7, 12.5), rel=0.1)
    assert found.residual_std < 1.1 * found.noise_std  # 2 to 12 times, with the whole searched at once


def test_a_worse_explanation_that_a_part_begins_is_no_rival() -> None:
    record = np.genfromtxt(FLOW, delimiter=",", names=True)
    found = identify(record["t"], record["sp"], record["pv"], record["co"])
    assert found.identifiable  # bounded by a sampling interval, though a third of it fits a dead time of 115 s as well
    assert found.estimate.bound_s == 10.0
