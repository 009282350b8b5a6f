"""What `retuner run` shows: on a terminal a live view with the decisions above it, elsewhere plain lines."""

import textwrap
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from retuner.adaptive.supervision.decision import Action, Decision
from retuner.decision_page.decision_words import (
    cause_text,
    change_text,
    model_text,
    ms_words,
    response_text,
    rolls_back,
    settings_text,
    short_reason,
    stays,
)
from retuner.errors import one_line
from retuner.live_view.loop_seen import LoopSeen
from retuner.report.console import COLOURS, KEPT, MOST_CHARACTERS, ROLLED_BACK, live_line

# The lines of the live view, made for a width: none is ever longer, so none wraps.
#
# Where there is not room for all, what comes last in a line goes first; a cut is marked by an ellipsis.
#
# A small trace of a signal in a line of characters.

# ---- A small trace of a signal in a line of characters

BARS = "▁▂▃▄▅▆▇█"
PLAIN = "_.-=*#"
"""Marks for terminals that show ASCII only."""


def trace(values: Sequence[float], width: int, marks: str = BARS) -> str:
    """The values from left to right in so many characters: each column shows the mean of its share."""
    if width < 1 or not values:
        return ""
    count = min(width, len(values))
    shares = [values[len(values) * i // count : len(values) * (i + 1) // count] for i in range(count)]
    columns = [sum(share) / len(share) for share in shares]
    low, high = min(columns), max(columns)
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-9):
        return marks[0] * len(columns)
    top = len(marks) - 1
    return "".join(marks[round(top * (value - low) / (high - low))] for value in columns)


INDENT = 11  # columns before the second line of a decision: as many as its time takes
LONGEST_TRACE = 60
PANEL_LINES = 6  # Lines of a loop with all that can be seen of it


def fitted(text: Text, width: int) -> Text:
    """The text on one line of at most so many columns."""
    text.truncate(width, overflow="ellipsis")
    text.no_wrap = True
    return text


def folded(text: str, width: int, indent: int = 0) -> list[str]:
    """The text in lines of at most so many columns, broken between words; a word that is longer stays whole."""
    space = " " * indent
    return textwrap.wrap(
        one_line(text),
        max(width, 20),
        subsequent_indent=space,
        initial_indent=space,
        break_long_words=False,
        break_on_hyphens=False,
    )


def decision_lines(decision: Decision, width: int, loop: str = "", *, detail: bool = False) -> list[Text]:
    """A decision in two lines: when, where, cause and what is done; then why.

    loop : its name, where there are several. detail : all else that was weighed.
    """
    back = rolls_back(decision)
    cause = ROLLED_BACK if back else KEPT if stays(decision) else cause_text(decision)
    head = Text.assemble(
        (f"{decision.t_s:9,.0f}s ", "dim"),
        (f"{one_line(f'{loop} {decision.region}'.strip())}  ", "bold"),
        (f"{cause}  ", COLOURS.get(cause, "magenta")),
        "no change" if decision.action is Action.NONE else change_text(decision),
    )
    judged = decision.judgement.reason if decision.judgement and not back else ""
    reason = decision.reason if detail else short_reason(decision)
    why = "; ".join(one for one in (one_line(reason), f"trial: {one_line(judged)}" if judged else "") if one)
    lines = [head, Text(f"{' ' * INDENT}{why}")]
    if detail:
        weighed = decision.diagnosis
        evidence = "" if weighed is None else f"{weighed.reason} (confidence {weighed.confidence:.0%})"
        told = [response_text(decision), model_text(decision), evidence]
        lines += [Text(line, style="dim") for one in told if one for line in folded(one, width, INDENT)]
        lines[1:2] = [Text(line) for line in folded(why, width, INDENT)] or lines[1:2]
    return [fitted(line, width) for line in lines]


def loop_lines(seen: LoopSeen, unit: str, pv: Iterable[float], width: int, *, ascii_only: bool = False) -> list[Text]:
    """A loop in PANEL_LINES lines."""
    s, here, marks = seen.sample, seen.here, PLAIN if ascii_only else BARS
    mode = f"   mode {here.mode}{'   MANUAL' * seen.manual}" if here and here.mode else ""
    name = Text.assemble(
        (seen.loop, "bold"), (f"   t {s.t_s:,.0f} s", "dim"), (mode, "yellow" if seen.manual else "dim")
    )
    values = Text.assemble("  sp ", (f"{s.sp:9.4g}", "bold"), "   pv ", (f"{s.pv:9.4g}", "bold cyan"), f" {unit}   co ")
    values.append(f"{s.co:6.1f}", "bold")
    values.append(" % at a limit" if s.limited else " %", "red" if s.limited else "")
    room = min(width - cell_len("  pv trace "), LONGEST_TRACE)
    drawn = Text.assemble(("  pv trace ", "dim"), (trace(tuple(pv), room, marks), "cyan"))
    gains = settings_text(seen.running) if seen.running else "gains not known yet"
    ms = "" if here is None else f"   Ms {'not known yet' if here.ms is None else ms_words(here.ms)}"
    in_force = Text.assemble("  region ", (here.name if here else "not known", "bold"), f"   {gains}", (ms, "bold"))
    peaks = f", {len(seen.peaks)} peak{'s' * (len(seen.peaks) != 1)}" if seen.peaks else ""
    trial = here.trial if here else "idle"
    phases = Text(f"  recogniser {seen.recogniser}{peaks}, band {seen.band:.2g} {unit}")
    phases.append(f"   trial {trial}", "" if trial == "idle" else "magenta")
    needs = seen.needs_a_person
    waits = Text.assemble(("  needs you: ", "bold red"), needs) if needs else Text(f"  waits for {seen.waits_for}")
    lines = [name, values, drawn, in_force, phases, waits]
    return [fitted(line, width) for line in lines]


def loop_line(seen: LoopSeen, unit: str, pv: Iterable[float], width: int, *, ascii_only: bool = False) -> Text:
    """A loop in one line, where there are too many for more."""
    s, here = seen.sample, seen.here
    ms = "-" if here is None or here.ms is None else ms_words(here.ms)
    text = Text.assemble(
        ("! " if seen.needs_a_person else "  ", "bold red"),
        (f"{seen.loop[:12]:12} ", "bold"),
        f"sp {s.sp:8.4g} pv {s.pv:8.4g} {unit} co {s.co:5.1f} % Ms {ms} ",
        (trace(tuple(pv), 12, PLAIN if ascii_only else BARS), "cyan"),
        f" {here.name if here else ''}: {seen.needs_a_person or seen.waits_for}",
    )
    return fitted(text, width)


RENEW_S = 0.2
"""Time between two pictures: what a person can follow, and less than a thousandth of the control loop's time."""
TRACED = 600  # samples in the small trace
LEAST_WIDTH = 40  # columns below which lines are cut rather than made shorter


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
