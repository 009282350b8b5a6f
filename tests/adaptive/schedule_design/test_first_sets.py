"""A schedule goes no farther at once than the records were asked where each set is in force."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from retuner import Lookup, PidGains
from retuner.adaptive.identification.first_step import MOST_AT_ONCE, MOST_OF_A_RECORD
from retuner.adaptive.schedule_choice.boundaries_of_one_variable import Layout
from retuner.adaptive.schedule_choice.schedule_from_records import Design, first_sets
from retuner.adaptive.schedule_design.places import DesignLimits, Place, place_of
from retuner.adaptive.signals.sample import Window


def place(x: float) -> Place:
    """Gain 1, lag 100 s, dead time 2 s."""
    return place_of(x, np.log([0.01, 2.0, 100.0]), 1e-4 * np.eye(3), 1, 0.5, DesignLimits())


PLACES = tuple(place(x) for x in (10.0, 30.0, 70.0, 90.0))
OWN = PLACES[0].own


def design(lookup: Lookup = Lookup.HARD) -> Design:
    joint: Any = SimpleNamespace(joint=SimpleNamespace(stretches=(), loads=()))
    return Design("flow", joint, PLACES, Layout(lookup, (0.0, 50.0, 100.0), (OWN, OWN)), 0.0, 0.0, (), "2 sets")


def record(steps: int) -> tuple[Window, np.ndarray]:
    """So many setpoint steps at flow 20, one at flow 80."""
    n = 100 * (steps + 2)
    t = np.arange(float(n))
    sp = np.where(t // 100 <= steps, t // 100 % 2, 2.0)
    flow = np.where(t < 100 * (steps + 1), 20.0, 80.0)
    return Window(t, sp, sp + 0.0, np.cos(t)), flow


@pytest.mark.parametrize("lookup", [Lookup.HARD, Lookup.INTERPOLATED])
@pytest.mark.parametrize(("steps", "most"), [(1, MOST_AT_ONCE), (2, 2 * MOST_AT_ONCE), (8, MOST_OF_A_RECORD)])
def test_each_set_grows_by_what_happened_in_its_part(steps: int, most: float, lookup: Lookup) -> None:
    """It had no cap at all: Kc x20 and Ki x194 from one step."""
    weak = PidGains(OWN.kp / 20.0, OWN.ki / 194.0)
    window, flow = record(steps)
    found = first_sets(design(lookup), [window], [flow], lambda *_: weak)
    assert found.layout is not None
    for gains, factor in zip(found.layout.sets, (most, MOST_AT_ONCE), strict=True):
        assert gains.kp <= factor * weak.kp * (1 + 1e-9)
        assert gains.ki <= factor * weak.ki * (1 + 1e-9)
        assert gains.ki > 0.9 * factor * weak.ki
        assert all(one.judged(gains).ms_worst < 1.8 for one in PLACES)
    assert found.aim == design(lookup).layout
    assert "194.0 times the gain or integral action" in found.reason


def test_what_is_near_or_not_known_is_set_at_once() -> None:
    window, flow = record(1)
    for now in (PidGains(OWN.kp / 2.9, OWN.ki / 2.9), PidGains(10.0 * OWN.kp, OWN.ki), None):
        assert first_sets(design(), [window], [flow], lambda *_, now=now: now).aim is None


def test_a_set_is_held_to_the_place_where_it_goes_farthest() -> None:
    weak, near = PidGains(OWN.kp / 20.0, OWN.ki / 20.0), PidGains(OWN.kp / 2.0, OWN.ki / 2.0)
    window, flow = record(1)
    found = first_sets(design(), [window], [flow], lambda x, _: weak if x == 30.0 else near)
    assert found.layout.sets[0].kp <= MOST_AT_ONCE * weak.kp * (1 + 1e-9)
    assert found.layout.sets[1] == OWN
