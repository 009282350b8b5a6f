"""Conversions between forms: exact both ways where they exist, refused where they do not."""

import cmath
import math
import struct

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from retuner.schedule.controller_units import NAMES, Acting, ControllerUnits
from retuner.schedule.dials import CONTROLLERS
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
from retuner.schedule.vendor_units import Quantity, StorableNumbers, VendorGain, VendorUnits

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


@given(gains_kc, integral_times, derivative_times, magnitudes)
def test_series_and_ideal_are_the_controllers_their_equations_say(kc, tau_i, tau_d, w):
    s = 1j * w
    integral = 0 if tau_i is None else 1 / (tau_i * s)
    series = kc * (1 + integral) * (1 + tau_d * s)
    ideal = kc * (1 + integral + tau_d * s)

    assert cmath.isclose(response(SeriesGains(kc, tau_i, tau_d).to_parallel(), s), series, rel_tol=1e-9)
    assert cmath.isclose(response(IdealGains(kc, tau_i, tau_d).to_parallel(), s), ideal, rel_tol=1e-9)


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


# ---- Gains in a vendor's form and units: what they come to, what rounding makes of them, which sets lie between

WORD = StorableNumbers(0, 65535, 1.0)


def controller(*, series: bool = False) -> VendorUnits:
    """Proportional band in 0.1 %, times in seconds, a message each: as CiA 404 has them."""
    gains = (
        VendorGain(Quantity.XP, 0.1, WORD, 0),
        VendorGain(Quantity.TN, 1.0, WORD, 1, off=0.0),
        VendorGain(Quantity.TV, 1.0, WORD, 2, off=0.0),
    )
    return VendorUnits(gains, pv_span=200.0, co_span=100.0, series=series)


def test_a_proportional_band_is_told_of_the_span() -> None:
    # kc = 2 %/K over 200 K and 100 %: the whole output in 50 K, 25 % of the span
    assert controller().numbers(IdealGains(2.0, 90.0, 15.0).to_parallel()) == {"xp": 250.0, "tn": 90.0, "tv": 15.0}
    assert controller().of({"xp": 250.0, "tn": 90.0, "tv": 15.0}) == IdealGains(2.0, 90.0, 15.0).to_parallel()


def test_series_numbers_are_those_of_the_series_form() -> None:
    gains = SeriesGains(2.0, 90.0, 15.0).to_parallel()
    assert controller(series=True).numbers(gains) == {"xp": 250.0, "tn": 90.0, "tv": 15.0}
    assert controller().numbers(gains) != controller(series=True).numbers(gains)


@given(st.floats(0.02, 50.0), st.floats(1.0, 5000.0), st.floats(0.0, 500.0))
def test_what_is_held_is_held_again_and_near(kc: float, tau_i: float, tau_d: float) -> None:
    units = controller()
    held = units.rounded(IdealGains(kc, tau_i, tau_d).to_parallel())
    assert units.rounded(held) == held
    assert abs(held.kp / kc - 1) < 0.06  # half a step of 0.1 % in a band of at least 1 %


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_float32_gains_are_rounded_as_the_wire_rounds(kp: float, ki: float) -> None:
    units = VendorUnits(
        (
            VendorGain(Quantity.KP, holds=StorableNumbers(single=True)),
            VendorGain(Quantity.KI, holds=StorableNumbers(single=True)),
        )
    )
    assert units.rounded(PidGains(kp, ki)) == PidGains(*struct.unpack("<ff", struct.pack("<ff", kp, ki)))
    assert units.atomic


def test_without_integral_action_the_number_that_says_so_is_kept() -> None:
    assert controller().numbers(PidGains(2.0, 0.0)) == {"xp": 250.0, "tn": 0.0, "tv": 0.0}
    assert controller().of({"xp": 250.0, "tn": 0.0, "tv": 0.0}) == PidGains(2.0, 0.0)
    plain = VendorUnits((VendorGain(Quantity.KP), VendorGain(Quantity.TN)))
    with pytest.raises(ValueError, match="no integral action, and the controller has no number for that"):
        plain.numbers(PidGains(2.0, 0.0))


def test_repeats_per_minute_and_milliseconds() -> None:
    gains = (VendorGain(Quantity.KP, 0.01), VendorGain(Quantity.REPEATS), VendorGain(Quantity.TV, 1e-3))
    assert VendorUnits(gains).numbers(IdealGains(2.0, 30.0, 0.5).to_parallel()) == {
        "kp": 200.0,
        "repeats": 2.0,
        "tv": 500.0,
    }


