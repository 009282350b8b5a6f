"""A simulated loop with somebody who watches it: plant, valve, controller, supervisor, a sample at a time.

The order within a sample is a controller's: read pv, compute co, report the sample. Gains that the supervisor asks for
are in force from the next sample on, taken over without a bump. No rounding by a device is modelled.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from cases.loop import FAR, Sensor, Valve

from retuner import Action, Decision, GainTable, Lookup, LoopMode, LoopSample, Mode, PidGains, Retuner, RetunerSettings
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.schedule.pid import LIMITED, PidState, change, law, start, step
from retuner.schedule.regions import Regions, RegionState, choose, enter

LOST = 1e4  # A loop whose pv is further from rest than this many setpoint steps has been lost


class Moved(Protocol):
    """A process about its resting point."""

    def move(self, u: float) -> float:
        """Hold the input u for one sample; the output at its end."""


class Supervisor(Protocol):
    """Whoever may change the gains of a loop."""

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        """Take a sample; a region and the gains to write there, or nothing."""

    def written(self, region: int, gains: PidGains) -> None:
        """The controller runs them now."""


class FixedGains:
    """Nobody changes anything."""

    def observe(self, sample: LoopSample) -> None:
        """Nothing ever follows."""

    def written(self, region: int, gains: PidGains) -> None:
        """Never asked for."""


class LostLoop(Exception):  # noqa: N818  it is no error of the program
    """pv went out of all bounds: the loop was unstable for too long."""


class WatchedLoop:
    """The loop from rest.

    plant : about rest. table : regions and gains at the start; regions are along sp or pv. dt_s : sampling interval.
    co0, sp0 : resting output and setpoint. low, high : range of the output. lost : |pv - sp0| at which it is lost.
    """

    def __init__(
        self,
        plant: Moved,
        table: GainTable,
        dt_s: float,
        supervisor: Supervisor,
        *,
        co0: float = 0.0,
        sp0: float = 0.0,
        low: float = -FAR,
        high: float = FAR,
        valve: Valve | None = None,
        sensor: Sensor | None = None,
        lost: float = LOST,
        hidden: bool = False,
    ) -> None:
        self.plant, self.table, self.dt_s, self.supervisor = plant, table, dt_s, supervisor
        self.co, self.sp0, self.co0, self.low, self.high, self.lost = co0, sp0, co0, low, high, lost
        self.valve, self.sensor, self.hidden = valve, sensor, hidden
        self._rest = valve(co0) if valve else co0
        self._regions = table.regions.law()
        self.region: RegionState = enter(self._regions, sp0, 0.0)
        self._law = law(table.gains_of(self.region.region), co_min=low, co_max=high)
        self._state: tuple[float, float, float, float, int] = tuple(start(self._law, sp0, sp0, co0))
        self.i, self.y, self.changes, self.revision = 0, 0.0, 0, 0
        self.sp = 0.0
        """Setpoint that was last sent, where somebody moves it between runs."""

    @property
    def gains(self) -> PidGains:
        """In force now."""
        return self._law.gains

    @property
    def t_s(self) -> float:
        """Time of the last sample."""
        return self.i * self.dt_s

    def run(self, sp: float, load: float | Sequence[float], noise: Sequence[float]) -> list[tuple[float, float]]:
        """As many samples as there is noise, at this setpoint and load (one value, or one a sample); (pv, co) of each.

        Raises LostLoop: pv went out of all bounds.
        """
        trace, loads = [], [load] * len(noise) if isinstance(load, (int, float)) else load
        dt_s, plant, valve, sensor, supervisor = self.dt_s, self.plant, self.valve, self.sensor, self.supervisor
        sp0, rest, lost, watched = self.sp0, self._rest, self.lost, not self.hidden
        by_pv, blended = self.table.regions.variable == "pv", self.table.lookup is Lookup.INTERPOLATED
        for more, upset in zip(noise, loads, strict=True):
            self.i += 1
            t_s = self.i * dt_s
            pv = sp0 + self.y + more
            if sensor:
                pv = sensor(pv)
            x = pv if by_pv else sp
            now = choose(self._regions, self.region, x, t_s)
            if now is not self.region:
                if now.region != self.region.region and not blended:
                    self._adopt(self.table.gains_of(now.region), sp, self._state[1])
                self.region = now
            if blended:
                self._adopt(self.table.at(now.region, x), sp, self._state[1])
            self._state, co = step(self._law, self._state, sp, pv, dt_s)
            self.co = co
            self.y = y = plant.move((valve(co) if valve else co) - rest + upset)
            trace.append((pv, co))
            if not -lost < y < lost:
                raise LostLoop
            if not watched:
                continue
            limited = self._state[LIMITED]
            wish = supervisor.observe(LoopSample(t_s, sp, pv, co, LoopMode.AUTO, limited, x, self.revision))
            if wish is not None:
                self.write(*wish, sp, pv)
        return trace

    def write(self, region: int, gains: PidGains, sp: float, pv: float) -> None:
        """Put gains in force, without a bump, and tell the supervisor."""
        self.table = self.table.with_gains(region, gains)
        self.changes += 1
        self.revision += 1
        if region == self.region.region and self.table.lookup is Lookup.HARD:  # a mean comes with the next sample
            self._adopt(gains, sp, pv)
        self.supervisor.written(region, gains)

    def _adopt(self, gains: PidGains, sp: float, pv: float) -> None:
        new = law(gains, co_min=self.low, co_max=self.high)
        state: PidState = change(self._law, new, self._state, sp, pv)
        self._state, self._law = tuple(state), new


# ---- Who watches a loop in the comparison: retuner itself; see rivals.py for the others

WRITTEN = frozenset({Action.WRITE, Action.RESTORE})  # Actions after which gains are written
OPENED = 8.0  # Factor to which a change, and the sum of all changes, is held where the limits are opened


def guard_settings(*, opened: bool) -> GuardSettings:
    """The defaults, or all limits on the size of a change at OPENED."""
    usual = GuardSettings()
    return usual.opened(OPENED) if opened else usual


def settings(dt_s: float, pv_span: float, *, opened: bool = False) -> RetunerSettings:
    """Settings of a retuner that may write by itself."""
    return RetunerSettings(dt_s, pv_span, Mode.AUTO, guard=guard_settings(opened=opened))


def one_region(gains: PidGains) -> GainTable:
    """A table with a single set."""
    return GainTable("loop", Regions("sp", "-", ("all",), -1e6, (), 1e6), (gains,))


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
