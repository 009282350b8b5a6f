"""What stands in each region now: gains, what is known of the process, where a trial or a lock stands.

Made from the documents of the decisions, the newest that says something of its region; a map of two scheduling
variables is a grid of cells besides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES
from retuner.decision_page.explain import cause_text, model_text, settings_text, stays, takes_back
from retuner.decision_page.html import escaped, paragraph, text_table
from retuner.decision_page.row_values import Document, decided_on, number, part, words
from retuner.schedule.table import GainTable

IDLE = "idle"
BORROWED = "borrowed"


@dataclass(frozen=True, slots=True)
class RegionNow:
    """One region as its decisions leave it. The counts are of decisions; borrowed : the last change came from a
    neighbour's model.
    """

    name: str
    seen: int
    changes: int
    undone: int
    cause: str
    process: str
    borrowed: bool
    trial: str
    mode: str


def regions_now(names: Sequence[str], decisions: Sequence[Document]) -> list[RegionNow]:
    """Every region in the order of the table."""
    return [_region(name, [one for one in decisions if words(one, "region") == name]) for name in names]


def _region(name: str, own: list[Document]) -> RegionNow:
    known = next(
        (
            one
            for one in reversed(own)
            if decided_on(one) is not None and (number(one, "records") or part(one, "known"))
        ),
        {},
    )
    judged = next((one for one in reversed(own) if part(one, "diagnosis")), {})
    changed = [one for one in own if words(one, "action") == "commit"]
    last = own[-1] if own else {}
    return RegionNow(
        name,
        len(own),
        len(changed),
        sum(map(takes_back, own)),
        _now(judged, last),
        model_text(known) if known else "",
        bool(changed) and words(changed[-1], "basis") == BORROWED,
        _standing(last),
        words(last, "mode"),
    )


def _now(judged: Document, last: Document) -> str:
    """How the region runs: a cause of tuning that led to no further change is no complaint."""
    if words(last, "action") != "restore" and "commit" in {words(last, "action"), words(judged, "action")}:
        return "changed, not judged yet"
    cause = words(part(judged, "diagnosis"), "cause")
    changeable = cause in {str(one) for one in TUNING_CAUSES} and words(judged, "action") == "none"
    return "settled: nothing better is proved" if changeable else cause_text(judged) if judged else ""


def _standing(last: Document) -> str:
    """Where the region stands after its last decision: what ended a trial says more than the phase that it began."""
    code, trial = words(last, "code"), words(last, "trial")
    at_the_end = " at the end of the session" * code.endswith("_stopped")
    if stays(last) or code.startswith("kept_"):
        return f"trial gains kept{at_the_end}"
    if takes_back(last):
        return f"rolled back{at_the_end}"
    return "on trial" if words(last, "action") == "commit" else trial


def overview(table: GainTable, decisions: Sequence[Document], advice: Sequence[str] = ()) -> str:
    """The table, and the grid where there are two scheduling variables, as HTML.

    advice : sentences that propose to split or merge regions.
    """
    names = table.regions.names
    rows = [
        (now.name, f"{now.seen}", now.process or "nothing yet", now.cause, _marks(now))
        for now in regions_now(names, decisions)
    ]
    heads = ("region", "responses", "process model", "now", "state")
    return text_table(heads, rows) + "".join(map(paragraph, advice)) + _grid(table)


def _marks(now: RegionNow) -> str:
    """What a person should know of a region besides."""
    told = [
        f"mode {now.mode}" if now.mode else "",
        now.trial if now.trial != IDLE else "",
        "settings from a neighbouring region's model" if now.borrowed else "",
        f"{now.undone} rolled back" if now.undone else "",
    ]
    return ", ".join(one for one in told if one)


def _grid(table: GainTable) -> str:
    """Settings by cell, the first variable down and the second across; nothing for one variable."""
    regions = table.regions
    if len(regions.axes) < 2:
        return ""
    down, across = regions.axes
    heads = (f"{down.label} \\ {across.label}", *(across.text(j) for j in range(len(across))))
    rows = [
        (
            down.text(i),
            *(
                f"{regions.names[at]}: {settings_text(table.gains_of(at), table.loop)}"
                for at in range(i * len(across), (i + 1) * len(across))
            ),
        )
        for i in range(len(down))
    ]
    return f"<h3>{escaped('Settings over both variables')}</h3>{text_table(heads, rows)}"
