"""`retuner.PidController`: a scheduled PID controller that watches and retunes its own loop.

    pid = PidController(PidGains(kp=2.0, ki=0.05), dt_s=1.0, pv_range=(0, 200), mode="auto")
    while True:
        heater(pid.step(setpoint, thermometer()))       # once every dt_s

What a decision asks for is done here: gains change without a bump, and a change that disappoints is rolled back.
Nothing of that is left to the caller. `close` decides what runs on when nobody watches any more.
"""

import logging
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from retuner.adaptive import display_hook
from retuner.adaptive.orders import operator_orders
from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.question import NOT_EVALUATED
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.adaptive.trial.phase import TrialEvent
from retuner.decisions.background import BackgroundRetuner
from retuner.decisions.decider import Decider
from retuner.decisions.warm_up import warm_up_beside
from retuner.drivers.closing import Closes
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.pid import LIMITED, PidLaw, PidState, StateTuple, change, law, start, step, track
from retuner.schedule.regions import CAN, Regions, RegionState, choose, enter, values
from retuner.schedule.table import GainTable, Lookup
from retuner.simulation.loop_trend import Frame, History, LoopTrend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOG = logging.getLogger("retuner")
LOG.addHandler(logging.NullHandler())
MEMORY = 1  # version of what `memory` gives
HARD = Lookup.HARD
WARMS_AT = 20  # sample at which what a decision needs is loaded: a program that runs a step or two starts without it
LONGEST_S = 1e9  # Longest time between two steps: 30 years, and less than the time of day counted from 1970


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the loop stood after a sample. xs : values of the scheduling variables. table : that was in force."""

    t_s: float
    xs: tuple[float, float]
    region: RegionState
    table: GainTable
    pid: StateTuple
    sp: float
    pv: float


class PidController(display_hook.Drawn, Closes):
    """A PID controller with scheduled gains, and the retuner that watches it.

    Not thread-safe: guard calls with your own lock. Once a process, beside a loop that has run for a while, a thread
    loads what decisions need, so that no step waits for that.

    Parameters
    ----------
    gains : one set for all, or a GainTable with a set for each operating region.
    dt_s : usual time between two steps, seconds; more than 0.
    pv_range : lowest and highest pv that the transmitter can show, pv units.
    co_range : lowest and highest output, co units; the integral does not wind up there. Default 0 to 100 (percent).
    mode : what the retuner may do: "off", "advise" (default: proposals wait for `approve`), "trial" or "auto".
    b : setpoint weight of the proportional action, 0 to 1. tau_f_s : filter time of the derivative action, seconds.
    co_rate_per_s : fastest move of the output, co units per second; None for no limit.
    background : decisions are made in another process, so that no step takes long; close the controller then.
    settings : all settings of the retuner; in place of mode, and of what follows from dt_s, pv_range, b and tau_f_s.
    name : of the loop, in decisions and in the log.
    memory : what `memory` gave before a restart: gains and all that is known go on, and the output as it was. A change
        that was on trial then is decided at once: the more robust set runs.
    history : samples to keep for `history` and `plot`, 56 bytes each; 0 for none.

    Raises
    ------
    ValueError
        A number is not finite or outside what is said here, there is no such mode, or the memory cannot be used.

    Examples
    --------
    >>> pid = PidController(PidGains(kp=2.0, ki=0.05), dt_s=1.0, pv_range=(0, 200))
    >>> pid.step(60.0, 20.0)
    80.0
    >>> pid.step(60.0, 21.0)
    80.0
    >>> pid
    PidController('loop', advise: kp 2, ki 0.05, kd 0; co 80, no decision yet)
    """

    def __init__(
        self,
        gains: PidGains | GainTable,
        *,
        dt_s: float,
        pv_range: tuple[float, float],
        co_range: tuple[float, float] = (0.0, 100.0),
        mode: Mode | str = Mode.ADVISE,
        b: float = 1.0,
        tau_f_s: float = 0.0,
        co_rate_per_s: float | None = None,
        background: bool = False,
        settings: RetunerSettings | None = None,
        name: str = "loop",
        memory: Mapping[str, Any] | None = None,
        history: int = 100_000,
    ) -> None:
        low, high = _range("pv_range", pv_range)
        co_low, co_high = _range("co_range", co_range)
        if not (0.0 < dt_s < math.inf):
            raise ValueError(f"dt_s = {dt_s} must be a positive finite number of seconds")
        if isinstance(gains, GainTable):
            table = gains
        else:
            table = GainTable(name, Regions("pv", "pv", ("all",), low, (), high), (_gains(gains),))
        watched = settings or RetunerSettings(
            dt_s, high - low, _mode(mode), setpoint_weight=b, filter_s=tau_f_s, pv_range=(low, high)
        )
        self._retuner = Retuner(table, watched) if memory is None else _remembered(memory, table, watched)
        self._dt_s = dt_s
        self._law = law(
            table.gains[0], b=b, tau_f_s=tau_f_s, co_min=co_low, co_max=co_high, co_rate_per_s=co_rate_per_s
        )
        self._regions = table.regions.law()
        self._place: _Place | None = None
        self._background = BackgroundRetuner(self._retuner) if background else None
        self._decision: Decision | None = None
        self._last: Decision | None = None
        self._proposed: Decision | None = None
        self._held_co: float | None = None
        self._begin_s = 0.0
        self._history = History(history)
        if memory is not None:
            # Go on after a restart: time with a gap that nothing is learned over, and the output where it stood
            watched = self._retuner.settings
            self._begin_s = _finite("memory: t_s", memory["t_s"]) + (watched.gap_samples + 2) * watched.sample_time_s
            self._held_co = None if memory["co"] is None else _finite("memory: co", memory["co"])
            last = self._retuner.abort(TrialEvent.RESTARTED)
            if last is not None:
                self._obey(last)

    @classmethod
    def from_kc(
        cls, kc: float, tau_i_s: float | None = None, tau_d_s: float = 0.0, *, form: str = "ideal", **options: Any
    ) -> "PidController":
        """A controller from gain and times: see `PidGains.from_ideal`, and the class for the errors.

        form : "ideal" or "series". options : all else that the class takes; dt_s and pv_range must be given.
        """
        if form not in ("ideal", "series"):
            raise ValueError(f"form = {form!r} is unknown; use ideal, series")
        return cls((PidGains.from_ideal if form == "ideal" else PidGains.from_series)(kc, tau_i_s, tau_d_s), **options)

    def step(
        self,
        sp: float,
        pv: float,
        dt_s: float | None = None,
        *,
        x: float | None = None,
        x2: float | None = None,
        manual_co: float | None = None,
    ) -> float:
        """Take one sample; the output to apply until the next one.

        Parameters
        ----------
        sp, pv : setpoint and process value, pv units. dt_s : time since the last step, seconds; None for the usual one.
        x, x2 : values of the scheduling variables, where the table follows something else than sp, pv or co.
        manual_co : the output that somebody else sets, co units: the controller follows it, and takes over without a
            bump when it is left out again.

        Returns
        -------
        float
            The output, co units, inside its range and rate.

        Raises
        ------
        ValueError
            A number is not finite or the time not positive. Nothing is changed: go on with the next good sample, and
            give the time since the last good one.
        """
        sp, pv = _finite("sp", sp), _finite("pv", pv)
        elapsed_s = self._dt_s if dt_s is None else _finite("dt_s", dt_s)
        if elapsed_s > LONGEST_S:
            raise ValueError(
                f"dt_s = {elapsed_s:g} is over 30 years: give the time since the last step; nothing changed"
            )
        place = self._advanced(sp, pv, elapsed_s, (x, x2), manual_co)
        co, limited = place.pid[3], int(place.pid[LIMITED])
        mode = LoopMode.AUTO if manual_co is None else LoopMode.MANUAL
        xs = place.xs
        sample = LoopSample(place.t_s, sp, pv, co, mode, limited, xs[0], self._retuner.table.revision, xs[1])
        self._place = place  # before anybody may break off what follows: the time of the next sample goes on from here
        self._decision = (self._background or self._retuner).observe(sample)
        if self._retuner.sample_number == WARMS_AT:
            warm_up_beside()
        self._history.add((place.t_s, sp, pv, co, self._law.kp, self._law.ki, self._law.kd))
        if self._decision is not None:
            self._obey(self._decision)
        return co

    @property
    def trend(self) -> LoopTrend:
        """The newest samples, with the gains that each was worked out with."""
        return self._history.trend()

    @property
    def history(self) -> Frame:
        """The history as a frame of pandas, or as arrays by name where pandas is not installed."""
        return self.trend.frame()

    def plot(self) -> "Figure":
        """The picture of the newest samples, as a notebook shows it."""
        figure: Figure = display_hook.figure(self)
        return figure

    @property
    def decision(self) -> Decision | None:
        """The decision that came with the last step; None with most steps."""
        return self._decision

    @property
    def last_decision(self) -> Decision | None:
        """The newest decision so far."""
        return self._last

    @property
    def table(self) -> GainTable:
        """The gains of all regions as they stand."""
        return self._retuner.table

    @property
    def gains(self) -> PidGains:
        """The gains that the next step works with, unless it enters another region."""
        if self._place is None or self._retuner.region is None:
            return self._retuner.table.gains[0]
        return self._retuner.table.at(self._retuner.region, *self._retuner.scheduled)

    @property
    def retuner(self) -> Retuner:
        """What watches the loop."""
        return self._retuner

    def approve(self, decision: Decision | None = None) -> Decision:
        """Put a proposal in force, on trial: the newest one, unless another is given.

        Returns
        -------
        Decision
            What was done, or why not.

        Raises
        ------
        ValueError
            There is no proposal, it is older than a day, or other gains became active meanwhile.
        """
        advised = decision or self._proposed
        if advised is None or self._place is None:
            raise ValueError("there is no proposal to approve")
        return self._obey(operator_orders.approve_proposal(self._retuner, advised))

    def roll_back(self, region: int | str = 0) -> Decision | None:
        """Roll back a change that is on trial or waits for approval; None when there is none."""
        back = self._retuner.rolled_back(self._retuner.table.index(region))
        return None if back is None else self._obey(back)

    take_back = roll_back  # its former name

    def set_gains(self, gains: PidGains) -> Decision | None:
        """Set other gains by hand in the region where the loop is; they are kept for a shift, see TrialSettings.

        Raises
        ------
        ValueError
            The controller has made no step yet, the table cannot hold these gains there, or they act in the other
            direction; nothing is changed.
        """
        if self._place is None:
            raise ValueError("the controller has made no step yet; make it with these gains")
        made = self._retuner.edited(_gains(gains))
        if made is not None and made.code == "edit_not_taken":
            raise ValueError(made.reason)
        return None if made is None else self._obey(made)

    def set_mode(self, mode: Mode | str) -> Decision | None:
        """Say what the retuner may do from now on; "off" rolls back what is on trial."""
        back = operator_orders.set_mode(self._retuner, None, _mode(mode))
        return None if back is None else self._obey(back)

    def decide_by(self, decider: Decider) -> None:
        """Have decisions made elsewhere from now on: see `retuner.one_plant.controllers`.

        Raises
        ------
        ValueError
            They are made in the background.
        """
        if self._background is not None:
            raise ValueError("background = True: its decisions are made in another process already")
        self._background = BackgroundRetuner(self._retuner, decider=decider)

    def close(self) -> Decision | None:
        """End the watching. Of a change that is still on trial the more robust set runs on, the tried or the old one.

        Returns
        -------
        Decision or None
            Which set runs on; None where nothing was on trial.
        """
        last = self._retuner.abort(TrialEvent.STOPPED)
        if last is not None:
            self._obey(last)
        if self._background is not None:
            self._background.close()
        return last

    def memory(self) -> dict[str, object]:
        """What must not be lost over a restart, as plain JSON values; see the parameter of that name."""
        place = self._place
        return {
            "version": MEMORY,
            "retuner": remember(self._retuner),
            "t_s": self._begin_s if place is None else place.t_s,
            "co": self._held_co if place is None else place.pid[3],
        }

    def __repr__(self) -> str:
        g, table = self.gains, self._retuner.table
        co = "not stepped yet" if self._place is None else f"co {self._place.pid[3]:.4g}"
        said = "no decision yet" if self._last is None else f"last decision {self._last.number}: {self._last.code}"
        mode = self._retuner.settings.mode
        return f"PidController({table.loop!r}, {mode}: kp {g.kp:.4g}, ki {g.ki:.4g}, kd {g.kd:.4g}; {co}, {said})"

    def _advanced(
        self, sp: float, pv: float, dt_s: float, x: tuple[float | None, float | None], manual_co: float | None
    ) -> _Place:
        """Where the loop stands after this sample; nothing is changed here but the law in force."""
        # The values of the scheduling variables
        known = {"sp": sp, "pv": pv, "co": self._law.co_min if self._place is None else self._place.pid[3]}
        found = [0.0, 0.0]
        for i, axis in enumerate(self._retuner.table.regions.axes):
            given = x[i]
            if given is None and axis.variable == CAN:
                raise ValueError(f"the gains follow {axis.label}: give it as {('x', 'x2')[i]}")
            found[i] = float(known[axis.variable] if given is None else given)
        xs, last = (found[0], found[1]), self._place
        if last is None:
            t_s = self._begin_s
            region = enter(self._regions, xs[0], t_s, xs[1])
            now = self._law_at(region, xs)
            state: StateTuple
            if self._held_co is not None:
                state = start(now, sp, pv, self._held_co)
            else:  # integral at 0, so that the first output is that of the proportional action
                wish = now.kp * (now.b * sp - pv)
                if not math.isfinite(wish):
                    raise ValueError(f"sp = {sp}, pv = {pv}: give finite numbers")
                state = PidState(0.0, pv, 0.0, min(max(wish, now.co_min), now.co_max), 0)
        else:
            t_s = last.t_s + dt_s
            region = choose(self._regions, last.region, xs[0], t_s, xs[1])
            now, state = self._law_at(region, xs), last.pid
            if now is not self._law:
                state = change(self._law, now, state, last.sp, last.pv)
        if manual_co is None:
            state, _ = step(now, state, sp, pv, dt_s)
        else:
            state, _ = track(now, state, sp, pv, manual_co, dt_s)
        self._law = now
        return _Place(t_s, xs, region, self._retuner.table, state, sp, pv)

    def _law_at(self, region: RegionState, xs: tuple[float, float]) -> PidLaw:
        """The law with the gains of this place; the same object as long as they do not change."""
        now, last, table = self._law, self._place, self._retuner.table
        if last is not None and table is last.table and region.region == last.region.region and table.lookup == HARD:
            return now
        at = values(self._regions, region, *xs)
        if last is not None and not all(map(math.isfinite, at)):
            return now
        gains = table.at(region.region, *at)
        return now if (gains.kp, gains.ki, gains.kd) == (now.kp, now.ki, now.kd) else now.with_gains(gains)

    def _obey(self, decision: Decision) -> Decision:
        """Do what a decision asks for: the next step works with what the table has then."""
        self._last = decision
        if decision.action is Action.WRITE and decision.gains_after is not None:
            self._retuner.committed(self._retuner.table.index(decision.region), decision.gains_after)
        elif decision.action is Action.RESTORE:
            self._retuner.restored()
        elif decision.action is Action.ADVISE:
            self._proposed = decision
        level = logging.WARNING if decision.code == NOT_EVALUATED else logging.INFO
        LOG.log(level, "%s, region %s, %.0f s: %s", decision.loop, decision.region, decision.t_s, decision.reason)
        return decision


def _remembered(memory: Mapping[str, Any], table: GainTable, settings: RetunerSettings) -> Retuner:
    """The retuner of a controller before its restart.

    Raises ValueError: the memory is of another version, damaged, or of another loop.
    """
    if memory.get("version") != MEMORY or not {"retuner", "t_s", "co"} <= memory.keys():
        raise ValueError("memory: it is damaged, or of another release; leave it out to begin anew")
    found = restore(memory["retuner"], settings)
    if (found.table.loop, found.table.regions) != (table.loop, table.regions):
        raise ValueError(f"memory: it is of loop {found.table.loop!r} with other regions; leave it out to begin anew")
    return found


def _finite(name: str, value: float | str | None) -> float:
    """The number, if it is finite; a sensor that failed may give anything, None too.

    Raises ValueError: it is no finite number.
    """
    try:
        number = math.nan if value is None else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{name} = {value!r} is not a finite number; nothing is changed")
    return number


def _range(name: str, ends: tuple[float, float]) -> tuple[float, float]:
    """Two ends. Raises ValueError: they are not two finite numbers in their order."""
    try:
        low, high = ends
        ordered = -math.inf < low < high < math.inf
    except (TypeError, ValueError):
        ordered = False
    if not ordered:
        raise ValueError(f"{name} = {ends!r} must be two finite numbers, the lower one first")
    return low, high


def _gains(gains: PidGains) -> PidGains:
    """Gains; who comes from another library may give three numbers. Raises TypeError: they are something else."""
    if not isinstance(gains, PidGains):
        raise TypeError(f"gains = {gains!r}: give PidGains(kp, ki, kd), ki and kd in seconds, or a GainTable")
    return gains


def _mode(mode: Mode | str) -> Mode:
    if mode not in tuple(Mode):
        raise ValueError(f"mode = {mode!r} is unknown; use {', '.join(Mode)}")
    return Mode(mode)
