"""Limits, recording, condition and the screening as a whole."""

import math

import numpy as np
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.indexes.condition import Condition, one_sided, record_condition, still_stretches
from retuner.adaptive.indexes.glossary import GLOSSARY
from retuner.adaptive.indexes.harmonics import half_wave_shape, phase_deg, refined_frequency, tones
from retuner.adaptive.indexes.output_limits import at_limits
from retuner.adaptive.indexes.recording_quality import held_together, quantum, recording_quality
from retuner.adaptive.indexes.screening import (
    cross_correlation,
    ellipse,
    flat_share,
    jump_share,
    kurtosis,
    screen,
    yamashita,
)
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains

T = np.arange(1000.0)


def window(pv, co, sp=None) -> Window:
    """A record at one sample a second, setpoint 0 unless given."""
    n = len(pv)
    return Window(np.arange(float(n)), np.zeros(n) if sp is None else sp, pv, co)


def test_time_at_given_limits(wave):
    co = np.clip(60 * wave("sine"), -30, 45)
    found = at_limits(co, -30, 45)
    # asin(1/2)/pi and asin(3/4)/pi of a period are within
    assert found.low == pytest.approx(0.5 - math.asin(0.5) / math.pi, abs=0.02)
    assert found.high == pytest.approx(0.5 - math.asin(0.75) / math.pi, abs=0.02)
    assert (found.hit, found.given) == (2, True)
    assert at_limits(60 * wave("sine"), -100, 100).hit == 0


def test_limits_are_recognised_but_not_where_co_only_stands_still(wave):
    clipped = at_limits(np.clip(60 * wave("sine"), -30, 100))
    assert (clipped.low > 0.3, clipped.high, clipped.given) == (True, 0.0, False)
    assert at_limits(60 * wave("sine")).hit == 0
    assert at_limits(np.repeat([1.0, 2, 3, 2, 1, 3, 1, 3], 100)).hit == 0  # held values
    assert at_limits(np.ones(100)).hit == 0
    fades = np.append(0.9 ** np.arange(50), np.zeros(100))  # simulated without noise, it comes to rest
    assert at_limits(1.0 - fades, error=fades).hit == 0


