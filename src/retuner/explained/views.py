"""Decisions made ready for their pages: each with the samples of its response out of the trend, and the model's pv."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.decision import Decision
from retuner.adaptive.fitted import explained_pv
from retuner.adaptive.sample import FloatArray, Window
from retuner.explain import document_of
from retuner.explained.reading import Document, number, numbers, part, words
from retuner.explained.view import DecisionView, Samples, samples_of


def view_of(
    decision: Decision | Document,
    columns: Mapping[str, FloatArray],
    unit: str,
    place: tuple[int, str] | None = None,
    later: tuple[Document, ...] = (),
) -> DecisionView:
    """One decision as its page sees it.

    Parameters
    ----------
    decision : the decision, or its document out of a ledger. columns : the trend of the run by column.
    unit : of pv. place : row of the ledger and its hash. later : see what_came_of.
    """
    document = document_of(decision)
    samples = samples_of(columns, part(document, "response"), number(document, "t_s") or 0.0)
    sample_time_s = float(np.median(np.diff(columns["t"]))) if len(columns["t"]) > 1 else 0.0
    row, digest = place or (None, "")
    view = DecisionView(document, samples, unit, sample_time_s, row, digest, later)
    return view if samples is None else replace(view, samples=with_model(view, samples))


def with_model(view: DecisionView, samples: Samples) -> Samples:
    """The samples with pv as the model of this record explains it, where there is one."""
    if view.of_record is None or view.estimate.get("residual") is None:
        return samples
    window = Window(samples.t_s, samples.sp, samples.pv, samples.co)
    inside = [t for t in numbers(view.estimate, "loads") if t >= samples.t_s[0]]
    residual = number(view.estimate, "residual") or 0.0
    return replace(samples, explained=explained_pv(window, view.of_record, inside, residual))


def what_came_of(document: Document, all_documents: Sequence[Document]) -> tuple[Document, ...]:
    """The decisions that judged or undid a change, up to the next change of the same region."""
    if words(document, "action") not in {"commit", "advise"}:
        return ()
    own, region = number(document, "number") or 0.0, words(document, "region")
    found = []
    for later in all_documents:
        if (number(later, "number") or 0.0) <= own or words(later, "region") != region:
            continue
        if later.get("judgement") or words(later, "action") == "restore":
            found.append(later)
        if words(later, "action") != "none":
            break
    return tuple(found)


def worth_pages(documents: Sequence[Document], most: int) -> list[Document]:
    """Decisions of which there is more to tell than a line, at most so many, in the order of time.

    Those that change gains come first, then the newest.
    """
    worth = [document for document in documents if worth_a_page(document)]
    ranked = sorted(worth, key=lambda document: (not changes(document), -(number(document, "t_s") or 0.0)))
    kept = {id(document) for document in ranked[:most]}
    return [document for document in worth if id(document) in kept]


def changes(document: Document) -> bool:
    """Whether gains are written, put back or advised."""
    return words(document, "action") in {"commit", "advise", "restore"}


def worth_a_page(document: Document) -> bool:
    """Whether there is more to tell than one line: gains change or are judged, a proof or a cause speaks against it."""
    told = changes(document) or document.get("verdict") or document.get("judgement")
    return bool(told) or words(part(document, "diagnosis"), "cause") not in {"", "ok"}
