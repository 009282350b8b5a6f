"""Lookup on a map of cells: exact at the knots, bilinear between them, clamped outside; which set to store for it."""

import math
from dataclasses import replace
from fractions import Fraction
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner import Axis, GainTable, Lookup, PidGains, Regions

HEAT = Axis("sp", "degC", 20.0, (80.0, 150.0), 220.0)
FLOW = Axis("can", "%", 0.0, (50.0,), 100.0, signal="flow")
REGIONS = Regions.along(tuple("abcdef"), HEAT, FLOW)
GAINS = tuple(PidGains(1.0 + i, 0.1 / (1 + i), 2.0 * i) for i in range(6))
HARD = GainTable("boiler", REGIONS, GAINS)
SMOOTH = replace(HARD, lookup=Lookup.INTERPOLATED)
ROW = GainTable("oven", Regions.along(("a", "b", "c"), HEAT), GAINS[:3], Lookup.INTERPOLATED)

sizes = st.just(0.0) | st.floats(1e-3, 1e3)
some_gains = st.builds(PidGains, st.floats(1e-3, 1e3), sizes, sizes)
xs, x2s = st.floats(-50.0, 300.0), st.floats(-50.0, 150.0)


def test_hard_lookup_is_the_region_wherever_x_is():
    for i, gains in enumerate(GAINS):
        assert HARD.at(i, 1e9, -1e9) is gains
        assert HARD.weights(i, 0.0, 0.0) == ((i, 1.0),)


def test_interpolation_is_exact_at_every_knot_and_clamped_outside():
    for i, (x, x2) in enumerate(product((50.0, 115.0, 185.0), (25.0, 75.0))):
        assert SMOOTH.at(0, x, x2) is GAINS[i]
    for i, corner in ((0, (-1e9, -1e9)), (1, (-1e9, 1e9)), (4, (1e9, -1e9)), (5, (1e9, 1e9))):
        assert SMOOTH.at(3, *corner) is GAINS[i]


@given(st.lists(some_gains, min_size=6, max_size=6), xs, x2s)
def test_interpolated_gains_are_the_bilinear_mean(gains, x, x2):
    """Against rational arithmetic, and never outside the corners."""
    found = replace(SMOOTH, gains=tuple(gains)).at(0, x, x2)
    u = min(max((Fraction(x) - 50) / 65, Fraction(0)), Fraction(1))
    row = 0
    if x > 115.0:
        u, row = min((Fraction(x) - 115) / 70, Fraction(1)), 1
    v = min(max((Fraction(x2) - 25) / 50, Fraction(0)), Fraction(1))
    corners = [
        (2 * row, (1 - u) * (1 - v)),
        (2 * row + 1, (1 - u) * v),
        (2 * row + 2, u * (1 - v)),
        (2 * row + 3, u * v),
    ]
    for name in ("kp", "ki", "kd"):
        exact = sum(w * Fraction(getattr(gains[i], name)) for i, w in corners)
        most = max(getattr(gains[i], name) for i, _ in corners)
        assert abs(Fraction(getattr(found, name)) - exact) <= 8 * Fraction(2.0**-52) * Fraction(most)


@given(st.integers(0, 5), xs, x2s, st.sampled_from((HARD, SMOOTH)))
def test_shares_are_positive_and_together_one(region, x, x2, table):
    shares = table.weights(region, x, x2)

    assert all(w > 0.0 for _, w in shares)
    assert sum(w for _, w in shares) == pytest.approx(1.0, rel=1e-15)
    assert len({i for i, _ in shares}) == len(shares)


@given(st.lists(some_gains, min_size=6, max_size=6), xs, x2s, st.sampled_from((1.0, -1.0)), st.floats(0.2, 5.0))
def test_what_is_stored_puts_in_force_what_was_wanted(gains, x, x2, sign, factor):
    """For the region that x lies in: only its set changes, and the mean is what was wanted, or there is no such set."""
    gains = tuple(PidGains(sign * g.kp, sign * g.ki, sign * g.kd) for g in gains)
    table = replace(SMOOTH, gains=gains)
    region = REGIONS.region_at((sum(x >= b for b in HEAT.bounds), int(x2 >= 50.0)))
    now = table.at(region, x, x2)
    wanted = PidGains(now.kp * factor, now.ki * factor, now.kd * factor)
    stored = table.stored_for(region, wanted, x, x2)
    if stored is None:
        assert factor < 1.0
        return
    changed = table.with_gains(region, stored)
    assert changed.gains == (*gains[:region], stored, *gains[region + 1 :])
    assert changed.revision == table.revision + 1
    got = changed.at(region, x, x2)
    for name in ("kp", "ki", "kd"):
        assert getattr(got, name) == pytest.approx(getattr(wanted, name), rel=1e-9)


def test_at_a_knot_and_under_hard_lookup_the_set_is_what_was_wanted():
    wanted = PidGains(3.0, 0.5, 1.0)

    assert SMOOTH.stored_for("d", wanted, 115.0, 75.0) is wanted
    assert HARD.stored_for(2, wanted, 0.0, 0.0) is wanted
    assert HARD.stored_for(2, PidGains(-3.0, -0.5), 0.0, 0.0) is None, "the other regions act the other way"


def test_half_way_the_whole_change_falls_on_one_set():
    """Half way between two sets of 2, a mean of 3 needs 4 in one of them."""
    table = replace(ROW, gains=(PidGains(2.0, 0.2), PidGains(2.0, 0.2), GAINS[2]))

    assert table.stored_for("a", PidGains(3.0, 0.2), 82.5) == PidGains(4.0, 0.2)


@pytest.mark.parametrize(
    ("wanted", "x", "region", "why"),
    [
        (PidGains(0.9, 0.01, 0.0), 82.5, 0, "b alone brings kp 1 into the mean"),
        (PidGains(1.5, 0.075, 0.5), 82.5, 0, "kd of b alone brings 1"),
        (PidGains(1.5, 0.075, 1.0), 180.0, 0, "a has no share beyond b"),
        (PidGains(-1.5, -0.1), 82.5, 0, "the other direction"),
        (PidGains(1.0, 0.075, 1.0), 82.5, 0, "kp of a would have to vanish"),
    ],
)
def test_a_mean_that_one_set_cannot_make(wanted, x, region, why):
    assert ROW.stored_for(region, wanted, x) is None, why


@pytest.mark.parametrize(("x", "x2", "named"), [(math.nan, 0.0, "sp = nan"), (50.0, math.inf, "flow = inf")])
def test_a_failed_sensor_is_refused(x, x2, named):
    for table in (HARD, SMOOTH):
        with pytest.raises(ValueError, match=f"{named} is not a finite number; keep the active gains"):
            table.at(1, x, x2)