@pytest.mark.parametrize(
    ("gains", "reason"),
    [
        (PidGains(0.005, 0.001), "outside 0 to 65535"),
        (PidGains(2.0, 20.0), "rounded to 0"),
        (PidGains(-2.0, -0.1), "outside 0 to 65535"),
        (PidGains(0.0, 0.1), "no ideal or series form"),
    ],
)
def test_what_cannot_be_held_is_refused_with_the_reason(gains: PidGains, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        controller().numbers(gains)


def test_an_action_without_a_number_is_refused() -> None:
    units = VendorUnits((VendorGain(Quantity.KP), VendorGain(Quantity.KI)))
    with pytest.raises(ValueError, match="no number for derivative"):
        units.numbers(PidGains(1.0, 0.1, 0.5))


@pytest.mark.parametrize("quantities", [("ki",), ("kp", "xp"), ("kp", "ki", "tn")])
def test_one_number_an_action(quantities: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="give"):
        VendorUnits(tuple(VendorGain(Quantity(name)) for name in quantities))


def test_the_ways_name_every_order_and_the_sets_between() -> None:
    units = controller()
    old, new = {"xp": 250.0, "tn": 90.0, "tv": 15.0}, {"xp": 125.0, "tn": 45.0, "tv": 15.0}
    ways = {way.messages: way.between for way in units.ways(old, new)}
    assert ways == {
        (0, 1): (IdealGains(4.0, 90.0, 15.0).to_parallel(),),
        (1, 0): (IdealGains(2.0, 45.0, 15.0).to_parallel(),),
    }


def test_numbers_that_are_no_controller_are_refused() -> None:
    for numbers in ({"xp": 0.0, "tn": 1.0, "tv": 0.0}, {"xp": math.nan, "tn": 1.0, "tv": 0.0}):
        with pytest.raises(ValueError, match=r"kc|finite"):
            controller().of(numbers)


# Gains in the units of the trade: there and back, the analytic values, the action, and what is refused


SPANS = st.floats(1e-2, 1e4)
ORDINARY = st.floats(1e-4, 1e4)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("kc-s", (2.0, 20.0)),
        ("kc-min", (2.0, 1 / 3)),
        ("gain-s", (4.0, 20.0)),  # 2 %/degC over 200 degC: 4 % of span for one
        ("pb-rpm", (25.0, 3.0)),  # 100/4 percent; once in 20 s
        ("pb-min", (25.0, 1 / 3)),
        ("parallel", (2.0, 0.1)),
    ],
)
def test_known_numbers(name: str, numbers: tuple[float, float]) -> None:
    shown = ControllerUnits.named(name, pv_span=200.0).numbers(PidGains(2.0, 0.1))
    assert shown[:2] == pytest.approx(numbers)


def test_a_controller_without_integral_action_says_so() -> None:
    for name in NAMES:
        units = ControllerUnits.named(name, 200.0)
        shown = units.numbers(PidGains(2.0, 0.0))
        assert shown.integral is None
        assert units.gains(shown.gain) == PidGains(2.0, 0.0)


def test_the_action_is_a_word_and_the_numbers_are_positive() -> None:
    cooling = PidGains(-2.0, -0.1)
    units = ControllerUnits.named("pb-rpm", 200.0, action="direct")
    assert units.text(cooling) == "PB 25 % reset 3 repeats/min"
    assert units.text(cooling, acting=True) == "PB 25 % reset 3 repeats/min, direct acting"
    assert ControllerUnits.named("kc-s").text(cooling, acting=True) == "Kc -2 tau_I 20 s, direct acting"
    assert units.gains(25.0, 3.0) == cooling
    with pytest.raises(ValueError, match="give a positive number"):
        units.gains(-25.0, 3.0)
    heating = PidGains(2.0, 0.1)
    assert units.numbers(heating).gain == -25.0
    assert units.text(heating) == "PB 25 % reset 3 repeats/min, reverse acting (the controller is set to direct)"
    assert ControllerUnits.named("pb-rpm", 200.0).numbers(cooling).gain == -25.0


def test_what_has_no_form_of_its_own_is_shown_in_another_by_name() -> None:
    swinging = PidGains(1.0, 1.0, 1.0)  # tau_I 1 s, tau_D 1 s: no series form
    shown = ControllerUnits.named("kc-s").numbers(swinging)
    assert shown == (1.0, 1.0, 1.0, Form.IDEAL)
    assert ControllerUnits.named("kc-s").text(swinging) == "Kc 1 tau_I 1 s tau_D 1 s (ideal)"
    assert ControllerUnits.named("pb-min", 50.0).text(PidGains(0.0, 0.5)) == "Ki 0.5/s (integral only)"
    assert ControllerUnits.named("parallel").text(PidGains(0.0, 0.5)) == "kp 0 ki 0.5/s"


def test_a_table_says_what_its_numbers_are() -> None:
    assert ControllerUnits().heads == "Kc, tau_I in s"
    assert ControllerUnits.named("pb-rpm", 200.0).heads == "PB in %, reset in repeats/min"
    assert ControllerUnits.named("parallel").heads == "kp, ki in/s, kd in s"


