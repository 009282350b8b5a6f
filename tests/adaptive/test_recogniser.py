"""The recogniser: peaks of known responses, streaming equals any split, every (state, event) pair, scaling."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from retuner.adaptive.signals.recogniser import (
    TABLE,
    Event,
    RecogniserLaw,
    RecogniserPhase,
    RecogniserState,
    begin,
    response_of,
    step,
    taken_over,
)
from retuner.adaptive.signals.response import Ending, Response

LAW = RecogniserLaw(wait_s=60.0, quiet_s=8.0)


def run(pv: list[float], sp: list[float], dt: float, band: float, law: RecogniserLaw = LAW) -> list[Response]:
    state = begin(0.0, sp[0])
    found = []
    for i in range(1, len(pv)):
        state = step(law, state, i * dt, sp[i], sp[i] - pv[i], band)
        response = response_of(state, band)
        if response:
            found.append(response)
    return found


def decay(t: float, zeta: float, w: float) -> float:
    """Error of a second-order step response with two equal dead-beat axes: exp(-zeta w t) cos(wd t)."""
    return math.exp(-zeta * w * t) * math.cos(w * math.sqrt(1 - zeta**2) * t) if t >= 0 else 0.0


@pytest.mark.parametrize("zeta", [0.1, 0.2, 0.3])
def test_peaks_overshoot_damping_and_period_of_a_known_decay(zeta: float) -> None:
    dt, w = 0.1, 0.5
    t = [i * dt for i in range(2000)]
    sp = [10.0 if x >= 20 else 0.0 for x in t]
    pv = [10.0 * (1 - decay(x - 20, zeta, w)) if x >= 20 else 0.0 for x in t]
    response, *_ = run(pv, sp, dt, band=0.1)
    # peaks of exp(-a t) cos(b t) lie at tan(b t) = -a/b; successive ones fall by exp(-a pi / b)
    a, b = zeta * w, w * math.sqrt(1 - zeta**2)
    ratio = math.exp(-a * math.pi / b)
    t2, t3 = (math.pi - math.atan(a / b)) / b, (2 * math.pi - math.atan(a / b)) / b
    e2 = -10 * math.exp(-a * t2) * math.cos(math.atan(a / b))
    assert response.ending == Ending.COMPLETE
    assert response.sp_changed
    assert [p.t_s for p in response.peaks] == pytest.approx([20.0, 20 + t2, 20 + t3], abs=dt)
    assert response.peaks[1].e == pytest.approx(e2, rel=1e-3)
    assert response.overshoot == pytest.approx(-e2 / 10, rel=1e-3)
    assert response.damping == pytest.approx((-e2 * ratio - e2) / (10 - e2), rel=1e-3)
    assert response.period_s == pytest.approx(t3, abs=2 * dt)


def test_a_setpoint_response_whose_second_extreme_grows_is_not_waited_for() -> None:
    """A swing that grows sixfold a half cycle is handed out two half cycles after its step, not three."""
    t = [0.1 * i for i in range(1200)]
    sp = [1.0 if x >= 20 else 0.0 for x in t]
    error = [math.exp(0.3 * (x - 20)) * math.cos(0.5 * (x - 20)) if x >= 20 else 0.0 for x in t]
    response, *_ = run([a - e for a, e in zip(sp, error, strict=True)], sp, 0.1, band=0.02)
    assert response.ending == Ending.GROWN
    assert len(response.peaks) == 2
    assert response.overshoot is not None
    assert response.overshoot == pytest.approx(math.exp(0.6 * math.pi), rel=0.01)
    assert response.t_end_s < 20 + 3 * math.pi  # before the third half cycle


def test_what_other_gains_take_over_in_motion_is_their_response() -> None:
    """The error stands at 3 when the gains change, and creeps back: one response, of the setpoint step before."""
    state, law = _in_mid_response(), RecogniserLaw(wait_s=600.0, quiet_s=8.0)
    state = taken_over(state, 30.0, 5.0, shortest_s=20.0)
    found = []
    for i in range(1, 2000):
        state = step(law, state, 30.0 + 0.1 * i, 5.0, 3.0 * math.exp(-0.02 * i * 0.1), 0.05)
        found += [response_of(state, 0.05)] if response_of(state, 0.05) else []
    (response,) = found
    assert response.taken_over
    assert response.sp_changed
    assert response.t_start_s == pytest.approx(30.1)
    assert response.t_end_s == pytest.approx(60.0, abs=0.2)  # three times the ten seconds since the step
    assert response.ending == Ending.TIMEOUT


def test_gains_taken_over_at_rest_begin_no_response() -> None:
    state = taken_over(_in_mid_response(), 30.0, 5.0, shortest_s=20.0)
    for i in range(1, 2000):
        state = step(LAW, state, 30.0 + 0.1 * i, 5.0, 0.0, 0.05)
        assert response_of(state, 0.05) is None
    assert state == begin(state.t_start_s, 5.0)._replace(phase=RecogniserPhase.LOCATE_1)


def _in_mid_response() -> RecogniserState:
    """At 30 s, ten seconds after a setpoint step of 5."""
    state = begin(0.0, 0.0)._replace(phase=RecogniserPhase.LOCATE_1)
    for i in range(1, 301):
        sp = 5.0 if i >= 200 else 0.0
        state = step(LAW, state, 0.1 * i, sp, 4.0 if sp else 0.0, 0.05)
    assert state.started
    return state


def test_a_load_response_is_not_taken_for_a_setpoint_change() -> None:
    pv = [0.0] * 100 + [3.0 * (0.05 * i) * math.exp(1 - 0.05 * i) for i in range(900)]
    (response,) = run(pv, [0.0] * 1000, 0.5, band=0.05)
    assert not response.sp_changed
    assert response.peaks[0].e == pytest.approx(-3.0, rel=1e-3)


def test_the_next_setpoint_change_cuts_a_response_short_and_starts_its_own() -> None:
    sp = [0.0] * 100 + [5.0] * 40 + [10.0] * 860
    pv = [0.0] * 100
    for i in range(100, 1000):
        pv.append(pv[-1] + 0.02 * (sp[i] - pv[-1]))
    first, second = run(pv, sp, 0.5, 0.05, RecogniserLaw(wait_s=300.0, quiet_s=8.0))
    assert first.ending == Ending.SETPOINT
    assert second.ending == Ending.QUIET
    assert second.peaks[0].e > 5.0


def test_an_error_that_never_comes_back_times_out() -> None:
    (first, *_) = run([0.0] * 600, [0.0] * 50 + [5.0] * 550, 0.5, band=0.05)
    assert first.ending == Ending.TIMEOUT
    assert first.peaks == ()


def test_a_sustained_oscillation_is_recognised_again_and_again() -> None:
    pv = [2.0 * math.sin(0.5 * i * 0.1) for i in range(8000)]
    found = run(pv, [0.0] * 8000, 0.1, band=0.1)
    assert len(found) >= 4
    for response in found:
        assert response.damping == pytest.approx(1.0, abs=0.01)
        assert response.period_s == pytest.approx(2 * math.pi / 0.5, rel=0.02)


def test_noise_inside_the_band_starts_nothing() -> None:
    pv = [0.05 * math.sin(1.7 * i) + 0.04 * math.sin(0.31 * i * i) for i in range(5000)]
    assert run(pv, [0.0] * 5000, 0.5, band=0.1) == []


def test_at_rest_the_state_is_the_same_object() -> None:
    state = begin(0.0, 1.0)
    for i in range(1, 100):
        state = step(LAW, state, i * 0.5, 1.0, 0.01, 0.1)
    assert state.phase == RecogniserPhase.LOCATE_1
    assert step(LAW, state, 60.0, 1.0, -0.02, 0.1) is state


def test_every_state_and_event_leads_somewhere() -> None:
    assert len(TABLE) == len(RecogniserPhase)
    assert all(len(row) == len(Event) for row in TABLE)
    assert all(TABLE[phase][Event.NONE] == phase for phase in RecogniserPhase if phase != RecogniserPhase.ADAPT)
    assert all(target == RecogniserPhase.SETTLE for target in TABLE[RecogniserPhase.ADAPT])
    for phase in list(RecogniserPhase)[: RecogniserPhase.ADAPT]:
        for event in (Event.QUIET, Event.TIMEOUT, Event.SETPOINT):
            assert TABLE[phase][event] == RecogniserPhase.ADAPT
    reachable, queue = set(), [RecogniserPhase.SETTLE]
    while queue:
        phase = queue.pop()
        if phase not in reachable:
            reachable.add(phase)
            queue += TABLE[phase]
    assert reachable == set(RecogniserPhase)


@given(
    errors=st.lists(st.floats(-10, 10), min_size=1, max_size=300),
    setpoints=st.lists(st.sampled_from([0.0, 0.0, 0.0, 4.0]), min_size=300, max_size=300),
    band=st.floats(0.05, 1.0),
)
@example(errors=[0.0] * 5 + [0.5, -1.0, 0.0], setpoints=[0.0] * 5 + [4.0, 4.0] + [0.0] * 293, band=1.0)
def test_any_record_keeps_the_states_lawful(errors: list[float], setpoints: list[float], band: float) -> None:
    state = begin(0.0, 0.0)
    for i, e in enumerate(errors, start=1):
        new = step(LAW, state, float(i), setpoints[i - 1], e, band)
        assert new.phase in TABLE[state.phase]
        response = response_of(new, band)
        if response:
            assert response.t_start_s <= response.t_end_s == float(i)
            signs = [math.copysign(1, p.e) for p in response.peaks]
            assert all(a != b for a, b in itertools.pairwise(signs))
            beyond = response.peaks[bool(response.sp_changed) :]  # the first peak of a setpoint step may drown in noise
            assert all(abs(p.e) > band for p in beyond)
            assert [p.t_s for p in response.peaks] == sorted(p.t_s for p in response.peaks)
        state = new


@given(scale=st.floats(1e-6, 1e6), errors=st.lists(st.floats(-10, 10), min_size=1, max_size=200))
def test_units_do_not_matter(scale: float, errors: list[float]) -> None:
    scale = 2.0 ** round(math.log2(scale))  # a power of two scales floats exactly
    plain, scaled = begin(0.0, 0.0), begin(0.0, 0.0)
    for i, e in enumerate(errors, start=1):
        plain = step(LAW, plain, float(i), 0.0, e, 0.25)
        scaled = step(LAW, scaled, float(i), 0.0, e * scale, 0.25 * scale)
        assert scaled.phase == plain.phase


def test_a_sluggish_loop_with_a_short_integral_time_is_followed_to_its_end() -> None:
    dt, tau = 1.0, 150.0  # the error takes 2.5 waiting times for one time constant
    sp = [0.0] * 50 + [5.0] * 1500
    pv = [0.0] * 50 + [5.0 * (1 - math.exp(-i * dt / tau)) for i in range(1500)]
    (response,) = run(pv, sp, dt, band=0.05, law=LAW)
    assert len(response.peaks) == 1
    assert response.t_end_s - response.t_start_s > 3.5 * tau


def test_an_error_that_never_was_at_rest_is_looked_at_once_all_the_same() -> None:
    pv = [0.02 * i for i in range(1500)]  # a runaway that was there before anybody looked
    (response,) = run(pv, [-1.0] * 1500, 1.0, band=0.05, law=LAW)
    assert (response.ending, response.peaks, response.sp_changed) == (Ending.TIMEOUT, (), False)


def test_a_load_before_a_slow_tail_has_come_to_rest_is_a_response() -> None:
    dt, patient = 0.5, RecogniserLaw(wait_s=2000.0, quiet_s=60.0)
    sp = [0.0] * 100 + [5.0] * 1900
    tail = [5.0 * math.exp(-i * dt / 2) - 0.5 * math.exp(-i * dt / 300) * (i > 0) for i in range(1900)]
    load = [0.0] * 400 + [3.0 * (1 - math.exp(-i * dt / 5)) * math.exp(-i * dt / 30) for i in range(1500)]
    pv = [0.0] * 100 + [5.0 - e - x for e, x in zip(tail, load, strict=True)]
    first, second = run(pv, sp, dt, 0.05, patient)[:2]
    assert (first.ending, first.sp_changed) == (Ending.TIMEOUT, True)
    assert not second.sp_changed
    assert second.t_start_s == pytest.approx((100 + 400) * dt, abs=5)


def test_what_is_left_of_a_swing_begins_no_response() -> None:
    dt = 0.5
    sp = [0.0] * 100 + [5.0] * 1900
    pv = [0.0] * 100 + [5.0 * (1 - decay(i * dt, 0.1, 0.2)) for i in range(1900)]
    assert len(run(pv, sp, dt, 0.05, RecogniserLaw(wait_s=400.0, quiet_s=60.0))) == 1


@pytest.mark.parametrize("zeta", [0.0, 0.3])
def test_a_swing_that_nobody_saw_begin_is_looked_at_unless_it_dies_away(zeta: float) -> None:
    dt, w = 0.5, 0.2  # 31 s a period, and a wait of 400 s
    pv = [-5.0 * decay(i * dt, zeta, w) for i in range(600)]
    found = run(pv, [0.0] * 600, dt, 0.05, RecogniserLaw(wait_s=400.0, quiet_s=30.0))
    assert bool(found) == (zeta == 0.0)
    assert all(response.t_start_s < 70 for response in found[:1])


def test_an_error_that_stands_still_is_waited_for_once() -> None:
    sp = [0.0] * 50 + [5.0] * 400
    pv = [0.0] * 50 + [min(4.0, 0.2 * i) for i in range(400)]
    (response,) = run(pv, sp, 1.0, band=0.05, law=LAW)
    assert response.ending == Ending.TIMEOUT
    assert response.t_end_s - response.t_start_s == pytest.approx(20 + LAW.wait_s, abs=3)


def test_after_an_early_crossing_a_long_integral_time_does_not_hold_the_response() -> None:
    dt, patient = 0.5, RecogniserLaw(wait_s=2000.0, quiet_s=20.0)
    sp = [0.0] * 100 + [5.0] * 3000
    error = [5.0 * math.exp(-i * dt / 2) - math.exp(-i * dt / 300) * (i > 0) for i in range(3000)]
    pv = [0.0] * 100 + [5.0 - e for e in error]
    response, *_ = run(pv, sp, dt, 0.05, patient)
    assert response.ending == Ending.TIMEOUT
    assert response.t_end_s - response.t_start_s < 30


def test_no_response_is_longer_than_allowed() -> None:
    short = RecogniserLaw(wait_s=1e6, quiet_s=8.0, longest_s=300.0)
    sp = [0.0] * 50 + [5.0] * 900
    pv = [0.0] * 50 + [0.004 * i for i in range(900)]
    response, *_ = run(pv, sp, 1.0, 0.05, short)
    assert response.ending == Ending.TIMEOUT
    assert response.t_end_s - response.t_start_s == pytest.approx(300.0, abs=2)


@pytest.mark.parametrize(("decay_ratio", "again"), [(1.0, True), (0.5, False)])
def test_a_swing_that_goes_on_is_followed_again_after_a_dozen_periods(decay_ratio: float, again: bool) -> None:
    """It steps over the band at every crossing, and the longest wait is a hundred of its periods."""
    dt, period = 1.0, 20.0
    t = [i * dt for i in range(500)]
    pv = [
        10.0 * decay_ratio ** (x / period) * math.sin(2 * math.pi * (x - 60.5) / period) if x > 60 else 0.0 for x in t
    ]
    law = RecogniserLaw(wait_s=100 * period, quiet_s=50.0)
    found = run(pv, [0.0] * len(t), dt, 0.02, law)
    first = found[0]
    assert first.ending == Ending.COMPLETE
    assert (len(found) > 1) is again
    if again:
        apart = found[1].t_start_s - first.t_end_s
        assert 12.0 * period <= apart <= 13.5 * period
        assert abs(found[1].peaks[0].e) == pytest.approx(10.0, rel=0.05)


def small_step(size: float, tau_s: float, noise: float, seed: int, at_s: int = 100) -> tuple[list[float], list[float]]:
    """A setpoint step and pv that follows it slowly, with noise; a second apart."""
    rng = np.random.default_rng(seed)
    sp = [size if t >= at_s else 0.0 for t in range(300)]
    pv = [size * (1 - math.exp(-(t - at_s) / tau_s)) if t >= at_s else 0.0 for t in range(300)]
    return sp, [y + noise * n for y, n in zip(pv, rng.standard_normal(300), strict=True)]


@pytest.mark.parametrize("bands", [0.6, 1.0, 1.9, 2.5, 3.9])
def test_a_setpoint_step_that_is_small_for_the_noise_is_a_response_and_is_waited_for(bands: float) -> None:
    sp, pv = small_step(bands, 20.0, 0.25, seed=7)
    response, *later = run(pv, sp, 1.0, band=1.0)
    assert response.sp_changed
    assert response.t_start_s == 100.0
    assert response.t_end_s >= 100.0 + LAW.wait_s
    assert not later


def test_a_setpoint_that_moves_by_less_than_shows_or_by_its_own_noise_begins_nothing() -> None:
    sp, pv = small_step(0.4, 20.0, 0.25, seed=8)
    assert not run(pv, sp, 1.0, band=1.0)
    state = begin(0.0, 0.0)
    for i, size in enumerate(np.random.default_rng(9).standard_normal(2000)):  # noise of the setpoint, in its own band
        state = step(LAW, state, i + 1.0, 0.2 * size, 0.2 * size, 1.0, 0.8)
        assert response_of(state, 1.0) is None


def test_the_next_small_step_ends_the_one_before_and_begins_its_own() -> None:
    sp, pv = small_step(1.5, 20.0, 0.0, seed=7)
    back = [0.0 if t >= 130 else size for t, size in enumerate(sp)]
    first, second = run(pv, back, 1.0, band=1.0)
    assert first.ending == Ending.SETPOINT
    assert second.t_start_s == pytest.approx(130.0, abs=2.0)
    assert second.sp_changed
