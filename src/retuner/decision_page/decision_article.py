"""One decision on one page: what was seen, learned, blamed, proposed, proved and promised, and what came of it.

The page tells what stands in the decision's document; only curves and margins are worked out again from the process in
it. A section for which there is nothing is left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.rules.registry import RULES, explanation, settings
from retuner.adaptive.rules.rule import ControllerKind, Wishes
from retuner.adaptive.rules.visual import oscillation_by_eye
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.evidence_words import evidence_table
from retuner.decision_page.explain import change_text, process_text, rolls_back, settings_text, stays
from retuner.decision_page.html import document, escaped, pairs, paragraph, section, table, text_table
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
from retuner.decision_page.text import (
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
from retuner.schedule.controller_units import ControllerUnits
from retuner.schedule.dials import PARALLEL
from retuner.schedule.gains import PidGains

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


def page(view: DecisionView) -> str:
    """The page as an HTML document of its own."""
    loop = words(view.document, "loop")
    title = f"{loop}: decision {view.number}"
    return document(title, f"<h1>{escaped(title)}</h1>{article(view)}")


def article(view: DecisionView) -> str:
    """The page as a part of another."""
    from retuner.decision_page.response_drawing import response_svg  # noqa: PLC0415  matplotlib, for those who draw
    from retuner.decision_page.robustness_drawing import robustness_svg  # noqa: PLC0415

    response = response_svg(view)
    drawing = robustness_svg(view, ms_limit(view))
    mode = words(view.document, "mode")
    parts_ = [f"region {words(view.document, 'region')}", f"{in_full(view.t_s)} s", f"mode {mode}" if mode else ""]
    body = [
        f'<p>{badge(view)} <span class="muted">{escaped(", ".join(one for one in parts_ if one))}</span></p>',
        paragraph(headline(view), "lead"),
        section("The response", response, paragraph(_how_it_ended(view), "muted")),
        judgement_section(view),
        '<div class="columns">',
        section("Process model", _learned(view)),
        section("Cause", _cause(view)),
        section("Settings" if view.rolls_back else "Proposal", _proposal(view)),
        "" if view.rolls_back else section("Proof", _proof(view)),
        "</div>",
        section("Robustness and predicted responses", paragraph(footing(view)), drawing, _margins(view)),
        promise_section(view),
        later_section(view),
        section("Ledger entry", _whereabouts(view)),
    ]
    return f"<article>{''.join(body)}</article>"


def badge(view: DecisionView) -> str:
    """What became of it, in a word or two and a colour."""
    tone = TONES.get(view.action, TONES["none"])
    what = "The trial settings stay" if stays(view.document) else DONE.get(view.action, view.action)
    return f'<span class="badge {tone}">{escaped(what)}</span>'


def _how_it_ended(view: DecisionView) -> str:
    """How the recogniser ended, in words, and the numbers of the peaks."""
    response = view.response
    if not response:
        return ""
    band, start, end = (number(response, name) for name in ("band", "t_start_s", "t_end_s"))
    length = f"From {start:,.0f} to {end:,.0f} s. " if start is not None and end is not None else ""
    endings = {
        "complete": "three peaks were verified",
        "quiet": "the error came to rest",
        "timeout": "no further peak came within the waiting time",
        "setpoint": "the next setpoint change cut it short",
        "grown": "its second peak had grown to several times the first",
    }
    ended = endings.get(words(response, "ending"), "")
    near = f" Errors below {band:.3g} {view.unit} count as noise." if band is not None else ""
    return f"{length}It ended when {ended}.{near}" if ended else f"{length}{near}"


def _learned(view: DecisionView) -> str:
    """Structure, parameters, how many records, how this one stood to what was known."""
    model = view.model
    if model is None:
        return paragraph(words(view.estimate, "reason"))
    records = number(view.document, "records")
    agreements = {agreement.code: str(agreement) for agreement in Agreement}
    rows: list[tuple[str, object]] = [("structure", structure(model)), *parameters(model, view.spread, view.unit)]
    none = "none of its own: estimated from neighbouring regions" if part(view.document, "known") else ""
    rows += [
        ("records in the model", f"{records:.0f}" if records else none),
        ("this record", agreements.get(words(view.document, "surprise"), "")),
        ("fit", words(view.estimate, "reason")),
        ("fit residual", _residual(view)),
        ("other plausible models", str(len(view.allowed)) if view.allowed else ""),
    ]
    if part(view.document, "known") and view.of_record:
        rows.append(("estimate from this record alone", process_text(view.of_record)))
    return pairs(rows)


def _residual(view: DecisionView) -> str:
    """What the fit leaves against the noise."""
    residual, noise = number(view.estimate, "residual"), number(view.estimate, "noise")
    if residual is None or not noise:
        return ""
    return f"{residual:.3g} {view.unit} (one standard deviation), {residual / noise:.2g} times the noise"


def _cause(view: DecisionView) -> str:
    """The cause, how sure, and its evidence."""
    diagnosis = part(view.document, "diagnosis")
    if not diagnosis:
        return ""
    confidence = number(diagnosis, "confidence")
    sure = f" (confidence {confidence:.0%})" if confidence is not None else ""
    name = words(diagnosis, "cause").replace("_", " ")
    lead = f"<p><b>{escaped(name)}</b>{escaped(sure)}: {escaped(words(diagnosis, 'reason'))}</p>"
    evidence = {key: value for key, raw in part(diagnosis, "evidence").items() if (value := finite(raw)) is not None}
    groups = evidence_table(evidence)
    first = [row for name in FIRST_GROUPS for row in groups.pop(name, [])]
    rest = [row for rows in groups.values() for row in rows]
    heads = ("evidence", "value", "how to read it")
    shown = text_table(heads, first) if first else ""
    more = f"<details><summary>{len(rest)} more numbers</summary>{text_table(heads, rest)}</details>" if rest else ""
    eye = paragraph(f"By eye: {'; '.join(seen)}.", "muted") if (seen := _by_eye(view)) else ""
    return f"{lead}{eye}{shown}{more}"


def _by_eye(view: DecisionView) -> list[str]:
    """What the visual rules say of a response that swings on."""
    period_s, damping = number(view.response, "period_s"), number(view.response, "damping")
    if not period_s or damping is None or damping < SWINGS or period_s < 0:
        return []
    integrating = view.model is not None and view.model.linear().integrators > 0
    cause = words(part(view.document, "diagnosis"), "cause")
    tuning = cause in {*TUNING_CAUSES, Cause.UNKNOWN}
    return oscillation_by_eye(period_s, view.before, integrating=integrating, tuning=tuning)


def _proposal(view: DecisionView) -> str:
    """The rule with its formula and numbers; settings in force, of the rule, and let through."""
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
        return ""
    lead = f"Rule {rule}" if rule else ""
    lead += f", tau_c {tau_c:.4g} s" if tau_c is not None else ""
    lead += f", {basis}." if lead and basis else "." if lead else ""
    settled = _settings_rows([gains for _, gains in shown], units_of(words(view.document, "loop")))
    rows = [row for row in settled if any(cell not in {"-", "0"} for cell in row[1:])]
    return (
        paragraph(lead)
        + (_formula(view, wanted) if wanted else "")
        + text_table(("", *(name for name, _ in shown)), rows)
    )


def _settings_rows(sets: Sequence[PidGains], units: ControllerUnits) -> Iterator[tuple[str, ...]]:
    """Settings as they stand on the controller, and in parallel form as they are sent; what nobody has is left out."""
    for i, dial in enumerate(units.dials):
        if not dial.label:
            continue
        form = f" ({units.form})" if i == 0 and not units.apart else ""
        cells = [_cell(_dialled(gains, units)[i], dial.unit) for gains in sets]
        yield f"{dial.label}{form}", *cells
    if units.dials != PARALLEL:
        for name, unit in (("kp", ""), ("ki", " /s"), ("kd", " s")):
            yield name, *(_cell(getattr(gains, name), unit) for gains in sets)


def _dialled(gains: PidGains, units: ControllerUnits) -> tuple[float | None, ...]:
    """The numbers on the controller; none in a form that this set has not."""
    try:
        shown = units.numbers(gains)
    except ValueError:
        return None, None, None
    return shown[:3] if shown.form == units.form else (None, None, None)


def _cell(value: float | None, unit: str) -> str:
    return "-" if value is None else "0" if value == 0 else f"{value:.5g}{unit}"


def _formula(view: DecisionView, wanted: PidGains) -> str:
    """The rule's formula with the numbers that give the proposal; nothing where they do not give just that."""
    proposal = part(view.document, "proposal")
    rule, model = RULES.get(words(proposal, "rule")), view.model
    tau_c = number(proposal, "tau_c")
    if rule is None or model is None or view.process is None:
        return ""
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
            source = paragraph(f"{_put_in(view, model, kind)} {told.source}".strip(), "muted")
            return f"<pre>{escaped(chr(10).join(lines))}</pre>{source}"
    return ""