def closed(rng, *, hand=lambda _: False, high=100.0, wound_up=False, n=900):
    """A tank of 100 s at 10 s under PI, setpoint to and fro, a load that wanders; a hand holds co at 40.38."""
    y, integral, load, past, rows = 50.0, 50.0, 0.0, [50.0] * 3, []
    for i in range(n):
        load += 0.5 * rng.normal()
        sp, pv = (50.0, 58.0)[(i // 150) % 2], y + 0.05 * rng.normal()
        wished = 2.0 * (sp - pv) + integral + 0.1 * (sp - pv)
        if hand(i):
            co = integral = 40.38
        else:
            co = min(wished, high)
            integral += 0.1 * (sp - pv) if wound_up or co == wished else 0.0
        past.append(co)
        y += (1 - math.exp(-0.1)) * (past[-3] + 0.1 * load - y)
        rows.append((sp, pv, co))
    sp, pv, co = np.array(rows).T
    return window(pv, co, sp)


@pytest.mark.parametrize("hand", [lambda i: i > 450, lambda i: (i // 150) % 2 == 1])
def test_co_that_a_hand_holds_is_at_no_limit(rng, hand):
    """It was called saturation: the controller output is at a limit for 50 % of the record."""
    assert screen(closed(rng, hand=hand), None).limits.hit == 0


@pytest.mark.parametrize("wound_up", [False, True])
def test_a_limit_is_one_though_the_error_comes_back_before_co_does(rng, wound_up):
    assert screen(closed(rng, high=56.0, wound_up=wound_up), None).limits.high > 0.3


def test_co_that_runs_by_its_integral_is_no_lack_of_integral_action(rng):
    """pv of a shut line lies at 0 beside a setpoint of 1 and wanders a little, co goes from 6 to 80."""
    n = 900
    pv, co = 0.001 * rng.normal(size=n) + 0.0003 * np.cumsum(rng.normal(size=n)), np.linspace(6.0, 80.0, n)
    assert record_condition(window(pv, co, np.ones(n))).condition is Condition.NO_RESPONSE
    slow = np.linspace(0.0, 0.1, n) + 0.001 * rng.normal(size=n)
    far = window(slow, 50.0 + 20.0 * (1.0 - slow), np.ones(n))  # proportional action alone
    assert record_condition(far).condition is Condition.NOT_CONTROLLING


@given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.integers(0, 5), st.sampled_from(["double", "single", "2 digits"]))
@settings(max_examples=examples(60))
def test_the_step_of_a_converter_is_found(wave, step, level, seed, written):
    rng = np.random.default_rng(seed)
    exact = np.round(20 * wave("sine") + rng.normal(size=1000)) * step + level * step
    written_as = {"double": exact, "single": np.float32(exact).astype(float)}
    x = written_as.get(written, np.round(exact / step * 100) / 100 * step)
    assert quantum(x) == pytest.approx(step, rel=0.01)


def test_no_step_where_there_is_none(rng):
    assert quantum(rng.normal(size=1000)) == 0
    assert quantum(np.repeat(rng.normal(size=100), 10)) == 0  # held, not rounded
    assert quantum(np.round(rng.normal(size=1000), 6)) == 0  # digits of a file
    assert quantum(np.repeat([1.0, 2.0], 50)) == 0


def test_compression_and_repetition(rng):
    corners = np.interp(np.arange(1001), np.arange(0, 1001, 10), rng.normal(size=101))
    found = recording_quality(corners)
    assert found.compression == pytest.approx(10, rel=0.05)
    held = recording_quality(np.repeat(rng.normal(size=100), 10))
    assert held.repeated == pytest.approx(0.9, abs=0.01)
    plain = recording_quality(rng.normal(size=1000))
    assert (plain.compression, plain.repeated) == (1, 0)
    assert plain.noise_share == pytest.approx(1, abs=0.15)
    assert recording_quality(np.ones(10)) is None
    rounded = recording_quality(np.round(5 * np.sin(np.arange(1000) / 50)))
    assert (rounded.quantum, rounded.compression) == (pytest.approx(1), 1)  # standing still is the converter's doing


def test_conditions(rng):
    noise = 0.01 * rng.normal(size=1000)
    moving, back = np.cumsum(rng.normal(size=1000)) / 10, np.sin(np.arange(1000) / 100.0)
    cases = {
        Condition.NORMAL: window(moving, np.roll(moving, 5)),
        Condition.DEAD_PV: window(np.full(1000, 3e-44), moving),
        Condition.DEAD_CO: window(moving, np.ones(1000)),
        Condition.NO_RESPONSE: window(noise + 0.1, np.cumsum(np.abs(moving))),
        Condition.MANUAL: window(moving, np.repeat([10.0, 20, 25, 5], 250)),
        Condition.NOT_CONTROLLING: window(moving + 50, np.roll(moving, 5)),
        Condition.MOVING_SETPOINT: window(moving, np.roll(moving, 5), moving + noise),
        Condition.QUIET: window(noise, -noise),
    }
    held = window(noise, np.cumsum(np.abs(moving)))
    assert record_condition(held).condition is Condition.NORMAL  # what does not answer stands beside its setpoint
    for stepped, condition in ((400, Condition.NO_RESPONSE), (997, Condition.QUIET)):  # the second leaves no time
        to = np.where(np.arange(1000) < stepped, 0.0, 1.0)
        assert record_condition(window(noise, back, to)).condition is condition
    for condition, record in cases.items():
        found = record_condition(record)
        assert found.condition == condition
        assert found.sentence
    assert {c.condition for c in map(record_condition, cases.values())} == set(Condition)


def test_an_oscillation_as_fast_as_the_averaging_is_not_quiet(wave, rng):
    tone = wave("sine", n=400, period=16.0) + 0.05 * rng.normal(size=400)
    found = screen(window(tone, -tone))
    assert found.condition.condition == Condition.NORMAL
    assert record_condition(window(tone, -tone)).condition == Condition.QUIET


def test_a_rounded_co_that_rests_for_a_while_is_not_manual(wave):
    co = np.round(wave("sine", period=300.0) * 2)
    assert still_stretches(co) == []
    assert record_condition(window(wave("sine", period=300.0), co)).condition == Condition.NORMAL
    assert still_stretches(np.repeat([1.0, 2.0], 200)) == [(0, 199), (200, 399)]


def test_screening_of_a_sticking_valve_and_of_a_tone(rng, wave):
    noise = 0.05 * rng.normal(size=(2, 1000))
    gains = PidGains(0.5, 0.5 / 20)
    valve = screen(window(wave("square") + noise[0], wave("triangle", phase=-0.25) + 0.2 * noise[1]), gains)
    tone = screen(window(wave("sine") + noise[0], -wave("sine", phase=0.1) + 0.2 * noise[1]), gains)
    for found in (valve, tone):
        assert found.oscillates
        assert found.period_s == pytest.approx(40, rel=0.01)
        assert found.evidence["period_to_tau_i"] == pytest.approx(2, rel=0.01)
    assert valve.evidence["triangle_co"] > 0.6
    assert tone.evidence["triangle_co"] < 0.4
    assert valve.evidence["jump_share"] > 0.3 > tone.evidence["jump_share"]
    assert valve.evidence["third_harmonic"] > 0.3
    assert tone.evidence["third_harmonic"] < 0.05
    assert valve.evidence["horch_drho"] > 0.67
    assert tone.evidence["horch_drho"] < 0.33
    assert tone.evidence["phase_deg"] == pytest.approx(-216, abs=2)


def test_every_number_has_its_words_and_no_word_is_idle(rng, wave):
    step = np.where(T < 300, 0.0, 1.0)
    followed = np.convolve(step, np.exp(-np.arange(60) / 20) / 20, "full")[:1000]
    seen = set(screen(window(followed + 0.01 * rng.normal(size=1000), followed * 2, step), PidGains(1, 0.1)).evidence)
    seen |= set(screen(window(wave("square"), wave("triangle")), PidGains(1, 0.1)).evidence)
    seen |= set(screen(window(np.exp(-T / 80), np.exp(-T / 80)), PidGains(1, 0.1)).evidence)
    damped = np.where(T < 300, 0, 1 - np.exp(-(T - 300) / 60) * np.cos((T - 300) / 15))
    seen |= set(screen(window(damped, damped, step), PidGains(1, 0.1)).evidence)
    assert seen == set(GLOSSARY)


@given(
    st.lists(st.sampled_from(["sine", "square", "noise", "constant", "ramp", "spike"]), min_size=3, max_size=3),
    st.integers(3, 300),
    st.integers(0, 5),
    st.floats(1e-12, 1e12),
)
@settings(max_examples=examples(150))
def test_any_record_gives_finite_numbers(wave, kinds, n, seed, scale):
    rng = np.random.default_rng(seed)
    shapes = {
        "noise": rng.normal(size=n),
        "constant": np.full(n, 0.1),
        "ramp": np.arange(float(n)),
        "spike": np.where(np.arange(n) == n // 2, 1.0, 0.0),
    }
    sp, pv, co = (scale * (shapes[k] if k in shapes else wave(k, n=n, period=17.0)) for k in kinds)
    found = screen(Window(np.arange(float(n)), sp, pv, co), PidGains(-1, -0.1))
    assert all(math.isfinite(v) for v in found.evidence.values())
    assert set(found.evidence) <= set(GLOSSARY)


def test_scale_and_level_do_not_matter(rng, wave):
    pv, co = wave("square") + 0.1 * rng.normal(size=1000), wave("triangle") + 0.1 * rng.normal(size=1000)
    small = screen(window(pv, co)).evidence
    large = screen(window(1e4 * pv, 1e-3 * co)).evidence
    in_units = {name for name, entry in GLOSSARY.items() if entry.unit in {"pv", "co"}}
    assert set(small) == set(large)
    for name in set(small) - in_units:
        assert large[name] == pytest.approx(small[name], rel=1e-6, abs=1e-9), name


def test_gaps_that_were_filled_with_the_last_values():
    rng = np.random.default_rng(8)
    pv, co = rng.normal(size=(2, 600))
    assert held_together(pv, co) is None
    rows = np.arange(600)
    last = np.where(rows % 60 < 40, rows, rows - rows % 60 + 39)  # of every 60 samples the last 20 repeat the 40th
    found = held_together(pv[last], co[last])
    assert found.share == pytest.approx(1 / 3, abs=0.01)
    assert found.samples == 20
    assert held_together(pv[last], co) is None  # a sensor that holds its value
    assert held_together(pv[last], np.roll(co[last], 13)) is None  # each compressed for itself
    assert held_together(np.zeros(600), np.zeros(600)) is None


def test_co_that_goes_one_way_without_bringing_pv_back():
    n, noise = 400, 0.05 * np.random.default_rng(9).normal(size=400)
    up, sp = np.linspace(10.0, 30.0, n), np.full(n, 5.0)
    share = one_sided(Window(np.arange(n), sp, 6.0 + noise, up))
    assert share == 1.0
    assert one_sided(Window(np.arange(n), sp, 5.0 + noise, up)) is None
    assert one_sided(Window(np.arange(n), sp, 6.0 + noise, up + 5 * np.sin(up))) is None
    assert one_sided(Window(np.arange(n), sp, 6.0 + noise, np.full(n, 10.0))) is None


# ---- Indexes of shape, non-linearity and movement on waves whose values are known

PERIOD = 40.0
W = 2 * math.pi / PERIOD


@pytest.mark.parametrize(
    ("kind", "third", "distortion", "even", "share", "peak"),
    [
        ("sine", 0, 0, 0, 1, 1.5),
        ("triangle", 1 / 9, math.hypot(1 / 9, 1 / 25), 0, 8 / math.pi**2 * 6 / 2 / (math.pi**2 / 4) / 1, 1.8),
        ("square", 1 / 3, math.hypot(1 / 3, 1 / 5), 0, 8 / math.pi**2, 1.0),
        ("saw", 1 / 3, math.sqrt(1 / 4 + 1 / 9 + 1 / 16 + 1 / 25), math.hypot(1 / 2, 1 / 4), 6 / math.pi**2, 1.8),
    ],
)
def test_fourier_series_of_the_waves(kind, third, distortion, even, share, peak, wave):
    found = tones(T, W, wave(kind))
    assert found[0].third == pytest.approx(third, abs=0.01)
    assert found[0].distortion == pytest.approx(distortion, abs=0.02)
    assert found[0].even == pytest.approx(even, abs=0.01)
    assert found[0].share == pytest.approx(share, abs=0.01)
    assert kurtosis(wave(kind)) == pytest.approx(peak, abs=0.02)


def test_kurtosis_of_noise_and_of_a_constant(rng):
    assert kurtosis(rng.normal(size=20000)) == pytest.approx(3.0, abs=0.15)
    assert kurtosis(np.full(100, 2.0)) is None


@pytest.mark.parametrize("degrees", [-170, -90, -45, 0, 60])
@pytest.mark.parametrize("direction", [1, -1])
def test_phase_and_frequency(rng, degrees, direction):
    period = 37.3
    w = 2 * math.pi / period
    co = 3 * np.sin(w * T) + 0.1 * rng.normal(size=1000)
    pv = direction * np.sin(w * T + math.radians(degrees)) + 0.1 * rng.normal(size=1000)
    refined = refined_frequency(T, pv, w * 1.02)
    assert refined == pytest.approx(w, rel=1e-3)
    found = tones(T, refined, pv, co)
    assert found is not None
    assert phase_deg(*found, direction) == pytest.approx(degrees, abs=2)


def test_tones_of_a_constant_are_none():
    assert tones(T, W, np.ones(1000)) is None


@pytest.mark.parametrize(
    ("kind", "low", "high"), [("sine", 0, 0.05), ("triangle", 0.95, 1), ("square", 0.3, 0.5), ("saw", 0.8, 1)]
)
def test_triangle_index(kind, low, high, wave):
    found = half_wave_shape(wave(kind), 0.2)
    assert low <= found.triangle_index <= high
    assert found.asymmetry == pytest.approx(0.4 if kind == "saw" else 0.0, abs=0.051 if kind != "square" else 0.5)


@pytest.mark.parametrize("tau", [0.1, 0.5, 2.0])
def test_relay_index_of_a_first_order_relay_cycle(tau, wave):
    """The half waves of a relay loop on a first-order process with delay, drawn from its formula."""
    switch = tau * math.log((1 + math.exp(1 / tau)) / 2)
    s = np.arange(1000) / 20 % 1.0
    peak = 1 - math.exp(-switch / tau)
    half = np.where(s < switch, 1 - np.exp(-s / tau), -1 + (1 + peak) * np.exp(-(s - switch) / tau))
    x = half * np.where(np.arange(1000) / 20 % 2 < 1, 1, -1)
    found = half_wave_shape(x, 0.05)
    assert found.relay_index > 0.6
    sine = half_wave_shape(wave("sine"), 0.2)
    assert sine.relay_index < -0.8


def test_half_waves_need_two_periods_and_four_samples(rng, wave):
    assert half_wave_shape(wave("sine", n=50), 0.2) is None
    assert half_wave_shape(wave("sine", period=6.0), 0.2) is None
    assert half_wave_shape(rng.normal(size=500), 10.0) is None


def test_horch_odd_and_even(wave):
    valve = cross_correlation(wave("square"), wave("triangle", phase=-0.25))  # co is the integral of pv
    dtau, drho = valve
    assert dtau > 0.9
    assert drho > 0.75
    tone = cross_correlation(-wave("sine"), wave("sine"))
    assert tone == pytest.approx((0.0, 0.0), abs=0.02)
    assert cross_correlation(np.zeros(100), wave("sine", n=100)) is None


def test_ellipse_of_two_sines_and_of_a_square_wave_over_a_triangle(rng, wave):
    for phase in (30, 90, 150):
        found = ellipse(np.sin(W * T - math.radians(phase)), 2 * np.sin(W * T))
        stick_band, roundness = found
        assert stick_band == pytest.approx(4 * abs(math.sin(math.radians(phase))), rel=0.01)
        assert roundness < 0.05
    found = ellipse(wave("square"), wave("triangle", phase=-0.25))
    assert found[1] == pytest.approx(math.sqrt(9 / 5 - 1) / 2, abs=0.03)  # std of 3 u^2, u even in -1..1, over 2
    noise = ellipse(rng.normal(size=20000), rng.normal(size=20000))
    assert noise[1] == pytest.approx(1.0, abs=0.05)
    assert ellipse(T, T) is None
    assert ellipse(wave("sine"), wave("sine")) is None


def test_yamashita_by_hand_by_chance_and_with_a_stuck_valve(rng, wave):
    # increments of co: + + 0 - -, of pv: 0 + 0 0 -  ->  moving 4, standing with co moving 2 (IS then II, DS then DD)
    co = np.cumsum([0, 1, 1, 0, -1, -1.0])
    pv = np.cumsum([0, 0, 1, 0, 0, -1.0])
    assert yamashita(pv, co) == (pytest.approx(0.5), pytest.approx(0.5))
    # IS followed by DD: pv goes with co's turn, no valve does that
    assert yamashita(np.array([0, 0, -1.0]), np.array([0, 1, 0.0])) == (pytest.approx(0.5), pytest.approx(0.0))
    by_chance = yamashita(rng.normal(size=20000), rng.normal(size=20000))
    assert by_chance[0] == pytest.approx(0.25, abs=0.02)
    stuck = yamashita(wave("square"), wave("triangle", phase=-0.25))
    assert stuck is not None
    assert min(stuck) > 0.8
    assert yamashita(np.ones(10), np.ones(10)) is None


def test_jumps_and_flat_stretches(rng, wave):
    square, triangle = wave("square"), wave("triangle", phase=-0.25)
    assert jump_share(square, triangle) == pytest.approx(1 - 0.05, abs=0.01)
    assert flat_share(square, triangle, 2) > 0.85
    assert flat_share(wave("sine", phase=-0.1), wave("sine"), 2) == pytest.approx(0, abs=0.1)
    # the largest twentieth of |N(0,1)| holds exp(-1.96^2 / 2) of the travel
    noise = jump_share(rng.normal(size=40001), T.repeat(41)[:40001] * 0 + np.arange(40001))
    assert noise == pytest.approx(math.exp(-(1.96**2) / 2) - 0.05, abs=0.01)
    assert jump_share(np.ones(100), np.ones(100)) is None
    assert flat_share(np.ones(100), np.ones(100), 5) is None
