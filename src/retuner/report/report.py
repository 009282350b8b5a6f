"""report.html: one self-contained page, read from the top: result, pictures, every decision, provenance.

Each decision that changes something, or that a proof decided, has a page of its own, which its row's link shows.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.supervision.decision import Decision
from retuner.decision_page.decision_document import Explained, Linked, Toned, article
from retuner.decision_page.decision_sentences import MS_LIMIT, ms_text
from retuner.decision_page.decision_view import view_of, what_came_of, worth_pages
from retuner.decision_page.decision_words import (
    cause_text,
    change_text,
    document_of,
    model_text,
    response_text,
    rolls_back,
    settings_text,
    stays,
)
from retuner.decision_page.row_values import Document, decided_on, in_full, number, part, words
from retuner.decision_page.shown_units import units_of
from retuner.report.run_drawings import Mark, trend_svg, twin_svg
from retuner.report.scores import Columns, RegionScore, Twin, twin_steps
from retuner.report.what_if import of_region, panel_style
from retuner.report.what_if import section as what_if_section
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.table import GainTable
from retuner.templates import rendered

# What stands in each region now: gains, what is known of the process, where a trial or a lock stands.
#
# Made from the documents of the decisions, the newest that says something of its region; a map of two scheduling
# variables is a grid of cells besides.

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
    rolled_back: int
    cause: str
    process: str
    borrowed: bool
    trial: str
    mode: str


def regions_now(names: Sequence[str], decisions: Sequence[Document]) -> list[RegionNow]:
    """Every region in the order of the table."""
    found = []
    for name in names:
        own = [one for one in decisions if words(one, "region") == name]
        newest = reversed([one for one in own if decided_on(one) is not None])
        known = next((one for one in newest if number(one, "records") or part(one, "known")), None)
        judged = next((one for one in reversed(own) if part(one, "diagnosis")), {})
        changed = [one for one in own if words(one, "action") == "commit"]
        last = own[-1] if own else {}
        now = RegionNow(
            name=name,
            seen=len(own),
            changes=len(changed),
            rolled_back=sum(map(rolls_back, own)),
            cause=_now(judged, last),
            process=model_text(known) if known else "",
            borrowed=bool(changed) and words(changed[-1], "basis") == BORROWED,
            trial=_standing(last),
            mode=words(last, "mode"),
        )
        found.append(now)
    return found


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
    if rolls_back(last):
        return f"rolled back{at_the_end}"
    return "on trial" if words(last, "action") == "commit" else trial


def overview(table: GainTable, decisions: Sequence[Document], advice: Sequence[str] = ()) -> dict[str, object]:
    """The table, and the grid where there are two scheduling variables.

    advice : sentences that propose to split or merge regions.
    """
    rows, regions = [], table.regions
    for now in regions_now(regions.names, decisions):
        marks = [f"mode {now.mode}"] * bool(now.mode) + [now.trial] * (now.trial != IDLE)
        marks += ["settings from a neighbouring region's model"] * now.borrowed
        marks += [f"{now.rolled_back} rolled back"] * bool(now.rolled_back)
        rows.append((now.name, f"{now.seen}", now.process or "nothing yet", now.cause, ", ".join(filter(None, marks))))
    if len(regions.axes) < 2:
        return {"rows": rows, "advice": advice, "grid": None}
    # settings by cell, the first variable down and the second across
    down, across = regions.axes
    heads = (f"{down.label} \\ {across.label}", *(across.text(j) for j in range(len(across))))
    cells = [f"{name}: {settings_text(table.gains_of(name), table.loop)}" for name in regions.names]
    grid = [(down.text(i), *cells[i * len(across) : (i + 1) * len(across)]) for i in range(len(down))]
    return {"rows": rows, "advice": advice, "grid": (heads, grid)}


SAME_GAINS = 1e-4  # relative difference up to which gains of a trend are those of the table (the wire rounds them)
SHORTEST_H = 0.01  # A shorter run is told in seconds
LONG_S = 3 * 3600.0  # longer runs have times in hours and minutes since their start, as their picture has
MOST_PAGES = 40  # decisions with a page of their own, the newest ones: about 130 kB and a quarter of a second each


@dataclass(frozen=True, slots=True)
class ReportData:
    """What a report tells of.

    run, fixed : trends by column (fixed: the same run without retuning, or None). changes : their times.
    events : times of setpoint and load steps, s. facts : provenance, name to value, shown at the end.
    decisions : of the run, or their documents out of a ledger. stopped : the run did not have its whole length.
    advice : sentences that propose to split or merge regions. ms_limit : of the guard, on the process as known.
    """

    loop: str
    unit: str
    before: GainTable
    after: GainTable
    scores: list[RegionScore]
    decisions: Sequence[Decision | Document]
    run: Columns
    fixed: Columns | None
    changes: list[float]
    events: list[float] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)
    stopped: bool = False
    advice: Sequence[str] = ()
    ms_limit: float = MS_LIMIT


def render(data: ReportData) -> str:
    """The page as text."""
    documents = [document_of(decision) for decision in data.decisions]
    views = [
        view_of(one, data.run, data.unit, later=what_came_of(one, documents))
        for one in worth_pages(documents, MOST_PAGES)
    ]
    # panels that try settings on each region's newest process, and on the longest stay in it
    panels = []
    for i, name in enumerate(data.after.regions.names):
        sets = (data.before.gains_of(name), data.after.gains_of(name))
        told = of_region(data.run, i, [one for one in documents if words(one, "region") == name], sets, data.ms_limit)
        panels += [(name, told)] if told is not None else []
    units = units_of(data.loop)
    # not every decision that has reasons has a page
    left = f" The newest {MOST_PAGES} have one; `retuner report FOLDER --decision N` makes any other."
    left *= len(views) == MOST_PAGES
    # the heading of a page is seen when its row's link is followed, and on paper
    pages = [
        (one.number, f"Decision {one.number}: {words(one.document, 'region')} at {in_full(one.t_s)} s", article(one))
        for one in views
    ]
    # the same step before and after, of each region whose gains or table changed
    still = {one.region for one in data.scores if not one.changes and one.before == one.after}
    names = data.after.regions.names
    twins = [
        twin_svg(data.run, data.fixed, twin, names[twin.region], data.unit, commissioned=as_commissioned(data, twin))
        for twin in twin_steps(data.run, data.events)
        if names[twin.region] not in still
    ]
    return rendered(
        "report.html.jinja",
        title=f"{data.loop}: retuning report",
        panel_style=panel_style(),
        trend=trend_svg(data.run, data.fixed, marks_of(data, documents), data.after.regions, data.unit),
        lead=_result_in_words(data, documents),
        scores=_scores_table(data, documents),
        scores_note=(
            f"Settings in {units.form} form unless marked. Ms is the peak of the sensitivity on the simulated process, "
            f"the largest over the operating points visited; the limit is {data.ms_limit:g}."
        ),
        regions=overview(data.after, documents, data.advice),
        twins=twins,
        twins_note="" if data.fixed is not None else "There was no run with fixed gains to compare with.",
        what_if=what_if_section(
            panels, {"controller": units.name, "span": units.pv_span, "sets": ["final", "baseline"]}
        ),
        decisions_note=(
            "One row per recognised response; rows that write or propose gains are shaded. A number with a link opens "
            f"the full reasoning below the table.{left}"
        ),
        decisions=_decisions_table(documents, {view.number for view in views}, data.run["t"]),
        pages=pages,
        facts=data.facts,
    )


def _result_in_words(data: ReportData, documents: Sequence[Document]) -> str:
    hours = float(data.run["t"][-1] - data.run["t"][0]) / 3600
    parts = ["The run was stopped before its end."] if data.stopped else []
    lasted = f"{hours:.2g} h" if hours >= SHORTEST_H else f"{3600 * hours:.2g} s"
    parts.append(f"{_counted(sum(bool(d.get('response')) for d in documents), 'response')} recognised in {lasted}.")
    parts.append(f"{_counted(sum(s.changes for s in data.scores), 'change')} written to the controller.")
    # when changes were rolled back, s
    undone = len([number(one, "t_s") or 0.0 for one in documents if rolls_back(one)])
    if undone:
        parts.append(f"{_counted(undone, 'change')} rolled back.")
    advised = sum(words(d, "action") == "advise" for d in documents)
    if advised:
        parts.append(f"{_counted(advised, 'change')} proposed and not written.")
    worst = max((s.ms_after for s in data.scores if s.ms_after is not None), default=None)
    if worst is not None:
        stable = f"is at most {worst:.2f}" if math.isfinite(worst) else "is not finite: the loop is UNSTABLE"
        over = f", over the limit of {data.ms_limit:g} (see the red cells)" if data.ms_limit < worst < math.inf else ""
        parts.append(f"Ms of the final gains on the simulated process {stable}{over}.")
    saved = [(s.iae, s.iae_fixed) for s in data.scores if s.iae_fixed]
    if saved:
        share = 1 - sum(a for a, _ in saved) / sum(b for _, b in saved if b)
        much = f"{abs(share):.0%} {'smaller' if share > 0 else 'LARGER'} than" if round(share, 2) else "the same as"
        parts.append(f"The integrated error is {much} with fixed gains.")
    return " ".join(parts)


def marks_of(data: ReportData, documents: Sequence[Document]) -> list[Mark]:
    """Changes and ways back by their decisions' numbers; a change of which no decision is known has none."""
    found = []
    for one in documents:
        action, t_s = words(one, "action"), number(one, "t_s") or 0.0
        if action == "commit" or rolls_back(one):
            found.append(Mark(t_s, int(number(one, "number") or 0), rolled_back=action == "restore"))
    decided = any(not mark.rolled_back for mark in found)
    return found if decided else [*found, *(Mark(t_s, 0, rolled_back=False) for t_s in data.changes)]


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{' was' if count == 1 else 's were'}"