def _put_in(view: DecisionView, model: ProcessModel, kind: ControllerKind) -> str:
    """How the numbers of the formula come from those of the process."""
    told = ["half a sampling interval added to theta"] if view.sample_time_s else []
    if model.tau2_s and kind == ControllerKind.PI:
        told.append(
            "half of tau2 added to theta" + (" and half to tau1 (half rule)" if model.tau1_s else " (half rule)")
        )
    return f"With {', '.join(told)}." if told else ""


def _proof(view: DecisionView) -> str:
    """What the guard asked and what the answers were."""
    verdict = view.verdict
    if not verdict:
        return ""
    rows = []
    for check in parts(verdict, "checks"):
        passed = check.get("passed")
        mark = "passed" if passed is True else "NOT passed" if passed is False else ""
        name = words(check, "name")
        words_ = words(check, "words") or name.replace("_", " ")
        none = "unstable" if name.startswith("ms_") else "none"
        rows.append(
            (
                escaped(words_),
                _value(check.get("value"), none) if name != "settled" else "yes" if passed else "no",
                _value(check.get("limit"), "none") if name != "settled" else "yes",
                f'<span class="{"good" if passed else "bad"}">{mark}</span>',
            )
        )
    shown = table(("check", "value", "limit", ""), rows) if rows else ""
    reason = words(verdict, "reason")
    return paragraph(f"{reason[:1].upper()}{reason[1:]}.") * bool(reason) + shown


def _value(value: object, none: str) -> str:
    """A number, or what its absence means."""
    known = finite(value)
    if known is None:
        return none
    return in_full(known)


def _margins(view: DecisionView) -> str:
    rows = margin_rows(view)
    if not rows:
        return ""
    new = new_name(view)
    middle = (old_name(view), new, f"{new}, worst case")[: len(rows[0]) - 2]
    return text_table(("", *middle, "usual"), rows)


def _whereabouts(view: DecisionView) -> str:
    loads = len(numbers(view.estimate, "loads"))
    return pairs(
        [
            ("ledger row", f"{view.row}, hash {view.hash}" if view.row is not None else ""),
            (
                "active gains at the time",
                settings_text(view.before, words(view.document, "loop")) if view.before else "",
            ),
            ("code", words(view.document, "code")),
            ("load steps in the record", str(loads) if loads else ""),
            ("state of the region", words(view.document, "trial")),
        ]
    )


# What a change promised, and what came of it: later responses against it, and the rollback if there was one.


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
