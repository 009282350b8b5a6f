"""A decision as its page sees it: the document that the ledger keeps, and the samples of its response.

A live run and a finished one are shown alike, because both come as the same document. Whatever is missing is None: the
page leaves its section out.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from retuner.adaptive.identification.fitted_curve import explained_pv
from retuner.adaptive.process.model import LinearProcess, ProcessModel
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.signals.response import Peak
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.adaptive.supervision.decision import Decision
from retuner.decision_page.decision_words import document_of
from retuner.decision_page.row_values import (
    Document,
    decided_on,
    finite,
    gains_of,
    model_of,
    number,
    numbers,
    part,
    parts,
    words,
)
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

LAST_SAMPLES = 300  # samples shown of a decision that no response led to
LEAD_SHARE = 0.25  # of a response's length that is shown before it


@dataclass(frozen=True, slots=True)
class Samples:
    """The samples of a response: arrays of shape (n,).

    explained : pv as the model gives it, None where not known. changed_s : when other gains began to run.
    """

    t_s: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray
    explained: FloatArray | None = None
    changed_s: tuple[float, ...] = ()

    @property
    def sample_time_s(self) -> float:
        """Median interval, 0 for a single sample."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0


@dataclass(frozen=True)
class DecisionView:
    """See the head of this file.

    document : what Decision.to_dict() gives. samples : of the response, None where they were not kept.
    unit : of pv. sample_time_s : of the loop; half of it counts as dead time. row, hash : in the ledger, None and empty
        where not known. later : documents of the decisions that judged or undid this one.
    """

    document: Document
    samples: Samples | None
    unit: str
    sample_time_s: float
    row: int | None = None
    hash: str = ""
    later: tuple[Document, ...] = ()

    number = cached_property(lambda self: int(number(self.document, "number") or 0))  # of the decision in its loop
    t_s = cached_property(lambda self: number(self.document, "t_s") or 0.0)  # when it was taken, s
    action = cached_property(lambda self: words(self.document, "action"))  # none, advise, commit or restore
    rolls_back = cached_property(lambda self: self.action == "restore")
    response = cached_property(lambda self: part(self.document, "response"))  # what the recogniser saw
    # what the record by itself, with what was known before, said of the process; and what the guard let through
    estimate = cached_property(lambda self: part(self.document, "estimate"))
    verdict = cached_property(lambda self: part(self.document, "verdict"))
    # the process as the record shows it; that which was decided on, known of the region after this record; and whether
    # the record speaks against it
    of_record = cached_property(lambda self: model_of(part(self.estimate, "model")))
    model = cached_property(lambda self: decided_on(self.document))
    contradicted = cached_property(lambda self: words(self.document, "surprise") == Agreement.CONTRADICTS.code)
    before = cached_property(lambda self: gains_of(part(self.document, "gains_before")))  # gains in force

    @cached_property
    def peaks(self) -> list[Peak]:
        """Extremes of the error."""
        found = self.response.get("peaks")
        pairs = [numbers({"pair": one}, "pair") for one in found] if isinstance(found, list | tuple) else []
        return [Peak(*pair) for pair in pairs if len(pair) == 2]

    @property
    def spread(self) -> dict[str, float]:
        """Standard deviations of its parameters, by name."""
        known = part(self.document, "known") or (self.estimate if self.model == self.of_record else {})
        return {name: value for name, raw in part(known, "std").items() if (value := finite(raw)) is not None}

    @cached_property
    def after(self) -> PidGains | None:
        """Gains written or advised; None when nothing changes."""
        return gains_of(part(self.document, "gains_after")) if self.action != "none" else None

    @cached_property
    def process(self) -> LinearProcess | None:
        """The model as a sampled controller sees it: half a sampling interval more dead time (Skogestad 2003)."""
        return self._sampled(self.model) if self.model else None

    @cached_property
    def allowed(self) -> tuple[LinearProcess, ...]:
        """The other models that the records still allow, as a sampled controller sees them: those of the proof."""
        models = [model_of(part(one, "model")) for one in parts(self.verdict, "allowed")[1:]]
        return tuple(self._sampled(model) for model in models if model)

    @cached_property
    def tried(self) -> PidGains | None:
        """Gains of which the page shows what they would do: those let through, else those that were proposed."""
        return self.after or gains_of(part(part(self.document, "proposal"), "parallel"))

    def _sampled(self, model: ProcessModel) -> LinearProcess:
        return model.seen_by_controller(self.sample_time_s).linear()


