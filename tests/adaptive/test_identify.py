"""Identification: exact without noise, calibrated with it, honest when there is nothing to know; the real heater."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effort import examples, sized
from hypothesis import given, settings
from hypothesis import strategies as st
from pi_loop import Lag, pi_loop
from test_setpoint_steps import LAW, WALK, sequences

import retuner
from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.choice.expected_cost import Choosable, LoopSettings, outlooks
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.diagnose import diagnose_window
from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.oscillation_online import SwingSettings
from retuner.adaptive.diagnosis.rival_fits import linear, room_for_a_tone
from retuner.adaptive.diagnosis.second_opinion import last_two
from retuner.adaptive.diagnosis.sticking_valve import stiction_or_tone
from retuner.adaptive.fit.dynamics import Dynamics, SamplingInstants
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import EXACT, refine
from retuner.adaptive.fit.structure import THETA, dynamics_at
from retuner.adaptive.identification import by_likelihood
from retuner.adaptive.identification.by_likelihood import TYPE, Likelihood, Likely, middle, runs_away, whitening
from retuner.adaptive.identification.candidate import judged
from retuner.adaptive.identification.fitted_curve import fitted_pv
from retuner.adaptive.identification.identify import OPEN_LOOP, Fits, FitSettings, estimate_of, fitted, identify_window
from retuner.adaptive.identification.loads import (
    _load_elsewhere,
    _merged,
    _with_load,
    _with_rounding,
    _without_load,
    _without_rounding,
)
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.structure_choice import asked_for, too_few
from retuner.adaptive.indexes.screening import screen
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.valve.slips import ROWS_PER_STEP, _greedy
from retuner.api import _unless_pv_stands, identify, identify_record
from retuner.commands.recorded.identify import described
from retuner.commands.recorded.other_cause import contradiction
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.schedule.gains import PidGains, SeriesGains

FIRST = ProcessType.FOPDT


def through(t: np.ndarray, u: np.ndarray, tau: float, theta: float) -> np.ndarray:
    """The response of a lag of gain one with dead time."""
    return Dynamics(0.0, 1 / tau).held(SamplingInstants.of(t), u - u[0], theta) / tau


HEATER = Path(__file__).parent.parent / "data" / "heater" / "open_loop_step.csv"


@pytest.mark.parametrize("upset", ["setpoint", "load"])
@pytest.mark.parametrize(("k", "tau", "theta"), [(1.0, 50.0, 5.0), (-2.0, 10.0, 7.3), (0.01, 400.0, 11.1)])
def test_without_noise_the_process_is_found_exactly(loop, k, tau, theta, upset):
    kc, tau_i, dt = 0.5 * tau / theta / k, min(tau, 8 * theta), theta / 7
    shape = {"sp": 1.0} if upset == "setpoint" else {"load": 1.0 / k}
    window = loop(k=k, tau=tau, theta=theta, kc=kc, tau_i=tau_i, dt=dt, at=40.2 * dt, **shape).run()
    found = identify_window(window, sign=1 if k > 0 else -1)
    model = found.log.model()
    assert found.identifiable
    # a load step is confounded with the bias only through where it starts; the fit still ends at the truth
    assert model.k == pytest.approx(k, rel=2e-3)
    assert model.tau1_s == pytest.approx(tau, rel=2e-3)
    assert model.theta_s == pytest.approx(theta, rel=2e-3)


def test_reverse_action_mirrors(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.01).run(3)
    mirrored = Window(window.t_s, window.sp, window.pv, -window.co)
    plain, mirror = identify_window(window), identify_window(mirrored)
    assert mirror.log.sign == -plain.log.sign == -1
    np.testing.assert_allclose(mirror.log.x, plain.log.x, atol=1e-5)


def test_time_and_unit_scaling(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.01).run(4)
    scaled = Window(window.t_s * 1000 + 77, window.sp * 9 + 300, window.pv * 9 + 300, window.co * 0.1 - 4)
    plain, other = identify_window(window, 1).log, identify_window(scaled, 1).log
    shift = np.array([math.log(90 / 1000), math.log(1000), math.log(1000)])
    np.testing.assert_allclose(other.x, plain.x + shift, atol=2e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(other.p)), np.sqrt(np.diag(plain.p)), rtol=0.02)


@pytest.mark.uncounted
@pytest.mark.parametrize("upset", ["setpoint", "load"])
def test_standard_deviations_are_calibrated(loop: Callable, upset: str) -> None:
    """Truth within two sigma in about 95 % of the records: the binomial 99.9 % range is 32 to 40 of 40."""
    shape = {"sp": 1.0, "noise": 0.02} if upset == "setpoint" else {"load": 3.0, "noise": 0.02}
    truth = np.log([1 / 50.0, 5.0, 50.0])
    inside = np.zeros(3)
    count, least = sized((10, 7), (20, 15), (200, 179))
    for seed in range(count):
        log = identify_window(loop(**shape).run(seed), 1).of(FIRST).log
        inside += np.abs(log.x - truth) < 2 * np.sqrt(np.diag(log.p))
    assert np.all(inside >= least), inside


def test_a_quiet_record_is_not_identifiable(loop: Callable) -> None:
    found = identify_window(loop(noise=0.02).run(1), 1)
    assert not found.identifiable
    assert found.reason


def test_a_constant_signal_is_refused_with_its_name(loop: Callable) -> None:
    window = loop(sp=1.0).run()
    with pytest.raises(ValueError, match="co stays at 3"):
        identify_window(Window(window.t_s, window.sp, window.pv, np.full(len(window.t_s), 3.0)))
    with pytest.raises(ValueError, match="pv stays at 3"):
        identify_window(Window(window.t_s, window.sp, np.full(len(window.t_s), 3.0), window.co))


def test_the_real_heater() -> None:
    """Reference fit of the record: k 0.361, tau 138 s, theta 14.2 s (provenance beside the data)."""
    data = np.genfromtxt(HEATER, delimiter=",", names=True)
    found = identify_window(Window(data["t"], np.zeros(len(data)), data["pv"], data["co"]), settings=OPEN_LOOP)
    model = found.log.model()
    assert found.identifiable
    assert model.type == ProcessType.SOPDT  # heater and sensor; the reference is of first order
    assert model.k == pytest.approx(0.361, rel=0.02)
    assert model.tau1_s + model.tau2_s / 2 == pytest.approx(138, rel=0.03)
    assert 8 < model.theta_s + model.tau2_s / 2 < 15
    assert np.all(np.sqrt(np.diag(found.log.p))[:3] < [0.03, 0.4, 0.03])  # what the noise of the record leaves open
    std = found.log.std()  # and what two lags leave out of a heater
    assert 0.01 < std["k"] < 0.03
    assert 5 < std["tau1"] < 12
    assert 0 < std["theta"] < 2


@settings(max_examples=examples(25))
@given(seed=st.integers(0, 10**6))
def test_any_finite_record_gives_a_finite_answer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 80))
    t = np.cumsum(rng.uniform(0.1, 2.0, n))
    pv, co = rng.standard_normal((2, n)) * 10.0 ** rng.integers(-6, 6, (2, 1))
    window = Window(t, np.zeros(n), np.cumsum(pv), co)
    if too_few(window):
        with pytest.raises(ValueError, match="are fewer than a process and its starts have unknowns"):
            identify_window(window)
        return
    found = identify_window(window)
    assert np.all(np.isfinite(found.log.x))
    assert found.reason


def test_a_condensed_record_tells_the_same(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.01, dt=0.05, n=6000).run(6)
    small = window.condensed(1500)
    assert len(small.t_s) == 1500
    held = np.diff(window.t_s, append=window.t_s[-1] + 0.05)
    assert float(np.sum(small.co) * 0.2) == pytest.approx(float(np.sum(window.co * held)))
    log = identify_window(window, 1).log
    truth = np.log([1 / 50.0, 5.0, 50.0])
    assert np.all(np.abs(log.x - truth) < np.maximum(4 * np.sqrt(np.diag(log.p)), 0.01))


def test_a_short_record_is_not_condensed(loop: Callable) -> None:
    window = loop(sp=1.0).run()
    assert window.condensed(500) is window


def test_structures_that_are_equally_good_make_no_difference(loop: Callable) -> None:
    """A record that shows nothing is explained alike by all of them: the winner leads, whichever it is."""
    found = fitted(loop(noise=0.1, n=60).run(seed=1), (1,), FitSettings())
    equal = [replace(c, criterion=0.0) for c in found]
    assert len({c.fit.misfit.type for c in equal}) > 2
    for i in range(len(equal)):
        estimate = estimate_of([*equal[i:], *equal[:i]], 0.0, {}, FitSettings())
        assert estimate.log.type == equal[i].fit.misfit.type
        assert estimate.plausible


def test_seconds_since_1970_make_no_difference() -> None:
    t = np.arange(200.0)
    co = np.where(t < 20, 0.0, 1.0)
    pv = 2.0 * through(t, co, 30.0, 5.0) + 0.01 * np.random.default_rng(7).standard_normal(len(t))
    here = identify_window(Window(t, co, pv, co), settings=OPEN_LOOP)
    there = identify_window(Window(t + 1.7e9, co, pv, co), settings=OPEN_LOOP)
    np.testing.assert_allclose(there.log.x, here.log.x, rtol=1e-6)
    loaded = pv - through(t, np.where(t < 120, 0.0, 1.0), 30.0, 0.0)
    shifted = identify_window(Window(t + 1.7e9, co, loaded, co))
    assert shifted.load_times_s == pytest.approx([1.7e9 + 120], abs=2)


@pytest.mark.parametrize("zeta", [0.2, 0.34])
def test_a_process_that_swings_long_is_found_with_its_damping(zeta: float) -> None:
    """An open-loop step. Both used to come out at 0.35, the least damping that was fitted."""
    t, tau = np.arange(0.0, 600.0, 2.0), 15.0
    u = np.where(t < 40.0, 0.0, 1.0)
    total = 2 * zeta * tau
    pv = 3.0 * Dynamics(tau**2 / total, 1 / total).held(SamplingInstants.of(t), u, 7.0) / total
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(t))
    model = identify_window(Window(t, np.zeros_like(t), pv + noise, u), sign=1).log.model()
    assert model.zeta == pytest.approx(zeta, rel=0.05)
    assert model.k == pytest.approx(3.0, rel=0.02)


# A load that moves along a ramp is two corners, not a row of steps; and the process is found beside it.


K, LAG_S, THETA_S = 2.0, 30.0, 6.0
BEGINS_S, LASTS_S = 60.0, 90.0
DT, N = 1.0, 400


def recorded(*, ramp_s: float = LASTS_S, sp: float = 0.0, seed: int = 2) -> Window:
    """PI on a lag with dead time; the load moves to 1 along a ramp, and stays."""
    t = DT * np.arange(N)
    load, noise = np.clip((t - BEGINS_S) / max(ramp_s, 1e-9), 0.0, 1.0), np.random.default_rng(seed).standard_normal(N)
    target = np.where(t >= BEGINS_S, sp, 0.0)
    return pi_loop(PidGains(1.6, 1.6 / 25), Lag(LAG_S, int(THETA_S), K), target, 0.004 * noise, load)


def test_a_ramp_is_found_as_two_corners_and_the_process_beside_it() -> None:
    best = fitted(recorded(), (1,), FitSettings())[0].fit
    model = identify_window(recorded(), 1).log.model()

    assert (best.misfit.loads, best.misfit.corners) == (2, 2)
    assert best.load_times_s == pytest.approx((BEGINS_S, BEGINS_S + LASTS_S), abs=4.0)
    assert best.ramp_s == pytest.approx(LASTS_S, rel=0.05)
    assert model.theta_s == pytest.approx(THETA_S, rel=0.2)
    assert model.k / (model.tau1_s + model.tau2_s) == pytest.approx(K / LAG_S, rel=0.1)


@pytest.mark.parametrize(("ramp_s", "sp"), [(0.0, 0.0), (LASTS_S, 1.0)])
def test_a_sharp_load_and_a_setpoint_step_are_not_explained_by_ramps(ramp_s: float, sp: float) -> None:
    found = fitted(recorded(ramp_s=ramp_s, sp=sp), (1,), FitSettings())
    assert all(c.fit.misfit.corners == 0 for c in found)
    assert found[0].fit.ramp_s == 0.0


def test_ramps_are_asked_for_where_one_sharp_step_does_not_do() -> None:
    sharp, slow = (fitted(recorded(ramp_s=s), (1,), FitSettings())[0] for s in (0.0, LASTS_S))
    assert not asked_for(sharp)
    assert asked_for(slow)
    plain = replace(sharp.fit.misfit, rounded=True)
    assert asked_for(replace(sharp, fit=replace(sharp.fit, misfit=plain)))


def test_a_record_that_any_step_explains_is_searched_as_before() -> None:
    found = fitted(recorded(ramp_s=0.0), (1,), FitSettings())[0]
    assert found.fit.misfit.loads == 1
    assert found.fit.load_times_s[0] == pytest.approx(BEGINS_S, abs=2.0)


def test_moves_keep_steps_before_corners() -> None:
    record = Record.of(recorded())
    misfit = Misfit(record, ProcessType.FOPDT, 1, 4, record.noise_std, 0.3, corners=3, rounded=True)
    p = np.array([math.log(K / LAG_S), math.log(THETA_S), math.log(LAG_S), 20.0, 60.0, 150.0, 390.0, math.log(3.0)])
    at = judged(refine(misfit, p, enough=EXACT, evaluations=0))

    sharp, moved = _without_rounding(at) or pytest.fail("no such move")
    assert (sharp.loads, sharp.corners, sharp.rounded) == (4, 3, False)
    np.testing.assert_allclose(moved[3:], [23.0, 60.0, 150.0, 390.0])
    less, kept = _without_load(at, 0) or pytest.fail("no such move")
    assert (less.loads, less.corners, less.rounded) == (3, 3, False)
    np.testing.assert_allclose(kept[3:], [60.0, 150.0, 390.0])
    fewer, kept = _without_load(at, 3) or pytest.fail("no such move")
    assert (fewer.loads, fewer.corners, fewer.rounded) == (3, 2, True)
    np.testing.assert_allclose(kept[3:], [20.0, 60.0, 150.0, math.log(3.0)])
    assert _merged(at) is None
    assert _load_elsewhere(at, 0) is None
    only = judged(refine(less, np.array([*p[:3], 60.0, 150.0, 390.0]), evaluations=0))
    assert _with_rounding(only) is None
    more, longer = _with_load(only, 4) or pytest.fail("no such move")
    assert (more.loads, more.corners) == (4, 3)
    np.testing.assert_allclose(longer[-3:], [60.0, 150.0, 390.0])


def test_the_last_two_responses_are_what_is_looked_at_again() -> None:
    moves = {*range(20, 30), *range(60, 70), *range(100, 120)}
    samples = [LoopSample(float(i), 0.0, 1.0 if i in moves else 0.0, 0.0) for i in range(120)]
    response = Response(100.0, 119.0, (), Ending.QUIET, sp_changed=False, band=0.1)
    kept = last_two(samples, response, SwingSettings())
    assert 30 <= kept[0].t_s < 60.0  # the second of three
    restless = [sample._replace(pv=1.0) for sample in samples]
    assert last_two(restless, response, SwingSettings()) == restless


# The drawn explanation of a record is the one that was fitted.


@pytest.mark.parametrize("load", [0.0, 1.5])
def test_fitted_pv_leaves_noise(load):
    n, noise = 400, 0.02
    rng = np.random.default_rng(4)
    t = 1.7e9 + np.arange(float(n))  # a clock that counts from 1970
    co = np.where((np.arange(n) // 130) % 2 == 0, 0.0, 1.0)
    x, pv = 0.0, np.zeros(n)
    for i in range(n):
        pv[i] = 30 + x + noise * rng.normal()
        x += (1 - np.exp(-1 / 15)) * (2 * co[max(i - 4, 0)] + (load if i >= 300 else 0.0) - x)
    window = Window(t, np.full(n, 30.0), pv, co)
    estimate = identify_window(window)
    fitted = fitted_pv(window, estimate)
    assert fitted.shape == (n,)
    assert np.std(pv - fitted) == pytest.approx(noise, rel=0.15)
    assert len(estimate.load_times_s) == (1 if load else 0)


# What loads alone do not tell: the width of Ms, and a dead time at its least.


SETTINGS = ChoiceSettings()


def test_loads_alone_leave_more_room_below_the_limit_and_beyond_it() -> None:
    process = ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, 5.0)
    sets = [Choosable(PidGains(4.0, 0.08)), Choosable(PidGains(5.5, 0.11))]
    loop, models = LoopSettings(0.0), [Plausible(process, 0.0)]
    sure, by_loads = (outlooks(models, sets, None, loop, s) for s in (SETTINGS, SETTINGS.by_loads()))
    assert [one.ms for one in sure] == [one.ms for one in by_loads]
    assert by_loads[0].cost - by_loads[1].cost < sure[0].cost - sure[1].cost


def test_a_dead_time_at_its_least_is_not_known_to_a_few_percent() -> None:
    rng, dt, n = np.random.default_rng(3), 0.6, 76
    x, integral = np.zeros(5), 0.0
    pv, co = np.zeros(n), np.zeros(n)
    for i in range(n):
        pv[i] = x[-1] + 0.006 * rng.standard_normal()
        integral -= 0.12 * dt * pv[i]
        co[i] = -0.5 * pv[i] + integral
        for _ in range(60):
            x = x + dt / 60 * (np.concatenate([[co[i] + (i >= 25)], x[:-1]]) - x)
    alternatives = identify_window(Window(dt * np.arange(float(n)), np.zeros(n), pv, co), sign=1).alternatives
    third = next(a.log for a in alternatives if a.log.type is ProcessType.TOPDT)
    assert math.exp(third.x[THETA]) < 0.1
    assert math.sqrt(float(third.p[THETA, THETA])) > 1.0


# What identification may say beside its model: what stands shows none, a first step, a bound, a start in motion.


PLANT = Path(__file__).parent.parent / "data" / "plant"


def test_far_more_gain_from_one_event_is_a_first_step_with_the_aim_behind_it(loop: Callable) -> None:
    window = loop(sp=1.0, kc=0.8, tau_i=40.0, noise=0.005, n=1500).run(1)
    found = identify_record(window, gains=SeriesGains(0.8, 40.0).to_parallel())
    assert found.settings.tuning.gains.kp == pytest.approx(3 * 0.8, rel=0.01)
    assert found.aim.tuning.gains.kp == pytest.approx(5.0, rel=0.1)
    assert "first step" in found.step_reason
    assert any("final settings" in line for line in described(found))
    assert found.to_dict()["aim"] is not None


def test_what_is_in_reach_is_given_at_once(loop: Callable) -> None:
    window = loop(sp=1.0, kc=2.5, tau_i=40.0, noise=0.005, n=1500).run(1)
    found = identify_record(window, gains=SeriesGains(2.5, 40.0).to_parallel())
    assert found.settings is not None
    assert found.aim is None
    assert found.step_reason == ""


def test_a_model_of_a_valve_that_stands_is_not_believed(loop: Callable) -> None:
    estimate = identify_window(loop(sp=1.0, noise=0.01).run(1))
    assert estimate.identifiable
    stands = read_loop_record((PLANT / "FIC20102_1016_12.csv",)).recording.window()
    found = _unless_pv_stands(stands, None, replace(estimate, residual_std=0.5 * float(np.std(stands.pv))))
    assert not found.identifiable
    assert "does not move while co moves" in found.reason


def test_where_diagnosis_sees_another_cause_the_command_says_so() -> None:
    told = Diagnosis(Cause.STICTION, 0.8, {}, "a valve that sticks")
    assert "STICTION" in contradiction(told)[0]
    assert contradiction(None) == []
    untold = " ".join(contradiction(replace(told, cause=Cause.UNKNOWN)))
    assert "look at the record" in untold
    assert "resolve this" not in untold  # nothing is named that could be resolved


def manual(cut: int, steps: tuple[tuple[int, float], ...] = ((50, 1.0), (200, -0.5), (400, 0.6))) -> list[np.ndarray]:
    """A lag of 40 s with gain 2 and 6 s of dead time in manual, the rows before `cut` not recorded."""
    t, u, rng = np.arange(600.0), np.zeros(600), np.random.default_rng(5)
    for at, value in steps:
        u[at:] = value
    pv = 2 * Dynamics(0.0, 1 / 40).held(SamplingInstants.of(t), u, 6.0) / 40 + 0.01 * rng.standard_normal(600)
    return [x[cut:] for x in (t, np.zeros(600), pv + 30, u + 20)]


@pytest.mark.parametrize("cut", [0, 50, 60, 120, 199, 215, 399])
def test_a_manual_record_may_begin_in_motion_or_with_its_step(cut: int) -> None:
    found = identify(*manual(cut), open_loop=True)
    model, std = found.estimate.log.model(), found.estimate.log.std()
    assert found.estimate.identifiable
    assert model.k == pytest.approx(2.0, abs=max(0.03, 4 * std["k"]))
    assert model.theta_s + model.tau2_s / 2 == pytest.approx(6.0, rel=0.1)


def test_a_lag_without_visible_dead_time_gets_settings_from_the_bound(loop: Callable) -> None:
    window = loop(tau=30.0, theta=0.4, kc=1.0, tau_i=30.0, dt=4.0, n=400, sp=1.0, at=160.0, noise=0.004).run(2)
    found = identify_record(window)
    assert found.estimate.identifiable, found.estimate.reason
    assert "one sampling interval" in found.estimate.reason
    gains = found.settings.tuning.gains
    assert gains.kp == pytest.approx(30.0 / (2 * 6.0), rel=0.05)  # SIMC with a dead time of 4 s, and half a sample
    assert found.settings.margins.ms < 1.8


def test_the_freer_search_is_never_worse_than_the_one_without_coincident_loads(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.01, load=0.4, at=45.0).run(7)
    fits = Fits(window, (1,), FitSettings())
    assert fits.free[0].criterion <= fits.barred[0].criterion


def test_a_drifting_load_on_an_integrator_is_a_parabola_not_a_lag() -> None:
    rng, rows = np.random.default_rng(2), []
    x, integral, past = 0.0, 0.0, [0.0] * 5
    for i in range(900):
        sp, load = float(i >= 200), 0.004 * i
        pv = x + 0.01 * rng.standard_normal()
        integral += 0.05 * (sp - pv)
        past.append(2.0 * (sp - pv) + integral)
        rows.append((float(i), sp, pv, past[-1]))
        x += 0.05 * (past.pop(0) + load)
    found = identify_window(Window(*np.array(rows).T), 1)
    model = found.log.model()
    assert model.type == ProcessType.INTEGRATING
    assert model.slope == pytest.approx(0.05, rel=0.03)
    assert model.theta_s == pytest.approx(5.0, rel=0.15)


def test_a_model_that_leaves_much_beside_what_it_explains_is_not_identified(loop: Callable) -> None:
    window = loop(sp=1.0, noise=0.005, n=1200).run(3)
    swing = 0.12 * np.sign(np.sin(window.t_s / 9.0)) * np.abs(np.sin(window.t_s / 31.0))
    found = identify_window(Window(window.t_s, window.sp, window.pv + swing, window.co), 1)
    assert not found.identifiable


# Records with hardly more samples than a hypothesis has unknowns: whatever they hold, an answer comes


@pytest.mark.parametrize("seed", [19, 112, 243])
def test_more_unknowns_than_samples_are_not_asked_for(seed: int) -> None:
    """These three stopped a tone, a load and the steps of a valve: "more unknowns than samples"."""
    rng = np.random.default_rng([seed, 77])
    n, dt_s = int(rng.integers(8, 90)), float(rng.choice([0.01, 0.1, 1, 60]))
    noise, kp = float(rng.choice([0.0, 1e-3, 0.02, 0.2, 1.0])), float(rng.choice([0.1, 0.5, 1, 3]))
    ki = kp / dt_s / float(rng.choice([2, 5, 20]))
    tau, theta = float(rng.choice([1, 4, 20])), int(rng.integers(0, 6))
    sp, load = np.zeros(n), np.zeros(n)
    for _ in range(int(rng.integers(0, 3))):
        sp[int(rng.integers(1, n)) :] = rng.normal()
    for _ in range(int(rng.integers(0, 4))):
        load[int(rng.integers(0, n)) :] += rng.normal()
    quantum, band = float(rng.choice([0, 0, 0.05, 0.3])), float(rng.choice([0, 0, 0.1, 0.5]))
    x = integral = stem = 0.0
    pv, co, u = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        seen = x + noise * rng.normal()
        pv[i] = round(seen / quantum) * quantum if quantum else seen
        integral += ki * dt_s * (sp[i] - pv[i])
        co[i] = np.clip(kp * (sp[i] - pv[i]) + integral, -5, 5)
        stem = co[i] if abs(co[i] - stem) > band else stem
        u[i] = stem
        x += ((u[i - theta] if i >= theta else 0.0) - x + load[i]) / tau
    found = diagnose_window(Window(np.arange(n) * dt_s, sp, pv, co), PidGains(kp, ki, 0.0)).diagnosis
    assert found.cause in Cause
    assert found.reason


@pytest.mark.parametrize("n", [10, 23, 40])
def test_steps_leave_samples_that_could_speak_against_them(n: int) -> None:
    pv = np.random.default_rng(n).normal(size=n).round(0)
    _, rows = _greedy(pv, 0.5, 0.0)
    assert len(rows) <= n // ROWS_PER_STEP


@pytest.mark.parametrize("n", [14, 15, 18, 24])
def test_a_record_that_no_tone_fits_into_has_no_rivals(n: int) -> None:
    """A response of many small setpoint moves, as a watching retuner asks of it, not as `diagnose` does."""
    t, settings, rng = np.arange(float(n)), DiagnosisSettings(), np.random.default_rng(n)
    sp = np.cumsum(np.where(t % 7 == 0, rng.choice([-0.3, 0.3], n), 0.0))
    pv = np.concatenate([[0.0], 0.9 * sp[:-1]]) + 0.01 * rng.standard_normal(n)
    window = Window(t, sp, pv, np.cumsum(sp - pv) * 0.2 + sp - pv)
    best = linear(window, (1,), settings.fit.choice, settings.fit.most_samples)[0]
    found = stiction_or_tone(best, screen(window, PidGains(1.0, 0.2), in_auto=True), settings)
    assert (found.verdict is None) or room_for_a_tone(best)


def many_gaps(n: int) -> tuple[np.ndarray, ...]:
    """A random record of n samples with a gap after every third one: each is a start with unknowns of its own."""
    rng = np.random.default_rng(n)
    t = np.cumsum(np.where(np.arange(n) % 3 == 0, 9.0, 1.0))
    return t, np.where(np.arange(n) > n // 3, 1.0, 0.0), np.cumsum(rng.normal(size=n)), np.cumsum(rng.normal(size=n))


@pytest.mark.parametrize("n", [3, 5, 8, 12, 16, 20])
def test_a_record_with_fewer_samples_than_unknowns_says_so(n: int) -> None:
    """It had said "more unknowns than samples", or "search: most or the grid is outside its range"."""
    with pytest.raises(ValueError, match="are fewer than a process and its starts have unknowns"):
        retuner.identify(*many_gaps(n))
    assert retuner.diagnose(*many_gaps(n)).cause is Cause.UNKNOWN


@pytest.mark.slow
def test_the_fewest_samples_that_are_enough_are_fitted() -> None:
    for n in range(20, 34):
        if not too_few(Window(*many_gaps(n))):
            assert retuner.identify(*many_gaps(n)).estimate.log.type
            retuner.diagnose(*many_gaps(n))


# Setpoint steps and the loads beside them in one likelihood: exact where theory gives the number


START = np.log([1 / 50, 5.0, 50.0, 1.0])  # slope gain, dead time, sum of the lags, second lag: near the bench's


def test_the_filter_leaves_of_its_own_process_what_was_never_foretold() -> None:
    """An autoregressive process of second order has two terms, and its innovations are what is left."""
    first, second, innovations = 1.5, -0.7, 0.25
    r = np.zeros(12)
    r[0] = innovations * (1 - second) / ((1 + second) * ((1 - second) ** 2 - first**2))  # Yule & Walker
    r[1] = first * r[0] / (1 - second)
    for k in range(2, 12):
        r[k] = first * r[k - 1] + second * r[k - 2]
    a, variance = whitening(r, 5)
    assert a == pytest.approx([1.0, -first, -second, 0.0, 0.0, 0.0], abs=1e-9)
    assert variance == pytest.approx(innovations)


@pytest.mark.parametrize(("kd", "filter_s"), [(0.0, 0.0), (3.0, 2.0)])
def test_process_and_controller_over_frequency_are_those_of_the_loop_in_time(kd: float, filter_s: float) -> None:
    law, n, dead_s = SampledLaw(PidGains(2.0, 0.05, kd), 1.0, 1.0, filter_s), 4096, 5.3
    p = np.array([math.log(0.02), math.log(dead_s), math.log(50.0), math.log(2.0)])
    held = math.exp(p[0]) * dynamics_at(TYPE, p).step(np.arange(n, dtype=np.float64) - dead_s)
    response = np.diff(setpoint_response(np.asarray(held), law), prepend=0.0)
    at = np.array([5, 100, 900])
    z1 = by_likelihood._z1()
    process, controller = by_likelihood._process(p, 1.0), by_likelihood._controller(law)
    from_sp = law.gains.kp + law.gains.ki * z1 / (1 - z1)
    seen = response @ z1[at] ** np.arange(n)[:, None]
    assert (process * from_sp / (1 + process * controller))[at] == pytest.approx(seen, abs=1e-6)


def likely(gains: float, walk: float, seed: int) -> Likely:
    own = sequences(2, walk, PidGains(gains, gains / 40, 0.0), seed=seed)
    found = Likelihood(own, 1, *LAW).best([START])
    assert found is not None
    return found


def test_of_a_loop_with_a_small_gain_the_loads_tell_the_process() -> None:
    """ln of the slope gain, where its controller hardly moves co, as surely as is claimed."""
    found = likely(0.6, WALK, seed=4)
    std = math.sqrt(found.own[0, 0])
    assert abs(found.p[0] - START[0]) <= 2.5 * std
    assert std < 0.5
    spread = math.exp(found.p[by_likelihood.LOAD]) / WALK
    assert 0.5 < spread < 2.0


def test_what_is_claimed_is_the_width_of_the_likelihood() -> None:
    own = sequences(2, WALK)
    likelihood = Likelihood(own, 1, *LAW)
    best = likelihood.best([START])
    assert best is not None
    at_one = [excess for _, excess in likelihood.around(best)][1 :: len(by_likelihood.AXES)]
    assert all(0.3 < excess < 2.5 for excess in at_one[:2])
    assert likelihood.around(best)[0][1] == 0.0


def test_the_middle_model_stands_for_ends_that_are_hardly_told_apart() -> None:
    ends = [(START + lag * np.eye(4)[2], 0.0) for lag in (-0.5, -0.2, 2.0)]
    assert middle(ends, 1, 1.0) == 1
    surely = [(x, 0.0 if i == 2 else 12.0) for i, (x, _) in enumerate(ends)]
    assert middle(surely, 1, 1.0) == 2


def test_a_loop_that_would_run_away_has_no_likelihood() -> None:
    (one,) = sequences(1, 0.01)
    likelihood = Likelihood([one], 1, *LAW)
    p = np.array([*START, math.log(WALK), math.log(0.1), 4.0])
    assert math.isfinite(likelihood.told(p).deviance)
    p[0] += math.log(30.0)
    assert math.isinf(likelihood.told(p).deviance)
    assert runs_away(np.array([0.0, 1.0, 0.0, 3.0]))
    assert not runs_away(np.array([0.0, 1.0, 1.2, 1.0]))


def test_what_no_record_tells_is_as_wide_as_of_any_process() -> None:
    """Of a loop at rest without a load nothing is told: the covariance stays finite, and so do the models in it."""
    (one,) = sequences(1, 0.0)
    quiet = replace(one, pv=tuple(0.001 * math.sin(i * i) for i in range(len(one.pv))))
    likelihood = Likelihood([quiet], 1, *LAW)
    p = np.array([-12.0, *START[1:], math.log(WALK), math.log(0.001), 4.0])
    curved = likelihood.curvature(p)
    own = np.linalg.inv(curved[1])[:4, :4]
    assert np.max(np.linalg.eigvalsh(own)) <= 1.0001 * by_likelihood.WIDEST**2
