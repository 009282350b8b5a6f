"""What was weighed: told where it is said, joined without touching either."""

from dataclasses import FrozenInstanceError, dataclass

import pytest

from retuner.adaptive.decision_numbers import NO_NUMBERS, Numbers
from retuner.adaptive.supervision.admission import AdmissionNumbers


@dataclass(frozen=True, slots=True)
class Outer(Numbers):
    peaks: float
    inner: AdmissionNumbers | None = None


def test_what_is_not_said_is_not_told_and_zero_is_said() -> None:
    assert AdmissionNumbers(manual=0.0, limit=0.5).to_dict() == {"manual": 0.0, "limit": 0.5}
    assert NO_NUMBERS.to_dict() == {}


def test_numbers_within_numbers_stand_beside_the_rest() -> None:
    assert Outer(2.0, AdmissionNumbers(kept=7.0)).to_dict() == {"peaks": 2.0, "kept": 7.0}
    assert Outer(2.0).to_dict() == {"peaks": 2.0}


def test_joined_keeps_both_and_changes_neither() -> None:
    first, second = AdmissionNumbers(kept=1.0, manual=0.0), AdmissionNumbers(manual=3.0)
    assert first.joined(second).to_dict() == {"kept": 1.0, "manual": 3.0}
    assert (first.manual, second.kept) == (0.0, None)


def test_nobody_writes_into_them() -> None:
    said = AdmissionNumbers()
    with pytest.raises(FrozenInstanceError):
        said.kept = 1.0
