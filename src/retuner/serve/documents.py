"""What the page is told, as JSON values: overview, a loop, its trend, its decisions, the ledger."""

import csv
import io
import json
from collections.abc import Iterable
from dataclasses import fields

import numpy as np

from retuner.decision_page.decision_document import page
from retuner.decision_page.decision_view import view_of, what_came_of
from retuner.decision_page.decision_words import cause_text, change_text, ms_words, response_text, settings_text
from retuner.decision_page.row_values import number, part, words
from retuner.decision_page.shown_units import units_of
from retuner.errors import one_line
from retuner.live_view.live_file import FIELDS
from retuner.report.ledger_words import LedgerLine, no_formula
from retuner.report.what_if import MS_LIMIT, of_region
from retuner.schedule.gains import PidGains
from retuner.schedule.plain_values import plain_values
from retuner.serve.ledger_tail import Decided, Document, LedgerTail
from retuner.serve.runs import RecordedRuns, WatchedLoop, WatchedSession
from retuner.session.order_queue import SHORT
from retuner.session.outputs import REPORT, SUMMARY

MOST_POINTS = 4000  # samples of a trend in one answer
SILENT_S, SILENT_SAMPLES = 10.0, 10
"""A loop is silent when so long, and for so many sampling intervals, nothing has come."""
NEWEST = 200  # decisions in a loop's list
TRIED = 30_000  # newest samples in which the stays are looked for that settings are tried on
ROWS = 500  # ledger rows in one answer


def overview(runs: RecordedRuns) -> Document:
    """Every loop of every session with what needs a person."""
    sessions = [
        {
            "name": s.name,
            **plain_values(s.ledger, "ended stopped=interrupted rows=count head broken"),
            "loops": [_short(s, loop) for loop in s.loops.values()],
            "outcome": outcome(s),
        }
        for s in runs.sessions.values()
    ]
    return {"sessions": sessions, "refused": runs.refused}


def _short(session: WatchedSession, loop: WatchedLoop) -> Document:
    newest = loop.reader.since(loop.reader.counts()[0] - 1).table
    state, head = loop.reader.state(), loop.reader.head
    decided = next((one for one in reversed(session.ledger.decisions) if _is_of(one, loop)), None)
    age, sample_time_s = loop.age_s(), float(loop.reader.head.get("sample_time_s", 0.0))
    return {
        "key": loop.key,
        "session": session.name,
        "head": head,
        "state": state,
        "newest": newest[-1, :6].tolist() if len(newest) else None,
        "cause": cause_text(decided.document) if decided else "",
        "waiting": needs_a_person(session, loop),
        "ended": session.ledger.ended,
        "silent_s": age if age > max(SILENT_S, SILENT_SAMPLES * sample_time_s) else None,
    }


