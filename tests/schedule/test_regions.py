"""Regions: the choice is its definition (hysteresis, minimum stay, a failed sensor); the gain table and its lookups."""

import math
from bisect import bisect_right
from dataclasses import FrozenInstanceError, replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner import GainTable, Lookup, PidGains
from retuner.schedule.regions import Regions, choose, enter

OVEN = Regions("pv", "degC", ("cold", "warm", "hot"), 20.0, (80.0, 150.0), 220.0, 2.0, 60.0)


@st.composite
def some_regions(draw, min_count=1):
    count = draw(st.integers(min_count, 6))
    low = draw(st.floats(-1e3, 1e3))
    widths = draw(st.lists(st.floats(0.5, 100.0), min_size=count, max_size=count))
    edges = [low]
    for width in widths:
        edges.append(edges[-1] + width)
    hysteresis = draw(st.floats(0.0, 0.49)) * min(widths)
    names = tuple(f"r{i}" for i in range(count))
    stay = draw(st.just(0.0) | st.floats(0.1, 50.0))
    return Regions("pv", "", names, edges[0], tuple(edges[1:-1]), edges[-1], hysteresis, stay)


def walk(regions, xs, dt_s=1.0):
    """The region after each x."""
    law = regions.law()
    state = enter(law, xs[0], 0.0)
    states = [state]
    for i, x in enumerate(xs[1:], start=1):
        state = choose(law, state, x, i * dt_s)
        states.append(state)
    return states


@given(some_regions(), st.floats(-2e3, 2e3))
def test_every_value_has_a_region_and_a_boundary_belongs_above(regions, x):
    assert enter(regions.law(), x, 0.0).region == bisect_right(regions.bounds, x)
    for i, bound in enumerate(regions.bounds):
        assert enter(regions.law(), bound, 0.0).region == i + 1
        assert enter(regions.law(), math.nextafter(bound, -math.inf), 0.0).region == i


@given(some_regions(2))
def test_every_region_can_be_entered_from_both_sides(regions):
    """Even at the widest hysteresis: at its centre x is inside, coming from below or from above."""
    regions = replace(regions, min_stay_s=0.0)
    for i in range(len(regions)):
        for start in (regions.low - 1.0, regions.high + 1.0):
            assert walk(regions, [start, regions.centre(i)])[-1].region == i


def test_spans_and_centres():
    assert [OVEN.span(i) for i in range(3)] == [(20.0, 80.0), (80.0, 150.0), (150.0, 220.0)]
    assert [OVEN.centre(i) for i in range(3)] == [50.0, 115.0, 185.0]
    for region in (-1, 3):
        with pytest.raises(ValueError, match=f"region {region} does not exist"):
            OVEN.span(region)


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"variable": "temperature"}, "variable = 'temperature' is unknown; use one of sp, pv, co"),
        ({"names": ("a", "b")}, "2 bounds make 3 regions, not 2"),
        ({"names": ("a", "b", "a")}, "different"),
        ({"names": ("a", "b", " ")}, "not empty"),
        ({"names": ("a", "b", "c\n")}, "one line"),
        ({"unit": "\x7f"}, "one line"),
        ({"bounds": (150.0, 80.0)}, "must increase; 80.0 after 150.0"),
        ({"bounds": (80.0, 80.0)}, "must increase"),
        ({"bounds": (80.0, 300.0)}, "must increase; 220.0 after 300.0"),
        ({"bounds": (80.0, math.nan)}, "nan is not a finite number"),
        ({"high": math.inf}, "inf is not a finite number"),
        ({"low": -1.7e308, "high": 1.7e308}, "inf is not a finite number"),
        ({"hysteresis": -1.0}, "hysteresis = -1.0"),
        ({"hysteresis": 30.1}, "region 'cold' is 60 wide"),
        ({"hysteresis": math.nan}, "hysteresis = nan"),
        ({"min_stay_s": -1.0}, "min_stay_s = -1.0"),
        ({"min_stay_s": math.inf}, "min_stay_s = inf"),
        ({"min_stay_s": math.nan}, "min_stay_s = nan"),
    ],
)
def test_what_makes_no_regions_is_refused(wrong, what):
    with pytest.raises(ValueError, match=what):
        replace(OVEN, **wrong)


