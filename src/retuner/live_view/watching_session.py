"""Looks on at a session for whoever sits at the screen, and for whoever watches from another process.

From a running session to its live file: every sample, and what else can be seen when it changes.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from retuner.adaptive.signals.sample import LoopSample
from retuner.config.model import Config
from retuner.config.session_config import SessionConfig
from retuner.decision_page.row_values import number
from retuner.live_view.live_file import FIELDS, LiveWriter
from retuner.live_view.live_screen import LiveScreen
from retuner.live_view.loop_seen import LoopObserver
from retuner.products import product
from retuner.report.console import screen_console
from retuner.report.event_words import event_line
from retuner.schedule.table import GainTable
from retuner.session.loop_session import LoopSession
from retuner.session.outputs import live_file
from retuner.session.session import Observer

# ---- From a running session to its live file

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
        "by_hand": product("foreign device").advice_only(config) if config.foreign_device else "",
        "regions": list(regions.names),
        "axes": [{"label": axis.label, "unit": axis.unit, "bounds": list(axis.bounds)} for axis in regions.axes],
        "fields": list(FIELDS),
        "duration_s": config.scenario.duration_s if config.scenario else None,
    }


class Publisher:
    """Writes what can be seen of one loop.

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
        self.close()
        self._say(f"{self._path}: {why}; the session continues, but cannot be watched from outside")


TOLD_WHEN_LATE = 3  # decisions that came too late, or were left out for one, after which it is told what helps
COME_LATE = (
    "decisions take longer than the loop's responses: what is late changes nothing, the gains stay; a lower --speed "
    "(here and at the device), or fewer programs beside this one, lets them come in time"
)


def screen_for(as_json: bool, *, answers_only: bool, detail: bool) -> LiveScreen:
    """The screen of a run: on standard error where its answer is one JSON document. answers_only, detail : see it."""
    return LiveScreen(screen_console(stderr=as_json), quiet=as_json, answers_only=answers_only, detail=detail)


class OnScreen(Observer):
    """Shows the loops of a run as they go."""

    def __init__(self, screen: LiveScreen, config: SessionConfig) -> None:
        self._screen, self._config = screen, config
        self._observers: dict[str, LoopObserver] = {}

    def observer(self, loop: LoopSession) -> LoopObserver:
        """The one that looks at a loop."""
        if loop.name not in self._observers:
            self._observers[loop.name] = LoopObserver(loop.retuner, loop.device)
        return self._observers[loop.name]

    def sampled(self, loop: LoopSession, sample: LoopSample) -> None:
        """See Observer."""
        name, config = loop.name, self._config
        unit = config.loops[self._place(loop) if config.several else 0].loop.pv_unit
        self._screen.sample(name, unit, sample.pv, loop.scenario.progress, lambda: self.observer(loop).look(sample))

    def _place(self, loop: LoopSession) -> int:
        return self._config.names.index(loop.name)


class Watching(OnScreen):
    """The observer of a session with its decisions and what else happens; and a live file for each loop.

    folder : of the session.
    """

    def __init__(self, screen: LiveScreen, config: SessionConfig, folder: Path) -> None:
        super().__init__(screen, config)
        self._folder = folder
        self._publishers: dict[str, Publisher] = {}
        self._lost: dict[str, int] = {}
        self._late = 0

    def sampled(self, loop: LoopSession, sample: LoopSample) -> None:
        """See Observer."""
        if (found := self._publishers.get(loop.name)) is None:
            place = self._place(loop)
            head = head_of(self._config.loops[place], loop.table, several=self._config.several)
            found = Publisher(self._folder, head, self.observer(loop), self._screen.say, place + 1)
            self._publishers[loop.name] = found
        found.sample(sample)
        super().sampled(loop, sample)

    def recorded(self, loop: LoopSession | None, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """See Observer."""
        name = loop.name if loop is not None and self._config.several else ""
        if kind == "decision" and loop is not None:
            self._screen.decision(made := loop.decisions[-1], name)
            late = made.code == "passed_over" or made.code.startswith("overtaken")
            self._late += late
            if late and self._late == TOLD_WHEN_LATE:
                self._screen.say(COME_LATE)
        elif told := event_line(kind, body):
            if kind == "lost" and not body.get("reason"):  # told again when their number has doubled
                before = self._lost.get(name, 0)
                self._lost[name] = total = before + int(number(body, "count") or 0)
                if total.bit_length() == before.bit_length():
                    return
                told += f", {total} so far" * bool(before)
            self._screen.event(f"{t_s:8,.0f} s {f'{name}: ' * bool(name)}{told}")

    def said(self, text: str) -> None:
        """See Observer."""
        self._screen.say(text)

    def close(self) -> None:
        """The session is over."""
        for publisher in self._publishers.values():
            publisher.close()
