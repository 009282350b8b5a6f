"""The page that leads to the loops of one session: what was done in each, what it is worth, where its report is."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from retuner.decision_page.decision_document import Linked
from retuner.decision_page.decision_words import rolls_back
from retuner.decision_page.row_values import Document, words
from retuner.report.scores import RegionScore
from retuner.templates import rendered


class LoopLine(NamedTuple):
    """One loop in the index.

    report : path of its report, None without one. decisions, changes, undone, advised : how many. iae : of the run over
    that of the same run with fixed gains, in the worst region and in the best; None where there is none to compare.
    trouble : what a person should look after, may be empty.
    """

    name: str
    report: str | None
    decisions: int
    changes: int
    rolled_back: int
    advised: int
    iae: tuple[float, float] | None
    trouble: str


def loop_line(
    name: str, report: str | None, decisions: Sequence[Document], scores: Sequence[RegionScore], trouble: str
) -> LoopLine:
    """What the index says of a loop. decisions : their documents."""
    done = [words(one, "action") for one in decisions]
    ratios = [s.iae / s.iae_fixed for s in scores if s.iae_fixed]
    iae = (max(ratios), min(ratios)) if ratios else None
    changes = sum(score.changes for score in scores)
    return LoopLine(
        name, report, len(done), changes, sum(map(rolls_back, decisions)), done.count("advise"), iae, trouble
    )


def render_index(loops: Sequence[LoopLine], facts: Mapping[str, str]) -> str:
    """The page as text. facts : provenance, name to value."""
    heads = (
        "loop", "decisions", "changes", "rolled back", "proposals", "IAE relative to fixed gains",
        "needs attention",
    )  # fmt: skip
    rows = [
        (
            Linked(one.name, one.report or ""),
            *(one.decisions, one.changes, one.rolled_back, one.advised),
            _iae(one.iae),
            one.trouble,
        )
        for one in loops
    ]
    changes = sum(one.changes for one in loops)
    lead = f"{len(loops)} loops, {changes} change{'s' * (changes != 1)} written. Each name leads to the loop's report."
    classes = ["bad" if one.trouble else "" for one in loops]
    page = {"title": "Retuning report", "lead": lead, "heads": heads, "rows": rows, "classes": classes, "facts": facts}
    return rendered("loops.html.jinja", **page)


def _iae(ratios: tuple[float, float] | None) -> str:
    if ratios is None:
        return "-"
    worst, best = ratios
    return f"{worst:.2f}" if worst == best else f"{best:.2f} to {worst:.2f}"
