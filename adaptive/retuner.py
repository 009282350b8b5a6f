"""The retuner: one sample in, now and then one decision out.

    sample -> watcher -> completed response -> pipeline -> decision

The object is a thin shell round pure steps: no clock, no file, no bus. It never writes gains: it hands out a decision,
and learns by `committed` what the controller then reported.
"""

from typing import NamedTuple

from retuner.adaptive.belief import Belief
from retuner.adaptive.decision import Action, Decision, Mode
from retuner.adaptive.diagnosis.online import Standing
from retuner.adaptive.pipeline import Case, Outcome, decide
from retuner.adaptive.recogniser import Phase
from retuner.adaptive.response import Response
from retuner.adaptive.retuner_settings import RetunerSettings
from retuner.adaptive.sample import LoopSample
from retuner.adaptive.watcher import Completed, Left, Watcher, WatcherState
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable

LEFT = {
    False: Outcome("left_region", "the response left its region; it teaches nothing of either"),
    True: Outcome("variable_unknown", "the scheduling variable is not known any more: nobody can say to which region "
                  "the response belongs; it teaches nothing"),
}  # fmt: skip
"""What follows from a response that was cut off, by whether a scheduling variable was unknown."""


class RetunerState(NamedTuple):
    """Where a retuner stands; with its table and beliefs, all that later decisions depend on."""

    watcher: WatcherState
    decisions: int


class Retuner:
    """Watches one loop and decides.

    Parameters
    ----------
    table : regions and the gains in force in each.
    settings : see RetunerSettings.
    commissioned : the table as it was at first, when `table` is a later revision of it.
    """

    def __init__(self, table: GainTable, settings: RetunerSettings, commissioned: GainTable | None = None) -> None:
        self.settings = settings
        self.commissioned = commissioned or table
        self.beliefs: dict[int, Belief] = {}
        self.standing: dict[int, Standing] = {}
        self._watcher = Watcher(table, settings)
        self._observe = self._watcher.take
        self._decisions = 0

    @property
    def table(self) -> GainTable:
        """The gains in force."""
        return self._watcher.table

    @property
    def region(self) -> int | None:
        """Index of the region that the loop is in, None before the first sample."""
        return self._watcher.region

    @property
    def phase(self) -> Phase | None:
        """Where the recogniser stands."""
        return self._watcher.phase

    @property
    def band(self) -> float:
        """Noise band in pv units."""
        return self._watcher.band

    def state(self) -> RetunerState:
        """Where it stands: see memory.py, which turns it into plain values."""
        return RetunerState(self._watcher.state(), self._decisions)

    def resume(self, state: RetunerState) -> None:
        """Go on from there."""
        self._watcher.resume(state.watcher)
        self._decisions = state.decisions

    def observe(self, sample: LoopSample) -> Decision | None:
        """Take one sample; a decision comes with the sample that completes a response.

        Raises
        ------
        ValueError
            A number of the sample is not finite or its time does not increase; nothing is changed then.
        """
        seen = self._observe(sample)
        return None if seen is None else self._seen(seen)

    def committed(self, region: int, gains: PidGains) -> GainTable:
        """Take note that the controller now runs these gains in a region; returns the new table revision.

        gains : as read back from the controller (after its rounding).
        """
        self._watcher.gains_changed(self.table.with_gains(region, gains))
        return self.table

    def _seen(self, seen: Completed | Left) -> Decision | None:
        """Something came to an end: decide on it."""
        if isinstance(seen, Left):
            return self._decision(seen.region, LEFT[seen.unknown]) if seen.under_way else None
        if self.settings.mode_of(seen.region) == Mode.OFF:
            return None
        outcome = decide(self._case(seen), self.settings)
        if outcome.belief is not None:
            self.beliefs[seen.region] = outcome.belief
        if outcome.standing is not None:
            self.standing[seen.region] = outcome.standing
        return self._decision(seen.region, outcome, seen.response)

    def _case(self, seen: Completed) -> Case:
        """Everything that the decision depends on."""
        w = self._watcher
        return Case(
            seen.region,
            seen.response,
            w.window(seen.response),
            w.samples,
            w.table,
            self.commissioned,
            self.beliefs,
            self.standing.get(seen.region),
        )

    def _decision(self, region: int, outcome: Outcome, response: Response | None = None) -> Decision:
        """Put the record together."""
        verdict, learned = outcome.verdict, outcome.learned
        accepted = verdict is not None and verdict.accepted
        mode = self.settings.mode_of(region)
        wanted = Action.COMMIT if mode in {Mode.AUTO, Mode.TRIAL} else Action.ADVISE
        belief = learned.belief if learned else None
        self._decisions += 1
        return Decision(
            number=self._decisions,
            t_s=self._watcher.samples[-1].t_s,
            loop=self.table.loop,
            region=self.table.regions.names[region],
            mode=mode,
            action=wanted if accepted else Action.NONE,
            code=outcome.code,
            reason=outcome.reason,
            numbers=outcome.numbers,
            gains_before=self.table.gains_of(region),
            gains_after=verdict.gains if verdict else None,
            response=response,
            estimate=learned.estimate if learned else None,
            surprise=learned.surprise if learned else None,
            records=belief.records if belief else 0,
            diagnosis=outcome.diagnosis,
            basis=outcome.basis,
            proposal=outcome.proposal,
            verdict=verdict,
        )
