"""Conversions between forms: exact both ways where they exist, refused where they do not."""

import cmath
import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from retuner.schedule.gains import (
    Form,
    IdealGains,
    PidGains,
    SeriesGains,
    from_form,
    in_form,
    proportional_band_pct,
    repeats_per_min,
    to_ideal,
    to_series,
)

magnitudes = st.floats(1e-6, 1e6)
gains_kc = st.builds(lambda size, sign: size * sign, magnitudes, st.sampled_from((1.0, -1.0)))
integral_times = st.none() | magnitudes
derivative_times = st.just(0.0) | magnitudes


def close(one: PidGains, two: PidGains, rel: float = 1e-12) -> bool:
    return all(
        math.isclose(a, b, rel_tol=rel, abs_tol=0.0) for a, b in ((one.kp, two.kp), (one.ki, two.ki), (one.kd, two.kd))
    )


def response(gains: PidGains, s: complex) -> complex:
    return gains.kp + gains.ki / s + gains.kd * s


@settings(deadline=None)
@given(gains_kc, integral_times, derivative_times, magnitudes)
def test_series_and_ideal_are_the_controllers_their_equations_say(kc, tau_i, tau_d, w):
    s = 1j * w
    integral = 0 if tau_i is None else 1 / (tau_i * s)
    series = kc * (1 + integral) * (1 + tau_d * s)
    ideal = kc * (1 + integral + tau_d * s)

    assert cmath.isclose(response(SeriesGains(kc, tau_i, tau_d).to_parallel(), s), series, rel_tol=1e-9)
    assert cmath.isclose(response(IdealGains(kc, tau_i, tau_d).to_parallel(), s), ideal, rel_tol=1e-9)


@settings(deadline=None)
@given(st.sampled_from(list(Form)), st.sampled_from(list(Form)), gains_kc, integral_times, derivative_times)
def test_round_trip_over_every_pair_of_forms(first, second, kc, tau_i, tau_d):
    """P, PI, PD, PID, direct and reverse acting: through any form and back it is the same controller."""
    gains = from_form(first, kc, tau_i, tau_d)
    try:
        there = in_form(gains, second)
    except ValueError:
        assert second is Form.SERIES
        assert first is not Form.SERIES
        assert tau_i is not None
        assert tau_i < 4 * tau_d * (1 + 1e-12)
        return
    assert there["kc"] is not None
    assert there["tau_d"] is not None
    back = from_form(second, there["kc"], there["tau_i"], there["tau_d"])

    assert close(back, gains)
    assert (there["tau_i"] is None) == (tau_i is None)
    assert (there["tau_d"] == 0) == (tau_d == 0)
    assert math.copysign(1, there["kc"]) == math.copysign(1, kc)


@settings(deadline=None)
@given(gains_kc, magnitudes, st.floats(1.0 + 1e-6, 1e6))
def test_series_numbers_come_back_themselves(kc, tau_d, ratio):
    """Not only the same controller: the same numbers, when tau_i > tau_d (the root is ill-conditioned at equality)."""
    series = SeriesGains(kc, tau_d * ratio, tau_d)
    back = to_series(series.to_parallel())
    rel = 1e-13 * (ratio + 1) / (ratio - 1)

    assert back.tau_i_s is not None
    assert math.isclose(back.kc, series.kc, rel_tol=rel)
    assert math.isclose(back.tau_i_s, tau_d * ratio, rel_tol=rel)
    assert math.isclose(back.tau_d_s, tau_d, rel_tol=rel)


@settings(deadline=None)
@given(gains_kc, magnitudes)
def test_the_double_root_exists_in_spite_of_rounding(kc, tau):
    gains = SeriesGains(kc, tau, tau).to_parallel()
    back = to_series(gains)

    assert close(back.to_parallel(), gains)
    assert back.tau_d_s == pytest.approx(tau, rel=1e-6)


def test_series_times_may_come_back_exchanged():
    back = to_series(SeriesGains(2.0, 1.0, 3.0).to_parallel())

    assert back.kc == pytest.approx(6.0)
    assert back.tau_i_s == pytest.approx(3.0)
    assert back.tau_d_s == pytest.approx(1.0)


def test_formulas_of_the_digest():
    """tuning-rules: f = 1 + tau_D/tau_I; K_p = K_c f; T_i = tau_I f; T_d = tau_D/f."""
    ideal = to_ideal(SeriesGains(1.299, 2.0, 1.2).to_parallel())

    assert ideal.kc == pytest.approx(1.299 * 1.6)
    assert ideal.tau_i_s == pytest.approx(3.2)
    assert ideal.tau_d_s == pytest.approx(0.75)


