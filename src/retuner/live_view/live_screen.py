"""What `retuner run` shows: on a terminal a live view with the decisions above it, elsewhere plain lines."""

import time
from collections import deque
from collections.abc import Callable

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from retuner.adaptive.supervision.decision import Decision
from retuner.live_view.loop_seen import LoopSeen
from retuner.live_view.terminal import PANEL_LINES, decision_lines, fitted, folded, loop_line, loop_lines
from retuner.report.console import MOST_CHARACTERS, live_line

RENEW_S = 0.2
"""Time between two pictures: what a person can follow, and less than a thousandth of the control loop's time."""
TRACED = 600
"""Samples in the small trace."""
LEAST_WIDTH = 40
"""Columns below which lines are cut rather than made shorter."""


class LiveScreen:
    """Shows a run.

    console : where to. quiet : show nothing (for --json). answers_only : no live view, decisions or events.
    detail : decisions with all that was weighed. now_s : the machine's clock, for how often the picture is renewed.
    """

    def __init__(
        self,
        console: Console,
        *,
        quiet: bool = False,
        answers_only: bool = False,
        detail: bool = False,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.console = console
        self._quiet, self._detail, self._now_s = quiet, detail, now_s
        self._answers_only = answers_only
        self.live = console.is_terminal and not quiet and not answers_only
        self._ascii = not (console.encoding or "").lower().startswith("utf")
        self._title, self._progress = "", 0.0
        self._due_s = float("-inf")
        self._looked: dict[str, float] = {}
        self._seen: dict[str, LoopSeen] = {}
        self._pv: dict[str, deque[float]] = {}
        self._units: dict[str, str] = {}
        self._display = Live(console=console, auto_refresh=False, transient=True) if self.live else None

    def __enter__(self) -> "LiveScreen":
        if self._display is not None:
            self._display.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.pause()

    @property
    def width(self) -> int:
        """Columns of a line."""
        return max(self.console.width, LEAST_WIDTH)

    def pause(self) -> None:
        """No more live view."""
        if self._display is not None:
            self._display.stop()
            self._display = None

    def begin(self, text: str) -> None:
        """Something begins: its name."""
        self._title, self._progress = text, 0.0
        self._seen.clear()
        self._looked.clear()
        self._pv.clear()
        self._draw()

    def sample(self, loop: str, unit: str, pv: float, progress: float, look: Callable[[], LoopSeen]) -> None:
        """One sample of a loop has passed; look : what can be seen of it, asked only when it is going to be shown."""
        if self._display is None:
            return
        self._pv.setdefault(loop, deque(maxlen=TRACED)).append(pv)
        now_s = self._now_s()
        if now_s < self._due_s and self._looked.get(loop, float("-inf")) >= self._due_s - RENEW_S:
            return
        self._looked[loop], self._seen[loop], self._units[loop], self._progress = now_s, look(), unit, progress
        if now_s >= self._due_s:
            self._due_s = now_s + RENEW_S
            self._draw()

    def decision(self, decision: Decision, loop: str = "") -> None:
        """A decision was taken. loop : its name, where there are several."""
        if self._quiet or self._answers_only:
            return
        if not self.live:
            self.console.print(live_line(decision, loop), highlight=False, soft_wrap=True)
            return
        for line in decision_lines(decision, self.width, loop, detail=self._detail):
            self.console.print(line, highlight=False, no_wrap=True, crop=False)

    def event(self, text: str) -> None:
        """Something happened beside the decisions: a line, unless only the answer is wanted."""
        if not self._answers_only:
            self.say(text)

    def say(self, text: str) -> None:
        """A line of plain text; on a terminal folded between words."""
        if not self._quiet:
            for line in folded(text, self.width) if self.live else [text]:
                self.console.print(escape(line), highlight=False, soft_wrap=True)

    def command(self, text: str) -> None:
        """A command that a person may copy: whole, whatever the width."""
        if not self._quiet:
            self.console.print(escape(text), highlight=False, soft_wrap=True, style="bold" if self.live else None)

    def table(self, table: Table, narrow: Callable[[], list[str]]) -> None:
        """A table with all its numbers; narrow : its content in short lines, for a terminal that is too narrow."""
        if self._quiet:
            return
        wide = self.console.options.update(max_width=MOST_CHARACTERS)
        table.width = Measurement.get(self.console, wide, table).maximum
        if self.live and table.width > self.width:
            for line in narrow():
                self.console.print(fitted(Text(line), self.width), highlight=False)
        else:
            self.console.print(table, crop=False)

    def picture(self, width: int, height: int) -> RenderableType:
        """The live view in so much room."""
        # what runs, and how far it is
        room = max(min(width // 4, 30), 5)
        done = round(room * self._progress)
        full, empty = ("#", ".") if self._ascii else ("█", "░")
        bar = f"{full * done}{empty * (room - done)} {self._progress:4.0%}" if self._progress else ""
        lines = [fitted(Text.assemble((self._title, "bold reverse"), "  ", (bar, "green")), width)]
        if len(self._seen) * PANEL_LINES + 1 <= height:
            for name, seen in self._seen.items():
                lines += loop_lines(seen, self._units[name], self._pv[name], width, ascii_only=self._ascii)
        else:
            shown = list(self._seen.items())[: max(height - 2, 1)]
            for name, seen in shown:
                lines.append(loop_line(seen, self._units[name], self._pv[name], width, ascii_only=self._ascii))
            left = len(self._seen) - len(shown)
            lines += [Text(f"  and {left} more loops")] if left else []
        return Group(*lines)

    def _draw(self) -> None:
        if self._display is not None:
            self._display.update(self.picture(self.width, self.console.height), refresh=True)