def outcome(session: WatchedSession) -> Document | None:
    """What a session that ended came to, and where its report is; None before its report is written.

    text : such as "ended: 8 changes, error -76 %", against the same run with fixed gains where there was one.
    """
    try:
        told = json.loads((session.folder / SUMMARY).read_text(encoding="utf-8"))
        loops = told.get("loops", [told])
        changes = sum(one["action"] == "commit" for loop in loops for one in loop["decisions"])
        scores = [score for loop in loops for score in loop["scores"] if score["iae_fixed"]]
        before, after = (sum(float(score[name]) for score in scores) for name in ("iae_fixed", "iae"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # damaged, or of another release
        return None
    if not session.ledger.ended or not (session.folder / REPORT).is_file():
        return None
    words_ = f"ended: {changes} {'change' if changes == 1 else 'changes'}"
    less = f", error {100.0 * (after / before - 1.0):+.0f} % against the same run with fixed gains" if before else ""
    return {"text": words_ + less, "report": f"/report/{session.name}"}


def _is_of(decided: Decided, loop: WatchedLoop) -> bool:
    return words(decided.document, "loop") == loop.name


def needs_a_person(session: WatchedSession, loop: WatchedLoop) -> list[Document]:
    """Proposals that wait, changes that wait for a word, locked regions."""
    shown = session.ledger.shown_of(loop.name)
    regions, by_hand = set(loop.reader.head.get("regions", ())), loop.reader.head.get("by_hand")
    found: list[Document] = [
        {
            "what": "by hand" if by_hand else "proposal",
            "region": one.region,
            "decision": one.number,
            "digest": one.digest,
            "text": f"{settings_text(one.before, loop.name)} -> {settings_text(one.after, loop.name)}"
            + f"; {by_hand}" * bool(by_hand),
        }
        for one in shown.open(float(loop.reader.head.get("approval_s", 0.0)))
        if not shown.successor(one) and one.region in regions
    ]
    found += [
        {"what": "tried", "region": region, "digest": digest, "text": "trial passed: awaiting your approval"}
        for region, digest in shown.waiting.items()
        if region in regions
    ]
    for region in loop.reader.state().get("regions", ()):
        if region.get("trial") == "locked":
            text = f"locked after {region.get('undos')} rollbacks"
            found.append({"what": "locked", "region": region["name"], "digest": "", "text": text})
    return found


def loop_document(session: WatchedSession, loop: WatchedLoop) -> Document:
    """A loop with its decisions and what needs a person."""
    mine = [one for one in session.ledger.decisions if _is_of(one, loop)]
    decisions = []
    for one in mine[-NEWEST:]:
        d = one.document
        ms = part(part(d, "verdict"), "ms")
        told = {
            "number": one.number,
            "t_s": number(d, "t_s"),
            "region": words(d, "region"),
            "action": words(d, "action"),
            "cause": cause_text(d),
            "reason": one_line(words(d, "reason")),
            "response": response_text(d),
            "change": change_text(d) if words(d, "action") != "none" else "",
            "peaks": part(d, "response").get("peaks", []),
            "judgement": words(part(d, "judgement"), "reason"),
            "ms": ms_words(number(ms, "nominal")) if part(d, "verdict").get("ms") else "",
            "hash": one.hash[:SHORT],
        }
        decisions.append(told)
    return {
        **_short(session, loop),
        **plain_values(session.ledger, "rows=count ledger_head=head broken"),
        "decisions": decisions,
        "trial": _trial(mine),
        "outcome": outcome(session),
    }


def _trial(decisions: list[Decided]) -> Document | None:
    """The newest change with its promise and the responses that were judged since; None before the first."""
    changed = [one for one in decisions if words(one.document, "action") == "commit"]
    if not changed:
        return None
    newest = changed[-1]
    later = what_came_of(newest.document, [one.document for one in decisions])
    # per upset what is promised, beside what it was before
    promise = part(newest.document, "promise")
    found = []
    for upset in ("setpoint", "load"):
        now, before = (part(promise, name) for name in (upset, f"{upset}_before"))
        for name in ("iae", "decay", "overshoot", "settle_s"):
            values, old = now.get(name), before.get(name)
            if isinstance(values, list) and len(values) == 3 and values[0] is not None:
                was = old[0] if isinstance(old, list) and old else None
                found.append({"upset": upset, "name": name, "values": values, "before": was})
    return {
        "decision": newest.number,
        "region": words(newest.document, "region"),
        "change": change_text(newest.document),
        "promise": found,
        "seen": [
            {
                "number": int(number(one, "number") or 0),
                "finding": words(part(one, "judgement"), "finding") or words(one, "action"),
                "reason": words(part(one, "judgement"), "reason") or words(one, "reason"),
            }
            for one in later
        ],
    }


def trend(loop: WatchedLoop, from_s: float, to_s: float, points: int) -> Document:
    """A span of a trend by column, thinned so that extremes stay."""
    table = loop.reader.span(from_s, to_s, max(4, min(points, MOST_POINTS)))
    columns = {name: np.round(table[:, i], 6).tolist() for i, name in enumerate(FIELDS)}
    return {"columns": columns, "whole": list(loop.reader.extent())}


def tried(session: WatchedSession, loop: WatchedLoop) -> Document:
    """What the page tries settings on: a panel for each region whose process is known, with how gains are shown."""
    reader = loop.reader
    table = reader.since(max(reader.counts()[0] - TRIED, 0)).table
    run = {name: table[:, i].copy() for i, name in enumerate(FIELDS)}
    mine = [one.document for one in session.ledger.decisions if _is_of(one, loop)]
    open_ = {
        one.region: one.after
        for one in session.ledger.shown_of(loop.name).open(float(reader.head.get("approval_s", 0.0)))
    }
    panels = []
    for i, region in enumerate(reader.state().get("regions", ())):
        name, active = str(region["name"]), PidGains(**region["gains"])
        own = [one for one in mine if words(one, "region") == name]
        told = of_region(run, i, own, (active, open_.get(name)), float(reader.head.get("ms_limit", MS_LIMIT)))
        panels += [{"region": name, "what": told}] if told is not None else []
    units = units_of(loop.name)
    return {"panels": panels, "controller": units.name, "span": units.pv_span}


def decision_html(session: WatchedSession, loop: WatchedLoop, decided: Decided) -> str:
    """The page of a decision, as in the report."""
    end = number(decided.document, "t_s") or 0.0
    start = number(part(decided.document, "response"), "t_start_s")
    begin = end - 600 * float(loop.reader.head.get("sample_time_s", 1.0)) if start is None else start
    table = loop.reader.span(begin - 0.5 * (end - begin), end, MOST_POINTS)
    columns = {name: table[:, i].copy() for i, name in enumerate(FIELDS)}
    columns["sequence"] = np.concatenate(([0.0], np.cumsum(np.any(np.diff(table[:, 6:9], axis=0) != 0, axis=1))))
    later = what_came_of(decided.document, [one.document for one in session.ledger.decisions if _is_of(one, loop)])
    unit = str(loop.reader.head.get("unit", ""))
    return page(view_of(decided.document, columns, unit, (decided.row, decided.hash), later))


def rows(ledger: LedgerTail, wanted: str, after: int) -> Document:
    """Rows in words, the newest last: those that hold the text that is wanted."""
    found = [one for one in ledger.told if one.row > after and fits(one, wanted)]
    return {"rows": [one.to_dict() for one in found[-ROWS:]], "more": max(len(found) - ROWS, 0)}


def fits(told: LedgerLine, wanted: str) -> bool:
    """Whether a row holds every word that is wanted."""
    text = " ".join(str(value) for value in told.to_dict().values()).lower()
    return all(word in text for word in wanted.lower().split())


def rows_csv(found: Iterable[LedgerLine]) -> str:
    """Rows as CSV; what a spreadsheet would take for a formula is made text."""
    out = io.StringIO()
    writer = csv.writer(out)
    names = [field.name for field in fields(LedgerLine)]
    writer.writerow(names)
    for one in found:
        document = one.to_dict()
        writer.writerow([no_formula(document[name]) for name in names])
    return out.getvalue()
