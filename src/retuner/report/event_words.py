"""What happens beside decisions, in a line that an engineer at the screen understands: the link, the bus, the trial's
end, requests of an operator. Rows that need nobody's attention give no line.
"""

from collections.abc import Callable, Mapping

from retuner.decision_page.decision_words import settings_text
from retuner.decision_page.row_values import Document, gains_of, number, part, words

LINK = {"up": "CAN link up", "silent": "CAN link silent", "down": "CAN link down"}


def event_line(kind: str, body: Mapping[str, object]) -> str:
    """A row of the ledger as a sentence; empty where there is nothing to see."""
    tell = EVENTS.get(kind)
    return tell(dict(body)) if tell else ""


def _because(what: str, body: Document) -> str:
    reason = words(body, "reason")
    return f"{what}: {reason}" if reason else what


def _after(what: str) -> Callable[[Document], str]:
    """An event with its reason; what : its words, with {values of the row} in them."""
    return lambda body: _because(what.format(**{name: words(body, name) for name in NAMED}), body)


NAMED = ("region", "name", "command")


def _count(body: Document, name: str) -> int:
    return int(number(body, name) or 0)


def _unrestored(body: Document) -> str:
    found, what = body.get("regions"), "gains not known to be active"
    names = ", ".join(map(str, found)) if isinstance(found, list | tuple) else ""
    return _because(f"{what}: {names}" if names else what, body)


def _restored(body: Document) -> str:
    found, waiting = body.get("regions"), part(body, "waits")
    active = [str(name) for name in found if name not in waiting] if isinstance(found, list | tuple) else []
    told = [f"gains read back and active: {', '.join(active)}"] if active else []
    for name in waiting:
        gains = gains_of(part(waiting, name))
        told += [f"{name}: {settings_text(gains)} in the table, for when the loop comes"] if gains else []
    return _because("; ".join(told) or "gains read back and active", body)


def _request(body: Document) -> str:
    what = " ".join(filter(None, (words(body, "order") or "unreadable file", words(body, "mode"))))
    by = f" by {who}" if (who := words(body, "by")) else ""
    return _because(f"operator request {'accepted' if body.get('accepted') is True else 'refused'}: {what}{by}", body)


EVENTS: dict[str, Callable[[Document], str]] = {
    "refused": _after("write refused, region {region}"),
    "link": lambda body: _because(LINK.get(words(body, "state"), "CAN link"), body),
    "restart": lambda body: f"controller restarted (start {_count(body, 'epoch')})",
    "lost": lambda body: _because(f"{(lost := _count(body, 'count'))} sample{'s' * (lost != 1)} lost", body),
    "command": _after("command {command} failed"),
    "worker": _after("decision process"),
    "unknown": _after("write not confirmed"),
    "foreign": lambda body: (
        "gains changed by someone else"
        + (f": {settings_text(gains)}" if (gains := gains_of(part(body, "gains"))) else "")
    ),
    "action": _after("ALARM"),
    "dropped": _after("change not written, region {region}"),
    "bus": lambda body: (
        f"bus fault: {words(body, 'fault')}" + (f" ({times} times)" if (times := _count(body, "times")) > 1 else "")
    ),
    "variable": _after("scheduling variable {name}"),
    "abort": _after("trial interrupted"),
    "restored": _restored,
    "trial": lambda body: f"trial: {reason}" if (reason := words(body, "reason")) else "",
    "lockout": lambda body: f"region {words(body, 'region')} locked after {_count(body, 'undos')} rollbacks",
    "unrestored": _unrestored,
    "order": _request,
    "bump": lambda body: words(body, "reason"),
    "nudge": lambda body: words(body, "reason"),  # in older ledgers
}
"""Rows beside decisions that a person at the screen should see, and their words; the ledger tells them in the same."""
