"""pv that stands while co travels: found in a real record and in simulated ones, and not where a loop is healthy."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pi_loop import Lag, pi_loop
from test_beside_a_load import recorded

from retuner import PidGains, api, diagnosing
from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.controller_settings.summed_law import rough_law, summed_law
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.sticking_valve import pv_stands, pv_stands_verdict
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.plateaus import _parts, as_steps, plateaus, responses, rough_sigma
from retuner.adaptive.valve.stand_still import Leg, StandStill, StandStillSettings, _agreed, _ends, stand_still

GAINS = PidGains(0.2, 0.2 / 5.0)
SETTINGS = StandStillSettings()


def _by_itself(name: str) -> StandStill | None:
    """A real record with the settings that are read off it."""
    window = Window(*recorded(name))
    gains = rough_law(window)
    assert gains is not None
    return stand_still(window, gains, SETTINGS)


def flow_loop(positions: list[float] | None, sp: np.ndarray, load: np.ndarray, seed: int = 1) -> Window:
    """A fast flow process of gain 2 under PI. positions : where a stuck valve comes to stand, when co is 8 away."""
    noise, at, stands = 0.02 * np.random.default_rng(seed).standard_normal(len(sp)), 0.0, list(positions or [])

    def valve(co: float) -> float:
        nonlocal at
        if positions is None or (stands and abs(co - at) > 8.0):
            at = co if positions is None else stands.pop(0)
        return at

    return pi_loop(GAINS, Lag(-1.0 / math.log(0.4), k=2.0), sp, noise, np.append(0.0, load[:-1]), valve=valve)


def test_pv_as_steps():
    rng = np.random.default_rng(2)
    pv = np.repeat([0.0, 3.0, 1.0], [100, 150, 80]) + 0.05 * rng.standard_normal(330)
    found = as_steps(pv)
    assert len(found.jumps) == 2
    assert np.abs(np.array(found.jumps) - [100, 250]).max() <= 1
    assert [round(p.level) for p in plateaus(pv, found)] == [0, 3, 1]
    assert rough_sigma(pv) == pytest.approx(0.05, rel=0.3)


def test_a_valve_that_stands_and_slips_is_named():
    sp = np.repeat([0.0, 6.0, -4.0], 200)
    found = stand_still(flow_loop([4.0, 2.4, -3.0, -1.4, 0.5], sp, np.zeros(600)), GAINS, SETTINGS)
    assert found.stands
    assert found.sticks
    assert found.idle > 1
    assert found.agreed >= 1


@pytest.mark.parametrize("seed", range(5))
def test_a_valve_that_follows_is_not(seed):
    rng = np.random.default_rng(seed)
    load = np.cumsum(rng.standard_normal(600)) * 0.05
    sp = np.repeat(rng.uniform(-5, 5, 6), 100)
    found = stand_still(flow_loop(None, sp, load, seed), GAINS, SETTINGS)
    assert not found.stands
    assert not found.dead


def test_pv_that_does_not_answer_at_all():
    sp = np.concatenate([np.zeros(100), np.full(400, 1.0)])
    found = stand_still(flow_loop([0.0] * 500, sp, np.zeros(500)), GAINS, SETTINGS)
    assert found.dead
    assert not found.stands


def test_nothing_is_asked_of_a_controller_without_integral_action():
    assert stand_still(flow_loop(None, np.zeros(100), np.zeros(100)), PidGains(0.2, 0.0), SETTINGS) is None


def test_a_real_sticking_valve():
    """One or two slips a record, another band at every stop; gains were changed in 4 of its 23 records."""
    record = recorded("FIC20102_1016_12.csv")
    found = diagnosing.diagnose(*record).diagnosis
    assert found.cause == Cause.STICTION
    assert not found.retune
    assert "pv does not move while co moves" in found.reason
    assert found.evidence["stand_travel"] > 1
    assert not api.identify(*record).estimate.identifiable


def test_a_real_healthy_flow_loop():
    found = _by_itself("FIC46002_1102_1.csv")
    assert not found.stands


def test_a_real_sticking_valve_whose_co_was_stored_in_pieces():
    """One and a half rounds: pv stands while co ramps, jumps, stands while co ramps back, jumps."""
    record = recorded("FIC31102_0628_1.csv")
    found = diagnosing.diagnose(*record).diagnosis
    assert found.cause == Cause.STICTION
    assert not found.retune
    assert settings_in_force(Window(*record)).gains is None


def cropped(name: str, share: slice) -> StandStill | None:
    """Some of the rows of a real record, with the settings that are read off them."""
    window = Window(*(x[share] for x in recorded(name)))
    gains = rough_law(window)
    assert gains is not None
    return stand_still(window, gains, SETTINGS)


def test_a_step_goes_where_co_has_gone_whatever_little_steps_lie_between():
    """Without its last slip little steps of a load showed, and took co's long way away from the one slip after them."""
    found = cropped("FIC31102_0628_1.csv", slice(None, 676))
    assert found.agreed == 1
    assert found.degree == 1.0


