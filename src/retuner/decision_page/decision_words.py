"""A decision in one readable line, and its parts: what was seen, the cause, the process, what changes, the proof.

Terminal, ledger, tables and pages say these in the same words. Each function takes a Decision, or the document of one
as the ledger keeps it.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.decision_page.row_values import Document, brief, decided_on, gains_of, number, numbers, part, parts, words
from retuner.decision_page.shown_units import units_of
from retuner.schedule.gains import PidGains

if TYPE_CHECKING:
    from retuner.adaptive.supervision.decision import Decision  # loads all that decides

WHOLE_STEP = 0.999  # A step of at least this share is the whole one to a reader
SWINGING_PEAK_RATIO = 3.0
"""Ratio of the second peak to the first, or to the step, from which nobody speaks of overshoot."""
VERBS = {"commit": "written", "advise": "proposed", "restore": "rolled back"}
LATER = "in the table, to be written when the loop enters the region"  # What is done with other gains, by action
INTEGRATING = {ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG, ProcessType.DOUBLE_INTEGRATING}


def document_of(decision: "Decision | Document") -> Document:
    """A decision as plain values."""
    return decision if isinstance(decision, Mapping) else decision.to_dict()


def stays(decision: "Decision | Document") -> bool:
    """Whether the gains on trial stay, and are only read back: no rollback, though the action is that of one."""
    document = document_of(decision)
    before, after = (part(document, name) for name in ("gains_before", "gains_after"))
    return words(document, "action") == "restore" and bool(after) and after == before


def rolls_back(decision: "Decision | Document") -> bool:
    """Whether other gains replace those on trial."""
    document = document_of(decision)
    return words(document, "action") == "restore" and not stays(document)


def settings_text(gains: PidGains, loop: str = "") -> str:
    """Gains as people write them, in the units of the loop's controller. loop : its name, if it is known."""
    return units_of(loop).text(gains)


def short_settings(gains: PidGains, loop: str = "") -> str:
    """Gains for a narrow table: the numbers of settings_text without their names."""
    return units_of(loop).short(gains)


def response_text(decision: "Decision | Document") -> str:
    """What was recognised."""
    r = part(document_of(decision), "response")
    if not r:
        return ""
    text = f"{words(r, 'upset') or 'load'} response"
    overshoot, damping, period = (number(r, name) for name in ("overshoot", "damping", "period_s"))
    if overshoot is not None:
        far = f", second peak {brief(overshoot)} times the first"  # the first was hardly one
        text += far if overshoot >= SWINGING_PEAK_RATIO else f", overshoot {overshoot:.0%}"
    if damping is not None:
        text += f", half-cycle decay ratio {damping:.2f}"
    if period is not None:
        text += f", period {brief(period)} s"
    return text


def process_text(m: ProcessModel) -> str:
    """The parameters that a process has."""
    gain = "k'" if m.type in INTEGRATING else "k"
    lags = "".join(f" {name} {brief(time)} s" for name, time in m.times_s.items())
    zeta = f" zeta {m.zeta:.2f}" if m.zeta < 1 else ""
    return f"{gain} {brief(m.k)}{lags}{zeta} theta {brief(m.theta_s)} s"


def model_text(decision: "Decision | Document") -> str:
    """What the process is, and how many records say so."""
    document = document_of(decision)
    m = decided_on(document)
    if m is None:
        return ""
    if not part(document, "response"):  # an order: nothing was identified at this moment
        return process_text(m)
    count = int(number(document, "records") or 0)
    none = "from neighbouring regions" if part(document, "known") else "not identified"
    records = f"{count} record{'s' if count != 1 else ''}" if count else none
    return f"{process_text(m)} ({records})"


def cause_text(decision: "Decision | Document") -> str:
    """The cause, or what it was about where no response was looked at, or that there was none to name."""
    document = document_of(decision)
    return words(part(document, "diagnosis"), "cause").replace("_", " ") or about_nothing_seen(document) or "undecided"


def about_nothing_seen(decision: "Decision | Document") -> str:
    """What a decision is about that no response led to; empty where one did."""
    document = document_of(decision)
    code = words(document, "code")
    return "" if part(document, "response") else next((told for of, told in WITHOUT.items() if code.startswith(of)), "")


EDITED = "edited"  # code of a decision on gains that a person has set: the change is his
WITHOUT = {
    "edit": "edit", "kept_": "trial", "undo_": "trial", "approv": "order", "order": "order", "revert": "order",
    "action": "action",
}  # fmt: skip
"""What decisions without a response are about, by the beginnings of their codes."""


