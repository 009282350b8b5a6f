"""The pattern rule: decays with known peaks, every reading reached, steps clamped, loops brought to their targets."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.without_model.pattern_rule import (
    MOVING,
    PatternAdvice,
    PatternReading,
    PatternSettings,
    pattern_numbers,
    pattern_rule,
)
from retuner.schedule.gains import PidGains

PI = PidGains(2.0, 2.0 / 30)  # tau_I = 30 s
BEFORE, N = 50, 1200
SETTINGS = PatternSettings()


def decay(s: float, period_s: float = 30.0) -> FloatArray:
    """Error of a second-order setpoint step: extremes every half period, each -s times the one before."""
    t = np.arange(N - BEFORE, dtype=np.float64)
    w, a = 2 * math.pi / period_s, -2 * math.log(s) / period_s
    return np.asarray(np.exp(-a * t) * (np.cos(w * t) + a / w * np.sin(w * t)))


def load_decay(s: float, period_s: float = 30.0) -> FloatArray:
    """Error after a load on the same loop."""
    t = np.arange(N - BEFORE, dtype=np.float64)
    return np.asarray(s ** (2 * t / period_s) * np.sin(2 * math.pi * t / period_s))


def made(error: FloatArray, *, setpoint: bool = True, dead: int = 5) -> Window:
    """A window with this error after the upset (dead samples later); co goes along, and never stands."""
    after = np.arange(N) >= BEFORE
    late = np.concatenate((np.zeros(BEFORE), np.full(dead, error[0]), error))[:N]
    e = np.pad(late, (0, N - len(late)))
    sp = np.where(after & setpoint, 1.0, 0.0)
    co = np.where(after, 1.0 + (0.5 if setpoint else -1.0) * e, 0.0) + 1e-6 * np.arange(N)
    return Window(np.arange(N, dtype=np.float64), sp, sp - e, co)


def seen(window: Window, *, band: float = 0.01, ending: Ending = Ending.QUIET) -> Response:
    """The response with its peaks, found in the noise-free error."""
    e = (window.sp - window.pv)[BEFORE:]
    signs = np.sign(np.where(np.abs(e) > band, e, 0.0))
    peaks: list[Peak] = []
    for i in np.flatnonzero(signs):
        peak = Peak(float(BEFORE + i), float(e[i]))
        if not peaks or np.sign(peaks[-1].e) != signs[i]:
            if len(peaks) == 3:
                break
            peaks.append(peak)
        elif abs(peak.e) > abs(peaks[-1].e):
            peaks[-1] = peak
    setpoint = bool(window.sp[-1])
    return Response(float(BEFORE), float(N - 1), tuple(peaks), ending, setpoint, band)


def advised(
    window: Window,
    gains: PidGains = PI,
    cause: Cause | None = None,
    settings: PatternSettings = SETTINGS,
    response: Response | None = None,
) -> PatternAdvice:
    diagnosis = Diagnosis(cause, 0.9, {}, f"because of {cause}") if cause else None
    return pattern_rule(response or seen(window), window, gains, diagnosis, settings)


def factor(advice: PatternAdvice, gains: PidGains = PI) -> tuple[float, float]:
    """On Kc and tau_I."""
    new = advice.tuning.gains
    return new.kp / gains.kp, (new.kp / new.ki) / (gains.kp / gains.ki)


@pytest.mark.parametrize("s", [0.1, 0.2, 0.3, 0.5, 0.7])
def test_a_second_order_decay_has_equal_overshoot_and_damping(s: float) -> None:
    window = made(decay(s), dead=0)
    numbers = pattern_numbers(seen(window), window).to_dict()
    assert numbers["overshoot"] == pytest.approx(s, rel=0.02)
    assert numbers["damping"] == pytest.approx(s, rel=0.02)
    assert numbers["period_s"] == pytest.approx(30.0)


def test_how_soon_pv_answers_is_seen_where_it_rested() -> None:
    window = made(decay(0.3), dead=12)
    assert pattern_numbers(seen(window), window).tenth_s == pytest.approx(12 + 3, abs=1)
    restless = Window(window.t_s, window.sp, window.pv + np.where(window.t_s < 40, 0.1, 0.0), window.co)
    assert pattern_numbers(seen(window), restless).tenth_s is None


def test_co_shows_the_overshoot_of_a_load_response_without_second_peak() -> None:
    t = np.arange(N - BEFORE, dtype=np.float64)
    error = t / 20 * np.exp(1 - t / 20)
    window = made(error, setpoint=False, dead=0)
    over = Window(window.t_s, window.sp, window.pv, np.where(window.t_s >= BEFORE, 1.0, 0.0))
    over.co[BEFORE + 40 : BEFORE + 60] = 1.3
    numbers = pattern_numbers(seen(over), over).to_dict()
    assert numbers["co_overshoot"] == pytest.approx(0.3, abs=0.02)
    assert numbers["rise_s"] == pytest.approx(20, abs=1)
    assert numbers["rebound"] == 0


T = np.arange(N - BEFORE) * 2 * math.pi / 200
KICKED = np.exp(-0.3 * T) * (np.cos(T) - 0.7 * np.sin(T))
UNEVEN = Response(50.0, 400.0, (Peak(60.0, 1.0), Peak(75.0, -0.4), Peak(160.0, 0.2)), Ending.COMPLETE, False, 0.01)
LOAD = made(load_decay(0.4), setpoint=False)
SLOW_LOAD = made(np.exp(-np.arange(N - BEFORE) / 80), setpoint=False)


def on_a_tail(window: Window) -> Window:
    """The same upset while pv is on its way back from the one before it."""
    return replace(window, pv=window.pv - np.where(window.t_s < BEFORE, 0.2, 0.0))


CASES: dict[PatternReading, PatternAdvice] = {
    PatternReading.LIVELY: advised(made(decay(0.5))),
    PatternReading.CALM: advised(made(decay(0.06))),
    PatternReading.OVERDAMPED: advised(made(decay(0.001))),
    PatternReading.SLOW: advised(made(KICKED, dead=2)),
    PatternReading.ON_TARGET: advised(made(decay(0.15))),
    PatternReading.OTHER_CAUSE: advised(made(decay(0.5)), cause=Cause.STICTION),
    PatternReading.CONTRADICTED: advised(made(decay(0.5)), cause=Cause.SLUGGISH),
    PatternReading.CUT_SHORT: advised(made(decay(0.5)), response=seen(made(decay(0.5)), ending=Ending.SETPOINT)),
    PatternReading.NO_ORDINARY: advised(
        made(decay(0.5)), response=replace(seen(made(decay(0.5))), peaks=(Peak(50, 1), Peak(65, -0.05), Peak(80, 0.9)))
    ),
    PatternReading.UNEVEN: advised(LOAD, response=UNEVEN),
    PatternReading.WEAK: advised(made(decay(0.5)), response=seen(made(decay(0.5)), band=0.2)),
    PatternReading.LIMITED: advised(replace(LOAD, co=np.minimum(LOAD.co, 0.8))),
    PatternReading.PULSE: advised(replace(LOAD, co=np.where(LOAD.t_s > 70, 1e-6 * LOAD.t_s, LOAD.co))),
    PatternReading.UNRESTED: advised(on_a_tail(SLOW_LOAD)),
    PatternReading.UNDYING: advised(made(decay(0.95))),
}


@pytest.mark.parametrize("reading", PatternReading)
def test_every_reading_is_reached_and_says_why(reading: PatternReading) -> None:
    advice = CASES[reading]
    assert advice.reading is reading
    assert (advice.tuning is not None) == (reading in MOVING)
    assert "{" not in advice.sentence
    if advice.tuning:
        assert "pattern" in advice.sentence
        assert advice.tuning.rule == "pattern"


def test_a_load_on_the_tail_of_another_asks_for_no_more_action() -> None:
    assert advised(SLOW_LOAD).reading is PatternReading.OVERDAMPED
    assert advised(on_a_tail(SLOW_LOAD)).tuning is None


@pytest.mark.parametrize("cause", Cause)
@pytest.mark.parametrize("s", [0.001, 0.5, 0.95])
def test_only_tuning_causes_may_move_gains_and_none_against_its_direction(cause: Cause, s: float) -> None:
    advice = advised(made(decay(s)), cause=cause)
    if cause not in {Cause.AGGRESSIVE, Cause.SLUGGISH, Cause.SLOW_INTEGRATING, Cause.UNKNOWN}:
        assert advice.reading is PatternReading.OTHER_CAUSE
    if advice.tuning:
        kc, tau_i = factor(advice)
        assert not (cause is Cause.AGGRESSIVE and kc / tau_i > 1)
        assert not (cause is Cause.SLUGGISH and kc / tau_i < 1)


def test_a_swing_that_does_not_decay_needs_a_diagnosis_or_nobody_else_to_ask() -> None:
    window = made(decay(0.95))
    assert advised(window).reading is PatternReading.UNDYING
    assert advised(window, cause=Cause.UNKNOWN).reading is PatternReading.UNDYING
    assert advised(window, cause=Cause.AGGRESSIVE).reading is PatternReading.LIVELY
    assert advised(window, settings=replace(SETTINGS, alone=True)).reading is PatternReading.LIVELY


def test_what_gives_way_follows_the_integrals_share_of_the_phase() -> None:
    window = made(decay(0.5))
    assert factor(advised(window, PidGains(2.0, 0.02)), PidGains(2.0, 0.02)) == pytest.approx((1 / 1.5, 1.0))
    short = PidGains(2.0, 2.0 / 5)
    assert factor(advised(window, short), short) == pytest.approx((1.0, 1.5))
    between = PidGains(2.0, 2.0 / 12)
    kc, tau_i = factor(advised(window, between), between)
    assert 1 / 1.5 < kc < 1 < tau_i < 1.5
    assert tau_i / kc == pytest.approx(1.5)


def test_a_growing_swing_loses_gain_at_once() -> None:
    growing = made(decay(1.2))
    kc, _ = factor(advised(growing, cause=Cause.AGGRESSIVE))
    assert kc == pytest.approx(1 / SETTINGS.urgent_step)


def test_a_long_return_after_a_load_shortens_the_integral_time_even_when_cut_short() -> None:
    t = np.arange(N - BEFORE, dtype=np.float64)
    window = made(np.minimum(t / 10, np.exp(-(t - 10) / 150)), setpoint=False)
    for ending in (Ending.QUIET, Ending.SETPOINT):
        assert factor(advised(window, response=seen(window, ending=ending))) == pytest.approx((1.0, 1 / 1.2))


def test_derivative_keeps_its_ratio_to_the_integral_time() -> None:
    pid = PidGains(2.0, 2.0 / 5, 2.0)
    new = advised(made(decay(0.5)), pid).tuning
    assert new.gains.kd * new.gains.ki / new.gains.kp**2 == pytest.approx(pid.kd * pid.ki / pid.kp**2)


@pytest.mark.parametrize("gains", [PidGains(0.0, 0.1), PidGains(2.0, 0.0), PidGains(-2.0, -0.1)])
def test_controllers_without_one_of_the_actions_are_moved_in_what_they_have(gains: PidGains) -> None:
    calmer = advised(made(decay(0.5)), gains).tuning
    assert calmer.gains.direction == gains.direction
    assert abs(calmer.gains.kp) <= abs(gains.kp)
    assert abs(calmer.gains.ki) <= abs(gains.ki)
    assert all(math.isfinite(value) for value in advised(made(decay(0.5)), gains).numbers.to_dict().values())
    assert (calmer.gains.kp == 0, calmer.gains.ki == 0) == (gains.kp == 0, gains.ki == 0)


@given(s=st.floats(0.02, 1.3), period=st.floats(8, 300), tau_i=st.floats(1, 1000), setpoint=st.booleans())
def test_steps_are_clamped_and_stay_away_from_the_dead_zone(s, period, tau_i, setpoint):
    window = made((decay if setpoint else load_decay)(s, period)[: int(4 * period)], setpoint=setpoint)
    gains = PidGains(1.0, 1.0 / tau_i)
    advice = advised(window, gains, settings=replace(SETTINGS, alone=True))
    if advice.tuning:
        kc, tau = factor(advice, gains)
        most = SETTINGS.urgent_step if s > 0.9 else SETTINGS.step_down
        assert 1 / most <= kc * (1 + 1e-9)
        assert kc <= SETTINGS.step_up * (1 + 1e-9)
        assert 1 / SETTINGS.step_up <= tau * (1 + 1e-9)
        assert tau <= most * (1 + 1e-9)
    if advice.reading in {PatternReading.LIVELY, PatternReading.CALM}:
        assert abs(advice.numbers.margin) > SETTINGS.dead_zone


@given(size=st.floats(1e-3, 1e3), time=st.floats(1e-2, 1e3), gain=st.floats(1e-3, 1e3), s=st.floats(0.05, 0.6))
def test_units_do_not_matter(size: float, time: float, gain: float, s: float) -> None:
    window = made(decay(s))
    there = Window(window.t_s * time, window.sp * size, window.pv * size, window.co * gain)
    peaks = tuple(Peak(p.t_s * time, p.e * size) for p in seen(window).peaks)
    response = replace(seen(window), t_start_s=BEFORE * time, t_end_s=(N - 1) * time, peaks=peaks, band=0.01 * size)
    gains = PidGains(PI.kp * gain / size, PI.ki * gain / size / time)
    here, other = advised(window), advised(there, gains, response=response)
    assert here.reading is other.reading
    if here.tuning:
        assert factor(here) == pytest.approx(factor(other, gains), rel=1e-6)


@given(
    e=st.lists(st.sampled_from([-1.0, 0.0, 0.1, 1.0]) | st.floats(-5, 5), min_size=3, max_size=60),
    co=st.lists(st.sampled_from([0.1, 0.3]) | st.floats(-100, 100), min_size=1, max_size=3),
    peaks=st.integers(0, 3),
    setpoint=st.booleans(),
    first=st.integers(0, 20),
    ending=st.sampled_from(Ending),
)
def test_whatever_was_recorded_the_numbers_are_finite_and_the_rule_answers(e, co, peaks, setpoint, first, ending):
    n = len(e)
    window = Window(np.arange(float(n)), np.zeros(n), -np.array(e), np.resize(np.array(co), n))
    found = tuple(Peak(float(i), (-1.0) ** i * (1 + i)) for i in range(peaks))
    response = Response(float(min(first, n - 1)), float(n - 1), found, ending, setpoint, 0.05)
    for gains in (PI, PidGains(0.0, 0.1), PidGains(2.0, 0.0)):
        advice = advised(window, gains, response=response)
        assert all(math.isfinite(value) for value in advice.numbers.to_dict().values())
        assert advice.sentence