def _scores_table(data: ReportData, documents: Sequence[Document]) -> tuple[Sequence[str], Sequence[Sequence[object]]]:
    iae = (f"IAE fixed [{data.unit} s]", f"IAE retuned [{data.unit} s]")
    heads = ("region", "baseline gains", "final gains", "changes", "Ms before", "Ms after", *iae)
    rows = []
    for s in data.scores:
        fixed = s.iae if s.iae_fixed is None else s.iae_fixed
        rows.append(
            (
                s.region,
                *(settings_text(gains, data.loop) for gains in (s.before, s.after)),
                s.changes,
                ms_text(s.ms_before),
                _ms_cell(s, data.ms_limit, documents),
                "-" if s.iae_fixed is None else in_full(s.iae_fixed),
                Toned(in_full(s.iae), "good" if s.iae < fixed else "bad" if s.iae > fixed else ""),
            )
        )
    return heads, rows


def _ms_cell(score: RegionScore, limit: float, documents: Sequence[Document]) -> str | Explained:
    """Ms of the final gains; over the limit in red, with the reason why nothing brought it below."""
    text = ms_text(score.ms_after)
    if score.ms_after is None or score.ms_after <= limit:
        return text
    # Why a region ends with Ms over its limit, as far as its decisions tell
    own = [one for one in documents if words(one, "region") == score.region]
    if not own:
        why = "no response of this region was recognised, so it has no process model"
    else:
        newest = own[-1]
        told = f"decision {int(number(newest, 'number') or 0)}: {words(newest, 'reason')}"
        known = number(part(part(newest, "verdict"), "ms"), "nominal" if score.changes else "before")
        seen = f"; on the identified process it was {known:.2f}" if known is not None else ""
        changed = any(words(one, "action") == "commit" for one in own)
        one_process = "; the model is one for the whole region, this value is the worst over its operating points"
        why = f"{'the newest ' if changed else 'nothing was changed; the newest '}{told}{seen}{one_process}"
    return Explained(f"{text}, over {limit:g}", why)


