"""A ledger for people: who, when, why, from what to what, on what evidence, with what verdict. A line a row.

Works on the documents that rows hold, whatever release wrote them: what a row lacks is left empty.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

from retuner.errors import one_line
from retuner.explain import cause_text, model_text, ms_words, response_text, settings_text
from retuner.explained.reading import Document, gains_of, number, part, words
from retuner.ledger import Row

RETUNER, SCHEDULE, CONTROLLER, BUS, PROGRAM = "retuner", "schedule", "controller", "bus", "program"
BY = {
    "decision": RETUNER, "dropped": RETUNER, "session": PROGRAM, "end": PROGRAM, "bus": BUS, "link": BUS, "lost": BUS,
    "unknown": CONTROLLER, "restart": CONTROLLER, "reverted": CONTROLLER, "command": CONTROLLER,
    "foreign": "somebody else", "foreign_host": "another host", "lease": "another host", "conflict": "two controllers",
}  # fmt: skip
"""Who stands behind a row, where it does not say so itself."""
HIDDEN = {"samples", "gains", "before", "reason", "region", "why", "by", "decision", "proposal", "crc", "running",
          "record"}  # fmt: skip
"""Values of other rows that have a column of their own, or say nothing to a person."""


@dataclass(frozen=True, slots=True)
class Told:
    """One row as a person reads it.

    row : its number. when_s : time of the run's clock, s. old, new : settings in words.
    """

    row: int
    when_s: float
    kind: str
    who: str
    region: str
    why: str
    old: str
    new: str
    evidence: str
    verdict: str

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self)


def told(row: Row) -> Told:
    """A row in words."""
    body: Document = row.body
    texts = (row.kind, _who(row.kind, body), words(body, "region"), *WORDS.get(row.kind, _other)(body))
    return Told(row.seq, row.clock_s, *map(one_line, texts))


def _who(kind: str, body: Document) -> str:
    """Who is behind it."""
    if kind == "order":
        return words(body, "by") or "an order file"
    if kind in {"intent", "committed", "refused"}:
        return SCHEDULE if words(body, "why") == "schedule" else RETUNER
    return BY.get(kind, PROGRAM)


Words = tuple[str, str, str, str, str]


def _decision(body: Document) -> Words:
    """A decision: its whole reasoning in short."""
    verdict = part(body, "verdict")
    changes = words(body, "action") != "none"
    ms = part(verdict, "ms")
    proof = words(verdict, "reason")
    if "nominal" in ms:
        before, nominal, worst = (ms_words(number(ms, name)) for name in ("before", "nominal", "worst"))
        proof = f"{proof}: Ms {before} -> {nominal}, at worst {worst}"
    judgement = words(part(body, "judgement"), "reason")
    evidence = " | ".join(text for text in (response_text(body), cause_text(body), model_text(body)) if text)
    title = f"{words(body, 'action')} {int(number(body, 'number') or 0)}: {words(body, 'reason')}"
    return (title, _settings(body, "gains_before"), _settings(body, "gains_after") if changes else "", evidence,
            " | ".join(text for text in (proof, judgement) if text))  # fmt: skip


def _write(body: Document) -> Words:
    """A write that is meant, done, or has not come about."""
    digest = words(body, "decision")
    evidence = f"decision {digest[:8]}" if digest else ""
    verdict = words(body, "reason")
    return words(body, "why"), _settings(body, "before"), _settings(body, "gains"), evidence, verdict


def _order(body: Document) -> Words:
    """What a person wanted, and whether it was taken."""
    kind, digest, note = words(body, "order"), words(body, "digest"), words(body, "note")
    decision = int(number(body, "decision") or 0)
    about = digest[:8] if digest else f"decision {decision}" if decision else words(body, "file")
    proposal = part(body, "proposal")
    new = _settings(proposal, "after") or _settings(body, "gains")
    verdict = "taken" if body.get("accepted") is True else f"refused: {words(body, 'reason')}"
    why = f"{kind} {about}{f': {note}' if note else ''}".strip()
    return why, _settings(proposal, "before"), new, f"ordered {words(body, 'at')}".strip(), verdict


def _session(body: Document) -> Words:
    """What the run is made with."""
    made_with = ", ".join(f"{name} {version}" for name, version in part(body, "versions").items())
    return f"begins: {words(part(part(body, 'config'), 'loop'), 'name')}", "", "", made_with, ""


def _other(body: Document) -> Words:
    """Any other row: its reason, and what else it says."""
    more = ", ".join(f"{key} {value}" for key, value in body.items() if key not in HIDDEN and value is not None)
    return words(body, "reason"), "", _settings(body, "gains"), more, ""


WORDS: dict[str, Callable[[Document], Words]] = {
    "decision": _decision, "intent": _write, "committed": _write, "refused": _write, "order": _order,
    "session": _session,
}  # fmt: skip


def _settings(body: Document, name: str) -> str:
    """Gains in words, empty where there are none."""
    gains = gains_of(part(body, name))
    return settings_text(gains) if gains else ""