def change_text(decision: "Decision | Document") -> str:
    """What changes, from what to what, with Ms."""
    document = document_of(decision)
    verb, loop = VERBS.get(words(document, "action")), words(document, "loop")
    before, after = (gains_of(part(document, name)) for name in ("gains_before", "gains_after"))
    if verb is None or before is None or after is None:
        return "no change"
    if stays(document):
        return f"kept: {settings_text(after, loop)}"
    verb = LATER if document.get("later") else verb
    moved, verdict = f"{verb}: {settings_text(before, loop)} -> {settings_text(after, loop)}", part(document, "verdict")
    ms = part(verdict, "ms")
    if "nominal" not in ms or verdict.get("allowed") == []:  # no model: nothing is known of Ms
        return moved
    was, now = (ms_words(number(ms, name)) for name in ("before", "nominal"))
    worst, step = number(ms, "worst"), number(verdict, "step")
    at_worst = "worst case unstable" if worst is None else f"worst case {worst:.2f}"
    share = "" if step is None or step > WHOLE_STEP else f", {step:.0%} of the full change"
    return f"{moved}, Ms {was} -> {now} ({at_worst}{share})"


def part_words(verdict: Document) -> str:
    """How much of the way to what the rule gives is gone, and why no more; empty where it is all of it."""
    step = number(verdict, "step")
    if step is None or step > WHOLE_STEP:
        return ""
    told = f"{step:.0%} of the full change"
    for check in parts(verdict, "checks"):
        value, limit = number(check, "value"), number(check, "limit")
        if words(check, "name").startswith("step_") and value and limit and value > (1.0 - AT_LIMIT) * limit:
            return f"{told}: one change is limited to a factor of {limit:g}"
    return f"{told}: more is not proved robust" if any(abs(step - share) < AT_LIMIT for share in HALVED) else told


AT_LIMIT = 0.02  # A factor that reaches its limit but for so much is held by it: controllers round
HALVED = (0.5, 0.25)  # steps that the guard tries where the whole is not robust


def ms_words(ms: float | None) -> str:
    """Ms as people read it; null in a document is an unstable loop."""
    return "unstable" if ms is None or math.isinf(ms) else f"{ms:.2f}"


def one_line(decision: "Decision | Document") -> str:
    """The decision in one line."""
    document = document_of(decision)
    reason = words(document, "reason")
    told = [
        response_text(document),
        reason if about_nothing_seen(document) else f"{cause_text(document)}: {reason}",
        model_text(document),
        "" if words(document, "code") == EDITED else change_text(document),
    ]
    return " | ".join(one for one in told if one)


def proof_text(body: Document, action: str, reason: str) -> str:
    """The guard's word on what is written, proposed or refused; what the rule gives where that must wait."""
    verdict = part(body, "verdict")
    said = words(verdict, "reason")
    if not said or said in reason:
        said = ""
    elif verdict.get("accepted") is True and verdict.get("allowed") != []:
        before, share = ms_words(number(part(verdict, "ms"), "before")), part_words(verdict)
        was = "" if f"Ms {before} ->" in said else f"; Ms before {before}"
        part_of = share.partition("full change")[0]
        said = f"{said}{was}" + (f"; {share}" if share and part_of not in said else "")
    if action == "restore" or (not said and action != "none"):
        return ""
    if action != "none":
        return said
    refused = said if verdict and verdict.get("accepted") is not True else ""  # else proved, and held back for now
    given = gains_of(part(part(body, "proposal"), "parallel"))
    return "; ".join(filter(None, (refused, f"the rule gives {settings_text(given)}" if given else "")))


STOOD = {
    "agrees": "this record agrees",
    "odd": "this record contradicts it, and is kept as an alternative",
    "changed": "this record and the one that contradicted before replace the model",
    "opened": "this record contradicts what was known, near instability",
    "silent": "this record says nothing of it",
}
"""How a record stood to what was known."""


def explanation_text(body: Document) -> str:
    """The cause, with its reason where that is not the decision's own."""
    cause, why = cause_text(body), words(part(body, "diagnosis"), "reason")
    if not part(body, "response"):
        return ""
    return cause if not why or why in words(body, "reason") else f"{cause}: {why}"


def knowledge_text(body: Document) -> str:
    """What the process is by now, how this record stood to that, and by how many loads it was explained."""
    model = model_text(body)
    if not model:
        return ""
    # How the record stood to what was known; of the first one here that is the prediction from the other regions
    surprise, estimate = words(body, "surprise"), part(body, "estimate")
    if surprise == "agrees" and words(body, "code").startswith("undo_"):
        stood = ""
    elif surprise == "agrees" and number(body, "records") == 1:
        stood = "as predicted from the other regions"
    elif surprise == "odd" and estimate.get("identifiable") is False:
        stood = "this record contradicts it, but does not settle a model by itself"
    else:
        stood = STOOD.get(surprise, "")
    loads, rival = len(numbers(estimate, "loads")), part(estimate, "rival")
    steps = f"{loads} load step{'s' * (loads != 1)}"
    by_loads = words(part(body, "response"), "upset") != "setpoint"
    beside = (f"explained by {steps}" if by_loads else f"with {steps} beside the setpoint's") if loads else ""
    other = "another model explains the record as well" if rival else ""
    return ", ".join(text for text in (model, beside, stood, other) if text)


def short_reason(decision: "Decision") -> str:
    """Why: of a rollback the first clause, the report has the others."""
    return decision.reason.split("; ")[0] if rolls_back(decision) else decision.reason