def test_no_series_form_below_four_tau_d():
    with pytest.raises(ValueError, match=r"tau_i = 3\.99 s is less than 4 tau_d = 4 s; use ideal or parallel"):
        to_series(IdealGains(1.0, 3.99, 1.0).to_parallel())

    assert to_series(IdealGains(1.0, 4.01, 1.0).to_parallel()).tau_i_s == pytest.approx(2.1, abs=0.1)


@pytest.mark.parametrize("form", list(Form))
def test_pure_integral_shows_no_gain(form):
    assert in_form(PidGains(0.0, -0.5, 0.0), form) == {"kc": 0.0, "tau_i": None, "tau_d": 0.0}


@pytest.mark.parametrize("convert", [to_ideal, to_series])
@pytest.mark.parametrize("gains", [PidGains(0.0, 1.0), PidGains(0.0, 0.0, 1.0), PidGains(0.0, -1.0, -1.0)])
def test_without_proportional_action_only_parallel_exists(convert, gains):
    with pytest.raises(ValueError, match="use parallel"):
        convert(gains)


@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize(
    ("kc", "tau_i", "tau_d", "what"),
    [
        (0.0, 1.0, 0.0, "kc = 0"),
        (math.nan, 1.0, 0.0, "kc = nan"),
        (math.inf, 1.0, 0.0, "kc = inf"),
        (1.0, 0.0, 0.0, "tau_i_s = 0.0"),
        (1.0, -1.0, 0.0, "tau_i_s = -1.0"),
        (1.0, math.inf, 0.0, "tau_i_s = inf"),
        (1.0, math.nan, 0.0, "tau_i_s = nan"),
        (1.0, 1.0, -1.0, "tau_d_s = -1.0"),
        (1.0, 1.0, math.nan, "tau_d_s = nan"),
        (1e-300, 1e300, 0.0, "rounds to 0"),
        (1e300, 1e-300, 0.0, "ki = inf"),
    ],
)
def test_what_is_no_controller_is_refused_by_name(form, kc, tau_i, tau_d, what):
    with pytest.raises(ValueError, match=what):
        from_form(form, kc, tau_i, tau_d)


@pytest.mark.parametrize("call", [lambda: from_form("isa", 1.0, 1.0), lambda: in_form(PidGains(1.0, 1.0), "Series")])
def test_unknown_form(call):
    with pytest.raises(ValueError, match="use series, ideal or parallel"):
        call()


@settings(deadline=None)
@given(gains_kc, magnitudes, magnitudes)
def test_proportional_band_round_trip(kc, pv_span, co_span):
    band = proportional_band_pct(kc, pv_span, co_span)
    assume(abs(band) < 1e300)

    assert math.isclose(proportional_band_pct(band, pv_span, co_span), kc, rel_tol=1e-14)  # the formula is its inverse
    assert math.copysign(1, band) == math.copysign(1, kc)


def test_proportional_band_of_a_known_loop():
    """50 % band on 0..200 degC: an error of half the span (100 degC) moves co over its 100 %."""
    assert proportional_band_pct(50.0, 200.0) == pytest.approx(1.0)
    assert proportional_band_pct(1.0, 200.0) == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("kc", "pv_span", "co_span"),
    [(0, 1, 1), (math.nan, 1, 1), (1, 0, 1), (1, 1, -1), (1, math.inf, 1), (1e-300, 1e-300, 1)],
)
def test_proportional_band_refuses(kc, pv_span, co_span):
    with pytest.raises(ValueError, match=r"must be|beyond"):
        proportional_band_pct(kc, pv_span, co_span)


@settings(deadline=None)
@given(integral_times)
def test_repeats_in_a_minute(tau_i):
    repeats = repeats_per_min(tau_i)

    assert repeats == 0 if tau_i is None else repeats * tau_i == pytest.approx(60.0, rel=1e-14)


def test_repeats_of_a_known_time():
    assert repeats_per_min(30.0) == 2.0


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_repeats_refuses(value):
    with pytest.raises(ValueError, match="positive finite"):
        repeats_per_min(value)


@pytest.mark.parametrize(
    ("gains", "what"),
    [((0.0, 0.0, 0.0), "all zero"), ((1.0, -1.0, 0.0), "different signs"), ((1.0, 0.0, math.nan), "kd = nan")],
)
def test_gains_refuse(gains, what):
    with pytest.raises(ValueError, match=what):
        PidGains(*gains)


@pytest.mark.parametrize("gains", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_direction_of_action(gains):
    assert PidGains(*gains).direction == 1
    assert PidGains(*(-g for g in gains)).direction == -1


def test_gains_are_printed_to_three_digits_and_represented_whole() -> None:
    gains = PidGains(-2.168500043904018, 0.0, -0.25)
    assert str(gains) == "kp -2.17, kd -0.25"
    assert repr(gains) == "PidGains(kp=-2.168500043904018, ki=0.0, kd=-0.25)"
