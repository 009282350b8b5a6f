"""A decision as a document: a lead, and sections of rows, sentences and drawings; templates/decision.html.jinja lays it
out. What terminal, ledger and tables say of a decision in a line is decision_words.py's.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.rules.registry import RULES, explanation, settings
from retuner.adaptive.rules.rule import ControllerKind, Wishes
from retuner.adaptive.rules.visual import oscillation_by_eye
from retuner.decision_page.decision_sentences import (
    DONE,
    footing,
    headline,
    margin_rows,
    ms_limit,
    new_name,
    old_name,
    parameters,
    structure,
)
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.decision_words import change_text, process_text, rolls_back, settings_text, stays
from retuner.decision_page.evidence_words import evidence_table
from retuner.decision_page.response_drawing import response_svg
from retuner.decision_page.robustness_drawing import robustness_svg
from retuner.decision_page.row_values import (
    Document,
    finite,
    gains_of,
    in_full,
    number,
    numbers,
    numbers_or_none,
    part,
    parts,
    words,
)
from retuner.decision_page.shown_units import units_of
from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.dials import PARALLEL
from retuner.schedule.gains import PidGains
from retuner.templates import rendered


class Text(NamedTuple):
    """A paragraph. kind : how it is set: "", lead or muted. bold : the words that it begins with, in bold."""

    text: str
    kind: str = ""
    bold: str = ""


class Table(NamedTuple):
    """Rows of cells under their heads. fold : the line behind which it is folded away, empty for shown at once."""

    heads: Sequence[str]
    rows: Sequence[Sequence[object]]
    fold: str = ""


class Pairs(NamedTuple):
    """Names and values."""

    pairs: Sequence[tuple[str, str]]


class Code(NamedTuple):
    """Lines of a formula."""

    code: str


class Drawing(NamedTuple):
    """A drawing by its name: response or robustness."""

    drawing: str


class Toned(NamedTuple):
    """A word that is good or bad."""

    text: str
    tone: str


class Explained(NamedTuple):
    """A number; why : it is not as it should be, empty where it is."""

    text: str
    why: str


class Linked(NamedTuple):
    """A text that leads somewhere, or nowhere."""

    text: str
    link: str


Block = Text | Table | Pairs | Code | Drawing


class PageSection(NamedTuple):
    """A heading with what stands under it. column : beside the others of its kind where there is room."""

    heading: str
    blocks: Sequence[Block]
    column: bool = False


class DecisionDocument(NamedTuple):
    """One decision in words and numbers, as pages lay it out."""

    title: str
    badge: Toned
    place: str
    lead: str
    sections: Sequence[PageSection]


def decision_document(view: DecisionView) -> DecisionDocument:
    """What was seen, learned, blamed, proposed, proved and promised, and what came of it.

    It tells what stands in the decision's document; only curves and margins are worked out again from the process in
    it. A section for which there is nothing is left out.
    """
    mode, back = words(view.document, "mode"), view.rolls_back
    place = (f"region {words(view.document, 'region')}", f"{in_full(view.t_s)} s", f"mode {mode}" if mode else "")
    what = "The trial settings stay" if stays(view.document) else DONE.get(view.action, view.action)
    promise = part(view.document, "promise")
    rows = [
        (label, *(cell for upset in UPSETS for cell in _promised(promise, upset, name, factor, unit)))
        for name, (label, factor, unit) in MEASURES.items()
    ]
    rows = [row for row in rows if any(row[1:])]
    models = number(promise, "models")
    over = f" over the {models:.0f} plausible model{'s' * (models != 1)}" if models else ", from what was seen"
    ms = numbers_or_none(promise, "ms")
    predicted_ms = ""
    if len(ms) == 3:
        best, low, high = ("unstable" if value is None else _in(value) for value in ms)
        predicted_ms = f" Predicted Ms: {best} ({low} .. {high})."
    spread = f"In brackets the smallest and largest value{over}.{predicted_ms}"
    heads = ("", "setpoint step: predicted", "previous settings", "load step: predicted", "previous settings")
    heading = "Predicted performance, against which the next responses are judged"
    if view.rolls_back:
        heading = f"Predicted performance of what {'is on trial' if stays(view.document) else 'was rolled back'}"
    judged = []
    for later in view.later:
        told = (
            _told(part(later, "judgement")) or words(later, "reason"),
            change_text(later) if rolls_back(later) else "",
        )
        reason = " Then ".join(one for one in told if one)
        when = f"{number(later, 't_s') or 0.0:,.0f}"
        judged.append((f"{number(later, 'number') or 0:.0f}", when, reason, words(later, "trial")))
    loads = len(numbers(view.estimate, "loads"))
    entry = (
        ("ledger row", f"{view.row}, hash {view.hash}" if view.row is not None else ""),
        ("active gains at the time", settings_text(view.before, words(view.document, "loop")) if view.before else ""),
        ("code", words(view.document, "code")),
        ("load steps in the record", str(loads) if loads else ""),
        ("state of the region", words(view.document, "trial")),
    )
    sections = (
        PageSection("The response", (Drawing("response"), Text(_how_it_ended(view), "muted"))),
        PageSection("The trial: this response against the predicted performance", _judged_by(view)),
        PageSection("Process model", _learned(view), column=True),
        PageSection("Cause", _cause(view), column=True),
        PageSection("Settings" if back else "Proposal", _proposal(view), column=True),
        PageSection("Proof", () if back else _proof(view), column=True),
        PageSection(
            "Robustness and predicted responses", (Text(footing(view)), Drawing("robustness"), *_margins(view))
        ),
        PageSection(heading, (Table(heads, rows), Text(spread, "muted")) if rows else ()),
        PageSection("What came of it", _table(("decision", "time [s]", "result", "then"), judged)),
        PageSection("Ledger entry", _pairs(entry)),
    )
    return DecisionDocument(
        f"{words(view.document, 'loop')}: decision {view.number}",
        Toned(what, TONES.get(view.action, TONES["none"])),
        ", ".join(one for one in place if one),
        headline(view),
        sections,
    )


def _pairs(rows: Sequence[tuple[str, object]]) -> tuple[Pairs, ...]:
    told = [(name, str(value)) for name, value in rows if value]
    return (Pairs(told),) if told else ()


def _table(heads: Sequence[str], rows: Sequence[Sequence[object]], fold: str = "") -> tuple[Table, ...]:
    return (Table(heads, rows, fold),) if rows else ()


TONES = {"commit": "good", "advise": "warn", "restore": "bad", "none": "faint"}
BASES = {
    "model": "from the identified process",
    "borrowed": "from the neighbouring regions' models",
    "pattern": "from the response pattern, without a model",
    "slow_oscillation": "from the slow oscillation, without a model",
    "pretune": "from a step test",
    "ran_before": "gains that were active here before",
}
"""What a proposal rests on, in words."""
FIRST_GROUPS = ("margins with the active settings", "competing explanations")
"""Groups of evidence that are shown at once; the others unfold."""
SWINGS = 0.25  # ratio of successive half swings from which a response looks like an oscillation: a quarter decay
SAME = 1e-6  # gains that a formula gives are the proposal's to this share, or the formula is not shown
ENDINGS = {
    "complete": "three peaks were verified",
    "quiet": "the error came to rest",
    "timeout": "no further peak came within the waiting time",
    "setpoint": "the next setpoint change cut it short",
    "grown": "its second peak had grown to several times the first",
}
"""How the recogniser ended, in words."""


def _how_it_ended(view: DecisionView) -> str:
    response = view.response
    if not response:
        return ""
    band, start, end = (number(response, name) for name in ("band", "t_start_s", "t_end_s"))
    length = f"From {start:,.0f} to {end:,.0f} s. " if start is not None and end is not None else ""
    ended = ENDINGS.get(words(response, "ending"), "")
    near = f" Errors below {band:.3g} {view.unit} count as noise." if band is not None else ""
    return f"{length}It ended when {ended}.{near}" if ended else f"{length}{near}"


def _learned(view: DecisionView) -> Sequence[Block]:
    model = view.model
    if model is None:
        return (Text(words(view.estimate, "reason")),)
    records = number(view.document, "records")
    agreements = {agreement.code: str(agreement) for agreement in Agreement}
    rows: list[tuple[str, object]] = [("structure", structure(model)), *parameters(model, view.spread, view.unit)]
    none = "none of its own: estimated from neighbouring regions" if part(view.document, "known") else ""
    residual, noise = number(view.estimate, "residual"), number(view.estimate, "noise")
    left = ""
    if residual is not None and noise:
        left = f"{residual:.3g} {view.unit} (one standard deviation), {residual / noise:.2g} times the noise"
    rows += [
        ("records in the model", f"{records:.0f}" if records else none),
        ("this record", agreements.get(words(view.document, "surprise"), "")),
        ("fit", words(view.estimate, "reason")),
        ("fit residual", left),
        ("other plausible models", str(len(view.allowed)) if view.allowed else ""),
    ]
    if part(view.document, "known") and view.of_record:
        rows.append(("estimate from this record alone", process_text(view.of_record)))
    return _pairs(rows)


def _cause(view: DecisionView) -> Sequence[Block]:
    diagnosis = part(view.document, "diagnosis")
    if not diagnosis:
        return ()
    confidence = number(diagnosis, "confidence")
    sure = f" (confidence {confidence:.0%})" if confidence is not None else ""
    name = words(diagnosis, "cause").replace("_", " ")
    evidence = {key: value for key, raw in part(diagnosis, "evidence").items() if (value := finite(raw)) is not None}
    groups = evidence_table(evidence)
    first = [row for name in FIRST_GROUPS for row in groups.pop(name, [])]
    rest = [row for rows in groups.values() for row in rows]
    heads = ("evidence", "value", "how to read it")
    period_s, damping = number(view.response, "period_s"), number(view.response, "damping")
    if not period_s or damping is None or damping < SWINGS or period_s < 0:
        seen = []
    else:
        integrating = view.model is not None and view.model.linear().integrators > 0
        tuning = words(part(view.document, "diagnosis"), "cause") in {*TUNING_CAUSES, Cause.UNKNOWN}
        seen = oscillation_by_eye(period_s, view.before, integrating=integrating, tuning=tuning)
    return (
        Text(f"{sure}: {words(diagnosis, 'reason')}", bold=name),
        Text(f"By eye: {'; '.join(seen)}." if seen else "", "muted"),
        *_table(heads, first),
        *_table(heads, rest, fold=f"{len(rest)} more numbers"),
    )


def _proposal(view: DecisionView) -> Sequence[Block]:
    proposal = {} if view.rolls_back else part(view.document, "proposal")
    wanted = gains_of(part(proposal, "parallel"))
    names = (
        ("on trial", "", "kept" if stays(view.document) else "rolled back")
        if view.rolls_back
        else ("active", "rule", "accepted")
    )
    columns = zip(names, (view.before, wanted, view.after), strict=True)
    shown = [(name, gains) for name, gains in columns if gains is not None]
    basis = BASES.get(words(view.document, "basis"), "")
    rule, tau_c = words(proposal, "rule"), number(proposal, "tau_c")
    if not rule and view.after is None:
        return ()
    lead = f"Rule {rule}" if rule else ""
    lead += f", tau_c {tau_c:.4g} s" if tau_c is not None else ""
    lead += f", {basis}." if lead and basis else "." if lead else ""
    settled = _settings_rows([gains for _, gains in shown], units_of(words(view.document, "loop")))
    rows = [row for row in settled if any(cell not in {"-", "0"} for cell in row[1:])]
    return Text(lead), *(_formula(view, wanted) if wanted else ()), Table(("", *(name for name, _ in shown)), rows)


def _settings_rows(sets: Sequence[PidGains], units: ControllerUnits) -> Iterator[tuple[str, ...]]:
    """Settings as they stand on the controller, and in parallel form as they are sent; what nobody has is left out."""
    dialled: list[tuple[float | None, ...]] = []
    for gains in sets:
        try:
            shown = units.numbers(gains)
            dialled.append(shown[:3] if shown.form == units.form else (None, None, None))
        except ValueError:  # a form that this set has not
            dialled.append((None, None, None))
    for i, dial in enumerate(units.dials):
        form = f" ({units.form})" if i == 0 and not units.apart else ""
        if dial.label:
            yield f"{dial.label}{form}", *[_cell(numbers_[i], dial.unit) for numbers_ in dialled]
    if units.dials != PARALLEL:
        for name, unit in (("kp", ""), ("ki", " /s"), ("kd", " s")):
            yield name, *(_cell(getattr(gains, name), unit) for gains in sets)


def _cell(value: float | None, unit: str) -> str:
    return "-" if value is None else "0" if value == 0 else f"{value:.5g}{unit}"


def _formula(view: DecisionView, wanted: PidGains) -> Sequence[Block]:
    """The rule's formula with the numbers that give the proposal; nothing where they do not give just that."""
    proposal = part(view.document, "proposal")
    rule, model = RULES.get(words(proposal, "rule")), view.model
    tau_c = number(proposal, "tau_c")
    if rule is None or model is None or view.process is None:
        return ()
    wishes = Wishes(tau_c_s=tau_c if "tau_c_s" in rule.wishes else None)
    sampled = replace(model, theta_s=view.process.theta_s)
    for kind in ControllerKind:
        if kind not in rule.formulas:
            continue
        try:
            found = settings(rule, kind, sampled, None, wishes)
        except ValueError:
            continue
        pairs_ = ((found.gains.kp, wanted.kp), (found.gains.ki, wanted.ki), (found.gains.kd, wanted.kd))
        if all(abs(a - b) <= SAME * max(abs(a), abs(b)) for a, b in pairs_):
            told = explanation(rule, kind, sampled, None, wishes, found)
            lines = [*told.formula, *(line for line in told.with_numbers if line not in told.formula)]
            adjusted = ["half a sampling interval added to theta"] if view.sample_time_s else []
            if model.tau2_s and kind == ControllerKind.PI:
                adjusted.append(
                    "half of tau2 added to theta"
                    + (" and half to tau1 (half rule)" if model.tau1_s else " (half rule)")
                )
            put_in = f"With {', '.join(adjusted)}." if adjusted else ""
            return Code("\n".join(lines)), Text(f"{put_in} {told.source}".strip(), "muted")
    return ()


