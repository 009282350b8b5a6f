"""Decisions made ready for their pages: each with the samples of its response out of the trend, and the model's pv."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from retuner.adaptive.decision import Decision
from retuner.adaptive.fitted import explained_pv
from retuner.adaptive.sample import FloatArray, Window
from retuner.explain import document_of
from retuner.explained.reading import Document, number, numbers, part
from retuner.explained.view import DecisionView, Samples, samples_of


def view_of(
    decision: Decision | Document, columns: Mapping[str, FloatArray], unit: str, place: tuple[int, str] | None = None
) -> DecisionView:
    """One decision as its page sees it.

    Parameters
    ----------
    decision : the decision, or its document out of a ledger. columns : the trend of the run by column.
    unit : of pv. place : row of the ledger and its hash.
    """
    document = document_of(decision)
    samples = samples_of(columns, part(document, "response"), number(document, "t_s") or 0.0)
    sample_time_s = float(np.median(np.diff(columns["t"]))) if len(columns["t"]) > 1 else 0.0
    view = DecisionView(document, samples, unit, sample_time_s, *(place or (None, "")))
    return replace(view, samples=with_model(view, samples)) if samples is not None else view


def with_model(view: DecisionView, samples: Samples) -> Samples:
    """The samples with pv as the model of this record explains it, where there is one."""
    if view.of_record is None or view.estimate.get("residual") is None:
        return samples
    window = Window(samples.t_s, samples.sp, samples.pv, samples.co)
    inside = [t for t in numbers(view.estimate, "loads") if t >= samples.t_s[0]]
    residual = number(view.estimate, "residual") or 0.0
    return replace(samples, explained=explained_pv(window, view.of_record, inside, residual))


def worth_pages(views: Iterable[DecisionView], most: int) -> list[DecisionView]:
    """Decisions of which there is more to tell than a line, at most so many, in the order of time.

    Those that change gains come first, then the newest.
    """
    worth = [view for view in views if view.worth_a_page]
    ranked = sorted(worth, key=lambda view: (not view.changes, -view.t_s))
    return sorted(ranked[:most], key=lambda view: view.number)