def as_commissioned(data: ReportData, twin: Twin) -> bool:
    """Whether the first of two equal steps ran on the baseline gains to its end."""
    before = data.before.gains_of(twin.region)
    if "kp" not in data.run:
        return False
    part_ = slice(*twin.first)
    return all(
        np.allclose(data.run[name][part_], value, rtol=SAME_GAINS, atol=0.0)
        for name, value in (("kp", before.kp), ("ki", before.ki))
    )


def _decisions_table(
    documents: Sequence[Document], paged: set[int], t_s: FloatArray
) -> tuple[Sequence[str], Sequence[Sequence[object]], Sequence[str]]:
    """A row for each decision; paged : numbers of those that have a page. t_s : of the run, as its picture has it."""
    long = bool(len(t_s)) and float(t_s[-1] - t_s[0]) > LONG_S
    heads = ("no.", "time [h:mm]" if long else "time [s]", "region", "response", "cause", "reason", "process", "change")
    rows, classes = [], []
    for document in documents:
        name = f"{number(document, 'number') or 0:.0f}"
        link = Linked(name, f"#decision-{name}" if int(name) in paged else "")
        at_s = number(document, "t_s") or 0.0
        minutes = round((at_s - float(t_s[0])) / 60) if long else 0
        told = (
            f"{minutes // 60}:{minutes % 60:02d}" if long else f"{at_s:,.0f}",
            words(document, "region"),
            response_text(document),
            cause_text(document),
            words(document, "reason"),
            model_text(document),
            change_text(document),
        )
        rows.append((link, *told))
        classes.append("" if words(document, "action") == "none" else "commit")
    return heads, rows, classes
