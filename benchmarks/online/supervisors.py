"""Who watches a loop in the comparison: retuner itself; see rivals.py for the others."""

from collections.abc import Callable

from retuner.adaptive.guard import GuardSettings
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

WRITTEN = frozenset({Action.COMMIT, Action.RESTORE})
"""Actions after which gains are written."""
OPENED = 8.0
"""Factor to which a change, and the sum of all changes, is held where the limits are opened."""


def guard_settings(*, opened: bool) -> GuardSettings:
    """The defaults, or all limits on the size of a change at OPENED."""
    usual = GuardSettings()
    return usual.opened(OPENED) if opened else usual


def settings(dt_s: float, pv_span: float, *, opened: bool = False) -> RetunerSettings:
    """Of a retuner that may write by itself."""
    return RetunerSettings(dt_s, pv_span, Mode.AUTO, guard=guard_settings(opened=opened))


def one_region(gains: PidGains, reach: float = 1e6) -> GainTable:
    """A table with a single set."""
    return GainTable("loop", Regions("sp", "-", ("all",), -reach, (), reach), (gains,))


class Watching:
    """Retuner, live; told : is given every decision."""

    def __init__(
        self, table: GainTable, wanted: RetunerSettings, told: Callable[[Decision], None] | None = None
    ) -> None:
        self.retuner = Retuner(table, wanted)
        self.decisions: list[Decision] = []
        self.writes: list[Decision] = []
        self._told = told

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        """A decision now and then; those that ask for a write are written."""
        decision = self.retuner.observe(sample)
        if decision is None:
            return None
        self.decisions.append(decision)
        if self._told:
            self._told(decision)
        if decision.action not in WRITTEN or decision.gains_after is None:
            return None
        self.writes.append(decision)
        return self.retuner.table.index(decision.region), decision.gains_after

    def written(self, region: int, gains: PidGains) -> None:
        """Tell retuner, as a session does after reading back."""
        if self.writes and self.writes[-1].action == Action.RESTORE:
            self.retuner.restored()
        else:
            self.retuner.committed(region, gains)
