"""What several records say of a valve's curve."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.region_model.co_curve import CoCurve, added, before

SLOPES = st.floats(-0.2, 0.2)
STDS = st.floats(1e-3, 1.0)


def test_nothing_is_known_before_a_record() -> None:
    found = before([], 40.0)
    assert found.slope == 0.0
    assert found.std == pytest.approx(1.4 / 40.0 * math.sqrt(0.5))


def test_records_that_agree_make_it_certain_and_one_does_not() -> None:
    one = CoCurve(0.034, 0.02)
    assert before([one], 40.0).slope < 0.5 * one.slope
    many = before([one] * 40, 40.0)
    assert many.slope == pytest.approx(0.034, rel=0.1)
    assert many.std < 0.01


def test_where_records_see_none_it_is_gone() -> None:
    found = before([CoCurve(0.002 * (-1) ** i, 0.01) for i in range(20)], 40.0)
    assert abs(found.slope) < 1e-4
    assert found.std < 0.002


@given(known=st.tuples(SLOPES, STDS), own=st.tuples(SLOPES, STDS))
def test_what_a_record_adds_is_what_it_says_by_itself(known: tuple[float, float], own: tuple[float, float]) -> None:
    before_it, record = CoCurve(*known), CoCurve(*own)
    precision = 1 / before_it.std**2 + 1 / record.std**2
    mean = (before_it.slope / before_it.std**2 + record.slope / record.std**2) / precision
    found = added(before_it, CoCurve(mean, 1 / math.sqrt(precision)))
    if found is None:
        assert record.std > 900 * before_it.std
    else:
        assert found.std == pytest.approx(record.std, rel=1e-2)
        assert found.slope == pytest.approx(record.slope, rel=1e-2, abs=1e-3 + 1e-2 * record.std)


@given(records=st.lists(st.tuples(SLOPES, STDS), max_size=5), travel=st.floats(1e-3, 1e4))
def test_it_says_no_more_than_the_records_said(records: list[tuple[float, float]], travel: float) -> None:
    found = before([CoCurve(*one) for one in records], travel)
    assert 0 < found.std < math.inf
    assert abs(found.slope) <= max([0.0, *(abs(slope) for slope, _ in records)])


@pytest.mark.parametrize(("slope", "std"), [(math.nan, 1.0), (0.0, 0.0), (0.0, math.inf), (math.inf, 1.0)])
def test_what_is_no_number_is_refused(slope: float, std: float) -> None:
    with pytest.raises(ValueError, match="co's curve"):
        CoCurve(slope, std)
