"""Gains in a vendor's form and units: what they come to, what rounding makes of them, which sets lie between."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.schedule.gains import IdealGains, PidGains, SeriesGains
from retuner.schedule.vendor_units import Holds, Quantity, VendorGain, VendorUnits

WORD = Holds(0, 65535, 1.0)


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
        (VendorGain(Quantity.KP, holds=Holds(single=True)), VendorGain(Quantity.KI, holds=Holds(single=True)))
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