# ---- The gain table: revisions, hard and interpolated lookup

REGIONS = Regions("pv", "degC", ("cold", "warm", "hot"), 20.0, (80.0, 150.0), 220.0, 2.0, 60.0)
GAINS = (PidGains(1.0, 0.1), PidGains(2.0, 0.05, 3.0), PidGains(4.0, 0.0, 1.0))
HARD = GainTable("oven", REGIONS, GAINS)
SMOOTH = replace(HARD, lookup=Lookup.INTERPOLATED)

sizes = st.floats(0.0, 1e6)
some_gains = st.builds(PidGains, st.floats(1e-6, 1e6), sizes, sizes)


def test_interpolated_at_and_beyond_the_knots():
    for region in range(3):
        for x, gains in zip(
            (50.0, 115.0, 185.0, 20.0, -1e9, 220.0, 1e9), (*GAINS, *GAINS[:1] * 2, *GAINS[2:] * 2), strict=True
        ):
            assert SMOOTH.at(region, x) == gains


@given(some_gains, some_gains, st.floats(50.0, 115.0), st.sampled_from((1.0, -1.0)))
def test_interpolated_gains_are_the_exact_weighted_mean(one, two, x, sign):
    """Against rational arithmetic: within four roundings of the larger corner, and never outside the corners."""
    one, two = (PidGains(sign * g.kp, sign * g.ki, sign * g.kd) for g in (one, two))
    table = replace(SMOOTH, gains=(one, two, two))
    found = table.at(0, x)
    w = (Fraction(x) - 50) / 65
    for a, b, mean in ((one.kp, two.kp, found.kp), (one.ki, two.ki, found.ki), (one.kd, two.kd, found.kd)):
        exact = (1 - w) * Fraction(a) + w * Fraction(b)
        rounding = max(2.0**-52 * max(abs(a), abs(b)), 2.0**-1074)  # below the normal range it no longer shrinks
        assert abs(Fraction(mean) - exact) <= 4 * Fraction(rounding)


def test_a_single_region_interpolates_to_itself():
    table = GainTable("x", Regions("sp", "", ("all",), 0.0, (), 1.0), GAINS[:1], Lookup.INTERPOLATED)

    assert {table.at(0, x) for x in (-1.0, 0.5, 2.0)} == {GAINS[0]}


def test_a_change_is_a_new_revision_and_leaves_the_old_one():
    new = PidGains(9.0, 0.9)
    changed = HARD.with_gains("warm", new)

    assert changed == replace(HARD, gains=(GAINS[0], new, GAINS[2]), revision=1)
    assert changed.with_gains(1, GAINS[1]) == replace(HARD, revision=2)
    assert HARD.gains == GAINS
    assert HARD.revision == 0
    with pytest.raises(FrozenInstanceError):
        HARD.revision = 7


def test_regions_by_name_and_index():
    assert [HARD.index(name) for name in REGIONS.names] == [0, 1, 2]
    assert HARD.gains_of("hot") is HARD.gains_of(2) is GAINS[2]


@pytest.mark.parametrize("table", [HARD, SMOOTH])
@pytest.mark.parametrize("region", ["tepid", -1, 3])
def test_a_region_that_is_not_there(table, region):
    calls = [lambda: table.gains_of(region), lambda: table.with_gains(region, GAINS[0])]
    if not isinstance(region, str):
        calls.append(lambda: table.at(region, 50.0))
    for call in calls:
        with pytest.raises(ValueError, match=f"region '?{region}'? does not exist"):
            call()


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"loop": " "}, "loop"),
        ({"loop": "a\nb"}, "one line"),
        ({"gains": GAINS[:2]}, "3 regions need as many sets of gains, not 2"),
        ({"gains": (*GAINS[:2], PidGains(-1.0, -0.1))}, r"cold \+1, warm \+1, hot -1"),
        ({"revision": -1}, "revision = -1"),
        ({"lookup": "fuzzy"}, "use hard or interpolated"),
    ],
)
def test_what_makes_no_table_is_refused(wrong, what):
    with pytest.raises(ValueError, match=what):
        replace(HARD, **wrong)


def test_a_lookup_may_be_given_by_its_name():
    assert replace(HARD, lookup="interpolated").lookup is Lookup.INTERPOLATED
