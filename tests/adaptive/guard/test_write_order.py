"""The order of messages: a set between that would lose the loop is seen, and the other order taken or nothing."""

import math

from retuner import PidGains, ProcessModel, ProcessType
from retuner.adaptive.guard.write_order import gentlest_way, proved_way
from retuner.adaptive.identification.plausible import Plausible
from retuner.schedule.vendor_units import Quantity, VendorGain, VendorUnits, Way

UNITS = VendorUnits((VendorGain(Quantity.KP, message=0), VendorGain(Quantity.TN, message=1)))


def plausible(k: float, tau1: float, theta: float) -> Plausible:
    return Plausible(ProcessModel(ProcessType.FOPDT, k, tau1, 0.0, theta), 0.0)


def ways(old: dict[str, float], new: dict[str, float]) -> tuple[list[Way], tuple[PidGains, PidGains]]:
    return list(UNITS.ways(old, new)), (UNITS.of(old), UNITS.of(new))


def test_the_order_with_the_unstable_set_between_is_not_taken() -> None:
    # a slow integrating-like loop: much gain with a long time, or little gain with a short one; never much with short
    model = [plausible(1.0, 100.0, 10.0)]
    possible, ends = ways({"kp": 6.0, "tn": 300.0}, {"kp": 1.0, "tn": 15.0})
    chosen = proved_way(possible, ends, model, 0.1, 2.1)
    assert chosen.messages == (0, 1)  # the gain first: 1.0 with 300 s; the time first would be 6.0 with 15 s
    assert chosen.ms_worst < 2.1
    back, other_ends = ways({"kp": 1.0, "tn": 15.0}, {"kp": 6.0, "tn": 300.0})
    again = proved_way(back, other_ends, model, 0.1, 2.1)
    assert again.messages == (1, 0)


def test_an_order_that_one_allowed_model_does_not_bear_is_refused() -> None:
    models = [plausible(1.0, 100.0, 10.0), Plausible(ProcessModel(ProcessType.FOPDT, 4.0, 100.0, 0.0, 25.0), 1.0)]
    possible, ends = ways({"kp": 6.0, "tn": 300.0}, {"kp": 5.0, "tn": 15.0})
    assert proved_way(possible, ends, models, 0.1, 2.1) is None


def test_nothing_is_proved_without_a_model() -> None:
    possible, ends = ways({"kp": 1.0, "tn": 100.0}, {"kp": 2.0, "tn": 50.0})
    assert proved_way(possible, ends, [], 0.1, 2.1) is None
    gentlest = gentlest_way(possible)
    assert gentlest.messages == (0, 1)
    assert math.isnan(gentlest.ms_worst)


def test_one_message_has_no_set_between() -> None:
    possible, ends = ways({"kp": 1.0, "tn": 100.0}, {"kp": 2.0, "tn": 100.0})
    chosen = proved_way(possible, ends, [plausible(1.0, 100.0, 10.0)], 0.1, 2.1)
    assert chosen.messages == (0,)
