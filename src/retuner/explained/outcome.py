"""What a change promised, and what came of it: the trial's judgement, or why the old settings were put back."""

from collections.abc import Mapping

from retuner.explained.reading import finite, number, part, parts, words
from retuner.explained.view import DecisionView
from retuner.html_parts import pairs, paragraph, section, text_table


def promise_section(view: DecisionView) -> str:
    """The promise that later responses are judged against."""
    promise = part(view.document, "promise")
    return section("Promise", pairs([(name.replace("_", " "), _plain(value)) for name, value in promise.items()]))


def trial_section(view: DecisionView) -> str:
    """The trial that this decision judged or ended."""
    trial = part(view.document, "trial")
    if not trial:
        return ""
    rows = [(words(one, "name").replace("_", " "), _plain(one.get("promised")), _plain(one.get("measured")),
             _plain(one.get("limit"))) for one in parts(trial, "compared")]  # fmt: skip
    compared = text_table(("", "promised", "measured", "limit"), rows) if rows else ""
    rest = [(name.replace("_", " "), _plain(value)) for name, value in trial.items()
            if name not in {"compared", "reason"}]  # fmt: skip
    return section("Trial", paragraph(words(trial, "reason")), compared, pairs(rest))


def _plain(value: object) -> str:
    """A value of a document in a cell."""
    known = finite(value)
    if known is not None:
        return f"{known:.4g}"
    if isinstance(value, Mapping):
        mean, std = number(value, "mean"), number(value, "std")
        if mean is not None:
            return f"{mean:.4g} +- {std:.2g}" if std is not None else f"{mean:.4g}"
        return ", ".join(f"{name} {_plain(one)}" for name, one in value.items())
    if isinstance(value, str):
        return value.replace("_", " ")
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return ""
