"""What was weighed, as a value: its fields are the names under which a decision tells it.

    class SwingNumbers(Numbers):
        decay: float
        decay_sure: float | None = None

Such a value is built where the numbers are found, and handed back; nobody writes into another's. The plain form that a
ledger keeps is made here and nowhere else.
"""

from enum import StrEnum
from typing import Self

from retuner.schedule.late_dataclass import dataclass, fields, replace


@dataclass(frozen=True, slots=True)
class Numbers:
    """Numbers by name, None where one is not said; by itself: none at all. A field may hold Numbers again."""

    def to_dict(self) -> dict[str, float]:
        """What is said, by name; what a field holds in Numbers of its own stands beside the rest."""
        found: dict[str, float] = {}
        for name, value in ((field.name, getattr(self, field.name)) for field in fields(self)):
            if isinstance(value, Numbers):
                found |= value.to_dict()
            elif value is not None:
                found[name] = value
        return found

    def joined(self, other: Self) -> Self:
        """Two sets of numbers of one kind as one; `other` has the last word."""
        said = {field.name: getattr(other, field.name) for field in fields(other)}
        return replace(self, **{name: value for name, value in said.items() if value is not None})


NO_NUMBERS = Numbers()  # the numbers of a decision that weighed nothing


class Basis(StrEnum):
    """What a proposal rests on."""

    MODEL = "model"
    SLOW_OSCILLATION = "slow_oscillation"
    PATTERN = "pattern"
    BORROWED = "borrowed"
    PRETUNE = "pretune"
    ALL_SAMPLES = "all_samples"
