"""The fewest sets over places whose best gains are known, as steps and as interpolation, and the loop in motion."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import Lookup, PidGains, ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.schedule_choice import schedule_from_records
from retuner.adaptive.schedule_choice.boundaries_of_one_variable import (
    Layout,
    boundaries_of_fewest_sets,
    knots_of_fewest_sets,
    mean_of,
)
from retuner.adaptive.schedule_choice.schedule_from_records import _counted, _refused, _within
from retuner.adaptive.schedule_design.places import DesignLimits, Place, iae, place_at
from retuner.adaptive.schedule_design.record_stretches import cut, signals_of, without_gaps
from retuner.adaptive.signals.sample import Window

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
    for found in (boundaries_of_fewest_sets(places, LIMITS, 8), knots_of_fewest_sets(places, LIMITS, 8)):
        assert len(found.sets) == 1
        assert found.edges == (0.0, 100.0)


@pytest.mark.slow
@settings(max_examples=examples(15))
@given(st.floats(1.2, 8.0), st.sampled_from([boundaries_of_fewest_sets, knots_of_fewest_sets]))
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
    found = boundaries_of_fewest_sets(places, LIMITS, 8)
    assert len(found.sets) == 1


def test_more_sets_than_allowed_is_no_layout() -> None:
    assert boundaries_of_fewest_sets(along(8.0), LIMITS, 2) is None


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


# What is not explained or not known gives no settings: seen on a heat exchanger whose flow moves its temperature.


def curves(std_theta):
    """k = 1 / s, a dead time of 0.6 s beside a second lag of 27 s, known to this."""
    return SimpleNamespace(
        ln=lambda *_: np.log([[0.0055, 0.6, 88.0, 27.0]]),
        ln_covariance=lambda *_: np.diag([0.05, std_theta, 0.05, 0.08]) ** 2,
        form=SimpleNamespace(sign=1),
    )


def test_a_small_dead_time_that_may_be_hours_makes_no_place_known():
    assert place_at(curves(0.1), 1.0, 1.5, DesignLimits()).known
    assert not place_at(curves(3.0), 1.0, 1.5, DesignLimits()).known


def known(n):
    return [SimpleNamespace(x=float(i), known=i < n, gain_std=0.3) for i in range(25)]


def refused(moved=10.0, rows=2, size=1.0, differences=(0.25, 0.06, 0.12), places=25):
    """Why no sets follow from records in which pv moves by so much, and how many stretches they have."""
    t, rng = np.arange(200.0), np.random.default_rng(1)
    pv = 20 + rng.normal(0.0, 0.1, 200) + moved * (t > 100)
    stretches = cut(signals_of(Window(t, np.full(200, 20.0), pv, 30 - (pv - 20)), pv, 1))
    joint = SimpleNamespace(loads=[(1,) * rows] * len(stretches), stretches=stretches)
    now, ln = SimpleNamespace(sizes=[np.full(rows, size)] * len(stretches)), np.log([[0.1, 1.0, 10.0]])
    found = SimpleNamespace(joint=joint, now=now, ln=lambda *_: ln, differences=differences)
    five = SimpleNamespace(span=lambda: (0.0, 4.0))  # places that the records visit
    return _refused(SimpleNamespace(curves=found, one=five, two=None), known(places)), len(stretches)


def test_records_that_need_two_load_steps_a_stretch_are_not_explained():
    assert refused()[0] == ""
    reason, stretches = refused(rows=4)
    assert f"not explained: {2 * stretches} load steps" in reason
    assert refused(rows=4, size=0.1)[0] == "", "what moves pv by 2 % of its travel mends a form, it is no load"


def test_stretches_that_differ_at_one_place_give_no_settings():
    assert "slope gain differs by a factor of 1.6" in refused(differences=(0.5, 0.03, 0.06))[0]


def test_a_process_that_needs_too_many_sets_gets_slower_ones(monkeypatch):
    places = [
        place_at(
            SimpleNamespace(
                ln=lambda *_, b=b: np.array([[b, 0.0, 2.0]]),
                ln_covariance=lambda *_: np.diag([0.02, 0.02, 0.02]) ** 2,
                form=SimpleNamespace(sign=1),
            ),
            x,
            0.1,
            DesignLimits(),
        )
        for x, b in ((0.0, 0.0), (1.0, 0.25), (2.0, 0.5))
    ]
    monkeypatch.setattr(schedule_from_records, "MOST_SETS", 1)

    layout, j = schedule_from_records._affordable(places, DesignLimits(), "hard")

    assert layout is not None
    assert j > DesignLimits().j
    assert all(place.judged(gains).j <= j for place in places for gains in layout.sets)


def test_records_in_which_pv_does_not_leave_its_noise_tell_nothing():
    assert "tell nothing" in refused(moved=0.0)[0]
    assert refused(moved=1.0, size=0.001)[0] == ""


def test_a_gap_in_a_record_parts_it_and_nothing_is_made_up_in_it():
    t = np.concatenate([np.arange(100.0), np.arange(900.0, 1000.0), [5000.0, 5001.0]])
    window = Window(t, t, t, t)

    pieces = without_gaps(window, t)

    assert [(w.t_s[0], w.t_s[-1], len(x)) for w, x in pieces] == [(0.0, 99.0, 100), (900.0, 999.0, 100)]
    assert without_gaps(pieces[0][0], t[:100])[0][0] is pieces[0][0]


def test_one_known_place_in_five_visited_ones_gives_no_settings():
    assert "at 1 of the 5 places that the records visit" in refused(places=1)[0]
    assert "nowhere" in refused(places=0)[0]
    assert refused(places=3)[0] == "", "what was not visited asks for nothing"
    assert "the 3 of 25 places that are known" in _counted(1, "hard", known(3), 1.25, 1.25)
    assert "every place" in _counted(1, "hard", known(25), 1.25, 1.25)
