"""Regions along two axes and filtered ones: each axis by itself, no chatter, neighbours, boundaries, unknown values."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.schedule.regions import Axis, Regions, RegionState, choose, enter, filtered, place, values

HEAT = Axis("sp", "degC", 20.0, (80.0, 150.0), 220.0, 2.0, 60.0)
FLOW = Axis("can", "%", 0.0, (50.0,), 100.0, 5.0, 0.0, 10.0, "flow")
NAMES = tuple(f"{heat} {flow}" for heat in ("cold", "warm", "hot") for flow in ("little", "much"))
BOILER = Regions.along(NAMES, HEAT, FLOW)

numbers = st.floats(-200.0, 400.0) | st.sampled_from((math.nan, math.inf, -math.inf))


lags = st.floats(0.1, 20.0)


@st.composite
def some_axes(draw, filter_s=None):
    filter_s = draw(st.just(0.0) | lags) if filter_s is None else draw(filter_s)
    edges = [draw(st.floats(-100.0, 100.0))]
    for _ in range(draw(st.integers(1, 4))):
        edges.append(edges[-1] + draw(st.floats(1.0, 50.0)))
    narrowest = min(b - a for a, b in pairwise(edges))
    return Axis(
        draw(st.sampled_from(("sp", "can"))),
        "",
        edges[0],
        tuple(edges[1:-1]),
        edges[-1],
        draw(st.floats(0.01, 0.49)) * narrowest,
        draw(st.just(0.0) | st.floats(0.5, 5.0)),
        filter_s,
    )


@st.composite
def some_maps(draw):
    first, second = draw(some_axes()), draw(some_axes())
    return Regions.along(tuple(f"r{i}" for i in range(len(first) * len(second))), first, second)


def walk(regions, samples, dt_s=1.0):
    """The states after each sample (x, x2)."""
    law = regions.law()
    states = [enter(law, samples[0][0], 0.0, samples[0][1])]
    for i, (x, x2) in enumerate(samples[1:], start=1):
        states.append(choose(law, states[-1], x, i * dt_s, x2))
    return states


@given(some_maps(), st.lists(st.tuples(numbers, numbers), min_size=1, max_size=40))
def test_each_axis_chooses_by_itself(regions, samples):
    """A cell is where two single axes stand; neither feels what the other does, nor its failures."""
    samples = [(regions.low, regions.second.low), *samples]
    states = walk(regions, samples)
    for k, axis in enumerate(regions.axes):
        law, part, since, y = axis.law(), 0, 0.0, samples[0][k]
        for t_s, (sample, state) in enumerate(zip(samples[1:], states[1:], strict=True), start=1):
            y = filtered(law, y, sample[k], 1.0)
            now = place(law, part, since, y, float(t_s))
            part, since = (now, float(t_s)) if now != part else (part, since)
            assert regions.cell(state.region)[k] == part
            assert (state.y, state.y2)[k] == y


@given(some_axes(), st.lists(st.floats(-200.0, 400.0), min_size=2, max_size=80), st.floats(0.05, 5.0))
def test_changes_are_bounded_by_the_travel(axis, xs, dt_s):
    """n changes need a travel of the filtered value of 2 h (n - 1), which is at most that of the value itself."""
    regions = Regions.along(tuple(f"r{i}" for i in range(len(axis))), axis)
    states = walk(regions, [(x, 0.0) for x in xs], dt_s)
    changes = sum(a.region != b.region for a, b in pairwise(states))
    travel = sum(abs(b - a) for a, b in pairwise(xs))

    assert 2 * axis.hysteresis * (changes - 1) <= travel + 1e-9


def test_the_bound_on_changes_is_reached():
    """So that the test above can fail: just beyond the hysteresis back and forth changes every time."""
    axis = replace(HEAT, min_stay_s=0.0)
    xs = [78.0 - 1e-9, 82.0 + 1e-9] * 20
    states = walk(Regions.along(("a", "b", "c"), axis), [(x, 0.0) for x in xs])
    changes = sum(a.region != b.region for a, b in pairwise(states))

    assert changes == len(xs) - 1
    assert 2 * axis.hysteresis * (changes - 1) == pytest.approx(sum(abs(b - a) for a, b in pairwise(xs)), rel=0.06)


def test_noise_beyond_the_hysteresis_is_held_by_the_filter():
    """+-20 round a boundary with h = 2: without a filter a change a sample, with one of 50 samples none."""
    noisy = [(80.0 + (20.0 if i % 2 else -20.0), 0.0) for i in range(400)]
    plain = replace(HEAT, min_stay_s=0.0)
    changes = [
        sum(a.region != b.region for a, b in pairwise(walk(Regions.along(("a", "b", "c"), axis), noisy)[100:]))
        for axis in (plain, replace(plain, filter_s=50.0))
    ]
    assert changes == [299, 0]


@given(some_axes(lags), st.floats(-100, 100), st.floats(-100, 100), st.floats(0.01, 50.0))
def test_the_filter_is_a_first_order_lag(axis, first, then, dt_s):
    """After n steps the distance is (tau/(tau + dt))^n of what it was: the pole of the backward difference."""
    law, y = axis.law(), first
    for _ in range(7):
        y = filtered(law, y, then, dt_s)

    share = (axis.filter_s / (axis.filter_s + dt_s)) ** 7
    assert y - then == pytest.approx(share * (first - then), rel=1e-9, abs=1e-9)


def test_no_time_constant_no_delay_and_a_failed_sensor_holds_it():
    law = FLOW.law()
    assert filtered(replace(law, filter_s=0.0), 1.0, 9.0, 1e-3) == 9.0
    for x in (math.nan, math.inf, -math.inf):
        assert filtered(law, 3.0, x, 5.0) == 3.0


def test_a_stale_signal_keeps_its_axis_and_the_other_goes_on():
    law = BOILER.law()
    state = enter(law, 50.0, 0.0, 20.0)
    for t_s in range(1, 100):
        state = choose(law, state, 200.0, float(t_s), math.nan)
    assert BOILER.names[state.region] == "hot little"
    assert values(law, state, 200.0, math.nan) == (200.0, 20.0)

    state = choose(law, state, 200.0, 100.0, 90.0)
    assert 20.0 < state.y2 < 90.0


def test_entering_again_keeps_what_is_not_known():
    law = BOILER.law()
    first = enter(law, 50.0, 0.0, 90.0)
    again = enter(law, 200.0, 500.0, math.nan, first)

    assert [BOILER.names[s.region] for s in (first, again)] == ["cold much", "hot much"]
    assert (again.y, again.y2) == (200.0, 90.0)
    single = Regions.along(("low", "high"), FLOW).law()
    assert enter(single, math.nan, 9.0, 0.0, enter(single, 80.0, 1.0)).region == 1


@pytest.mark.parametrize(("x", "x2", "t_s"), [(math.nan, 1.0, 0.0), (50.0, math.nan, 0.0), (50.0, 1.0, math.inf)])
def test_a_first_cell_needs_numbers(x, x2, t_s):
    with pytest.raises(ValueError, match="must be finite to choose a first region"):
        enter(BOILER.law(), x, t_s, x2)


def test_time_that_runs_back_changes_nothing():
    law = BOILER.law()
    state = enter(law, 50.0, 100.0, 20.0)
    for t_s in (99.0, math.nan, math.inf):
        assert choose(law, state, 220.0, t_s, 90.0) is state


def test_a_plain_axis_pays_nothing():
    """The same object as long as nothing changes, and no filtered values in the state."""
    plain = Regions.along(("a", "b", "c"), HEAT).law()
    state = enter(plain, 50.0, 0.0)

    assert state == RegionState(0, 0.0)
    assert choose(plain, state, 81.9, 1e3, math.nan) is state
    assert values(plain, state, 81.9) == (81.9, 0.0)


def test_cells_are_counted_row_by_row():
    assert BOILER.shape == (3, 2)
    assert [BOILER.cell(i) for i in range(6)] == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]
    assert [BOILER.region_at(BOILER.cell(i)) for i in range(6)] == list(range(6))
    assert BOILER.text(3) == "80 to 150 degC, flow 50 to 100 %"
    assert (BOILER.span(3, 0), BOILER.span(3, 1), BOILER.centre(3, 1)) == ((80.0, 150.0), (50.0, 100.0), 75.0)
    assert (BOILER.centre(3, 0), BOILER.centre(3, 1)) == (115.0, 75.0)
    for call in (lambda: BOILER.cell(6), lambda: BOILER.region_at((3, 0)), lambda: BOILER.region_at((1,))):
        with pytest.raises(ValueError, match="does not exist"):
            call()


@given(some_maps(), st.data())
def test_neighbours_share_a_boundary(regions, data):
    a = data.draw(st.integers(0, len(regions) - 1))
    for b in range(len(regions)):
        step = [abs(i - j) for i, j in zip(regions.cell(a), regions.cell(b), strict=True)]
        assert regions.distance(a, b) == regions.distance(b, a) == sum(step)
        assert (b in regions.neighbours(a)) == (a in regions.neighbours(b)) == (sorted(step) == [0, 1])
        if b in regions.neighbours(a):
            axis, value = regions.boundary(a, b)
            assert set(regions.span(a, axis)) & set(regions.span(b, axis)) == {value}
            assert regions.span(a, 1 - axis) == regions.span(b, 1 - axis)
        else:
            with pytest.raises(ValueError, match="share no boundary"):
                regions.boundary(a, b)


def test_neighbours_in_a_row():
    row = Regions("pv", "degC", ("cold", "warm", "hot"), 20.0, (80.0, 150.0), 220.0)

    assert [row.neighbours(i) for i in range(3)] == [(1,), (0, 2), (1,)]
    assert row.boundary(2, 1) == (0, 150.0)
    assert BOILER.neighbours(2) == (0, 3, 4)


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: Regions.along(NAMES[:5], HEAT, FLOW), "2 and 1 bounds make 6 regions, not 5"),
        (lambda: Regions.along((*NAMES[:5], "cold little"), HEAT, FLOW), "different"),
        (lambda: replace(HEAT, filter_s=-1.0), "filter_s = -1.0 must be a finite number, 0 or more"),
        (lambda: replace(HEAT, filter_s=math.nan), "filter_s = nan"),
        (lambda: replace(HEAT, signal="flow"), "signal = 'flow' belongs to variable 'can', not to 'sp'"),
        (lambda: replace(FLOW, signal="a\nb"), "one line"),
        (lambda: replace(FLOW, hysteresis=26.0), "part 1 of flow is 50 wide"),
    ],
)
def test_what_makes_no_map_is_refused(call, what):
    with pytest.raises(ValueError, match=what):
        call()
