"""A state machine as data: where it stands, one table of where each input leads, and a count of what fits nowhere.

An input that the table does not name in the present phase leaves the phase as it is, for late and foreign answers are
ordinary on a bus; but it is counted, so that a machine which is driven in a way that nobody meant shows it.
"""

from collections import Counter
from collections.abc import Mapping
from enum import Enum
from typing import Generic, TypeVar

Phase = TypeVar("Phase", bound=Enum)
Input = TypeVar("Input", bound=Enum)


class StateMachine(Generic[Phase, Input]):
    """One machine at work.

    table : the phase that follows, by phase and input. start : the first phase.
    """

    def __init__(self, table: Mapping[tuple[Phase, Input], Phase], start: Phase) -> None:
        self._table = table
        self.phase = start
        self.ignored: Counter[tuple[Phase, Input]] = Counter()  # inputs that the table does not name, by phase

    def take(self, happened: Input) -> bool:
        """Go where the table says; whether it says anything."""
        new = self._table.get((self.phase, happened))
        if new is None:
            self.ignored[self.phase, happened] += 1
            return False
        self.phase = new
        return True
