"""From a running session to its live file: every sample, and what else can be seen when it changes."""

from collections.abc import Callable, Mapping
from pathlib import Path

from retuner.adaptive.signals.sample import LoopSample
from retuner.config.model import Config
from retuner.live_view.live_file import FIELDS, LiveWriter
from retuner.live_view.loop_seen import LoopObserver
from retuner.schedule.table import GainTable
from retuner.session.outputs import live_file

EVERY_SAMPLES = 50
"""The state is told anew at least so often: progress and scheduling values move without anything else changing."""


def head_of(config: Config, table: GainTable, *, several: bool = False) -> dict[str, object]:
    """What of a loop does not change while a session runs, for whoever draws it. several : loops in the session."""
    loop, regions = config.loop, table.regions
    return {
        "loop": loop.name,
        "several": several,
        "unit": loop.pv_unit,
        "pv": [loop.pv_min, loop.pv_max],
        "co": [loop.co_min_pct, loop.co_max_pct],
        "sample_time_s": loop.sample_time_s,
        "ms_limit": config.adaptation.ms_marked,
        "approval_s": config.adaptation.approval_s,
        "regions": list(regions.names),
        "axes": [{"label": axis.label, "unit": axis.unit, "bounds": list(axis.bounds)} for axis in regions.axes],
        "fields": list(FIELDS),
        "duration_s": config.scenario.duration_s if config.scenario else None,
    }


class Publisher:
    """Writes what can be seen of one loop.

    Parameters
    ----------
    folder : of the session. head : what does not change. observer : of the loop. say : is told once why it ends.
    number : of the loop in its session, from 1.
    """

    def __init__(
        self,
        folder: Path,
        head: Mapping[str, object],
        observer: LoopObserver,
        say: Callable[[str], None],
        number: int = 1,
    ) -> None:
        self._path, self._observer, self._say = live_file(folder, number), observer, say
        self._told: tuple[object, ...] = ()
        self._since = 0
        self._writer: LiveWriter | None = None
        self._newest: LoopSample | None = None
        try:
            self._writer = LiveWriter(self._path, head)
        except OSError as error:
            self._give_up(error.strerror or str(error))

    def sample(self, sample: LoopSample) -> None:
        """A sample that the loop has taken in."""
        writer, observer = self._writer, self._observer
        if writer is None:
            return
        s, region, running = sample, observer.region, observer.running
        gains = (running.kp, running.ki, running.kd) if running else (0.0, 0.0, 0.0)
        writer.sample((s.t_s, s.sp, s.pv, s.co, -1.0 if region is None else float(region), float(s.limited), *gains))
        self._newest = sample
        self._since += 1
        moved = observer.moved()
        if moved != self._told or self._since >= EVERY_SAMPLES:
            self._told, self._since = moved, 0
            writer.state(observer.look(sample).to_dict())
        if writer.trouble:
            self._give_up(writer.trouble)

    def close(self) -> None:
        """No more is told than how it stands."""
        if self._writer is not None:
            if self._newest is not None:
                self._writer.state(self._observer.look(self._newest).to_dict())
            self._writer.close()
            self._writer = None

    def _give_up(self, why: str) -> None:
        """Watching from outside ends; the session goes on."""
        self.close()
        self._say(f"{self._path}: {why}; the session continues, but cannot be watched from outside")
