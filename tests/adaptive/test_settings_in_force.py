"""Controller settings recovered from records: the law's own records, rounded and limited ones, and a real servo."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_recording import read_recording

from retuner.adaptive.controller_settings.changed_settings import under_one_setting
from retuner.adaptive.controller_settings.read_off import SettingsInForce, settings_in_force, usable_increments
from retuner.adaptive.controller_settings.regression import Structure, by_levels
from retuner.adaptive.region_model.co_curve import CoCurve, added, before
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

SERVO = Path(__file__).parents[1] / "data" / "servo" / "pid_step.csv"


def record(
    gains: PidGains,
    *,
    b=1.0,
    tau_f_s=0.0,
    dt=1.0,
    n=800,
    noise=0.1,
    k=1.0,
    lag=20.0,
    theta=3,
    co_range=(0.0, 100.0),
    steps=(50.0, 53.0, 48.0),
    load=2.0,
    quantum=0.0,
    seed=0,
):
    """A loop under schedule.pid: setpoint steps, one load step, noise on the pv that the controller sees."""
    rng = np.random.default_rng(seed)
    rules = law(gains, b=b, tau_f_s=tau_f_s, co_min=co_range[0], co_max=co_range[1])
    pv, under_way, state = 50.0, [50.0] * (theta + 1), start(rules, 50.0, 50.0, 50.0)
    rows = np.zeros((n, 4))
    for i in range(n):
        sp = steps[i * len(steps) // n]
        seen = pv + noise * rng.normal()
        state, co = step(rules, state, sp, seen, dt)
        rows[i] = i * dt, sp, seen, co
        under_way.append(co)
        pv += dt / lag * (50.0 - pv + k * (under_way.pop(0) - 50.0) + (load if i > 0.55 * n else 0.0))
    if quantum:
        rows[:, 3] = np.round(rows[:, 3] / quantum) * quantum
    return Window(*rows.T.copy())


def deviations(found: SettingsInForce, gains: PidGains) -> list[float]:
    """Deviations in standard deviations."""
    assert found.gains is not None
    return [
        abs(getattr(found.gains, name) - getattr(gains, name)) / max(found.std[name], 1e-9) for name in ("kp", "ki")
    ]


@given(
    kp=st.floats(0.3, 1.5),
    tau_i=st.floats(10, 60),
    b=st.sampled_from([0.0, 0.5, 1.0]),
    sign=st.sampled_from([1, -1]),
    scale=st.sampled_from([0.01, 1.0, 60.0]),
    seed=st.integers(0, 9),
)
@settings(max_examples=examples(30))
def test_pi_settings_of_the_law_s_own_records_are_exact(kp, tau_i, b, sign, scale, seed):
    gains = PidGains(sign * kp, sign * kp / tau_i / scale)
    window = record(gains, b=b, dt=scale, lag=20 * scale, k=sign * 1.0, seed=seed)
    found = settings_in_force(window, 0, 100)
    # kp is told for an integral over the mean of two samples, the law integrates the last one: half of ki dt more
    assert found.gains.kp + found.gains.ki * scale / 2 == pytest.approx(gains.kp, rel=1e-6)
    assert found.gains.ki == pytest.approx(gains.ki, rel=1e-6)
    assert found.gains.kd == 0
    assert found.b is not None
    assert abs(found.b * found.gains.kp - b * gains.kp) < 0.6 * abs(gains.ki) * scale + 1e-9
    assert found.explained > 1 - 1e-9
    assert max(deviations(found, gains)) < 2


@given(
    kp=st.floats(0.3, 1.0),
    tau_i=st.floats(20, 60),
    tau_d=st.floats(2, 6),
    filtering=st.floats(0.2, 1.0),
    seed=st.integers(0, 9),
)
@settings(max_examples=examples(20))
def test_derivative_and_its_filter_are_found(kp, tau_i, tau_d, filtering, seed):
    gains = PidGains(kp, kp / tau_i, kp * tau_d)
    found = settings_in_force(record(gains, tau_f_s=filtering * tau_d, seed=seed), 0, 100)
    assert found.structure.derivative == "pv"
    assert found.gains.kd == pytest.approx(gains.kd, rel=1e-3)
    assert found.structure.tau_f_s == pytest.approx(filtering * tau_d, rel=1e-3)
    assert found.gains.ki == pytest.approx(gains.ki, rel=1e-3)


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_level_equation_takes_the_rounding_of_co():
    gains = PidGains(0.8, 0.8 / 25)
    inside = 0
    for seed in range(20):
        found = settings_in_force(record(gains, quantum=0.4, noise=0.3, seed=seed), 0, 100)
        assert found.gains.kp == pytest.approx(gains.kp, rel=0.08)
        assert found.gains.ki == pytest.approx(gains.ki, rel=0.05)
        inside += max(deviations(found, gains)) < 2
    assert inside >= 16  # of 20; both within two standard deviations


def test_proportional_and_integral_controllers_are_told_apart_from_pi():
    p_only = settings_in_force(record(PidGains(1.5, 0.0)), 0, 100)
    i_only = settings_in_force(record(PidGains(0.0, 0.02)), 0, 100)
    assert (p_only.gains.ki, i_only.gains.kp) == (0, 0)
    assert p_only.gains.kp == pytest.approx(1.5, rel=1e-9)
    assert i_only.gains.ki == pytest.approx(0.02, rel=1e-9)
    assert i_only.forms() == {}
    assert p_only.forms()["series"] == {"kc": pytest.approx(1.5), "tau_i": None, "tau_d": pytest.approx(0.0)}


def test_saturation_manual_and_bumps_are_left_out():
    gains = PidGains(3.0, 0.1)
    window = record(gains, steps=(50.0, 58.0, 47.0), noise=0.05, co_range=(38.0, 60.0))
    at_limit = (window.co <= 38) | (window.co >= 60)
    assert 0.02 < np.mean(at_limit) < 0.3
    co = window.co.copy()
    co[600:] += 5.0  # a person's hand, then the law goes on
    for limits in ((38.0, 60.0), (None, None)):
        found = settings_in_force(Window(window.t_s, window.sp, window.pv, co), *limits)
        assert found.gains.ki == pytest.approx(gains.ki, rel=0.02)
        assert found.gains.kp + found.gains.ki / 2 == pytest.approx(gains.kp, rel=0.02)


def test_a_filter_on_pv_is_found():
    gains = PidGains(0.8, 0.03)
    rules = law(gains)
    rng = np.random.default_rng(3)
    pv = 50 + np.cumsum(rng.normal(size=600)) * 0.1 + 0.2 * rng.normal(size=600)
    state, seen, rows = start(rules, 50, 50, 50), 50.0, []
    for i, value in enumerate(pv):
        seen += (value - seen) / (4.0 + 1.0)  # tau_f 4 s at 1 s: tau_f / dt + 1
        state, co = step(rules, state, 50, seen, 1.0)
        rows.append((float(i), 50.0, float(value), co))
    found = settings_in_force(Window(*np.array(rows).T.copy()), 0, 100)
    assert found.structure.pv_filter_s == pytest.approx(4.0, rel=0.01)
    assert found.gains.ki == pytest.approx(0.03, rel=0.01)


def test_pv_of_the_sample_before_is_recognised():
    window = record(PidGains(0.8, 0.03))
    late = Window(window.t_s[1:], window.sp[1:], window.pv[1:], window.co[:-1])
    found = settings_in_force(late, 0, 100)
    assert found.structure.lag == 1
    assert found.gains.ki == pytest.approx(0.03, rel=1e-6)


def test_of_a_long_record_the_busiest_stretch_is_taken():
    part = record(PidGains(0.8, 0.03), n=4000, noise=0.05)
    calm = np.full(6000, 50.0)
    window = Window(
        np.arange(10000.0),
        np.concatenate([calm, part.sp]),
        np.concatenate([calm, part.pv]),
        np.concatenate([calm, part.co]),
    )
    found = settings_in_force(window, 0, 100)
    assert found.samples <= 4000
    assert found.gains.ki == pytest.approx(0.03, rel=1e-3)


def test_the_real_servo_shows_its_settings():
    found = settings_in_force(read_recording(SERVO).window(), -100, 100)
    assert 10 * found.gains.kp == pytest.approx(9.26, rel=0.01)
    assert 10 * found.gains.ki == pytest.approx(13.0, rel=0.01)
    assert found.explained > 0.999
    assert found.to_dict()["samples"] > 2000


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda w: Window(w.t_s, w.sp, np.full_like(w.pv, 3.0), w.co), "dead signal"),
        (lambda w: Window(w.t_s, w.sp, w.pv, np.full_like(w.co, 3.0)), "co does not change"),
        (lambda w: Window(w.t_s, w.sp, np.roll(w.pv, 97), w.co), "only known"),
        (lambda w: Window(w.t_s, w.sp, w.pv, 50 + np.sin(w.t_s / 7) + np.sin(w.t_s / 19)), "explain"),
        (lambda w: Window(w.t_s[:40], w.sp[:40], w.pv[:40], w.co[:40]), "only 39 samples"),
        (lambda w: Window(w.t_s, w.sp, w.pv, np.clip(w.co, 50, 50.3)), "only 4 samples"),
        (lambda w: Window(w.t_s, w.sp, np.interp(w.t_s, w.t_s[::9], w.pv[::9]), w.co), "compressed 9 times"),
        (lambda w: Window(w.t_s, w.sp, w.pv, np.where(w.t_s < 400, w.co, 50 + 3 * (w.co - 50))), "first half"),
        (
            lambda w: Window(w.t_s, w.sp, w.pv, w.co - 0.03 * np.cumsum(np.where(w.t_s < 400, w.sp - w.pv, 0.0))),
            "or the integral was held",
        ),
    ],
)
def test_records_that_do_not_show_the_settings_are_refused_in_a_sentence(spoil, said):
    found = settings_in_force(spoil(record(PidGains(0.8, 0.03))))
    assert found.gains is None
    assert said in found.reason
    assert "\n" not in found.reason
    assert found.to_dict()["parallel"] is None


@pytest.mark.parametrize("sign", [1, -1])
def test_the_direction_is_told_where_the_size_is_not(sign):
    window = record(PidGains(sign * 0.8, sign * 0.03), k=sign * 1.0)
    rng = np.random.default_rng(1)
    found = settings_in_force(
        Window(window.t_s, window.sp, window.pv, window.co + 0.14 * np.cumsum(rng.normal(size=800)))
    )
    assert found.gains is None
    assert found.direction == sign
    assert settings_in_force(window).direction == sign


def test_a_record_in_which_the_law_made_no_move_says_nothing() -> None:
    t = np.arange(50.0)
    found = by_levels(Window(t, 0 * t, np.sin(t), np.cos(t)), Structure(), np.zeros(49, dtype=bool))
    assert found.explained == 0.0
    assert all(math.isinf(std) for std in found.std.values())


def test_noise_for_co_is_refused():
    rng = np.random.default_rng(5)
    window = Window(np.arange(500.0), np.full(500, 50.0), 50 + rng.normal(size=500), 50 + rng.normal(size=500))
    found = settings_in_force(window)
    assert found.gains is None
    assert found.direction is None
    assert math.isfinite(found.explained)


# ---- What several records say of a valve's curve

SLOPES = st.floats(-0.2, 0.2)
STDS = st.floats(1e-3, 1.0)


def test_nothing_is_known_before_a_record() -> None:
    found = before([], 40.0)
    assert found.slope == 0.0
    assert found.std == pytest.approx(1.4 / 40.0 * math.sqrt(0.5))


def test_records_that_agree_make_it_certain_and_one_does_not() -> None:
    one = CoCurve(0.034, 0.02)
    assert before([one], 40.0).slope < 0.5 * one.slope
    many = before([one] * 40, 40.0)
    assert many.slope == pytest.approx(0.034, rel=0.1)
    assert many.std < 0.01


def test_where_records_see_none_it_is_gone() -> None:
    found = before([CoCurve(0.002 * (-1) ** i, 0.01) for i in range(20)], 40.0)
    assert abs(found.slope) < 1e-4
    assert found.std < 0.002


@given(known=st.tuples(SLOPES, STDS), own=st.tuples(SLOPES, STDS))
def test_what_a_record_adds_is_what_it_says_by_itself(known: tuple[float, float], own: tuple[float, float]) -> None:
    before_it, record = CoCurve(*known), CoCurve(*own)
    precision = 1 / before_it.std**2 + 1 / record.std**2
    mean = (before_it.slope / before_it.std**2 + record.slope / record.std**2) / precision
    found = added(before_it, CoCurve(mean, 1 / math.sqrt(precision)))
    if found is None:
        assert record.std > 900 * before_it.std
    else:
        assert found.std == pytest.approx(record.std, rel=1e-2)
        assert found.slope == pytest.approx(record.slope, rel=1e-2, abs=1e-3 + 1e-2 * record.std)


@given(records=st.lists(st.tuples(SLOPES, STDS), max_size=5), travel=st.floats(1e-3, 1e4))
def test_it_says_no_more_than_the_records_said(records: list[tuple[float, float]], travel: float) -> None:
    found = before([CoCurve(*one) for one in records], travel)
    assert 0 < found.std < math.inf
    assert abs(found.slope) <= max([0.0, *(abs(slope) for slope, _ in records)])


@pytest.mark.parametrize(("slope", "std"), [(math.nan, 1.0), (0.0, 0.0), (0.0, math.inf), (math.inf, 1.0)])
def test_what_is_no_number_is_refused(slope: float, std: float) -> None:
    with pytest.raises(ValueError, match="co's curve"):
        CoCurve(slope, std)


@pytest.mark.parametrize(("row", "kp"), [(800, 0.4), (200, 0.4), (1400, 0.4), (800, 1.6)])
def test_a_record_is_parted_where_its_settings_were_changed(row: int, kp: float) -> None:
    first, second = record(PidGains(0.8, 0.04), seed=1), record(PidGains(kp, kp / 20.0), seed=2)
    rows = slice(800 - min(row, 800), None), slice(1600 - max(row, 800))
    values = {k: np.concatenate([getattr(first, k)[rows[0]], getattr(second, k)[rows[1]]]) for k in ("sp", "pv", "co")}
    both = Window(np.arange(len(values["pv"]), dtype=float), **values)
    parts = under_one_setting(both)
    assert [len(part.t_s) for part in parts] == [
        pytest.approx(800 - max(800 - row, 0), abs=3),
        pytest.approx(len(both.t_s) - min(row, 800), abs=3),
    ]
    assert [settings_in_force(part).gains.kp for part in parts] == [
        pytest.approx(0.8, rel=0.05),
        pytest.approx(kp, rel=0.05),
    ]


def test_a_record_under_one_law_is_not_parted() -> None:
    window = record(PidGains(0.8, 0.04), quantum=0.1)
    assert under_one_setting(window) == [window]


def test_an_end_of_the_range_that_a_kick_touches_once_is_no_move_of_the_law() -> None:
    window = record(PidGains(0.8, 0.04))
    touched = replace(window, co=np.where(np.arange(800) == 300, 100.0, window.co))
    usable = usable_increments(touched, None, None)
    assert np.flatnonzero(~usable).tolist() == [299, 300, 301]
