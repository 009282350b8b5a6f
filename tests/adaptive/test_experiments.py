"""What records of experiments say: exact processes, printed examples, a real relay record, and what is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import printed, refused
from hypothesis import given
from hypothesis import strategies as st
from plain_recording import read_recording

from retuner.adaptive.experiments import relay, step
from retuner.adaptive.experiments.plan import (
    Experiment,
    LoopAtRest,
    Plan,
    RelayState,
    at_rest,
    enough,
    relay_output,
    relay_start,
)
from retuner.adaptive.experiments.relay import relay_cycle
from retuner.adaptive.experiments.step import swing
from retuner.adaptive.experiments.valve_test import STAIRCASE, read_valve_test, valve_positions
from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.cli import main
from retuner.drivers.plants.linear_plant import LinearPlant

SERVO = Path(__file__).parents[1] / "data" / "servo" / "relay.csv"


def plant(process: LinearProcess, noise: float, seed: int) -> LinearPlant:
    return LinearPlant(process, start_co=0.0, co_min=-1e9, co_max=1e9, noise=noise, seed=seed)


def step_record(
    process: LinearProcess, *, size: float = 2.0, dt: float = 0.1, n: int = 1500, noise: float = 0.0
) -> Window:
    machine = plant(process, noise, 1)
    co = [size if i >= 50 else 0.0 for i in range(n)]
    pv = [machine.step(u, 0.0, dt) for u in [0.0, *co[:-1]]]
    return Window(np.arange(n) * dt, np.zeros(n), np.array(pv) + 20.0, np.array(co) + 30.0)


def setpoint_record(
    process: LinearProcess, kc: float, *, size: float = 1.0, dt: float = 0.01, n: int = 4000, noise: float = 0.0
) -> Window:
    machine, co, rows = plant(process, noise, 2), 0.0, []
    for i in range(n):
        pv = machine.step(co, 0.0, dt)
        sp = size if i >= 100 else 0.0
        co = kc * (sp - pv)
        rows.append((i * dt, sp, pv, co))
    return Window(*np.array(rows).T)


def relay_record(
    process: LinearProcess,
    up: float,
    down: float,
    *,
    eps: float = 0.0,
    dt: float = 0.02,
    n: int = 4000,
    noise: float = 0.0,
    shift: float = 0.0,
) -> Window:
    machine, co, high, rows = plant(process, noise, 3), 0.0, True, []
    sign = math.copysign(1.0, process.k)
    for i in range(n):
        pv = machine.step(co, 0.0, dt)
        if i >= 50:
            error = -pv * sign
            high = True if error > eps else False if error < -eps else high
            co = up if high else -down
        rows.append((i * dt, shift, pv + shift, co + shift))
    return Window(*np.array(rows).T)


def ultimate(process: LinearProcess) -> tuple[float, float]:
    """Ku and Pu from the frequency response."""
    w = np.geomspace(1e-3, 1e2, 200001)
    phase = np.unwrap(np.angle(process.response(w) / process.k))
    i = int(np.argmax(phase < -math.pi))
    return 1 / abs(process.response(w[i : i + 1])[0]), 2 * math.pi / w[i]


# open-loop step


@pytest.mark.parametrize("method", ["two-point", "tangent"])
@pytest.mark.parametrize("process", [LinearProcess(1.5, (20.0,), (), 5.0), LinearProcess(-0.4, (8.0,), (), 12.0)])
def test_graphical_methods_find_first_order_with_dead_time(method: str, process: LinearProcess) -> None:
    found = step.model_by(step.StepMethod(method), step.step_response(step_record(process)))
    assert found.k == pytest.approx(process.k, rel=2e-3)
    assert found.tau1_s == pytest.approx(process.lags_s[0], rel=0.02)
    assert found.theta_s == pytest.approx(process.theta_s, abs=0.1)


@pytest.mark.parametrize("method", ["reaction-curve", "63-percent"])
def test_methods_by_the_start_of_the_response_see_it_at_two_per_cent(method: str) -> None:
    response = step.step_response(step_record(LinearProcess(1.5, (20.0,), (), 5.0)))
    found = step.model_by(step.StepMethod(method), response)
    late = -20.0 * math.log(1 - 0.02)
    assert found.theta_s == pytest.approx(5.0 + late, abs=0.1)
    assert found.tau1_s == pytest.approx(20.0 - (late if method == "63-percent" else 0.0), rel=0.02)


def test_two_point_times_on_two_equal_lags_are_those_of_the_exact_response() -> None:
    # 1 - (1 + x) e^-x is 28.3 % at x = 1.0483 and 63.2 % at x = 2.1462
    found = step.model_by(step.StepMethod.TWO_POINT, step.step_response(step_record(LinearProcess(1.0, (10.0, 10.0)))))
    assert found.tau1_s == pytest.approx(1.5 * 10 * (2.1462 - 1.0483), rel=0.01)
    assert found.theta_s == pytest.approx(21.462 - found.tau1_s, abs=0.15)


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("k", [0.05, -0.05])
def test_the_slope_of_a_ramp_gives_an_integrating_process(k: float, noise: float) -> None:
    record = step_record(LinearProcess(k, (), (), 4.0, 1), n=600, noise=noise)
    with pytest.raises(ValueError, match="not come to rest"):
        step.step_response(record)
    found = step.model_by(step.StepMethod.SLOPE, step.step_response(record, rest=False))
    assert found.type == ProcessType.INTEGRATING
    assert found.k == pytest.approx(k, rel=0.02 if not noise else 0.06)
    assert found.theta_s == pytest.approx(4.0, abs=0.1 if not noise else 1.5)


REFUSED_STEPS = {
    "no step": (lambda r: Window(r.t_s, r.sp, r.pv, r.co * 0 + 1), "no step"),
    "two steps": (lambda r: Window(r.t_s, r.sp, r.pv, r.co + (r.t_s > 60)), "more than one step"),
    "pv does not answer": (
        lambda r: Window(r.t_s, r.sp, r.pv * 0 + 1 + 0.1 * np.sin(1e4 * r.t_s), r.co),
        "larger step",
    ),
    "not at rest yet": (lambda r: Window(r.t_s[:300], r.sp[:300], r.pv[:300], r.co[:300]), "not come to rest"),
}


@pytest.mark.parametrize("case", REFUSED_STEPS)
def test_records_that_are_no_step_response_are_refused(case: str) -> None:
    change, words = REFUSED_STEPS[case]
    with pytest.raises(ValueError, match=words):
        step.step_response(change(step_record(LinearProcess(1.5, (20.0,), (), 5.0))))


# setpoint overshoot


def test_skogestad_grimholt_worked_example() -> None:
    """Process E2, Kc0 = 1.5: printed to two or three digits."""
    seen = step.Overshoot(1.0, 0.79, 0.54, 4.4)
    assert seen.dy_inf == pytest.approx(0.5985, abs=5e-5)
    assert seen.d == pytest.approx(0.32, abs=5e-3)
    assert seen.b == pytest.approx(0.67, abs=5e-3)
    assert seen.a == pytest.approx(0.6038, abs=5e-4)
    model = step.two_step_model(seen, 1.5)
    assert model.k == pytest.approx(0.994, abs=5e-4)
    assert model.theta_s == pytest.approx(1.67, abs=5e-3)
    assert model.tau1_s == pytest.approx(3.00, abs=5e-3)


def test_the_worked_example_is_seen_in_the_simulated_response() -> None:
    process = LinearProcess(1.0, (2.0, 1.0, 0.4, 0.2, 0.05, 0.05, 0.05), (-0.3, 0.08))
    seen = step.measure(setpoint_record(process, 1.5))
    assert (seen.dy_p, seen.dy_u) == pytest.approx((0.79, 0.54), abs=0.01)
    assert seen.t_p_s == pytest.approx(4.4, abs=0.06)


TABLE = {  # process: Kc0 for 30 % overshoot, t_p, b (tuning-rules digest, section 9)
    "tau 5": (LinearProcess(1.0, (5.0,), (), 1.0), 4.007, 3.02, 0.800),
    "tau 10": (LinearProcess(1.0, (10.0,), (), 1.0), 7.988, 3.14, 0.889),
    "integrating": (LinearProcess(1.0, (), (), 1.0, 1), 0.798, 3.29, 1.0),
}


@pytest.mark.parametrize("case", TABLE)
def test_thirty_per_cent_overshoot_table(case: str) -> None:
    process, kc0, t_p, b = TABLE[case]
    record = setpoint_record(process, kc0, dt=0.002, n=15000)
    seen = step.measure(record)
    final = b  # of a unit step
    assert (seen.dy_p - final) / final == pytest.approx(0.30, abs=2e-3)
    assert seen.t_p_s == pytest.approx(t_p, abs=0.006)
    assert seen.dy_inf == pytest.approx(final, rel=5e-3)
    model = step.two_step_model(seen, kc0)
    assert model.slope == pytest.approx(process.k / (process.lags_s[0] if process.lags_s else 1.0), rel=0.06)
    assert model.theta_s == pytest.approx(1.0, rel=0.05)
    assert model.type == (ProcessType.FOPDT if process.lags_s else ProcessType.INTEGRATING)


@pytest.mark.parametrize("case", TABLE)
def test_direct_settings_are_about_those_of_simc(case: str) -> None:
    process, kc0, _, _ = TABLE[case]
    direct = step.direct_settings(step.measure(setpoint_record(process, kc0)), kc0).to_dict()["gains"]
    best = simc(step.two_step_model(step.measure(setpoint_record(process, kc0)), kc0)).to_dict()["gains"]
    assert direct["kc"] == pytest.approx(best["kc"], rel=0.02)
    assert direct["tau_i"] == pytest.approx(best["tau_i"], rel=0.4)


@given(scale=st.floats(0.01, 100), gain=st.floats(0.01, 100), sign=st.sampled_from([-1, 1]))
def test_setpoint_method_scales_with_time_and_gain(scale: float, gain: float, sign: int) -> None:
    plain = step.two_step_model(step.Overshoot(1.0, 0.79, 0.54, 4.4), 1.5)
    scaled = step.two_step_model(step.Overshoot(-3.0, -2.37, -1.62, 4.4 * scale), sign * 1.5 / gain)
    assert scaled.k == pytest.approx(sign * plain.k * gain)
    assert (scaled.tau1_s, scaled.theta_s) == pytest.approx((plain.tau1_s * scale, plain.theta_s * scale))


@pytest.mark.parametrize("seed", range(20))
def test_noise_on_a_response_without_overshoot_is_no_peak(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(600.0)
    pv = np.where(t >= 30, 1 - np.exp(-np.maximum(t - 30, 0) / 60), 0.0) + 0.04 * rng.standard_normal(600)
    sp = np.where(t >= 30, 2.0, 0.0)
    with pytest.raises(ValueError, match="no overshoot"):
        step.measure(Window(t, sp, pv, 1.0 * (sp - pv)))


def test_setpoint_responses_that_say_nothing_are_refused() -> None:
    process = LinearProcess(1.0, (5.0,), (), 1.0)
    with pytest.raises(ValueError, match="no overshoot"):
        step.measure(setpoint_record(process, 1.0))
    with pytest.raises(ValueError, match="0 steps"):
        step.measure(step_record(process))
    small = step.Overshoot(1.0, 0.63, 0.60, 3.0)
    with pytest.raises(ValueError, match="larger gain"):
        step.two_step_model(small, 1.5)
    with pytest.raises(ValueError, match="smaller gain"):
        step.direct_settings(step.Overshoot(1.0, 1.5, 0.2, 3.0), 1.5)
    with pytest.raises(ValueError, match="kc0 = 0"):
        step.two_step_model(step.Overshoot(1.0, 0.79, 0.54, 4.4), 0.0)
    with pytest.raises(ValueError, match="beyond the undershoot"):
        step.Overshoot(1.0, 0.5, 0.6, 3.0)
    with pytest.raises(ValueError, match="not a finite"):
        step.Overshoot(1.0, math.nan, 0.6, 3.0)


# relay


RELAYS = {  # process: share by which the describing function may miss Ku
    "four lags": (LinearProcess(1.0, (1.0,) * 4), 0.05),
    "first order": (LinearProcess(1.0, (5.0,), (), 1.0), 0.20),
    "Putra's example": (LinearProcess(4.0, (7.0,), (), 3.5), 0.20),
    "integrating": (LinearProcess(1.0, (), (), 1.0, 1), 0.25),
}


@pytest.mark.parametrize("case", RELAYS)
def test_relay_gives_ultimate_gain_and_period(case: str) -> None:
    process, miss = RELAYS[case]
    cycle = relay_cycle(relay_record(process, 1.0, 1.0, dt=0.01, n=8000))
    ku, pu = ultimate(process)
    assert cycle.ku == pytest.approx(ku, rel=miss)
    assert cycle.pu_s == pytest.approx(pu, rel=0.08)
    assert cycle.ku_std < 0.02 * cycle.ku
    assert cycle.high_s == pytest.approx(cycle.low_s, abs=0.02)


def test_relay_formula_to_the_last_digit_on_a_drawn_wave() -> None:
    t = np.arange(0, 20, 0.01)
    co = np.where((t % 4.0) < 2.0, 5.0, -5.0)
    pv = 0.5 * np.sin(2 * math.pi * (t + 0.005) / 4.0)
    cycle = relay_cycle(Window(t, t * 0, pv, co), hysteresis=0.3)
    assert cycle.amplitude == pytest.approx(0.5, rel=1e-4)
    assert cycle.ku == pytest.approx(4 * 5 / (math.pi * 0.4), rel=2e-4)
    assert cycle.pu_s == pytest.approx(4.0)


def test_the_point_of_the_frequency_response_is_exact_where_the_describing_function_is_not() -> None:
    for process, _ in RELAYS.values():
        cycle = relay_cycle(relay_record(process, 1.0, 1.0, eps=0.05, dt=0.005, n=16000), 0.05)
        true = process.response(np.array([2 * math.pi / cycle.pu_s]))[0]
        assert cycle.gain == pytest.approx(abs(true), rel=0.01)
        assert cycle.phase_deg == pytest.approx(math.degrees(np.angle(true)) % 360 - 360, abs=1.0)


def test_noise_round_the_switching_point_needs_the_hysteresis() -> None:
    process = LinearProcess(1.0, (5.0,), (), 1.0)
    quiet = relay_cycle(relay_record(process, 1.0, 1.0, eps=0.06), 0.06)
    noisy = relay_cycle(relay_record(process, 1.0, 1.0, eps=0.06, noise=0.02, n=8000), 0.06)
    assert noisy.ku == pytest.approx(quiet.ku, rel=0.1)
    assert noisy.pu_s == pytest.approx(quiet.pu_s, rel=0.1)
    assert noisy.ku_std > 2 * quiet.ku_std
    chattering = relay_record(process, 1.0, 1.0, eps=0.0, noise=0.02, n=8000)
    switches = np.count_nonzero(np.diff(chattering.co))
    assert switches > 1.3 * np.count_nonzero(np.diff(relay_record(process, 1, 1, eps=0.06, noise=0.02, n=8000).co))


@pytest.mark.parametrize("eps", [0.0, 0.05])
@pytest.mark.parametrize(
    "process",
    [LinearProcess(1.0, (5.0,), (), 1.0), LinearProcess(-1.0, (1.0,), (), 1.0), LinearProcess(3.0, (1.0,), (), 2.0)],
)
def test_asymmetric_relay_finds_first_order_with_dead_time_exactly(process: LinearProcess, eps: float) -> None:
    cycle = relay_cycle(relay_record(process, 1.3, 0.7, eps=eps, dt=0.01, n=8000, shift=40.0), eps)
    model = relay.first_order(cycle, 40.0, 40.0)
    assert model.k == pytest.approx(process.k, rel=0.01)
    assert model.tau1_s == pytest.approx(process.lags_s[0], rel=0.03)
    assert model.theta_s == pytest.approx(process.theta_s, abs=0.02)  # up to two samples of switching delay


def test_asymmetric_relay_refuses_what_it_has_no_formula_for() -> None:
    process = LinearProcess(1.0, (5.0,), (), 1.0)
    with pytest.raises(ValueError, match="relay is symmetric"):
        relay.first_order(relay_cycle(relay_record(process, 1.0, 1.0)), 0.0, 0.0)
    integrating = relay_cycle(relay_record(LinearProcess(1.0, (), (), 1.0, 1), 1.3, 0.7))
    with pytest.raises(ValueError, match=r"use the fit|symmetric"):
        relay.first_order(integrating, 0.0, 0.0)


def test_the_real_servo_record_has_this_ultimate_gain_and_period() -> None:
    cycle = relay_cycle(read_recording(SERVO).window())
    # the record by hand: 5 full waves between 0.262 and 0.464 s, switchings 20 +- 2 ms apart, peaks 1 or 2 quanta of
    # 3.5 either side
    assert cycle.waves > 60
    assert cycle.pu_s == pytest.approx(0.041, abs=0.001)
    assert 0.001 < cycle.pu_std_s < 0.004
    assert 3.5 <= cycle.amplitude <= 5.3
    assert cycle.ku == pytest.approx(4 * 100 / (math.pi * cycle.amplitude))
    assert cycle.ku == pytest.approx(29, abs=4)
    assert 5 < cycle.ku_std < 15  # the encoder's quantum is of the size of the wave, and the spread says so


def test_a_setpoint_change_inside_the_record_makes_no_difference() -> None:
    window = read_recording(SERVO).window()
    part = window.t_s < 1.0  # before the change
    alone = relay_cycle(Window(window.t_s[part], window.sp[part], window.pv[part], window.co[part]))
    whole = relay_cycle(window)
    assert whole.pu_s == pytest.approx(alone.pu_s, rel=0.05)
    assert whole.ku == pytest.approx(alone.ku, rel=0.15)


REFUSED_RELAYS = {
    "never switched": (lambda r: replace(r, co=r.co * 0 + 1.0), "never switched"),
    "too short": (lambda r: Window(r.t_s[:300], r.sp[:300], r.pv[:300], r.co[:300]), "switches"),
    "not a relay": (lambda r: replace(r, co=np.sin(r.t_s)), "not what a relay"),
}


@pytest.mark.parametrize("case", REFUSED_RELAYS)
def test_records_without_a_limit_cycle_are_refused(case: str) -> None:
    change, words = REFUSED_RELAYS[case]
    with pytest.raises(ValueError, match=words):
        relay_cycle(change(relay_record(LinearProcess(1.0, (5.0,), (), 1.0), 1.0, 1.0)))


def test_hysteresis_as_high_as_the_wave_is_refused() -> None:
    record = relay_record(LinearProcess(1.0, (5.0,), (), 1.0), 1.0, 1.0)
    for hysteresis, words in ((0.2, "no more than the hysteresis"), (-0.1, "hysteresis = -0.1"), (math.nan, "nan")):
        with pytest.raises(ValueError, match=words):
            relay_cycle(record, hysteresis)


# sustained swing


@pytest.mark.parametrize(("share", "noise"), [(0.7, 0.0), (0.9, 0.0), (0.9, 0.02), (1.0, 0.0), (1.0, 0.02), (1.03, 0)])
def test_swing_under_proportional_control_shows_period_and_decay(share: float, noise: float) -> None:
    process = LinearProcess(4.0, (7.0,), (), 3.5)
    ku, pu = ultimate(process)
    seen = swing(setpoint_record(process, share * ku, dt=0.05, n=4000 if share > 0.8 else 2000, noise=noise))
    assert seen.period_s == pytest.approx(pu, rel=0.12)  # longer below the ultimate gain
    assert seen.sustained == (0.9 < share < 1.05)
    if share == 1.0:
        assert seen.period_s == pytest.approx(pu, rel=0.01)
        assert seen.decay == pytest.approx(1.0, abs=0.03)


@given(decay=st.floats(0.15, 1.2), period=st.floats(0.5, 20.0))
def test_decay_of_a_drawn_swing(decay: float, period: float) -> None:
    t = np.arange(0, 8, 0.01)
    pv = 3 + np.sin(2 * math.pi * t - 0.5) * decay**t
    seen = swing(Window(t * period, t * 0, pv, t * 0))
    assert seen.period_s == pytest.approx(period, rel=0.05)
    assert seen.decay == pytest.approx(decay, rel=0.1)
    assert ("Ku" in seen.verdict()) != (0.18 <= seen.decay <= 0.35)


def test_no_swing_is_refused() -> None:
    t = np.arange(0, 20, 0.1)
    with pytest.raises(ValueError, match="periods"):
        swing(Window(t, t * 0, 1 - np.exp(-t), t * 0))


# ---- The pure step functions of experiments on demand: rest, relay, when enough has been seen, settings out of
# range

PLAN = Plan(Experiment.RELAY, 10.0, 0.0, 100.0, rest_samples=30)
REST = LoopAtRest(50.0, 40.0, 0.1, 0.3)


def samples(pv: list[float], co: float = 40.0, sp: float = 50.0) -> list[LoopSample]:
    return [LoopSample(float(i), sp, value, co) for i, value in enumerate(pv)]


def noisy(n: int, sigma: float, slope: float = 0.0, seed: int = 1) -> list[float]:
    rng = np.random.default_rng(seed)
    return (50.0 + sigma * rng.standard_normal(n) + slope * np.arange(n)).tolist()


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.5])
def test_a_steady_loop_is_at_rest_whatever_its_noise(sigma: float) -> None:
    seen = [at_rest(PLAN, samples(noisy(60, sigma, seed=seed))) for seed in range(50)]
    assert sum(rest is not None for rest in seen) >= 48
    rest = next(r for r in seen if r is not None)
    assert rest.pv == pytest.approx(50.0, abs=0.5)
    assert rest.hysteresis == pytest.approx(3 * rest.sigma)


@given(slope=st.floats(0.05, 2.0), sign=st.sampled_from([-1, 1]))
def test_a_drifting_loop_is_not(slope: float, sign: int) -> None:
    assert at_rest(PLAN, samples(noisy(60, 0.01, sign * slope))) is None


def test_rest_needs_its_samples_and_one_setpoint_and_mode() -> None:
    assert at_rest(PLAN, samples([50.0] * 29)) is None
    moved = samples([50.0] * 20) + samples([50.0] * 20, sp=51.0)
    assert at_rest(PLAN, moved) is None
    assert at_rest(PLAN, samples([50.0] * 40)) == LoopAtRest(50.0, 40.0, 0.0, 0.0)
    assert at_rest(replace(PLAN, hysteresis=0.7), samples([50.0] * 40)) == LoopAtRest(50.0, 40.0, 0.0, 0.7)


@given(bias=st.floats(0.0, 0.8), amplitude=st.floats(0.1, 20.0))
def test_relay_levels_keep_the_amplitude(bias: float, amplitude: float) -> None:
    plan = replace(PLAN, bias=bias, amplitude=amplitude)
    high = relay_output(plan, RelayState(True, 0), REST)
    low = relay_output(plan, RelayState(False, 0), REST)
    assert (high - low) / 2 == pytest.approx(amplitude)
    assert high - 40.0 >= 40.0 - low - 1e-9
    assert (low, high) == pytest.approx(plan.co_levels(40.0))
    assert relay_start().high


def first_order(n: int, tau: float, gain: float = 5.0, delay: int = 5) -> list[float]:
    t = np.maximum(np.arange(n) - delay, 0)
    return (50.0 + gain * (1 - np.exp(-t / tau))).tolist()


@pytest.mark.parametrize("sigma", [0.0, 0.1])
@pytest.mark.parametrize("tau", [10.0, 40.0])
def test_a_step_is_over_when_the_response_has_come_to_rest_and_not_before(tau: float, sigma: float) -> None:
    plan, rest = Plan(Experiment.STEP, 5.0, 0.0, 100.0), LoopAtRest(50.0, 40.0, sigma, 0.0)
    noise = sigma * np.random.default_rng(4).standard_normal(1000)
    pv = (np.array(first_order(1000, tau)) + noise).tolist()
    ends = next(n for n in range(1, 1000) if enough(plan, samples(pv[:n]), rest, relay_start()))
    assert 3 * tau < ends < 9 * tau + 40
    assert abs(pv[ends] - 55.0) < 0.3 + 4 * sigma


def test_a_dead_time_is_not_rest() -> None:
    plan = Plan(Experiment.STEP, 5.0, 0.0, 100.0)
    assert not enough(plan, samples(noisy(500, 0.1)), REST, relay_start())


def test_a_ramp_is_over_when_it_has_gone_far_enough_of_its_band() -> None:
    plan = Plan(Experiment.STEP, 5.0, 0.0, 60.0)
    pv = [50.0 + 0.1 * i for i in range(200)]
    assert not enough(plan, samples(pv[:55]), REST, relay_start())
    assert enough(plan, samples(pv[:65]), REST, relay_start())


def test_a_swinging_setpoint_response_is_over_after_some_turns_and_a_peak_is_no_rest() -> None:
    plan = Plan(Experiment.SETPOINT, 1.0, 0.0, 100.0)
    t = np.arange(600)
    sustained = (51.0 - np.cos(2 * math.pi * t / 60)).tolist()
    ends = next(
        n for n in range(1, 600) if enough(plan, samples(sustained[:n]), LoopAtRest(50, 40, 0.0, 0.0), relay_start())
    )
    assert 100 < ends < 250
    dying = (51.0 - np.cos(2 * math.pi * t / 60) * np.exp(-t / 40)).tolist()
    ends = next(
        n for n in range(1, 600) if enough(plan, samples(dying[:n]), LoopAtRest(50, 40, 0.02, 0.0), relay_start())
    )
    assert ends > 90  # beyond the undershoot at 60


@pytest.mark.parametrize("cycles", [2, 7])
def test_a_relay_is_over_after_its_cycles(cycles: int) -> None:
    plan = replace(PLAN, cycles=cycles)
    assert not enough(plan, samples([50.0] * 9), REST, RelayState(True, 2 * cycles + 2))
    assert enough(plan, samples([50.0] * 9), REST, RelayState(True, 2 * cycles + 3))


@given(pv=st.floats(1.0, 99.0), deviation=st.floats(0.01, 200.0))
def test_the_band_about_rest_is_never_wider_than_either_limit(pv: float, deviation: float) -> None:
    plan = replace(PLAN, deviation=deviation).about(pv)
    assert PLAN.pv_low <= plan.pv_low < pv < plan.pv_high <= PLAN.pv_high
    assert plan.pv_high - plan.pv_low <= 2 * deviation * (1 + 1e-9)


# The valve test: staircases on simulated valves, read back; what is no valve test


STEP, HOLD = 0.5, 40
LEVELS = STEP * np.concatenate([[0.0], np.cumsum(STAIRCASE)])
FLOW = ProcessModel(ProcessType.FOPDT, 2.0, 10.0, theta_s=3.0)
TANK = ProcessModel(ProcessType.INTEGRATING, 0.05, theta_s=3.0)


def record(dead_band: float, resolution: float, seed: int, model: ProcessModel = FLOW, noise: float = 0.1) -> Window:
    """A test by hand with steps of 0.5 on a valve of that kind, which stands anywhere in its play at first."""
    rng, plant = np.random.default_rng(seed), HeldInput(model.linear(), 1.0)
    co = np.repeat(50.0 + LEVELS, HOLD)
    p = x = 50.0 + rng.uniform(-0.5, 0.5) * dead_band
    pv, moved = [], 0.0
    for u in co.tolist():
        pv.append(20.0 + moved + noise * rng.normal())
        p = min(max(p, u - dead_band / 2), u + dead_band / 2)
        if abs(p - x) >= resolution * (1 - 1e-9):
            x = p
        moved = plant.step(x - 50.0)
    t = np.arange(float(len(co)))
    return Window(t, np.full(len(co), 20.0), np.array(pv), co)


def test_the_staircase_leads_back_and_a_sound_valve_follows_it() -> None:
    assert sum(STAIRCASE) == 0
    assert valve_positions(LEVELS, 0.0, 0.0) == pytest.approx(LEVELS)
    assert np.ptp(valve_positions(LEVELS, 1.0, 0.0)) == pytest.approx(np.ptp(LEVELS) - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("model", [FLOW, TANK])
@pytest.mark.parametrize(("dead_band", "resolution"), [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (0.4, 0.0)])
def test_play_is_read_back_with_its_odds(model: ProcessModel, dead_band: float, resolution: float) -> None:
    for seed in range(6):
        found = read_valve_test(record(dead_band, resolution, seed, model))
        assert found.dead_band == pytest.approx(dead_band, abs=0.26)
        if dead_band:
            assert found.dead_band_odds > 0.9
        else:
            assert found.sound > 0.5


def test_a_valve_that_moves_in_jumps_has_a_resolution() -> None:
    for seed in range(6):
        found = read_valve_test(record(0.0, 1.0, seed))
        assert found.resolution_odds > 0.9
        assert 0.5 < found.resolution <= 1.0


def test_from_a_file_to_the_finding(tmp_path: Path) -> None:
    window = record(1.0, 0.0, 3)
    path = tmp_path / "valve.csv"
    rows = zip(window.t_s, window.pv, window.co, strict=True)
    path.write_text("t,pv,co\n" + "".join(f"{t:g},{pv:.4f},{co:.3f}\n" for t, pv, co in rows), encoding="utf-8")
    told = printed("experiment", "valve", "--from", path)
    assert told.startswith("THE VALVE DOES NOT FOLLOW")
    assert "dead band  1 of co" in told
    assert "+4, 4 x +0.5, 8 x -0.5, -2, 4 x -0.5, 8 x +0.5, -2" in printed("experiment", "valve", "--step", "0.5")
    assert "2 x +0.5, 2 x -0.5" in printed("experiment", "valve", "--step", "0.5", "--short")
    assert main(["experiment", "valve", "--step", "50"]) == 2
    assert "--hold: missing" in refused("experiment", "valve", "loop.toml")


def test_what_is_no_valve_test_is_refused() -> None:
    t, still = np.arange(400.0), np.full(400, 50.0)
    with pytest.raises(ValueError, match="co does not move"):
        read_valve_test(Window(t, still, still, still))
    with pytest.raises(ValueError, match="co is held 2 times"):
        read_valve_test(Window(t, still, still + t, still + 5.0 * (t > 200)))
    window = record(0.0, 0.0, 1)
    with pytest.raises(ValueError, match="pv does not move"):
        read_valve_test(Window(window.t_s, window.sp, np.full(len(window.pv), 20.0), window.co))
