"""Gains in the units of the trade: there and back, the analytic values, the action, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.schedule.controller_units import NAMES, Acting, ControllerUnits
from retuner.schedule.dials import CONTROLLERS
from retuner.schedule.gains import Form, PidGains, SeriesGains

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
def test_there_and_back_on_every_vendors_controller(
    name: str, sets: tuple[float, float, float], spans: tuple[float, float], sign: int, acting: bool
) -> None:
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