def test_a_step_that_follows_the_setpoint_at_once_says_nothing():
    """Of a record cropped to just before its setpoint step pv stood no more: co had not gone there before. Where co
    came from the other side, the valve has turned at once.
    """
    sp, co = (
        np.repeat([0.0, 4.0], [40, 260]),
        np.concatenate([np.zeros(40), np.linspace(0, 2, 60), np.linspace(2, 0, 200)]),
    )
    rows = Window(np.arange(300.0), sp, np.repeat([0.0, 4.0, 3.0], [42, 188, 70]), co)
    found = plateaus(rows.pv, as_steps(rows.pv))
    assert len(found) == 3
    agreed, share = _agreed(rows, found, 1, 5.0, SETTINGS)
    assert (len(agreed), share) == (1, 1.0)
    alone = replace(rows, sp=np.zeros(300))
    turned = replace(rows, co=np.concatenate([np.linspace(3, 0, 40), co[40:]]))
    assert max(_agreed(one, found, 1, 5.0, SETTINGS)[1] for one in (alone, turned)) < 0.1


@pytest.mark.parametrize(("free", "degree"), [(False, 1.0), (True, 0.0)])
def test_a_setpoint_step_that_pv_has_not_answered_is_as_good_as_a_slip(free: bool, degree: float) -> None:
    """Of a valve that stood for an hour, and under a step to the end, nothing was told: it had not slipped yet."""
    sp = np.repeat([0.0, 4.0], [240, 60])
    gains = PidGains(0.2, 0.04)
    found = stand_still(flow_loop(None if free else [], sp, np.full(300, 0.15)), gains, SETTINGS)
    assert found.degree == degree
    assert not found.ends_s


def test_a_setpoint_that_returns_at_the_next_sample_is_no_step() -> None:
    """Its size of zero had divided what pv did after it."""
    sp = np.repeat([0.0, 4.0], [240, 60])
    returned = sp.copy()
    returned[120] = 4.0
    loops = (flow_loop([], one, np.full(300, 0.15)) for one in (returned, sp))
    found, plain = (stand_still(loop, PidGains(0.2, 0.04), SETTINGS) for loop in loops)
    assert (found.degree, found.quick) == (plain.degree, plain.quick)


