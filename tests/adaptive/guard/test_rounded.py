"""What the guard lets through is what the controller will hold: rounded, and proved as it is rounded."""

from dataclasses import replace

import pytest
from guard_cases import GAINS, SETTINGS, request, times

from retuner.adaptive.guard import prove
from retuner.schedule.vendor_units import Quantity, StorableNumbers, VendorGain, VendorUnits


def units(step: float, high: float = 255.0) -> VendorUnits:
    """Whole numbers: kp in this step, Tn in seconds."""
    return VendorUnits(
        (
            VendorGain(Quantity.KP, step, StorableNumbers(1.0, high, 1.0)),
            VendorGain(Quantity.TN, 1.0, StorableNumbers(0.0, 10000.0, 1.0), message=1, off=0.0),
        )
    )


@pytest.mark.parametrize("step", [0.3, 0.1, 0.037, 0.001])
@pytest.mark.parametrize("factor", [0.3, 0.6, 1.9])
def test_accepted_gains_are_those_that_are_held(step: float, factor: float) -> None:
    held = units(step, 100_000.0)
    in_force = held.rounded(times(factor, factor))
    verdict = prove(replace(request(in_force), units=held), SETTINGS)
    if verdict.gains is not None:
        assert held.rounded(verdict.gains) == verdict.gains
        assert all(check.passed for check in verdict.checks)
        assert verdict.ms_worst <= SETTINGS.ms_worst
    if step <= 0.037:
        assert verdict.accepted


def test_what_cannot_be_held_is_refused() -> None:
    held = units(0.1, high=round(0.4 * GAINS.kp / 0.1))  # more gain than is in force cannot be held
    in_force = held.rounded(times(0.4, 0.4))
    assert prove(request(in_force), SETTINGS).accepted
    assert not prove(replace(request(in_force), units=held), SETTINGS).accepted
