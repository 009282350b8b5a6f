"""A decision in sentences, for its document: what was seen, what follows, how robust the loop is before and after."""

import math

from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.loop.margins import margins
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.region_model.update import Agreement
from retuner.decision_page.decision_view import DecisionView
from retuner.decision_page.decision_words import ms_words, part_words, process_text, settings_text, stays
from retuner.decision_page.row_values import number, part, parts, words
from retuner.decision_page.shown_units import units_of
from retuner.schedule.gains import PidGains

STRUCTURES = {
    ProcessType.FOPDT: "first order with dead time",
    ProcessType.SOPDT: "second order with dead time",
    ProcessType.INTEGRATING: "integrating with dead time",
    ProcessType.INTEGRATING_LAG: "integrating with a lag and dead time",
    ProcessType.DOUBLE_INTEGRATING: "double integrating with dead time",
    ProcessType.DELAY: "pure dead time",
    ProcessType.SOPDT_INVERSE: "second order with an inverse response and dead time",
    ProcessType.SOPDT_LEAD: "second order with a lead and dead time",
    ProcessType.TOPDT: "third order with dead time",
}
DONE = {
    "commit": "Written to the controller",
    "advise": "Proposed, not written",
    "restore": "Rolled back to the previous settings",
    "none": "Nothing was changed",
}
"""What became of a decision."""
WITHOUT_MODEL = {"pattern", "slow_oscillation", "ran_before"}  # what a proposal rests on that needs no model
MS_LIMIT = GuardSettings().ms_nominal  # limit of the nominal Ms where a document names none
SAME = 1e-3  # numbers closer than this share are one to a reader


def seen(view: DecisionView) -> str:
    """What the response looked like."""
    response = view.response
    if not response:
        return ""
    upset = "a setpoint change" if words(response, "upset") == "setpoint" else "a load disturbance"
    overshoot, damping, period = (number(response, name) for name in ("overshoot", "damping", "period_s"))
    if overshoot is None:
        return f"After {upset} the error returned without a second peak: no overshoot beyond the noise."
    swing = f", half-cycle decay ratio {damping:.2f} (0 dead-beat, 1 sustained)" if damping is not None else ""
    time = f", period {period:.3g} s" if period is not None else ""
    return f"After {upset} the loop overshot by {overshoot:.0%} of the first peak{swing}{time}."


def done(view: DecisionView) -> str:
    """What follows, with the numbers."""
    if stays(view.document) and view.after is not None:
        return f"The trial settings stay: {settings_text(view.after, words(view.document, 'loop'))}."
    what = DONE.get(view.action, view.action)
    if view.before is None or view.after is None:
        return f"{what}."
    return f"{what}: {moves(view.before, view.after, words(view.document, 'loop'))}."


def moves(before: PidGains, after: PidGains, loop: str = "") -> str:
    """Each setting that moves, by its name, from where to where and with its factor. loop : its name, if known."""
    units = units_of(loop)
    try:
        old, new = units.numbers(before), units.numbers(after)
    except ValueError:
        return f"{settings_text(before, loop)} becomes {settings_text(after, loop)}"
    if old.form != new.form:
        return f"{settings_text(before, loop)} becomes {settings_text(after, loop)}"
    told = []
    for dial, was, now in zip(units.dials, old[:3], new[:3], strict=True):
        if (was or 0.0) == (now or 0.0):
            continue
        if not was or not now:
            told.append(f"{dial.label} from {_or_none(was, dial.unit)} to {_or_none(now, dial.unit)}")
        elif abs(now / was - 1) > SAME:
            told.append(f"{dial.label} from {was:.3g} to {now:.3g}{dial.unit} (x {now / was:.3g})")
    return ", ".join(told) or "the same settings"


def _or_none(value: float | None, unit: str) -> str:
    return f"{value:.3g}{unit}" if value else "none"


def how_far(view: DecisionView) -> str:
    """What share of the rule's step was taken, and what the guard said of it."""
    share, _, why = part_words(view.verdict).partition(": ")
    if view.after is None or not share:
        return ""
    notes = view.verdict.get("notes")
    cut = "; ".join(one for one in notes if isinstance(one, str)) if isinstance(notes, list) else ""
    told = "; ".join(one for one in (why, cut) if one)
    return f"This is {share} (in the logarithm of the gains){f': {told}' if told else ''}."


def robustness(view: DecisionView) -> str:
    """Ms before, after and at worst, as the guard had them."""
    ms = part(view.verdict, "ms")
    if "nominal" not in ms or view.verdict.get("allowed") == []:  # no model: nothing is known of Ms
        return ""
    known = "the identified process" + ", which this record contradicts" * view.contradicted
    values = (number(ms, name) for name in ("before", "nominal", "worst"))  # null in a document is an unstable loop
    before, after, worst = ("unstable" if one is None or math.isinf(one) else f"Ms {one:.2f}" for one in values)
    if view.after is None:
        return f"With the active settings: {before} on {known}, worst case {worst} over the plausible models."
    return f"On {known}: {before} before, {after} after; worst case over the plausible models {worst}."


