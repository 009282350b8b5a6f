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

    report : path of its report, None without one. decisions : their documents. trouble : what a person should look
    after, may be empty.
    """

    name: str
    report: str | None
    decisions: Sequence[Document]
    scores: Sequence[RegionScore]
    trouble: str

    @property
    def changes(self) -> int:
        """How many were written."""
        return sum(score.changes for score in self.scores)

    @property
    def iae(self) -> str:
        """IAE of the run over that of the same run with fixed gains, from the best region to the worst."""
        ratios = [score.iae / score.iae_fixed for score in self.scores if score.iae_fixed]
        if not ratios:
            return "-"
        best, worst = min(ratios), max(ratios)
        return f"{worst:.2f}" if worst == best else f"{best:.2f} to {worst:.2f}"


def render_index(loops: Sequence[LoopLine], facts: Mapping[str, str]) -> str:
    """The page as text. facts : provenance, name to value."""
    heads = (
        "loop", "decisions", "changes", "rolled back", "proposals", "IAE relative to fixed gains",
        "needs attention",
    )  # fmt: skip
    rows = [
        (
            Linked(one.name, one.report or ""),
            *(len(one.decisions), one.changes, sum(map(rolls_back, one.decisions))),
            sum(words(decision, "action") == "advise" for decision in one.decisions),
            *(one.iae, one.trouble),
        )
        for one in loops
    ]
    changes = sum(one.changes for one in loops)
    lead = f"{len(loops)} loops, {changes} change{'s' * (changes != 1)} written. Each name leads to the loop's report."
    classes = ["bad" if one.trouble else "" for one in loops]
    page = {"title": "Retuning report", "lead": lead, "heads": heads, "rows": rows, "classes": classes, "facts": facts}
    return rendered("loops.html.jinja", **page)