def samples_of(columns: Mapping[str, FloatArray], response: Document, end_s: float) -> Samples | None:
    """The samples of a response out of a trend: with a quarter of its length before it, in one region, without a gap.

    Without a response the last samples before the decision: what was seen when a trial was ended in mid-response.
    columns : t, sp, pv, co and region by name, sequence (of the gain set) where it is known.
    end_s : time of the decision.
    """
    t = columns["t"]
    if not response and len(t) > LAST_SAMPLES:
        response = {"t_start_s": end_s - LAST_SAMPLES * float(np.median(np.diff(t))), "t_end_s": end_s}
    start, end = number(response, "t_start_s"), number(response, "t_end_s")
    if start is None or end is None or end <= start:
        return None
    first = int(np.searchsorted(t, start - LEAD_SHARE * (end - start)))
    last = int(np.searchsorted(t, max(end_s, end), side="right"))
    if last - first < 3:
        return None
    begun = int(np.searchsorted(t, start))
    region = columns["region"][first : begun + 1]
    t_s = t[first : begun + 1]
    gap = 3 * float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    cuts = [
        i + 1 for i, (a, b) in enumerate(pairwise(range(len(t_s)))) if region[a] != region[b] or t_s[b] - t_s[a] > gap
    ]
    first += cuts[-1] if cuts else 0
    sets = columns["sequence"][first:last] if "sequence" in columns else np.zeros(last - first)
    sp, pv, co = (columns[name][first:last] for name in ("sp", "pv", "co"))
    return Samples(t[first:last], sp, pv, co, None, tuple(t[first:last][1:][np.diff(sets) != 0].tolist()))


# Decisions made ready for their pages: each with the samples of its response out of the trend, and the model's pv.


def view_of(
    decision: Decision | Document,
    columns: Mapping[str, FloatArray],
    unit: str,
    place: tuple[int, str] | None = None,
    later: tuple[Document, ...] = (),
) -> DecisionView:
    """One decision as its page sees it.

    decision : the decision, or its document out of a ledger. columns : the trend of the run by column.
    unit : of pv. place : row of the ledger and its hash. later : see what_came_of.
    """
    document = document_of(decision)
    samples = samples_of(columns, part(document, "response"), number(document, "t_s") or 0.0)
    sample_time_s = float(np.median(np.diff(columns["t"]))) if len(columns["t"]) > 1 else 0.0
    row, digest = place or (None, "")
    view = DecisionView(document, samples, unit, sample_time_s, row, digest, later)
    if samples is None or view.of_record is None or view.estimate.get("residual") is None:
        return view
    # with pv as the model of this record explains it
    window = Window(samples.t_s, samples.sp, samples.pv, samples.co)
    inside = [t for t in numbers(view.estimate, "loads") if t >= samples.t_s[0]]
    residual = number(view.estimate, "residual") or 0.0
    explained = explained_pv(window, view.of_record, inside, residual)
    return replace(view, samples=replace(samples, explained=explained))


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
    """Decisions of which there is more to tell than a line, at most so many, in the order of time: gains change or are
    judged, or a proof or a cause speaks against it. Those that change gains come first, then the newest.
    """
    worth = [
        one
        for one in documents
        if changes(one)
        or one.get("verdict")
        or one.get("judgement")
        or words(part(one, "diagnosis"), "cause") not in {"", "ok"}
    ]
    ranked = sorted(worth, key=lambda document: (not changes(document), -(number(document, "t_s") or 0.0)))
    kept = {id(document) for document in ranked[:most]}
    return [document for document in worth if id(document) in kept]


def changes(document: Document) -> bool:
    """Whether gains are written, put back or advised."""
    return words(document, "action") in {"commit", "advise", "restore"}