def test_a_narrow_table_has_the_numbers_alone() -> None:
    units = ControllerUnits.named("pb-rpm", 200.0)
    assert units.short(PidGains(2.0, 0.1)) == "25, 3"
    assert units.short(SeriesGains(2.0, 20.0, 3.0).to_parallel()) == "25, 3, 0.05 (series)"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_finite_is_refused(name: str, place: int, bad: float) -> None:
    numbers = [2.0, 3.0, 0.1]
    numbers[place] = bad
    with pytest.raises(ValueError, match="not a finite number"):
        ControllerUnits.named(name, 200.0).gains(*numbers)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("pb",), "use kc-s"),
        (("",), "use kc-s"),
        (("pb-h", 1.0), "use kc-s"),
        (("parallel-min",), "use kc-s"),
        (("pb-rpm",), "give pv_span"),
        (("gain-s", 0.0), "pv_span = 0.0"),
        (("gain-s", math.nan), "pv_span = nan"),
        (("gain-s", 1.0, math.inf), "co_span = inf"),
        (("kc-s", None, 100.0, "sideways"), "direct"),
    ],
)
def test_what_are_no_units_is_refused(arguments: tuple[object, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        ControllerUnits.named(*arguments)


@pytest.mark.parametrize("numbers", [(0.0, 1.0), (2.0, -1.0), (2.0, 0.0), (2.0, 1.0, -1.0)])
def test_what_makes_no_controller_is_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"nothing|positive|negative|tau"):
        ControllerUnits.named("kc-min").gains(*numbers)


SET = PidGains(2.0, 0.1, 10.0)  # ideal: Kc 2, tau_I 20 s, tau_D 5 s
LED = SeriesGains(2.0, 40.0, 5.0)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [  # pv over 200 units, output over 100 %: a gain of 2 %/unit is 4 of the scaled signals, a band of 25 %
        ("deltav-standard", (4.0, 20.0, 5.0)),
        ("honeywell-a", (4.0, 20.0 / 60, 5.0 / 60)),
        ("siemens-cont-c", (2.0, 20.0, 5.0)),
        ("siemens-pid-compact", (2.0, 20.0, 5.0)),
        ("yokogawa", (25.0, 20.0, 5.0)),
        ("rockwell-pide", (4.0, 0.2 * 60, 20.0 / 60)),
        ("rockwell-pide-dependent", (4.0, 20.0 / 60, 5.0 / 60)),
        ("abb-800xa", (4.0, 20.0, 5.0)),
        ("abb-fc19", (2.0, 3.0, 5.0 / 60)),
        ("ovation", (4.0, 5.0, 20.0)),
        ("ardupilot", (2.0, 0.1, 10.0)),
        ("px4", (2.0, 0.1, 10.0)),
    ],
)
def test_what_stands_on_a_vendors_controller(name: str, numbers: tuple[float, float, float]) -> None:
    shown = ControllerUnits.named(name, pv_span=200.0).numbers(SET)
    assert shown[:3] == pytest.approx(numbers)
    assert shown.form == CONTROLLERS[name].form


@pytest.mark.parametrize(
    ("form", "gain", "reset", "rate"), [("series", 4.0, 40.0, 5.0), ("standard", 4.5, 45.0, 40 / 9)]
)
def test_deltav_has_two_forms(form: str, gain: float, reset: float, rate: float) -> None:
    """Kc (1 + Td/Ti), Ti + Td, Ti Td/(Ti + Td): the ideal form of a series controller."""
    shown = ControllerUnits.named(f"DeltaV_{form}", pv_span=200.0).numbers(LED.to_parallel())
    assert shown[:3] == pytest.approx((gain, reset, rate))


@given(
    name=st.sampled_from([*NAMES, *(name for name in CONTROLLERS if name != "odrive")]),
    sets=st.tuples(ORDINARY, ORDINARY, st.floats(0.0, 0.9)),
    spans=st.tuples(SPANS, SPANS),
    sign=st.sampled_from([-1, 1]),
    acting=st.booleans(),
)
def test_there_and_back_on_every_vendors_controller(name, sets, spans, sign, acting):
    kc, tau_i, share = sets
    gains = SeriesGains(sign * kc, tau_i, share * tau_i).to_parallel()
    units = ControllerUnits.named(name, *spans, action=Acting.of(gains) if acting else None)
    back = units.gains(*units.numbers(gains)[:3])
    for one, two in zip((gains.kp, gains.ki, gains.kd), (back.kp, back.ki, back.kd), strict=True):
        assert one == pytest.approx(two, rel=1e-9)
    assert units.name == name
    still = units.numbers(PidGains(gains.kp, 0.0))
    assert still.integral is None
    alone = units.gains(still.gain)
    assert (alone.kp, alone.ki) == (pytest.approx(gains.kp), 0.0)


def test_a_controller_without_derivative_action_refuses_one() -> None:
    odrive = ControllerUnits.named("odrive")
    assert odrive.text(PidGains(0.2, 0.4)) == "vel_gain 0.2 vel_integrator_gain 0.4/s"
    assert odrive.text(PidGains(0.2, 0.4, 0.1)).endswith("and kd 0.1 s, which it has not")
    with pytest.raises(ValueError, match="no derivative action"):
        odrive.numbers(PidGains(0.2, 0.4, 0.1))
    with pytest.raises(ValueError, match="no derivative action"):
        odrive.gains(0.2, 0.4, 0.1)


def test_a_name_that_is_none_shows_the_list() -> None:
    with pytest.raises(ValueError, match="deltav-standard, deltav-series, honeywell-a"):
        ControllerUnits.named("siemens")
