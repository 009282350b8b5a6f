"""A ledger for people: who, when, why, from what to what, on what evidence, with what verdict. A line a row.

Read from the top it is one argument: what was seen, what explains it, what was done, what came of it. A row that
follows from a decision names it by its number, and the end of a trial says of which change it was.

Works on the documents that rows hold, whatever release wrote them: what a row lacks is left empty.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from retuner.adaptive.trial.judge import TrialFinding
from retuner.adaptive.trial.phase import UNDECIDED, TrialPhase
from retuner.decision_page.decision_words import (
    EDITED,
    explanation_text,
    knowledge_text,
    proof_text,
    response_text,
    settings_text,
    stays,
)
from retuner.decision_page.row_values import (
    Document,
    brief,
    gains_of,
    number,
    numbers,
    numbers_or_none,
    part,
    parts,
    words,
)
from retuner.errors import one_line
from retuner.ledger import Row
from retuner.ledger.chain import digest_of, without_place
from retuner.report.event_words import EVENTS, event_line
from retuner.schedule.late_dataclass import asdict, dataclass

RETUNER, SCHEDULE, CONTROLLER, BUS, PROGRAM = "retuner", "schedule", "controller", "bus", "program"
BY = {
    "decision": RETUNER, "dropped": RETUNER, "trial": RETUNER, "judged": RETUNER, "restore": RETUNER,
    "lockout": RETUNER, "bump": RETUNER, "nudge": RETUNER, "schedule": RETUNER,
    "session": PROGRAM, "end": PROGRAM, "abort": PROGRAM, "unrestored": PROGRAM, "bus": BUS,
    "link": BUS, "lost": BUS, "variable": BUS, "absent": BUS, "restored": CONTROLLER, "unknown": CONTROLLER,
    "restart": CONTROLLER,
    "reverted": CONTROLLER, "command": CONTROLLER, "foreign": "someone else", "foreign_host": "another host",
    "action": "someone else", "lease": "another host", "conflict": "two controllers",
}  # fmt: skip
"""Who stands behind a row, where it does not say so itself."""
BY_ORDER = {"approved", "order_proposed", "ordered_back"}
"""Codes of decisions that a person stands behind; the order before them says who."""
HIDDEN = {
    "samples", "gains", "before", "reason", "region", "loop", "why", "by", "decision", "proposal", "crc", "running",
    "record", "of", "on_trial", "in_place_of", "said", "pv_unit", "kind",
}  # fmt: skip
"""Values of other rows that have a column of their own, or say nothing to a person."""


@dataclass(frozen=True, slots=True)
class LedgerLine:
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


class Teller:
    """Tells the rows of one ledger in their order, all from the first: a row names the decision behind it."""

    def __init__(self) -> None:
        self._decided: dict[tuple[str, str], tuple[str, int]] = {}
        self._tried: dict[tuple[str, str], str] = {}
        self._open: dict[tuple[str, str], str] = {}
        self._said: dict[tuple[str, str], tuple[str, str]] = {}
        self._units: dict[str, str] = {}
        self._several = False

    def told(self, row: Row) -> LedgerLine:
        """The next row in words."""
        body: Document = row.body
        where, kind = (words(body, "loop") if self._several else "", words(body, "region")), row.kind
        if kind == "session":
            config = part(body, "config")
            loops = [part(one, "loop") for one in (parts(config, "loops") or [config])]
            self._several = len(loops) > 1
            self._units = {words(one, "name"): words(one, "pv_unit") or "pv" for one in loops}
        elif kind == "decision":
            self._said[where] = f"decision {int(number(body, 'number') or 0)}", words(body, "reason")
        if kind == "decision" and words(body, "action") != "none":
            self._decided[where] = (digest_of(without_place(row.body)), int(number(body, "number") or 0))
        elif kind == "trial":
            self._tried[where] = self._decision(words(body, "decision"), where)
        about = {
            "of": self._decision(words(body, "decision"), where),
            "on_trial": self._tried.get(where, ""),
            "in_place_of": self._open.get(where, ""),
            "said": list(self._said.get(where, ())),
            "pv_unit": self._units.get(words(body, "loop") or next(iter(self._units), ""), "pv"),
        }
        plain = WORDS.get(kind, _event if kind in EVENTS else _other)({**body, **about, "kind": kind})
        # the judge knows no units: with that of pv
        unit = words(about, "pv_unit")
        texts = [
            text.replace(" pv s per unit", f" {unit} s per unit").replace(" in units of pv", f" {unit}")
            for text in plain
        ]
        # take note of the proposal that waits in a region, until other gains are active there
        if kind == "decision" and words(body, "action") == "advise":
            self._open[where] = f"decision {int(number(body, 'number') or 0)}"
        elif kind == "committed" or (kind == "decision" and words(body, "code") == EDITED):
            self._open.pop(where, None)
        if kind == "order":
            who = words(body, "by") or "a request file"
        elif kind in {"intent", "committed", "refused"}:
            who = SCHEDULE if words(body, "why") == "schedule" else RETUNER
        elif kind == "decision" and words(body, "code") in BY_ORDER:
            who = "an operator"
        else:
            who = BY.get(kind, PROGRAM)
        head = kind, who, words(body, "loop"), words(body, "region")
        return LedgerLine(row.seq, row.clock_s, *map(one_line, (*head, *texts)))

    def _decision(self, digest: str, where: tuple[str, str]) -> str:
        """The decision of that hash by its number, where it is the region's newest one."""
        newest, count = self._decided.get(where, ("", 0))
        return f"decision {count if digest == newest else digest[:8]}" if digest else ""