def _proof(view: DecisionView) -> Sequence[Block]:
    rows = []
    for check in parts(view.verdict, "checks"):
        passed, name = check.get("passed"), words(check, "name")
        mark = "passed" if passed is True else "NOT passed" if passed is False else ""
        value, limit = _value(check.get("value"), "unstable" if name.startswith("ms_") else "none"), ""
        limit = _value(check.get("limit"), "none")
        if name == "settled":
            value, limit = "yes" if passed else "no", "yes"
        told = words(check, "words") or name.replace("_", " ")
        rows.append((told, value, limit, Toned(mark, "good" if passed else "bad")))
    reason = words(view.verdict, "reason")
    return Text(f"{reason[:1].upper()}{reason[1:]}." * bool(reason)), *_table(("check", "value", "limit", ""), rows)


def _value(value: object, none: str) -> str:
    known = finite(value)
    return none if known is None else in_full(known)


def _margins(view: DecisionView) -> Sequence[Block]:
    rows = margin_rows(view)
    if not rows:
        return ()
    new = new_name(view)
    return (Table(("", *(old_name(view), new, f"{new}, worst case")[: len(rows[0]) - 2], "usual"), rows),)


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


def _judged_by(view: DecisionView) -> Sequence[Block]:
    judgement = part(view.document, "judgement")
    found = part(judgement, "numbers")
    rows = []
    for name, (label, factor, unit) in MEASURES.items():
        if number(found, name) is None:
            continue
        cells = []
        for value in (number(found, f"{name}{which}") for which in ("", "_promised", "_limit", "_before")):
            if value is None or value >= 0 or name == "overshoot":
                cells.append("" if value is None else _in(value, factor, unit))
            else:  # below 0 stands for infinite, but an overshoot may be
                cells.append("unstable" if name == "ms" else _in(None))
        rows.append((label, *cells))
    heads = ("", "measured", "predicted", "limit", "previous settings")
    return (Text(_told(judgement)), *_table(heads, rows)) if judgement else ()


def _told(judgement: Document) -> str:
    """The finding and its reason, which begins with it as a rule."""
    finding, reason = FINDINGS.get(words(judgement, "finding"), ""), words(judgement, "reason")
    told = reason if reason.lower().startswith(finding.lower()) else f"{finding}: {reason}"
    return f"{told[:1].upper()}{told[1:]}." if told else ""


def page(view: DecisionView) -> str:
    """The page as an HTML document of its own."""
    return _rendered("decision_page.html.jinja", view)


def article(view: DecisionView) -> str:
    """The page as a part of another."""
    return _rendered("decision.html.jinja", view)


def _rendered(template: str, view: DecisionView) -> str:
    drawings = {"response": response_svg(view), "robustness": robustness_svg(view, ms_limit(view))}
    told = decision_document(view)
    return rendered(template, title=told.title, decision=told, drawings=drawings)
