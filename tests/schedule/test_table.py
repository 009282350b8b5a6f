"""The gain table: revisions, hard and interpolated lookup."""

import math
from dataclasses import FrozenInstanceError, replace
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.schedule.gains import PidGains
from retuner.schedule.pid import PidState, law, step
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

REGIONS = Regions("pv", "degC", ("cold", "warm", "hot"), 20.0, (80.0, 150.0), 220.0, 2.0, 60.0)
GAINS = (PidGains(1.0, 0.1), PidGains(2.0, 0.05, 3.0), PidGains(4.0, 0.0, 1.0))
HARD = GainTable("oven", REGIONS, GAINS)
SMOOTH = replace(HARD, lookup=Lookup.INTERPOLATED)

sizes = st.floats(0.0, 1e6)
some_gains = st.builds(PidGains, st.floats(1e-6, 1e6), sizes, sizes)


def test_hard_lookup_is_the_region_wherever_x_is():
    for i, gains in enumerate(GAINS):
        for x in (-1e9, 50.0, 115.0, 1e9):
            assert HARD.at(i, x) is gains


def test_interpolated_at_and_beyond_the_knots():
    for region in range(3):
        for x, gains in zip(
            (50.0, 115.0, 185.0, 20.0, -1e9, 220.0, 1e9), (*GAINS, *GAINS[:1] * 2, *GAINS[2:] * 2), strict=True
        ):
            assert SMOOTH.at(region, x) == gains


def test_interpolated_half_way():
    found = SMOOTH.at(0, 82.5)

    assert (found.kp, found.ki, found.kd) == pytest.approx((1.5, 0.075, 1.5))


@settings(deadline=None)
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


@settings(deadline=None)
@given(some_gains, some_gains, st.floats(50.0, 115.0), st.floats(-100, 100), st.floats(-100, 100))
def test_the_interpolated_controller_is_the_weighted_mean_of_its_corners(one, two, x, sp, pv):
    table = replace(SMOOTH, gains=(one, two, two))
    state = PidState(0.0, pv - 1.0, 0.5, 0.0, 0)

    def after(gains: PidGains) -> tuple[float, float]:
        new, co = step(law(gains, b=0.7, tau_f_s=2.0, co_min=-1e30, co_max=1e30), state, sp, pv, 1.0)
        return co, new[0]

    w = (x - 50.0) / 65.0
    scale = max(abs(v) for g in (one, two) for v in (g.kp, g.ki, g.kd)) * 1e3
    for mean, a, b in zip(after(table.at(0, x)), after(one), after(two), strict=True):
        assert mean == pytest.approx((1 - w) * a + w * b, abs=1e-14 * scale)


def test_a_single_region_interpolates_to_itself():
    table = GainTable("x", Regions("sp", "", ("all",), 0.0, (), 1.0), GAINS[:1], Lookup.INTERPOLATED)

    assert {table.at(0, x) for x in (-1.0, 0.5, 2.0)} == {GAINS[0]}


@pytest.mark.parametrize("table", [HARD, SMOOTH])
@pytest.mark.parametrize("x", [math.nan, math.inf, -math.inf])
def test_a_failed_sensor_is_refused(table, x):
    with pytest.raises(ValueError, match=r"pv = .* is not a finite number; keep the active gains"):
        table.at(1, x)


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
