"""What a change promised, and what came of it: later responses against it, and the rollback if there was one."""

from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.explain import change_text, rolls_back, stays
from retuner.decision_page.html import paragraph, section, text_table
from retuner.decision_page.row_values import Document, number, numbers_or_none, part, words

MEASURES = {
    "overshoot": ("overshoot (-E2/E1)", 100.0, " %"),
    "damping": ("half-cycle decay ratio (E3-E2)/(E1-E2)", 1.0, ""),
    "decay": ("half-cycle decay ratio, as judged", 1.0, ""),
    "iae": ("IAE per unit step", 1.0, ""),
    "travel": ("travel of co per unit step (not judged)", 1.0, ""),
    "settle_s": ("settling time", 1.0, " s"),
    "ms": ("lowest Ms over the plausible models", 1.0, ""),
    "cost": ("lowest IAE over them, relative to the previous settings", 1.0, ""),
}
"""Numbers of a promise in words, with their factor and unit."""
UPSETS = ("setpoint", "load")
FINDINGS = {
    "better": "better than predicted",
    "as_promised": "as predicted",
    "worse": "worse than predicted",
    "inconclusive": "not judged",
}


def promise_section(view: DecisionView) -> str:
    """The promise that later responses are judged against."""
    promise = part(view.document, "promise")
    rows = [
        (label, *(cell for upset in UPSETS for cell in _promised(promise, upset, name, factor, unit)))
        for name, (label, factor, unit) in MEASURES.items()
    ]
    rows = [row for row in rows if any(row[1:])]
    if not rows:
        return ""
    models = number(promise, "models")
    over = f" over the {models:.0f} plausible model{'s' * (models != 1)}" if models else ", from what was seen"
    spread = f"In brackets the smallest and largest value{over}.{_promised_ms(promise)}"
    heads = ("", "setpoint step: predicted", "previous settings", "load step: predicted", "previous settings")
    heading = "Predicted performance, against which the next responses are judged"
    if view.rolls_back:
        heading = f"Predicted performance of what {'is on trial' if stays(view.document) else 'was rolled back'}"
    return section(heading, text_table(heads, rows), paragraph(spread, "muted"))


def _promised_ms(promise: Document) -> str:
    ms = numbers_or_none(promise, "ms")
    if len(ms) != 3:
        return ""
    best, low, high = ("unstable" if value is None else _in(value) for value in ms)
    return f" Predicted Ms: {best} ({low} .. {high})."


def _promised(promise: Document, upset: str, name: str, factor: float, unit: str) -> tuple[str, str]:
    """One number for one kind of upset: promised with its spread, and the settings before."""
    spread = numbers_or_none(part(promise, upset), name)
    before = numbers_or_none(part(promise, f"{upset}_before"), name)
    was = _in(before[0], factor, unit) if before else ""
    if len(spread) != 3:
        return "", was
    best, low, high = (_in(value, factor) for value in spread)
    return f"{best}{unit if spread[0] is not None else ''} ({low} .. {high})", was


def _in(value: float | None, factor: float = 1.0, unit: str = "") -> str:
    """A number with its unit; null in a document is a loop that never comes to rest."""
    return "never at rest" if value is None else f"{factor * value:.4g}{unit}"


def judgement_section(view: DecisionView) -> str:
    """The response against the promise of the settings that it ran under."""
    judgement = part(view.document, "judgement")
    if not judgement:
        return ""
    rows = judged_rows(part(judgement, "numbers"))
    shown = text_table(("", "measured", "predicted", "limit", "previous settings"), rows) if rows else ""
    lead = paragraph(_told(judgement))
    return section("The trial: this response against the predicted performance", lead, shown)


def _told(judgement: Document) -> str:
    """The finding and its reason, which begins with it as a rule."""
    finding, reason = FINDINGS.get(words(judgement, "finding"), ""), words(judgement, "reason")
    told = reason if reason.lower().startswith(finding.lower()) else f"{finding}: {reason}"
    return f"{told[:1].upper()}{told[1:]}." if told else ""


def judged_rows(found: Document) -> list[tuple[str, ...]]:
    """Measured, promised, limit and before, a row for each number that was weighed."""
    rows = []
    for name, (label, factor, unit) in MEASURES.items():
        if number(found, name) is None:
            continue
        beside = (number(found, f"{name}{which}") for which in ("", "_promised", "_limit", "_before"))
        rows.append((label, *("" if one is None else _judged(name, one, factor, unit) for one in beside)))
    return rows


def _judged(name: str, value: float, factor: float, unit: str) -> str:
    """A number that was weighed; below 0 stands for infinite, but an overshoot may be."""
    if value >= 0 or name == "overshoot":
        return _in(value, factor, unit)
    return "unstable" if name == "ms" else _in(None)


def later_section(view: DecisionView) -> str:
    """What came of a change: the later responses that were judged, and the rollback."""
    rows = []
    for later in view.later:
        undone = rolls_back(later)
        told = (_told(part(later, "judgement")) or words(later, "reason"), change_text(later) if undone else "")
        reason = " Then ".join(one for one in told if one)
        when = f"{number(later, 't_s') or 0.0:,.0f}"
        rows.append((f"{number(later, 'number') or 0:.0f}", when, reason, words(later, "trial")))
    return section("What came of it", text_table(("decision", "time [s]", "result", "then"), rows) if rows else "")
