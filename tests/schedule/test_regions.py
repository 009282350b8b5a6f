"""Regions: no chatter within the hysteresis, the minimum stay holds, a failed sensor changes nothing."""

import math
from bisect import bisect_right
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from retuner.schedule.regions import Regions, RegionState, choose, enter

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


@settings(deadline=None)
@given(some_regions(), st.lists(st.floats(-2e3, 2e3) | st.sampled_from((math.nan, math.inf, -math.inf)), max_size=40))
def test_choose_is_its_definition(regions, xs):
    """Against the rule written out: leave when x is beyond the widened border and the stay is over."""
    law = regions.law()
    edges = (-math.inf, *regions.bounds, math.inf)
    state = enter(law, regions.low, 0.0)
    region, since = 0, 0.0
    for t_s, x in enumerate(xs, start=1):
        outside = x < edges[region] - regions.hysteresis or x > edges[region + 1] + regions.hysteresis
        if math.isfinite(x) and outside and t_s - since >= regions.min_stay_s:
            region, since = sum(x >= bound for bound in regions.bounds), float(t_s)
        before, state = state, choose(law, state, x, float(t_s))
        assert state == RegionState(region, since)
        assert state is before or state.region != before.region


@settings(deadline=None)
@given(some_regions(2), st.data())
def test_noise_within_the_hysteresis_never_chatters(regions, data):
    """Round a border, with noise of less than 2 h from peak to peak, there is one change at most."""
    regions = replace(regions, min_stay_s=0.0)
    assume(regions.hysteresis > 1e-6)
    border = data.draw(st.sampled_from(regions.bounds))
    offset = data.draw(st.floats(-1.0, 1.0)) * regions.hysteresis
    noise = st.floats(-0.99, 0.99).map(lambda n: border + offset + n * regions.hysteresis)
    visited = [state.region for state in walk(regions, data.draw(st.lists(noise, min_size=1, max_size=60)))]

    assert sum(a != b for a, b in pairwise(visited)) <= 1


def test_just_more_than_the_hysteresis_does_change():
    """So that the test above can fail: 2.2 h from peak to peak goes back and forth every time."""
    regions = replace(OVEN, min_stay_s=0.0)
    visited = [state.region for state in walk(regions, [80.0 - 2.2, 80.0 + 2.2] * 10)]

    assert visited == [0, 1] * 10


@settings(deadline=None)
@given(some_regions(), st.lists(st.floats(-2e3, 2e3), min_size=1, max_size=60), st.floats(0.01, 10.0))
def test_no_stay_is_shorter_than_the_minimum(regions, xs, dt_s):
    entries = sorted({state.since_s for state in walk(regions, xs, dt_s)})

    assert all(b - a >= regions.min_stay_s for a, b in pairwise(entries))


def test_after_the_minimum_stay_the_region_is_left():
    states = walk(OVEN, [50.0] + [100.0] * 70)

    assert [s.region for s in states] == [0] * 60 + [1] * 11
    assert states[60] == RegionState(1, 60.0)


@settings(deadline=None)
@given(some_regions(), st.floats(-2e3, 2e3))
def test_every_value_has_a_region_and_a_border_belongs_above(regions, x):
    assert enter(regions.law(), x, 0.0).region == bisect_right(regions.bounds, x)
    for i, bound in enumerate(regions.bounds):
        assert enter(regions.law(), bound, 0.0).region == i + 1
        assert enter(regions.law(), math.nextafter(bound, -math.inf), 0.0).region == i


@settings(deadline=None)
@given(some_regions(2))
def test_every_region_can_be_entered_from_both_sides(regions):
    """Even at the widest hysteresis: at its centre x is inside, coming from below or from above."""
    regions = replace(regions, min_stay_s=0.0)
    for i in range(len(regions)):
        for start in (regions.low - 1.0, regions.high + 1.0):
            assert walk(regions, [start, regions.centre(i)])[-1].region == i


def test_a_jump_may_skip_regions():
    assert [s.region for s in walk(replace(OVEN, min_stay_s=0.0), [30.0, 200.0, 30.0])] == [0, 2, 0]


@pytest.mark.parametrize("x", [math.nan, math.inf, -math.inf])
def test_a_failed_sensor_holds_the_region(x):
    law = OVEN.law()
    state = enter(law, 100.0, 0.0)

    assert choose(law, state, x, 1e6) is state


@pytest.mark.parametrize("t_s", [math.nan, math.inf, -math.inf, -100.0])
def test_time_that_is_none_or_runs_back_holds_the_region(t_s):
    law = OVEN.law()
    state = enter(law, 100.0, 0.0)

    assert choose(law, state, 200.0, t_s) is state


@pytest.mark.parametrize(("x", "t_s"), [(math.nan, 0.0), (math.inf, 0.0), (50.0, math.nan)])
def test_a_first_region_needs_numbers(x, t_s):
    with pytest.raises(ValueError, match="must be finite"):
        enter(OVEN.law(), x, t_s)


def test_spans_and_centres():
    assert [OVEN.span(i) for i in range(3)] == [(20.0, 80.0), (80.0, 150.0), (150.0, 220.0)]
    assert [OVEN.centre(i) for i in range(3)] == [50.0, 115.0, 185.0]
    for region in (-1, 3):
        with pytest.raises(ValueError, match=f"region {region} does not exist"):
            OVEN.span(region)


def test_one_region_is_never_left():
    single = Regions("sp", "degC", ("all",), 0.0, (), 1.0, 0.5)

    assert {s.region for s in walk(single, [-1e9, 0.5, 1e9])} == {0}


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
