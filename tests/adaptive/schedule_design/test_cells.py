"""Sets over two variables: every place is served, no more sets than needed, and the table looks them up alike."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from test_cover import LIMITS, place

from retuner import Axis, GainTable, Lookup, Regions
from retuner.adaptive.schedule_choice.boundaries_of_two_variables import COUNT, Cells, cells
from retuner.adaptive.schedule_design.places import Place


def over(factor: float, factor2: float) -> list[Place]:
    """The gain grows by a factor along the first variable, and by another along the second."""
    shares = [i / (COUNT - 1) for i in range(COUNT)]
    made = {k: place(0.0, k) for k in {factor**a * factor2**b for a, b in product(shares, shares)}}
    return [replace(made[factor**a * factor2**b], x=100 * a, x2=10 * b) for a, b in product(shares, shares)]


@pytest.mark.slow
@pytest.mark.parametrize("lookup", ["hard", "interpolated"])
def test_every_place_is_served_in_the_way_that_is_asked_for(lookup: str) -> None:
    places = over(2.5, 2.0)
    found = cells(places, LIMITS, lookup, 16)
    assert found.lookup is Lookup(lookup)
    assert all(p.keeps(found.gains_at(p.x, p.x2 or 0.0), LIMITS) for p in places)
    assert len(found.sets) == (len(found.edges) - 1) * (len(found.edges2) - 1)
    assert cells(places, LIMITS, lookup, len(found.sets) - 1) is None


def test_a_variable_that_changes_nothing_needs_no_boundary() -> None:
    found = cells(over(1.0, 2.5), LIMITS, "hard", 16)
    assert len(found.edges) == 2
    assert len(found.edges2) > 2
    only = cells(over(1.0, 1.0), LIMITS, "auto", 16)
    assert len(only.sets) == 1


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_table_looks_up_what_was_proved() -> None:
    places = over(2.5, 2.0)
    for lookup in ("hard", "interpolated"):
        found = cells(places, LIMITS, lookup, 16)
        assert found is not None
        table = table_of(found)
        for x, x2 in product((-5.0, 13.0, 52.0, 99.0), (0.0, 4.1, 8.7)):
            part = sum(x >= e for e in found.edges[1:-1]) * (len(found.edges2) - 1)
            region = part + sum(x2 >= e for e in found.edges2[1:-1])
            wanted, got = found.gains_at(x, x2), table.at(region, x, x2)
            assert np.array([got.kp, got.ki]) == pytest.approx([wanted.kp, wanted.ki])


def table_of(found: Cells) -> GainTable:
    """As scheduling.table_of, without rounding."""
    first, second = (
        Axis(variable, "%", edges[0], edges[1:-1], edges[-1])
        for variable, edges in (("pv", found.edges), ("sp", found.edges2))
    )
    names = tuple(str(i) for i in range(len(found.sets)))
    return GainTable("loop", Regions.along(names, first, second), found.sets, found.lookup)