def headline(view: DecisionView) -> str:
    """The first paragraph of a page."""
    reason = words(view.document, "reason")
    why = f"{reason[:1].upper()}{reason[1:]}." if reason else ""
    return " ".join(one for one in (seen(view), why, done(view), how_far(view), robustness(view)) if one)


def footing(view: DecisionView) -> str:
    """The model on which curves and margins rest, where this record does not bear it out; empty where it does."""
    model, shown = view.model, view.of_record
    settled = view.estimate.get("identifiable") is not False
    if model is None or view.before is None or (settled and not view.contradicted):
        return ""
    known = ", ".join(f"{label.split()[0]} {value}" for label, value in parameters(model, view.spread, view.unit))
    reason = words(view.estimate, "reason")
    if view.contradicted:
        own = f": on its own it gives {process_text(shown)}" if shown else ""
        told = f"the model before this record ({known}). This record contradicts it{own}"
        told += "" if settled else f" (not identified either: {reason})"
    elif words(view.document, "surprise") == Agreement.SILENT.code:
        told = f"the model before this record ({known}), which does not identify the process"
    else:
        told = f"a model that is not accurate enough yet ({known}): {reason}"
    apart = words(view.document, "basis") in WITHOUT_MODEL
    return f"Curves, margins and predictions use {told}." + " The proposal does not use it." * apart


def structure(model: ProcessModel) -> str:
    """The structure in words."""
    text = STRUCTURES[model.type]
    return f"{text}, oscillatory (zeta {model.zeta:.2f})" if model.zeta < 1 else text


def parameters(model: ProcessModel, std: dict[str, float], unit: str) -> list[tuple[str, str]]:
    """Name and value with standard deviation of each parameter that the structure has; unit : of pv."""
    integrating = model.type in {ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG, ProcessType.DOUBLE_INTEGRATING}
    gain, per = ("k' (slope gain)", f" {unit}/(% s)") if integrating else ("k (gain)", f" {unit}/%")
    rows = [
        (gain, "k", model.k, per), ("tau1 (lag)", "tau1", model.tau1_s, " s"),
        ("tau2 (second lag)", "tau2", model.tau2_s, " s"), ("tau3 (third lag)", "tau3", model.tau3_s, " s"),
        ("theta (dead time)", "theta", model.theta_s, " s"),
    ]  # fmt: skip
    told = []
    for label, name, value, its in rows:
        spread = f" +- {std[name]:.2g} ({abs(std[name] / value):.1%})" if value and name in std else ""
        told += [(label, f"{value:.4g}{spread}{its}")] if value else []
    return told


def ms_limit(view: DecisionView) -> float:
    """The limit of the nominal Ms that the guard held it to."""
    limits = [
        number(check, "limit")
        for check in parts(view.verdict, "checks")
        if words(check, "name").startswith("ms_nominal")
    ]
    return next((limit for limit in limits if limit and limit > 1), MS_LIMIT)


def margin_rows(view: DecisionView) -> list[tuple[str, ...]]:
    """Name, before, after, worst of the models still allowed (where there are any), what is usual."""
    if view.process is None or view.before is None:
        return []
    columns = [margins(view.process, view.before)]
    if view.tried:
        tried = [margins(model, view.tried) for model in (view.process, *view.allowed)]
        columns += [tried[0], *([max(tried, key=lambda one: one.ms)] if view.allowed else [])]
    rows = []
    for label, name, unit, usual in (
        ("Ms", "ms", "", f"at most {ms_limit(view):.3g}"),
        ("gain margin", "gm", "", "at least 2"),
        ("phase margin", "pm_deg", " deg", "at least 45 deg"),
        ("delay margin", "delay_margin_s", " s", f"more than theta, {view.process.theta_s:.3g} s"),
    ):
        cells = []
        for found in columns:
            value: float = getattr(found, name)
            known = f"{value:.3g}{unit}" if math.isfinite(value) else "no limit"
            cells.append(known if found.stable else "unstable")
        rows.append((label, *cells, usual))
    return rows


def old_name(view: DecisionView) -> str:
    """What the gains in force are called."""
    return "before" if view.after else "active"


def new_name(view: DecisionView) -> str:
    """What the gains are called that were let through, or only proposed."""
    return "after" if view.after else "proposed"


def ms_text(ms: float | None) -> str:
    """Ms as people read it."""
    return "-" if ms is None else ms_words(ms)
