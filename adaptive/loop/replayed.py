"""A record replayed with other settings: what pv and co would have been under the same setpoint and the same loads.

    pv' = pv + G (co' - co),    co' = C' (sp - pv')

with pv, co on record, G the process and C' the other controller. What it does otherwise acts through the process alone
and adds to what was recorded, whatever the loads were and wherever they entered: steps, drifts and loads that wander
alike. As far as G is wrong, what it missed of the recorded co counts as a load, which is why a replay is told over all
models that the record allows.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.pid import law, start, step

MOST_SAMPLES = 20_000
"""Samples of a replay: of a longer record the newest ones. Thinning would give the controller another interval."""
MOST_STEPS, FEWEST_MODELS, MOST_MODELS = 120_000, 3, 12
"""Samples over all models that are replayed, and how many models at the least and at the most."""
GRID_SLACK = 1e-6  # share of an interval by which a time of the grid may miss a sample and still be it
WILD = 100.0  # A replay that leaves the record's pv by so many of its ranges runs away, and ends there


@dataclass(frozen=True, slots=True)
class ReplayedRecord:
    """A record with the settings of another controller in it: arrays of shape (n,) on one even grid.

    t_s, sp : as recorded. pv, co : as they would have been; in a replay that runs away NaN from there on.
    """

    t_s: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray

    @property
    def error(self) -> float:
        """Mean of |sp - pv|, pv units; infinite where the replay runs away."""
        return mean_error(self.sp, self.pv)

    @property
    def travel(self) -> float:
        """Way of co over the whole record, co units; infinite where the replay runs away."""
        return way(self.co)


def mean_error(sp: FloatArray, pv: FloatArray) -> float:
    """Mean of |sp - pv|, pv units; infinite where pv is not a number."""
    found = float(np.mean(np.abs(sp - pv)))
    return found if math.isfinite(found) else math.inf


def way(co: FloatArray) -> float:
    """Sum of the moves of co, co units; infinite where co is not a number."""
    found = float(np.sum(np.abs(np.diff(co))))
    return found if math.isfinite(found) else math.inf


def even(window: Window, most: int = MOST_SAMPLES) -> Window:
    """The newest of the record on an even grid of its usual interval; sp and co are held, pv is interpolated."""
    dt_s, end = window.sample_time_s, float(window.t_s[-1])
    n = min(max(round((end - float(window.t_s[0])) / dt_s), 2) + 1, most)
    t_s = np.maximum(end - dt_s * np.arange(n - 1, -1, -1, dtype=np.float64), window.t_s[0])
    t_s[0] = min(t_s[0], t_s[1] - dt_s / 2)
    last = np.clip(np.searchsorted(window.t_s, t_s + dt_s * GRID_SLACK, side="right") - 1, 0, len(window.t_s) - 1)
    return Window(t_s, window.sp[last], np.interp(t_s, window.t_s, window.pv), window.co[last], window.noise_std)


def replayed(
    window: Window,
    process: LinearProcess,
    gains: PidGains,
    co_limits: tuple[float | None, float | None] = (None, None),
    active: PidGains | None = None,
) -> ReplayedRecord:
    """The record with these settings in the loop, from the first sample on.

    window : on an even grid (`even`). process : that was identified on it. gains : the settings to try.
    co_limits : lowest and highest co, co units; None where there is none. active : in force on record, whose integral
        is taken over: a record may begin with the step of co at a setpoint step. Without them co is. The derivative is
        filtered by a tenth of its time.

    Raises ValueError: the process has more zeros than poles, or the limits leave no room.
    """
    dt_s = window.sample_time_s
    # The limits of co; where none is given, so far that a replay never meets one
    room = 1e6 * max(float(np.ptp(window.co)), 1.0)
    low = float(np.min(window.co)) - room if co_limits[0] is None else co_limits[0]
    high = float(np.max(window.co)) + room if co_limits[1] is None else co_limits[1]
    filter_s = gains.kd / gains.kp / 10.0 if gains.kp else 0.0
    pid = law(gains, tau_f_s=max(filter_s, 0.0), co_min=low, co_max=high)
    was = list(zip(window.sp.tolist(), window.pv.tolist(), window.co.tolist(), strict=True))
    far = WILD * max(float(np.ptp(window.pv)), float(np.ptp(window.sp)), 1e-9)
    plant, moved = HeldInput(process, dt_s), 0.0
    first = was[0][2] + (gains.kp - active.kp if active else 0.0) * (was[0][0] - was[0][1])
    state: tuple[float, float, float, float, int] = start(pid, *was[0][:2], first)
    pv, co = np.full(len(was), np.nan), np.full(len(was), np.nan)
    for i, (wanted, free, before) in enumerate(was):
        if not abs(moved) < far:
            break
        pv[i] = moved + free
        state, out = step(pid, state, wanted, moved + free, dt_s)
        co[i] = out
        moved = plant.step(out - before)
    return ReplayedRecord(window.t_s, window.sp, pv, co)


@dataclass(frozen=True, slots=True)
class BeforeAfter:
    """A record, and the same with other settings in the loop on every model that the record allows.

    record : on an even grid. replays : the best model's first.
    """

    record: Window
    replays: tuple[ReplayedRecord, ...]

    @property
    def best(self) -> ReplayedRecord:
        """The replay on the model that is believed most."""
        return self.replays[0]

    def band(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest value of "pv" or "co" over the models, each of shape (n,)."""
        all_of = np.stack([getattr(one, name) for one in self.replays])
        return np.min(all_of, axis=0), np.max(all_of, axis=0)


def before_after(
    window: Window,
    processes: Sequence[LinearProcess],
    gains: PidGains,
    co_limits: tuple[float | None, float | None] = (None, None),
    active: PidGains | None = None,
) -> BeforeAfter:
    """A record before and after a change of settings; processes : the best first. Errors as `replayed`."""
    record = even(window)
    most = min(max(MOST_STEPS // len(record.t_s), FEWEST_MODELS), MOST_MODELS)
    each = (replayed(record, one, gains, co_limits, active) for one in spread(processes, most))
    return BeforeAfter(record, tuple(each))


def spread(processes: Sequence[LinearProcess], most: int) -> tuple[LinearProcess, ...]:
    """The first models and evenly chosen ones of the rest, at most so many."""
    if len(processes) <= most:
        return tuple(processes)
    return tuple(processes[i] for i in np.linspace(0, len(processes) - 1, most).astype(int))