@pytest.mark.parametrize(("lag", "degree"), [(4.0, 1.0), (35.0, 0.1)])
def test_a_slow_swing_is_no_pv_that_stands(lag: float, degree: float) -> None:
    """Squares that take a third of a round to turn are a wave: a level that swung in 16 tau_I was a sticking valve."""
    rng, n = np.random.default_rng(4), 700
    target, pv = np.where(np.arange(n) // 100 % 2, -1.0, 1.0), np.ones(n)
    for i in range(1, n):
        pv[i] = pv[i - 1] + (target[i] - pv[i - 1]) / lag
    pv += 0.02 * rng.standard_normal(n)
    co = np.cumsum(-0.04 * pv)
    found = stand_still(Window(np.arange(float(n)), np.zeros(n), pv, co), PidGains(0.2, 0.04), SETTINGS)
    assert found.degree == pytest.approx(degree, abs=0.1)


def test_only_steps_that_end_a_stand_are_told_after_it():
    """At 5160 s pv goes a little the other way."""
    found = _by_itself("FIC31102_0628_1.csv")
    assert len(found.slips_s) == 3
    assert "then follows in steps (at 5480, 7350 s)" in pv_stands_verdict(found, {}).reason
    assert _ends([5.0, 30.0, 40.0], [Leg(10.0, 25.0, 0.5, 9.0), Leg(45.0, 60.0, 0.5, 9.0)]) == [30.0]
    assert "then" not in pv_stands_verdict(replace(found, ends_s=()), {}).reason


@given(kp=st.floats(0.1, 5.0), tau_i=st.floats(3.0, 60.0), sign=st.sampled_from([-1.0, 1.0]), seed=st.integers(0, 99))
def test_the_law_that_a_held_co_still_shows(kp: float, tau_i: float, sign: float, seed: int) -> None:
    t = np.arange(600.0)
    pv = np.cumsum(np.random.default_rng(seed).standard_normal(600))
    summed = np.concatenate([[0.0], np.cumsum(-(pv[1:] + pv[:-1]) / 2)])
    co = sign * (-kp * pv + kp / tau_i * summed)
    # The last value until the signal leaves it
    deviation = 0.05 * float(np.ptp(co))
    held = np.empty_like(co)
    last = co[0]
    for i, value in enumerate(co.tolist()):
        last = value if abs(value - last) > deviation else last
        held[i] = last
    law = summed_law(Window(t, np.zeros(600), pv, held))
    if law is not None:  # a record may be too little for it
        assert law.direction == sign
        assert law.ki == pytest.approx(sign * kp / tau_i, rel=0.4)


def test_a_co_that_no_law_moves_shows_none():
    rng = np.random.default_rng(3)
    pv, co = np.cumsum(rng.standard_normal((2, 600)), axis=1)
    assert summed_law(Window(np.arange(600.0), np.zeros(600), pv, co)) is None
    assert summed_law(Window(np.arange(600.0), np.zeros(600), pv, np.ones(600))) is None


@pytest.mark.parametrize("lag", [0.0, 0.4, 3.0, 100.0])
def test_a_response_begins_at_its_jump(lag: float) -> None:
    n = 60
    rise, _ = _parts(n, lag)
    columns = responses(rise, np.arange(n - 1))

    assert columns.shape == (n, n - 1)
    assert columns[:20, 20].max() == 0  # nothing before the jump
    np.testing.assert_allclose(columns[21:, 20], rise[: n - 21], atol=1e-12)


HALVES = {"half": slice(None, None, 2), "late": slice(30, None), "early": slice(None, 560)}


@pytest.mark.parametrize("part", HALVES.values(), ids=HALVES)
def test_how_far_a_valve_stands_is_alike_in_every_second_row_and_in_most_of_them(part: slice) -> None:
    sp = np.repeat([0.0, 6.0, -4.0], 200)
    window = flow_loop([4.0, 2.4, -3.0, -1.4, 0.5], sp, np.zeros(600))
    whole, some = (stand_still(one, GAINS, SETTINGS) for one in (window, window.part(part)))
    assert whole.degree == 1.0
    assert some.degree > 0.6


@pytest.mark.parametrize(("lead", "degree", "stands"), [(0.75, 1.0, True), (1.0, 0.5, True), (1.2, 0.1, False)])
def test_a_likelier_linear_explanation_takes_the_degree_away_by_and_by(monkeypatch, lead, degree, *, stands):
    """lead : of the linear explanation, in times the one that counts."""
    settings = DiagnosisSettings()
    monkeypatch.setattr(StandStill, "lead_of", lambda *_: lead * settings.standing.likelier)
    window = flow_loop([4.0, 2.4, -3.0, -1.4, 0.5], np.repeat([0.0, 6.0, -4.0], 200), np.zeros(600))
    misfit = SimpleNamespace(record=SimpleNamespace(pv=window.pv), loads=0)
    best: Any = SimpleNamespace(fit=SimpleNamespace(misfit=misfit, at=SimpleNamespace(explained=window.sp)))
    found = pv_stands(window, GAINS, best, settings)
    assert found.degree == pytest.approx(degree)
    assert found.stands is stands


def test_a_free_valve_stands_to_no_degree() -> None:
    rng = np.random.default_rng(3)
    load = np.cumsum(rng.standard_normal(600)) * 0.05
    found = stand_still(flow_loop(None, np.repeat(rng.uniform(-5, 5, 6), 100), load, 3), GAINS, SETTINGS)
    assert found is None or found.degree == 0.0


@pytest.mark.slow
def test_a_real_valve_is_told_from_every_second_row_as_from_all() -> None:
    """A bound on each of its numbers had made unknown of it: two of three slips agreed, and of every second row one."""
    window = Window(*recorded("FIC31102_0628_1.csv"))
    one, half = (diagnosing.diagnose_windows([w]).diagnosis for w in (window, window.part(slice(None, None, 2))))
    assert one.cause == half.cause == Cause.STICTION
    assert half.causes["stiction"] == pytest.approx(one.causes["stiction"], abs=0.1)
