"""retuner approve and ledger revert: what a person orders, put into the session's folder; and what can be ordered."""

import datetime as dt
import getpass
import os
from collections.abc import Sequence
from pathlib import Path

from retuner.adaptive.orders.pending_proposal import ProposalStanding
from retuner.adaptive.supervision.decision import gains_dict
from retuner.commands.options import tell
from retuner.commands.signatures import ApproveOptions, RevertOptions
from retuner.config.loading import load_session
from retuner.config.model import Config
from retuner.decision_page.decision_words import settings_text
from retuner.decision_page.shown_units import show_units_of
from retuner.errors import LedgerError, UserError, one_line, user_input
from retuner.files import write_whole
from retuner.gain_export.schedule_into_config import schedule_into
from retuner.ledger.lock import WriterLock
from retuner.products import product
from retuner.schedule.document import from_toml
from retuner.schedule.plain_values import plain_values
from retuner.session.order_queue import SHORT, OrderState, shown, superseded
from retuner.session.orders import Order, OrderKind, put_order
from retuner.session.outputs import CONFIG, GAINS, LEDGER, believed_rows, ledger_path, loop_folder, rows_by_loop


def _name(options: ApproveOptions | RevertOptions) -> str:
    """Who orders, for the ledger. Raises UserError: the system knows no name, and none is given."""
    if options.by is not None:
        return options.by
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        raise UserError("--by: no user name is known here; give your name") from None


def places(session: Path, loop: str | None = None) -> list["LoopPlace"]:
    """The loops of a session to which something may be ordered. loop : the name of one; None for all.

    Raises UserError: there is no session or no such loop, or its ledger cannot be believed: orders refer to what it
    says.
    """
    ledger = ledger_path(session)
    rows, config = believed_rows(ledger), load_session(ledger.parent / CONFIG, as_run=True)[0]
    show_units_of(config)
    about = rows_by_loop(rows, config.names) if config.several else {config.names[0]: rows}
    wanted = config.loops if loop is None else (config.loops[config.place(loop)],)
    return [LoopPlace(ledger, one, config.several, shown(about[one.loop.name])) for one in wanted]


def only_place(session: Path, loop: str | None) -> "LoopPlace":
    """The one loop that is meant; errors as `places`, and UserError when there are several and none is named."""
    found = places(session, loop)
    if len(found) > 1:
        names = ", ".join(place.name for place in found)
        raise UserError(f"--loop: there are {len(found)} loops, name one of {names}")
    return found[0]