def told(rows: Iterable[Row]) -> list[LedgerLine]:
    """The rows of a ledger in words, all from the first."""
    return list(map(Teller().told, rows))


class Words(NamedTuple):
    """A row in words: the last five columns of its line."""

    why: str
    old: str = ""
    new: str = ""
    evidence: str = ""
    verdict: str = ""


ACTIONS = {"commit": "to be written", "advise": "proposed", "restore": "rolled back", "none": "no change"}
"""What a decision does."""


def _decision(body: Document) -> Words:
    """A decision as an argument: what follows; from what to what; what was seen and what explains it; the proof."""
    action = words(body, "action")
    concerns = words(body, "on_trial") if words(body, "code").startswith(ABOUT_A_TRIAL) else ""
    done = "kept" if stays(body) else ACTIONS.get(action, action)
    older = words(body, "in_place_of") if action == "advise" else ""
    reason = words(body, "reason")
    own = stays(body) or f"{done}: " in reason or reason.startswith((done, *OWN_WORDS))
    said = reason if own else f"{done}: {reason}"
    said += f"; in place of {older}" if older else ""
    return Words(
        f"decision {int(number(body, 'number') or 0)}{f' on {concerns}' if concerns else ''}, {said}",
        "" if stays(body) else _settings(body, "gains_before"),
        _settings(body, "gains_after") if action != "none" else "",
        " | ".join(text for text in (response_text(body), explanation_text(body), knowledge_text(body)) if text),
        proof_text(body, action, reason),
    )


ABOUT_A_TRIAL = ("undo_", "kept_")  # beginnings of the codes of decisions on what becomes of a change on trial
OWN_WORDS = ("refused", "rollback refused", "an operator replaced")
"""Beginnings of reasons that say by themselves what is done."""


def _write(body: Document) -> Words:
    why, of = words(body, "why"), words(body, "of")
    done = "active, as read back" if "crc" in body else ""
    what = f"the gains of {of}" if of else WRITTEN.get(why, why)
    return Words(what, _settings(body, "before"), _settings(body, "gains"), done, words(body, "reason"))


WRITTEN = {
    "retune": "the gains of the decision",
    "schedule": "the gains of this region, by the schedule",
    "restore": "the gains that should run",
}
"""What a write is for."""


def _order(body: Document) -> Words:
    kind, digest, note = words(body, "order"), words(body, "digest"), words(body, "note")
    decision = int(number(body, "decision") or 0)
    about = words(body, "mode") or (
        digest[:8] if digest else f"decision {decision}" if decision else words(body, "file")
    )
    proposal = part(body, "proposal")
    new = _settings(proposal, "after") or _settings(body, "gains")
    verdict = "accepted" if body.get("accepted") is True else f"refused: {words(body, 'reason')}"
    why = f"{kind} {about}{f': {note}' if note else ''}".strip()
    return Words(why, _settings(proposal, "before"), new, f"requested {words(body, 'at')}".strip(), verdict)


def _trial(body: Document) -> Words:
    promised = part(body, "promise")
    told = []
    for upset, per in (("setpoint", "s"), ("load", f"{words(body, 'pv_unit') or 'pv'} s")):
        now, then = (numbers_or_none(part(promised, name), "iae")[:1] for name in (upset, f"{upset}_before"))
        was = "never at rest before" if then == [None] else f"before {brief(then[0] or 0.0)}" if then else ""
        told += [f"{upset} {brief(now[0])} {per} ({was})"] if now and now[0] is not None and was else []
    verdict = f"predicted IAE per unit step: {', '.join(told)}" if told else ""
    why = words(body, "reason") or f"{words(body, 'of') or 'a change'} is on trial"
    return Words(why, _settings(body, "verified"), _settings(body, "gains"), verdict=verdict)


