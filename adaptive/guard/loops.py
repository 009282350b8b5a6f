"""Ms of one set of gains on every model that is allowed, evaluated when asked and only once.

A set is safer than another when, on the models that are stable with either,

    Ms falls on the process, falls at worst, and rises on no model,

and no model that was stable becomes unstable. On a model that is unstable before and after (the largest step that the
limits allow is not enough) Ms does not say which is better. There the direction does: less of everything, which slows
the run away on any process; or a step on the straight way to a goal that is stable there.
"""

import math
from collections.abc import Sequence

from retuner.adaptive.guard.parameters import less_of_everything
from retuner.adaptive.margins import sensitivity_peak
from retuner.adaptive.process import LinearProcess
from retuner.schedule.gains import PidGains


class Loops:
    """Several processes, the first the one identified; filter_s : filter time of the controller's derivative."""

    def __init__(self, processes: Sequence[LinearProcess], filter_s: float = 0.0) -> None:
        self._processes, self._filter_s = tuple(processes), filter_s
        self._known: dict[tuple[int, PidGains], float] = {}
        self._order = list(range(len(self._processes)))

    def __len__(self) -> int:
        return len(self._processes)

    def ms(self, i: int, gains: PidGains) -> float:
        """Ms on one process, infinite when unstable."""
        key = (i, gains)
        if key not in self._known:
            self._known[key] = sensitivity_peak(self._processes[i], gains, self._filter_s)
        return self._known[key]

    def nominal(self, gains: PidGains) -> float:
        """Ms on the process, NaN when no model is known."""
        return self.ms(0, gains) if self._processes else math.nan

    def worst(self, gains: PidGains) -> float:
        """Largest Ms, NaN when no model is known."""
        return max((self.ms(i, gains) for i in range(len(self))), default=math.nan)

    def within(self, gains: PidGains, nominal: float, worst: float) -> bool:
        """Whether Ms keeps both limits; stops at the first model that does not, which is asked first next time."""
        if self.nominal(gains) > nominal:
            return False
        for place, i in enumerate(self._order):
            if self.ms(i, gains) > worst:
                self._order.insert(0, self._order.pop(place))
                return False
        return True

    def all_over(self, gains: PidGains, limit: float) -> bool:
        """Whether Ms is over a limit on every model (and there is one)."""
        return bool(self._processes) and all(self.ms(i, gains) > limit for i in range(len(self)))

    def safer(self, old: PidGains, new: PidGains, goal: PidGains) -> bool:
        """Whether new is safer than old (see the head of this file); goal : where the step leads."""
        pairs = [(self.ms(i, old), self.ms(i, new)) for i in range(len(self))]
        if not pairs or any(after > before for before, after in pairs):
            return False
        lost = [i for i, (before, after) in enumerate(pairs) if math.isinf(before) and math.isinf(after)]
        if lost:
            return less_of_everything(old, new) or all(math.isfinite(self.ms(i, goal)) for i in lost)
        return pairs[0][1] < pairs[0][0] and max(after for _, after in pairs) < max(before for before, _ in pairs)