class LoopPlace:
    """A loop of a session as a person sees it who wants to order something: its folder, and what it has shown.

    ledger : of the session. config : of the loop. several : it is one of several. shown : what the ledger tells of it.
    """

    def __init__(self, ledger: Path, config: Config, several: bool, shown: OrderState) -> None:
        self.session, self.config, self.shown = ledger.parent, config, shown
        self.name = config.loop.name if several else ""
        self.folder = loop_folder(self.session, self.name)
        self.expires_after_s = config.adaptation.approval_s  # how long a proposal is open
        self._ledger = ledger

    @property
    def by_hand(self) -> str:
        """Why nothing is written to its controller; empty when it is."""
        told: str = product("foreign device").advice_only(self.config) if self.config.foreign_device else ""
        return told

    def running(self) -> bool:
        """Whether a session fills the folder right now."""
        if not os.access(self.session, os.W_OK):
            raise UserError(f"{self.session}: cannot be written to; requests are files in it")
        try:
            WriterLock(self._ledger).close()
        except LedgerError:
            return True
        return False

    def put(
        self,
        kind: OrderKind,
        options: ApproveOptions | RevertOptions,
        digest: str = "",
        decision: int = 0,
        region: str = "",
    ) -> Path:
        """Put an order into the folder; its file."""
        now = dt.datetime.now(dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        with user_input("--by, --note"):
            order = Order(kind, _name(options), now, options.note, digest, decision, region)
        return put_order(self.folder, order)

    def who_acts(self) -> str:
        """What happens to an order."""
        if self.running():
            return "the running session acts on it at its next sample"
        return f"no session is running here; the next run with --out {self.session} acts on it at its start"


def approve(options: ApproveOptions) -> int:
    """Approve, unlock or list; the exit status: 0, or 1 where what was named is not approved.

    Raises UserError: there is no such session, loop, proposal or region, or what is asked contradicts itself.
    """
    session, digest, unlock, as_json = options.session, options.digest, options.unlock, options.as_json
    found = places(session, options.loop)
    if options.every and (unlock or digest) is not None:
        raise UserError("--all: lists proposals; omit it to approve or unlock one")
    if unlock is not None and options.into is not None:
        raise UserError("--into: takes up a proposed schedule; omit it to unlock a region")
    if unlock is not None:
        place = only_place(session, options.loop)
        names = [one.name for one in place.config.schedule.regions]
        if options.digest is not None:
            raise UserError("--unlock: names a region; a hash is approved without it")
        if unlock not in names:
            raise UserError(f"--unlock {unlock}: there is no such region; there are {', '.join(names)}")
        file = place.put(OrderKind.UNLOCK, options, region=unlock)
        unlocked = {"session": str(place.session), "unlocked": unlock, "file": str(file)}
        tell(unlocked, [f"{unlock}: {place.who_acts()}"], as_json=options.as_json)
        return 0
    if digest is None and options.into is not None:
        raise UserError(f"--into: give the hash of the schedule as well; `retuner approve {session}` lists them")
    if digest is None:
        return _list(found, options)
    place, full = _full_hash(found, digest)
    if full in place.shown.schedules:
        return _take_up(place, full, options)
    if options.into is not None:
        raise UserError(f"--into: is for a proposed schedule; {full[:SHORT]} is a change of gains")
    # Put the approval of a change into the session's folder; the exit status, 1 where it is not approved
    reason = _closed(place, full)
    document: dict[str, object] = {
        "session": str(place.session),
        "approved": None if reason else full,
        "reason": reason or None,
        "file": None,
    }
    if not reason:
        document["file"] = str(place.put(OrderKind.APPROVE, options, digest=full))
    text = f"{full[:SHORT]} is not approved: {reason}" if reason else f"{full[:SHORT]}: {place.who_acts()}"
    tell(document, [text], as_json=as_json)
    return 1 if reason else 0


def _take_up(place: LoopPlace, full: str, options: ApproveOptions) -> int:
    """Write a proposed schedule into a configuration; the exit status, 0.

    Raises UserError: no configuration is named, or it cannot have this schedule; nothing was changed then.
    """
    into = options.into
    if into is None:
        raise UserError(f"{full[:SHORT]}: is a schedule; name the configuration that gets it with --into")
    with user_input(f"proposal {full[:SHORT]}"):
        table = from_toml(str(place.shown.schedules[full]["table"]))
    today = dt.datetime.now(dt.UTC).date().isoformat()
    why = f": {options.note}" if options.note else ""
    note = one_line(f"proposal {full[:SHORT]} of {place.session}, approved by {_name(options)} on {today}{why}")
    # What a session ran is its record: a replay reads it
    if (into.resolve().parent / LEDGER).exists():
        raise UserError(f"--into {into}: belongs to the session recorded there; name the configuration of the next run")
    try:
        gains_at_end = from_toml((place.folder / GAINS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        gains_at_end = None
    written = schedule_into(into, table, place.config, note, gains_at_end)
    write_whole(into, written.text)
    document = {"session": str(place.session), "approved": full, "schedule": str(into), "comments": written.comments}
    parts = f"{len(table.gains)} regions along {table.regions.axes[0].label}"
    told = f"{into}: has the schedule {full[:SHORT]} now, {parts}; its next run uses it"
    if written.comments:
        told += f"; comments on {written.comments} lines of the old section were lost with it"
    tell(document, [told], as_json=options.as_json)
    return 0


def _closed(place: LoopPlace, full: str) -> str:
    """Why what a hash names is not approved; empty when it is."""
    if full in place.shown.approved:
        return "it was approved before"
    if full in place.shown.rejected:
        return "it was rejected"
    if place.by_hand:
        return place.by_hand
    proposal = place.shown.proposals.get(full)
    if proposal is None:
        return "" if full in place.shown.waiting.values() else "this change needs no operator"
    standing = place.shown.standing(proposal, place.expires_after_s)
    return str(standing) if standing is not ProposalStanding.OPEN else superseded(place.shown.successor(proposal))


def revert(options: RevertOptions) -> int:
    """Order the way back to the gains before a decision, in its region; the exit status, 0.

    Raises UserError: no such session or decision.
    """
    place, decision = only_place(options.session, options.loop), options.decision
    change = place.shown.changes.get(decision)
    if change is None:
        most = max(place.shown.changes, default=0)
        raise UserError(f"--decision {decision}: the ledger has no such decision; there are {most or 'none'}")
    file = place.put(OrderKind.REVERT, options, decision=decision)
    document = {
        "session": str(place.session),
        "decision": decision,
        "region": change.region,
        "gains": gains_dict(change.before),
        "file": str(file),
    }
    back = f"{change.region} back to {settings_text(change.before)}, as before decision {decision}"
    tell(document, [f"{back}: {place.who_acts()}"], as_json=options.as_json)
    return 0


def _full_hash(found: Sequence[LoopPlace], digest: str) -> tuple[LoopPlace, str]:
    """The hash that a person means by its beginning, and the loop that it is of."""
    session = found[0].session
    known = [
        (place, one) for place in found for one in (*place.shown.proposals, *place.shown.tried, *place.shown.schedules)
    ]
    if len(digest) < SHORT or set(digest) - set("0123456789abcdef"):
        raise UserError(
            f"HASH {digest}: give at least {SHORT} hexadecimal digits of a proposal's hash; "
            f"`retuner approve {session}` lists them"
        )
    meant = [(place, one) for place, one in known if one.startswith(digest)]
    if len(meant) != 1:
        what = "no proposal begins like this" if not meant else f"{len(meant)} proposals begin like this, give more"
        if len({one for _, one in meant}) == 1:
            names = " and ".join(place.name for place, _ in meant)
            what = f"{names} have this very proposal, name the loop with --loop"
        raise UserError(f"HASH {digest}: {what}; `retuner approve {session}` lists them")
    return meant[0]


def _list(found: Sequence[LoopPlace], options: ApproveOptions) -> int:
    """The open proposals of some loops, the newest of each region, each as a document and in a line."""
    documents, lines = list[dict[str, object]](), list[str]()
    for place in found:
        seen, able = place.shown, place.shown.open(place.expires_after_s)
        newest = [one for one in able if not seen.successor(one)]
        older = len(able) - len(newest)
        proposals = list[dict[str, object]]()
        for one in able if options.every else newest:
            successor, expires_s = seen.successor(one), one.t_s + place.expires_after_s
            beaten = sum(other.region == one.region for other in able) - 1
            told = f"superseded by {successor[:SHORT]}" if successor else f"supersedes {beaten} older" if beaten else ""
            change = f"{settings_text(one.before)} -> {settings_text(one.after)}; expires at {expires_s:,.0f} s"
            more = "".join(f"; {text}" for text in (told, place.by_hand) if text)
            lines.append(f"{one.digest[:SHORT]}  decision {one.number}, {one.region}: {change}{more}")
            proposals.append(
                plain_values(one, "hash=digest decision=number region t_s")
                | {"expires_s": expires_s}
                | plain_values(one, "gains_before=before gains_after=after")
                | {"superseded_by": successor or None}
            )
        for region, digest in seen.waiting.items():
            why = "trial passed, as predicted; approve it to continue in this region"
            lines.append(f"{digest[:SHORT]}  {region}: {why}")
        for digest, body in seen.schedules.items():
            lines.append(f"{digest[:SHORT]}  schedule: {body['reason']} Approve it with --into CONFIG")
        hidden = f" (and {older} superseded; --all lists them)" if older and not options.every else ""
        counted = f"{len(newest)} open proposal{'s' * (len(newest) != 1)} at {seen.last_s:,.0f} s"
        lines.append(f"{place.name or place.session}: {counted}{hidden}")
        documents.append(
            {
                "session": str(place.session),
                **({"loop": place.name} if place.name else {}),
                "time_s": seen.last_s,
                "waiting": [{"hash": digest, "region": region} for region, digest in seen.waiting.items()],
                "superseded": older,
                "proposals": proposals,
                "schedules": [{"hash": digest, **body["proposal"]} for digest, body in seen.schedules.items()],
            }
        )
    whole = {"session": str(found[0].session), "loops": documents} if found[0].name else documents[0]
    tell(whole, lines, as_json=options.as_json)
    return 0
