"""What happens in a run: setpoint and load steps at their times, counted from the first sample."""

from collections import deque

import numpy as np

from retuner.adaptive.signals.sample import FloatArray
from retuner.config.bench_config import ScenarioConfig, StepConfig


class ScenarioPlayer:
    """Hands out each step once, when its time has come.

    scenario : the steps in the order of time, or None: nothing happens and it never ends.
    """

    def __init__(self, scenario: ScenarioConfig | None) -> None:
        self._left = deque(scenario.steps if scenario else ())
        self.duration_s = scenario.duration_s if scenario else float("inf")
        self._start_s: float | None = None
        self._elapsed_s = 0.0
        self.played: list[float] = []
        """Sample times at which steps were taken."""

    def due(self, t_s: float) -> list[StepConfig]:
        """Steps whose time has come at sample time t_s; the first call sets the zero of time."""
        if self._start_s is None:
            self._start_s = t_s
        self._elapsed_s = t_s - self._start_s
        found = []
        while self._left and self._left[0].at_s <= self._elapsed_s:
            found.append(self._left.popleft())
            self.played.append(t_s)
        return found

    @property
    def finished(self) -> bool:
        """Whether the run has had its whole length."""
        return self._elapsed_s >= self.duration_s

    @property
    def progress(self) -> float:
        """Share of the run that is over, 0 to 1."""
        return min(self._elapsed_s / self.duration_s, 1.0)


def loads_at(scenario: ScenarioConfig | None, t_s: FloatArray) -> FloatArray:
    """The load that a scenario has put on the plant by each time, percent; t_s counts from its first value."""
    steps = [step for step in scenario.steps if step.load is not None] if scenario else []
    levels = np.array([0.0, *(step.load or 0.0 for step in steps)])
    return levels[np.searchsorted([step.at_s for step in steps], t_s - (t_s[0] if len(t_s) else 0.0), side="right")]
