"""The fewest sets over places whose best gains are known, as steps and as interpolation, and the loop in motion."""

from itertools import pairwise

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.schedule_choice.borders_of_one_variable import (
    Layout,
    borders_of_fewest_sets,
    knots_of_fewest_sets,
    mean_of,
)
from retuner.adaptive.schedule_choice.schedule_from_records import _within
from retuner.adaptive.schedule_design.places import DesignLimits, Place, iae
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup

LIMITS = DesignLimits()
DT = 0.1


def place(x: float, k: float, *, known: bool = True) -> Place:
    model = ProcessModel(ProcessType.FOPDT, k, 20.0, 0.0, 5.0)
    own = simc(model.seen_by_controller(DT)).gains
    seen = (model.seen_by_controller(DT).linear(),)
    return Place(x, model, seen, (0.02, 0.02, 0.02), 0.03 if known else 1.0, known, own, iae(model, own, DT), DT)


def along(factor: float, n: int = 11) -> list[Place]:
    """The gain grows by a factor over 0..100."""
    return [place(100 * i / (n - 1), factor ** (i / (n - 1))) for i in range(n)]


def kept(places: list[Place], layout: Layout) -> bool:
    return all(p.keeps(layout.gains_at(p.x), LIMITS) for p in places)


def test_a_process_that_is_the_same_everywhere_needs_one_set() -> None:
    places = along(1.0)
    for found in (borders_of_fewest_sets(places, LIMITS, 8), knots_of_fewest_sets(places, LIMITS, 8)):
        assert len(found.sets) == 1
        assert found.edges == (0.0, 100.0)


@pytest.mark.slow
@settings(max_examples=examples(15))
@given(st.floats(1.2, 8.0), st.sampled_from([borders_of_fewest_sets, knots_of_fewest_sets]))
def test_every_place_is_served_and_no_set_less_would_do(factor: float, cover: object) -> None:
    places = along(factor)
    assert callable(cover)
    found = cover(places, LIMITS, len(places))  # at 8.0 steps need ten: neighbours are just too far apart to share one
    assert found is not None
    assert kept(places, found)
    assert all(a < b for a, b in pairwise(found.edges))
    if len(found.sets) > 1:
        assert cover(places, LIMITS, len(found.sets) - 1) is None


def test_knots_lie_in_the_middle_of_their_parts() -> None:
    found = knots_of_fewest_sets(along(8.0), LIMITS, 8)
    assert found.lookup is Lookup.INTERPOLATED
    for gains, (low, high) in zip(found.sets, pairwise(found.edges), strict=True):
        assert found.gains_at((low + high) / 2).kp == pytest.approx(gains.kp)


def test_places_that_are_not_known_demand_nothing_and_give_no_set() -> None:
    places = [place(x, 1.0 if x < 50 else 9.0, known=x < 50) for x in range(0, 101, 10)]
    found = borders_of_fewest_sets(places, LIMITS, 8)
    assert len(found.sets) == 1


def test_more_sets_than_allowed_is_no_layout() -> None:
    assert borders_of_fewest_sets(along(8.0), LIMITS, 2) is None


def test_the_mean_of_two_sets_is_theirs_at_the_ends() -> None:
    one, two = PidGains(1.0, 0.1), PidGains(3.0, 0.5)
    assert mean_of(one, two, 0.0) == one
    assert mean_of(one, two, 1.0) == two
    assert mean_of(one, two, 0.5) == PidGains(2.0, 0.3)


@pytest.mark.parametrize(("name", "value"), [("ms", 1.2), ("j", 3.0), ("std", float("nan"))])
def test_limits_outside_their_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        DesignLimits(**{name: value})


def test_outer_edges_stand_out_of_the_range_no_more_than_the_knots_ask_for() -> None:
    found = knots_of_fewest_sets(along(4.0), LIMITS, 8)
    low, high = max(-found.edges[0], 0.0), max(found.edges[-1] - 100.0, 0.0)
    width = found.edges[-1] - found.edges[0]
    assert low + high == pytest.approx(max(width - 100.0, 0.0), abs=1.0)
    assert abs(low - high) < 0.2 * width


def test_the_next_experiment_stays_within_the_limits_of_the_output() -> None:
    assert _within(10.0, 50.0, (0.0, 100.0), 1.0) == 10.0
    assert _within(10.0, 95.0, (0.0, 100.0), 1.0) == -10.0
    assert _within(10.0, 95.0, (None, 100.0), -1.0) == -10.0
    assert _within(200.0, 40.0, (0.0, 100.0), -1.0) == pytest.approx(48.0)