def _judged(body: Document) -> Words:
    reason, said = words(body, "reason"), body.get("said")
    if isinstance(said, list) and len(said) == 2 and reason and reason in said[1]:
        reason = f"why: {said[0]}"
    finding, phase = words(body, "finding"), words(body, "trial")
    if phase == TrialPhase.WAITING:
        outcome = "is over: it awaits operator approval"
    elif finding == TrialFinding.WORSE.name.lower():
        outcome = "has failed"
    elif phase in UNDECIDED and phase != TrialPhase.WRITING:
        outcome = "goes on"
    else:
        outcome = "has passed" if finding in PASSING else "is over without a verdict"
    return Words(f"the trial of {words(body, 'on_trial') or 'a change'} {outcome}", verdict=reason)


PASSING = {finding.name.lower() for finding in (TrialFinding.BETTER, TrialFinding.AS_PROMISED)}
"""Findings that speak for a change."""


def _session(body: Document) -> Words:
    made_with = ", ".join(f"{name} {version}" for name, version in part(body, "versions").items())
    config = part(body, "config")
    loops = [words(part(one, "loop"), "name") for one in (parts(config, "loops") or [config])]
    taken_up = []  # schedules that a session proposed, and this one runs
    for schedule in parts(body, "schedules"):
        standing = "as proposed" if schedule.get("as_proposed") is True else "edited since"
        taken_up.append(f"{words(schedule, 'loop')}: schedule of proposal {words(schedule, 'hash')[:8]}, {standing}")
    return Words(f"begins: {', '.join(loops)}", evidence=made_with, verdict="; ".join(taken_up))


def _event(body: Document) -> Words:
    """What happened beside decisions, in the words of the screen."""
    told = event_line(words(body, "kind"), body)
    regions, waits = body.get("regions"), part(body, "waits")  # regions whose set runs when the loop comes
    runs = not waits or (isinstance(regions, list) and any(name not in waits for name in regions))
    new = "" if words(body, "kind") == "foreign" or not runs else _settings(body, "gains")
    return Words(told or words(body, "reason"), new=new)


def _end(body: Document) -> Words:
    how = "the run was stopped" if body.get("interrupted") is True else "the run is complete"
    log = words(body, "bus_log")
    return Words(how, evidence=f"bus log {log}, SHA-256 {words(body, 'bus_log_sha256')}" if log else "")


def _order_of_writes(body: Document) -> Words:
    count, ms = len(numbers(body, "messages")), number(body, "ms_between")
    why = f"one set of gains in {count} message{'s' * (count != 1)}"
    between = "" if ms is None else f"Ms of the sets between them at most {ms:.2f}"
    proved = "proved stable on every plausible model" if body.get("proved") is True else "not proved"
    return Words(why, evidence=between, verdict=proved if count > 1 else "")


def _other(body: Document) -> Words:
    plain = {key: value for key, value in body.items() if isinstance(value, str | int | float)}
    plain |= {key: ", ".join(map(str, value)) for key, value in body.items() if isinstance(value, list)}
    more = ", ".join(f"{key} {value}" for key, value in plain.items() if key not in HIDDEN)
    return Words(words(body, "reason"), new=_settings(body, "gains"), evidence=more)


def _asked(body: Document) -> str:
    return f"{int(number(body, 'asked') or 0):,}"


WORDS: dict[str, Callable[[Document], Words]] = {
    "decision": _decision,
    "intent": _write,
    "committed": _write,
    "refused": _write,
    "order": _order,
    "session": _session,
    "trial": _trial,
    "judged": _judged,
    "restore": lambda body: Words(
        f"the gains that {of} asks for are to run" if (of := words(body, "of")) else words(body, "reason"),
        new=_settings(body, "gains"),
    ),
    "over": lambda _: Words("the samples of this loop are at their end"),
    "schedule": lambda body: Words(
        words(body, "reason"), evidence=f"proposal {words(body, 'hash')[:8]}", verdict="proposed"
    ),
    "end": _end,
    "order_of_writes": _order_of_writes,
    "question": lambda body: Words(f"the response up to sample {_asked(body)} is being evaluated"),
    "answer": lambda body: Words(f"the evaluation of sample {_asked(body)} is there", verdict=words(body, "reason")),
    "memory": lambda body: Words("saved for a restart", evidence=f"SHA-256 {words(body, 'sha256')}"),
}


def _settings(body: Document, name: str) -> str:
    gains = gains_of(part(body, name))
    return settings_text(gains) if gains else ""


FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what a spreadsheet takes for the beginning of a formula


def no_formula(value: object) -> object:
    """A cell of a CSV: a text that a spreadsheet would take for a formula gets an apostrophe in front."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
