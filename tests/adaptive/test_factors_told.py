"""Sentences that name a number and its limit tell them apart."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.diagnosis.diagnosis_settings import DiagnosisSettings
from retuner.adaptive.diagnosis.tuning_verdict import _unexplained
from retuner.adaptive.identification.estimate import factors_text


def test_as_few_digits_as_tell_the_two_apart() -> None:
    assert factors_text(math.log(1.80), math.log(1.35)) == ("1.80", "1.35")
    assert factors_text(math.log(1.3512), math.log(1.35)) == ("1.351", "1.350")
    assert factors_text(50.0, 0.3) == ("over 1000", "1.3")


@given(limit=st.floats(0.05, 1.0), over=st.floats(1e-4, 5.0))
def test_what_is_over_its_limit_is_told_as_larger(limit: float, over: float) -> None:
    known, needed = factors_text(limit + over, limit)
    assert float(known) > float(needed)


@pytest.mark.parametrize(("loads", "left", "said"), [(0, 9.0, "9.0 times the noise"), (9, 1.0, "9 load steps explain")])
def test_what_is_not_explained_is_told_by_what_is_wrong_with_it(loads: float, left: float, said: str) -> None:
    assert said in _unexplained(0.0, loads, left, DiagnosisSettings())
    assert _unexplained(0.0, 0.0, 1.0, DiagnosisSettings()) == ""
