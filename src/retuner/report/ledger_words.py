"""A ledger for people: who, when, why, from what to what, on what evidence, with what verdict. A line a row.

Works on the documents that rows hold, whatever release wrote them: what a row lacks is left empty.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

from retuner.decision_page.explain import cause_text, model_text, ms_words, response_text, settings_text, stays
from retuner.decision_page.row_values import Document, gains_of, number, numbers, part, parts, words
from retuner.errors import one_line
from retuner.ledger import Row

RETUNER, SCHEDULE, CONTROLLER, BUS, PROGRAM = "retuner", "schedule", "controller", "bus", "program"
BY = {
    "decision": RETUNER, "dropped": RETUNER, "trial": RETUNER, "judged": RETUNER, "restore": RETUNER,
    "lockout": RETUNER, "nudge": RETUNER, "schedule": RETUNER,
    "session": PROGRAM, "end": PROGRAM, "abort": PROGRAM, "unrestored": PROGRAM, "bus": BUS,
    "link": BUS, "lost": BUS, "variable": BUS, "absent": BUS, "restored": CONTROLLER, "unknown": CONTROLLER,
    "restart": CONTROLLER,
    "reverted": CONTROLLER, "command": CONTROLLER, "foreign": "someone else", "foreign_host": "another host",
    "action": "someone else", "lease": "another host", "conflict": "two controllers",
}  # fmt: skip
"""Who stands behind a row, where it does not say so itself."""
BY_ORDER = {"approved", "ordered_back"}
"""Codes of decisions that a person stands behind; the order before them says who."""
HIDDEN = {
    "samples",
    "gains",
    "before",
    "reason",
    "region",
    "loop",
    "why",
    "by",
    "decision",
    "proposal",
    "crc",
    "running",
    "record",
}
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
    loop: str
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
    where = words(body, "loop"), words(body, "region")
    texts = (row.kind, _who(row.kind, body), *where, *WORDS.get(row.kind, _other)(body))
    return Told(row.seq, row.clock_s, *map(one_line, texts))


def _who(kind: str, body: Document) -> str:
    """Who is behind it."""
    if kind == "order":
        return words(body, "by") or "a request file"
    if kind in {"intent", "committed", "refused"}:
        return SCHEDULE if words(body, "why") == "schedule" else RETUNER
    if kind == "decision" and words(body, "code") in BY_ORDER:
        return "an operator"
    return BY.get(kind, PROGRAM)


Words = tuple[str, str, str, str, str]
ACTIONS = {"commit": "to be written", "advise": "proposed", "restore": "rolled back", "none": "no change"}
"""What a decision does."""


def _decision(body: Document) -> Words:
    """A decision: its whole reasoning in short."""
    verdict = part(body, "verdict")
    changes = words(body, "action") != "none"
    ms = part(verdict, "ms")
    proof = words(verdict, "reason")
    if "nominal" in ms:
        before, nominal, worst = (ms_words(number(ms, name)) for name in ("before", "nominal", "worst"))
        proof = f"{proof}: Ms {before} -> {nominal}, worst case {worst}"
    judgement = words(part(body, "judgement"), "reason")
    evidence = " | ".join(text for text in (response_text(body), cause_text(body), model_text(body)) if text)
    done = "kept" if stays(body) else ACTIONS.get(words(body, "action"), words(body, "action"))
    title = f"decision {int(number(body, 'number') or 0)}, {done}: {words(body, 'reason')}"
    return (
        title,
        _settings(body, "gains_before"),
        _settings(body, "gains_after") if changes else "",
        evidence,
        " | ".join(text for text in (proof, judgement) if text),
    )


def _write(body: Document) -> Words:
    """A write that is meant, done, or has not come about."""
    return words(body, "why"), _settings(body, "before"), _settings(body, "gains"), _digest(body), words(body, "reason")


def _order(body: Document) -> Words:
    """What a person wanted, and whether it was taken."""
    kind, digest, note = words(body, "order"), words(body, "digest"), words(body, "note")
    decision = int(number(body, "decision") or 0)
    about = words(body, "mode") or (
        digest[:8] if digest else f"decision {decision}" if decision else words(body, "file")
    )
    proposal = part(body, "proposal")
    new = _settings(proposal, "after") or _settings(body, "gains")
    verdict = "accepted" if body.get("accepted") is True else f"refused: {words(body, 'reason')}"
    why = f"{kind} {about}{f': {note}' if note else ''}".strip()
    return why, _settings(proposal, "before"), new, f"requested {words(body, 'at')}".strip(), verdict


def _trial(body: Document) -> Words:
    """A change that is on trial now, and what it promises."""
    promised = part(body, "promise")
    pairs = [
        (upset, *(numbers(part(promised, name), "iae") for name in (upset, f"{upset}_before")))
        for upset in ("setpoint", "load")
    ]
    told = [f"{upset} {now[0]:.3g} (before {then[0]:.3g})" for upset, now, then in pairs if now and then]
    verdict = f"predicted IAE per unit step: {', '.join(told)}" if told else ""
    return (
        words(body, "reason") or "on trial",
        _settings(body, "verified"),
        _settings(body, "gains"),
        _digest(body),
        verdict,
    )


def _judged(body: Document) -> Words:
    """A response that was judged against the promise."""
    return f"response judged, region then: {words(body, 'trial')}", "", "", "", words(body, "reason")


def _restore(body: Document) -> Words:
    """Verified gains that are to come back."""
    return words(body, "reason"), "", _settings(body, "gains"), _digest(body), words(body, "cause")


def _digest(body: Document) -> str:
    """Which decision a row belongs to."""
    digest = words(body, "decision")
    return f"decision {digest[:8]}" if digest else ""


def _session(body: Document) -> Words:
    """What the run is made with."""
    made_with = ", ".join(f"{name} {version}" for name, version in part(body, "versions").items())
    config = part(body, "config")
    loops = [words(part(one, "loop"), "name") for one in (parts(config, "loops") or [config])]
    return f"begins: {', '.join(loops)}", "", "", made_with, "; ".join(map(_taken_up, parts(body, "schedules")))


def _taken_up(schedule: Document) -> str:
    """A schedule that a session proposed, and this one runs."""
    standing = "as proposed" if schedule.get("as_proposed") is True else "edited since"
    return f"{words(schedule, 'loop')}: schedule of proposal {words(schedule, 'hash')[:8]}, {standing}"


def _schedule(body: Document) -> Words:
    """Another schedule that the records ask for."""
    return words(body, "reason"), "", "", f"proposal {words(body, 'hash')[:8]}", "proposed"


def _other(body: Document) -> Words:
    """Any other row: its reason, and what else it says."""
    plain = {key: value for key, value in body.items() if isinstance(value, str | int | float)}
    plain |= {key: ", ".join(map(str, value)) for key, value in body.items() if isinstance(value, list)}
    more = ", ".join(f"{key} {value}" for key, value in plain.items() if key not in HIDDEN)
    return words(body, "reason"), "", _settings(body, "gains"), more, ""


WORDS: dict[str, Callable[[Document], Words]] = {
    "decision": _decision,
    "intent": _write,
    "committed": _write,
    "refused": _write,
    "order": _order,
    "session": _session,
    "trial": _trial,
    "judged": _judged,
    "restore": _restore,
    "schedule": _schedule,
}


def _settings(body: Document, name: str) -> str:
    """Gains in words, empty where there are none."""
    gains = gains_of(part(body, name))
    return settings_text(gains) if gains else ""
