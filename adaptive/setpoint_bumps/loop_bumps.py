"""What a bump would teach, and where there is room for it: the planner's eyes on a retuner."""

from collections.abc import Callable

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.region_model.sequences import unsure
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.setpoint_bumps.bump_planner import SECONDS_PER_HOUR, BumpNews, BumpPlanner, LoopAround
from retuner.adaptive.setpoint_bumps.bump_settings import HOURS, BumpSettings
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TrialPhase

BUMPS_TO_BOUNDARY = (
    2.0  # bumps between the setpoint and a boundary of the region or the end of pv's range: it overshoots
)
ONCE = 1  # records after which a region has shown its process only once: a second one is to agree
WRITES = frozenset({Mode.TRIAL, Mode.AUTO})  # modes in which retuner may write by itself, so a setpoint as well
TO_THE_SETPOINT = frozenset({"sp", "pv"})  # scheduling variables that a bump moves


def hour_of_samples(t_s: float) -> float:
    """The hour of the day where time is simulated: it begins at midnight."""
    return t_s / SECONDS_PER_HOUR % HOURS


class LoopBumps:
    """Watches over one loop's bumps.

    settings : see BumpSettings. retuner : of the loop. hour_of : the hour of the day at a sample's time.
    """

    def __init__(
        self, settings: BumpSettings, retuner: Retuner, hour_of: Callable[[float], float] = hour_of_samples
    ) -> None:
        self._retuner, self._hour_of = retuner, hour_of
        self.planner = BumpPlanner(settings, retuner.settings.pv_span, retuner.settings.sample_time_s)

    def step(self, sample: LoopSample, *, free: bool = True) -> BumpNews | None:
        """Take a sample that the retuner has seen. free : nothing is being written to the controller."""
        if not self.planner.settings.allowed:
            return None
        retuner, (low, high) = self._retuner, self._room()
        wanted = self._what_a_bump_would_teach() if free and retuner.open_question is None else ""
        gains = retuner.table.gains_of(retuner.region) if retuner.region is not None else None
        reset_s = abs(gains.kp / gains.ki) if gains is not None and gains.ki else 0.0
        hour, may_write = self._hour_of(sample.t_s), self._may_write()
        around = LoopAround(retuner.at_rest, wanted, hour, retuner.band, low, high, may_write, reset_s)
        return self.planner.step(sample, around)

    def decided(self, decision: Decision) -> None:
        """A setpoint response that taught something is evidence; what loads alone teach leaves the process open."""
        taught = decision.agreement is not None and decision.agreement is not Agreement.SILENT and decision.records
        if taught and decision.response is not None and decision.response.sp_changed:
            self.planner.evidence(decision.t_s)

    def _may_write(self) -> bool:
        retuner, region = self._retuner, self._retuner.region
        return region is not None and retuner.settings.mode_of(region) in WRITES

    def _what_a_bump_would_teach(self) -> str:
        """Why a bump would teach something here, in words; empty where it would not, or must not be made."""
        retuner, region = self._retuner, self._retuner.region
        if region is None or not self._may_write():
            return ""
        name, phase = retuner.table.regions.names[region], retuner.trials.phase(region)
        if phase is TrialPhase.TRIAL:
            return f'the gains on trial in region "{name}" have not been judged'
        if phase is not TrialPhase.IDLE:
            return ""
        model = retuner.region_models.get(region)
        if model is None:
            return f'nothing is known of the process in region "{name}"'
        if not model.identifiable:
            return f'the model of region "{name}" is not accurate enough yet'
        if not retuner.excitation.get(region, Excitation()).setpoints:
            return f'the model of region "{name}" rests on loads alone'
        if self.planner.restless and not model.sequences:
            return f'loads move the loop all the time, and the model of region "{name}" rests on single responses'
        open_ = unsure(model, retuner.settings.sample_time_s) if model.sequences else ""
        if open_:
            return f'the process in region "{name}" is {open_}'
        if model.records <= ONCE:
            return f'region "{name}" has shown its process only once'
        return ""

    def _room(self) -> tuple[float, float]:
        """Setpoints to which a bump may go: inside the range of pv, and inside the region by a bump more."""
        retuner, region = self._retuner, self._retuner.region
        settings, size = retuner.settings, self.planner.size
        low, high = settings.pv_range
        regions = retuner.table.regions
        for axis, part in zip(regions.axes, regions.cell(region) if region is not None else (), strict=False):
            if axis.variable in TO_THE_SETPOINT:
                edges = (low, *axis.bounds, high)
                low, high = max(low, edges[part]), min(high, edges[part + 1])
        return low + (BUMPS_TO_BOUNDARY - 1) * size, high - (BUMPS_TO_BOUNDARY - 1) * size
