"""The lines of the live view, made for a width: none is ever longer, so none wraps.

Where there is not room for all, what comes last in a line goes first; a cut is marked by an ellipsis.

A small trace of a signal in a line of characters.
"""

import textwrap
from collections.abc import Iterable, Sequence

from rich.cells import cell_len
from rich.text import Text

from retuner.adaptive.supervision.decision import Action, Decision
from retuner.decision_page.explain import (
    cause_text,
    change_text,
    model_text,
    ms_words,
    response_text,
    settings_text,
    stays,
    takes_back,
)
from retuner.errors import one_line
from retuner.live_view.loop_seen import LoopSeen, RegionSeen
from retuner.report.console import COLOURS, KEPT, UNDONE, short_reason

# ---- A small trace of a signal in a line of characters

BARS = "▁▂▃▄▅▆▇█"
PLAIN = "_.-=*#"
"""For terminals that show ASCII only."""


def trace(values: Sequence[float], width: int, marks: str = BARS) -> str:
    """The values from left to right in so many characters: each column shows the mean of its share."""
    if width < 1 or not values:
        return ""
    columns = [_share(values, i, width) for i in range(min(width, len(values)))]
    low, high = min(columns), max(columns)
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-9):
        return marks[0] * len(columns)
    top = len(marks) - 1
    return "".join(marks[round(top * (value - low) / (high - low))] for value in columns)


def _share(values: Sequence[float], i: int, width: int) -> float:
    """Mean of the i-th of so many equal shares."""
    count = min(width, len(values))
    part = values[len(values) * i // count : len(values) * (i + 1) // count]
    return sum(part) / len(part)


INDENT = 11
"""Columns before the second line of a decision: as many as its time takes."""
LONGEST_TRACE = 60
PANEL_LINES = 6
"""Lines of a loop with all that can be seen of it."""


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
    undone = takes_back(decision)
    cause = UNDONE if undone else KEPT if stays(decision) else cause_text(decision)
    head = Text.assemble(
        (f"{decision.t_s:9,.0f}s ", "dim"),
        (f"{one_line(f'{loop} {decision.region}'.strip())}  ", "bold"),
        (f"{cause}  ", COLOURS.get(cause, "magenta")),
        "no change" if decision.action is Action.NONE else change_text(decision),
    )
    judged = decision.judgement.reason if decision.judgement and not undone else ""
    reason = decision.reason if detail else short_reason(decision)
    why = "; ".join(one for one in (one_line(reason), f"trial: {one_line(judged)}" if judged else "") if one)
    lines = [head, Text(f"{' ' * INDENT}{why}")]
    if detail:
        told = [response_text(decision), model_text(decision), _evidence(decision)]
        lines += [Text(line, style="dim") for one in told if one for line in folded(one, width, INDENT)]
        lines[1:2] = [Text(line) for line in folded(why, width, INDENT)] or lines[1:2]
    return [fitted(line, width) for line in lines]


def _evidence(decision: Decision) -> str:
    """The causes that were weighed, in a sentence."""
    if decision.diagnosis is None:
        return ""
    return f"{decision.diagnosis.reason} (confidence {decision.diagnosis.confidence:.0%})"


def loop_lines(seen: LoopSeen, unit: str, pv: Iterable[float], width: int, *, ascii_only: bool = False) -> list[Text]:
    """A loop in PANEL_LINES lines."""
    s, here, marks = seen.sample, seen.here, PLAIN if ascii_only else BARS
    name = Text.assemble((seen.loop, "bold"), (f"   t {s.t_s:,.0f} s", "dim"), _mode(seen))
    values = Text.assemble("  sp ", (f"{s.sp:9.4g}", "bold"), "   pv ", (f"{s.pv:9.4g}", "bold cyan"), f" {unit}   co ")
    values.append(f"{s.co:6.1f}", "bold")
    values.append(" % at a limit" if s.limited else " %", "red" if s.limited else "")
    room = min(width - cell_len("  pv trace "), LONGEST_TRACE)
    drawn = Text.assemble(("  pv trace ", "dim"), (trace(tuple(pv), room, marks), "cyan"))
    needs = seen.needs_a_person
    waits = Text.assemble(("  needs you: ", "bold red"), needs) if needs else Text(f"  waits for {seen.waits_for}")
    lines = [name, values, drawn, _in_force(seen, here), _phases(seen, here, unit), waits]
    return [fitted(line, width) for line in lines]


def _mode(seen: LoopSeen) -> Text:
    """What may be done, and who has the output."""
    mode = seen.here.mode if seen.here else ""
    return Text(f"   mode {mode}{'   MANUAL' * seen.manual}" if mode else "", "yellow" if seen.manual else "dim")


def _in_force(seen: LoopSeen, here: RegionSeen | None) -> Text:
    gains = settings_text(seen.running) if seen.running else "gains not known yet"
    ms = "" if here is None else f"   Ms {'not known yet' if here.ms is None else ms_words(here.ms)}"
    return Text.assemble("  region ", (here.name if here else "not known", "bold"), f"   {gains}", (ms, "bold"))


def _phases(seen: LoopSeen, here: RegionSeen | None, unit: str) -> Text:
    peaks = f", {len(seen.peaks)} peak{'s' * (len(seen.peaks) != 1)}" if seen.peaks else ""
    trial = here.trial if here else "idle"
    text = Text(f"  recogniser {seen.recogniser}{peaks}, band {seen.band:.2g} {unit}")
    return text.append(f"   trial {trial}", "" if trial == "idle" else "magenta")


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
