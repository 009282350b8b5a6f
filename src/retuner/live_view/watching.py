"""Looks on at a session for whoever sits at the screen, and for whoever watches from another process."""

from collections.abc import Mapping
from pathlib import Path

from retuner.adaptive.signals.sample import LoopSample
from retuner.config.session_config import SessionConfig
from retuner.live_view.live_screen import LiveScreen
from retuner.live_view.loop_seen import LoopObserver
from retuner.live_view.publishing import Publisher, head_of
from retuner.report.console import screen_console
from retuner.report.event_words import event_line
from retuner.session.loop_session import LoopSession
from retuner.session.session import NobodyLooks


def screen_for(as_json: bool, *, answers_only: bool, detail: bool) -> LiveScreen:
    """The screen of a run: on standard error where its answer is one JSON document. answers_only, detail : see it."""
    return LiveScreen(screen_console(stderr=as_json), quiet=as_json, answers_only=answers_only, detail=detail)


class OnScreen(NobodyLooks):
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
        observer, unit = self.observer(loop), self._config.loops[self._place(loop)].loop.pv_unit
        self._screen.sample(loop.name, unit, sample.pv, loop.scenario.progress, lambda: observer.look(sample))

    def _place(self, loop: LoopSession) -> int:
        """Where a loop stands among those of the session."""
        return self._config.names.index(loop.name)


class Watching(OnScreen):
    """The same, with decisions and what else happens; and a live file for each loop.

    Parameters
    ----------
    folder : of the session.
    """

    def __init__(self, screen: LiveScreen, config: SessionConfig, folder: Path) -> None:
        super().__init__(screen, config)
        self._folder = folder
        self._publishers: dict[str, Publisher] = {}

    def sampled(self, loop: LoopSession, sample: LoopSample) -> None:
        """See Observer."""
        if loop.name not in self._publishers:
            self._publishers[loop.name] = self._publisher(loop)
        self._publishers[loop.name].sample(sample)
        super().sampled(loop, sample)

    def recorded(self, loop: LoopSession | None, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """See Observer."""
        name = loop.name if loop is not None and self._config.several else ""
        if kind == "decision" and loop is not None:
            self._screen.decision(loop.decisions[-1], name)
        elif told := event_line(kind, body):
            self._screen.event(f"{t_s:8,.0f} s {f'{name}: ' * bool(name)}{told}")

    def said(self, text: str) -> None:
        """See Observer."""
        self._screen.say(text)

    def close(self) -> None:
        """The session is over."""
        for publisher in self._publishers.values():
            publisher.close()

    def _publisher(self, loop: LoopSession) -> Publisher:
        place = self._place(loop)
        head = head_of(self._config.loops[place], loop.table, several=self._config.several)
        return Publisher(self._folder, head, self.observer(loop), self._screen.say, place + 1)
