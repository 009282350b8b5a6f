"""Where a session takes in what people order: looked at, recorded with who and why, then told to the retuner.

Nothing is told that is not in the ledger first, and it is told by the function that a replay uses (orders.py).
What a person may refer to is what the session itself has shown: proposals by their hash, decisions by their number;
and, at the start, the proposals and decisions of the session before it in the same folder.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Reversible
from pathlib import Path
from typing import Any, NamedTuple

from retuner.adaptive.orders.pending_proposal import Proposal, ProposalStanding
from retuner.adaptive.supervision.decision import Action, Decision, Mode, gains_dict
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TrialPhase
from retuner.decisions.proposed_schedule import ROW as SCHEDULE
from retuner.errors import LedgerError, one_line
from retuner.ledger import Recorder, Row
from retuner.ledger.chain import digest_of, without_place
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.session.ledger_rows import feed, gains_of
from retuner.session.orders import LONGEST, Order, OrderBox, OrderFile, OrderKind
from retuner.session.outputs import LEDGER, ORDERS, believed_rows, loop_folder

# What a session has shown and a person may refer to, read from its ledger: open proposals, changes, tried sets.
#
# Whether a proposal is still open is said here as far as the ledger goes; the session that takes the order looks again.
# Of a region's proposals only the newest may be taken up: it knows more than those before it.


SHORT = 8  # hexadecimal digits of a hash by which people are told of a proposal


LOOK_EVERY_S = 0.25
"""Seconds between two looks into the folder of orders: a look at every one of 100 samples a second costs as much as all
else that is done with the sample."""


class DecidedChange(NamedTuple):
    """What a decision stood for: its region, and the gains before it."""

    region: str
    before: PidGains


@dataclass(slots=True)
class OrderState:
    """proposals : by hash. newest : hash of the newest proposal, by region. changes : by number of the decision.
    tried : region by hash of the decision that changed it. waiting : hash of the change that has passed and waits for
    a person, by region. in_force : gains by region, as far as decisions and writes tell. last_s : time of the last row,
    s. approved, rejected : hashes that were taken already. files : names of order files that it has dealt with.
    schedules : rows of proposed schedules by hash.
    """

    proposals: dict[str, Proposal] = field(default_factory=dict)
    newest: dict[str, str] = field(default_factory=dict)
    changes: dict[int, DecidedChange] = field(default_factory=dict)
    tried: dict[str, str] = field(default_factory=dict)
    waiting: dict[str, str] = field(default_factory=dict)
    in_force: dict[str, PidGains] = field(default_factory=dict)
    last_s: float = 0.0
    approved: set[str] = field(default_factory=set)
    rejected: set[str] = field(default_factory=set)
    files: set[str] = field(default_factory=set)
    schedules: dict[str, Mapping[str, Any]] = field(default_factory=dict)

    def standing(self, proposal: Proposal, expires_after_s: float) -> ProposalStanding:
        """Whether a proposal is open, as far as the ledger tells."""
        return proposal.standing(self.in_force.get(proposal.region, proposal.before), self.last_s, expires_after_s)

    def successor(self, proposal: Proposal) -> str:
        """Hash of the newest proposal of its region, empty when it is the newest itself."""
        newest = self.newest.get(proposal.region, "")
        return "" if newest == proposal.digest else newest

    def open(self, expires_after_s: float) -> list[Proposal]:
        """The ones that could be taken up, were they not superseded, and nobody has approved yet, oldest first."""
        return [
            p
            for p in self.proposals.values()
            if p.digest not in self.approved | self.rejected
            and self.standing(p, expires_after_s) is ProposalStanding.OPEN
        ]


def superseded(successor: str) -> str:
    """Why a proposal is not taken up that has a successor (its hash); empty without one."""
    return f"a newer proposal of its region supersedes it: {successor[:SHORT]}" if successor else ""


def shown(rows: Iterable[Row], found: OrderState | None = None) -> OrderState:
    """Read it off the rows of a ledger; found : what was read off the rows before them, which is changed."""
    found = found or OrderState()
    for row in rows:
        found.last_s = max(found.last_s, row.clock_s)
        body = row.body
        if row.kind == "decision":
            body = without_place(body)
            region, before, digest = str(body["region"]), gains_of(body["gains_before"]), digest_of(body)
            number, after = int(body["number"]), body["gains_after"]
            found.changes[number], found.in_force[region] = DecidedChange(region, before), before
            if body["action"] == Action.ADVISE and after is not None:
                found.newest[region], t_s = digest, float(body["t_s"])
                found.proposals[digest] = Proposal(
                    digest, number, region, t_s, before, gains_of(after), body.get("promise")
                )
            elif body["action"] == Action.WRITE:
                found.tried[digest] = region
        elif row.kind == "committed" and body.get("why") == "retune":
            found.in_force[str(body["region"])] = gains_of(body["gains"])
        elif row.kind == "restore":
            found.in_force[str(body["region"])] = gains_of(body["gains"])
            found.waiting.pop(str(body["region"]), None)
        elif row.kind == "judged" and body.get("trial") == TrialPhase.WAITING:
            region = str(body["region"])  # and the hash of its newest change
            found.waiting[region] = next((one for one in reversed(found.tried) if found.tried[one] == region), "")
        elif row.kind == "order":
            found.files.add(str(body.get("file")))
            if body.get("accepted") is True:
                taken = found.rejected if body.get("order") == OrderKind.REJECT else found.approved
                taken.add(str(body.get("digest")))
                if found.waiting.get(str(body.get("region"))) == body.get("digest"):
                    del found.waiting[str(body["region"])]
        elif row.kind == SCHEDULE:
            found.schedules[str(body["hash"])] = body
    return found


class Waiting(NamedTuple):
    """An order that waits until the loop is in its region: what is written must be seen to work. past_s : time of the
    session before, which counts for what it had proposed.
    """

    region: str
    body: dict[str, object]
    past_s: float


class Before(NamedTuple):
    """Orders left for a session that has ended: its box, and what it had shown; trouble: why that is not known."""

    box: OrderBox
    shown: OrderState
    trouble: str = ""


def left_before(session: Path | None, loop: str = "", known: Iterable[Row] | None = None) -> Before | None:
    """Orders that a session which was there before has left undone; None without one, or when there are none.

    loop : to which they were given, empty for the only one. known : the ledger's rows about it, if they were read.
    """
    folder = loop_folder(session, loop) if session is not None else None
    if session is None or folder is None or not (folder / ORDERS).is_dir():
        return None
    try:
        past = shown(known if known is not None else believed_rows(session / LEDGER))
    except LedgerError as error:
        return Before(OrderBox(folder), OrderState(), str(error))
    return Before(OrderBox(folder, past.files), past)


class OrderDesk:
    """Orders to one session.

    box : where orders lie. retuner : is told. record : keeps rows for good. decisions : of this session, as it goes on.
    expires_after_s : how long a proposal may be approved after it was made. before : what was left before it.
    """

    def __init__(
        self,
        box: OrderBox,
        retuner: Retuner,
        record: Recorder,
        decisions: Reversible[Decision],
        expires_after_s: float,
        before: Before | None = None,
    ) -> None:
        self._box = box
        self._retuner = retuner
        self._to_ledger = record
        self._decisions = decisions
        self._expires_after_s = expires_after_s
        self._before = before
        self._queue: deque[tuple[OrderFile, Before | None]] = deque()
        self._waiting: list[Waiting] = []
        self._look_at_s = float("-inf")
        self._rejected: set[str] = set()
        self._taken_up: dict[str, int] = {}  # number of the decision that writes an approved proposal, by hash

    def take(self, t_s: float) -> tuple[Decision, ...]:
        """Take in the next order, one a turn, since each may want a write; the decision that follows, if one does."""
        if self._before is not None:
            before, self._before = self._before, None
            self._queue += [(found, before) for found in before.box.take()]
        if t_s >= self._look_at_s:
            self._look_at_s = t_s + LOOK_EVERY_S
            self._queue += [(found, None) for found in self._box.take()]
        here = next((order for order in self._waiting if self._is_here(order)), None)
        decision = None
        if here is not None:
            self._waiting.remove(here)
            decision = self._due(here, t_s)
        elif self._queue:
            decision = self._one(*self._queue.popleft(), t_s)
        return (decision,) if decision is not None else ()

    def _one(self, found: OrderFile, before: Before | None, t_s: float) -> Decision | None:
        body: dict[str, object] = {"file": one_line(found.name)[:LONGEST], "accepted": False, "due": False}
        if found.order is None:
            self._to_ledger("order", t_s, {**body, "reason": found.refused})
            return None
        meant, reason = self._meant(found.order, before)
        body |= {**found.order.to_dict(), **meant}
        if found.order.kind is not OrderKind.MODE:
            reason = reason or self._closed(str(body["region"]))
        past_s = before.shown.last_s if before else 0.0
        order = Waiting(str(body["region"]), {**body, "accepted": not reason, "reason": reason}, past_s)
        if reason or self._is_here(order) or not (body.get("proposal") or body.get("gains")):
            return self._due(order, t_s)
        self._waiting.append(order)
        self._to_ledger("order", t_s, {**order.body, "reason": f"waits until the loop is in {order.region}"})
        return None

    def _due(self, order: Waiting, t_s: float) -> Decision | None:
        body = {**order.body, "due": True}
        proposal: Any = body.get("proposal")
        if body["accepted"] and proposal:
            standing = Proposal.from_dict(proposal).standing(
                self._retuner.table.gains_of(order.region), order.past_s + t_s, self._expires_after_s
            )
            reason = (
                str(standing)
                if standing is not ProposalStanding.OPEN
                else self._closed(order.region) or self._superseded(Proposal.from_dict(proposal))
            )
            reason = "it was rejected" if body["digest"] in self._rejected else reason
            if reason:
                body |= {"accepted": False, "reason": reason}
        if body["accepted"] and body.get("order") == OrderKind.REJECT:
            self._rejected.add(str(body["digest"]))
        self._to_ledger("order", t_s, body)
        decision = feed(self._retuner, "order", body, t_s)
        if proposal and decision is not None and decision.gains_after is not None:
            self._taken_up[str(body["digest"])] = decision.number
        return decision

    def _is_here(self, order: Waiting) -> bool:
        region = self._retuner.region
        return region is not None and self._retuner.table.regions.names[region] == order.region

    def _meant(self, order: Order, before: Before | None) -> tuple[dict[str, object], str]:
        if before is not None and before.trouble:
            return {}, before.trouble
        if order.kind in {OrderKind.APPROVE, OrderKind.REJECT}:
            return self._of_hash(order, before)
        if order.kind is OrderKind.MODE:
            past = "it was meant for the session before this one" if before is not None else ""
            return {}, past or (self._no_such(order.region) if order.region else "")
        if order.kind is OrderKind.PROPOSE:
            return {}, self._closed(order.region)
        if order.kind is OrderKind.REVERT:
            own = (DecidedChange(d.region, d.gains_before) for d in self._decisions if d.number == order.decision)
            change = before.shown.changes.get(order.decision) if before is not None else next(own, None)
            if change is None:
                return {}, f"no decision {order.decision} in that session"
            return {"region": change.region, "gains": gains_dict(change.before)}, ""
        return {}, self._closed(order.region) or self._not_at(order.region, TrialPhase.LOCKED)

    def _of_hash(self, order: Order, before: Before | None) -> tuple[dict[str, object], str]:
        """What is approved, a proposal or a change that has passed its trial and waits for a person; or rejected: such
        a change is rolled back.
        """
        digest, approves = order.digest, order.kind is OrderKind.APPROVE
        where = "this session" if before is None else "that session"
        unknown: dict[str, object] = {"proposal": None} if approves else {}
        if before is not None:
            past = before.shown.proposals.get(digest)
            if past is None:
                return unknown, f"no proposal {digest[:SHORT]} in {where}"
            if approves:
                reason = superseded(before.shown.successor(past)) or self._superseded(past)
                return {"region": past.region, "proposal": past.to_dict()}, reason
            reason = "it was approved in that session; order a revert to return to the gains before"
            return {"region": past.region, "tried": False}, reason * (digest in before.shown.approved)
        decision = next((d for d in self._decisions if d.gains_after is not None and d.digest() == digest), None)
        if decision is None:
            return unknown, f"no proposal {digest[:SHORT]} in {where}"
        proposal, region = Proposal.of(decision), decision.region
        if approves and digest in self._rejected:
            return {"region": region, "proposal": None}, "it was rejected"
        if proposal is None:
            return {"region": region} | ({"proposal": None} if approves else {"tried": True}), self._not_waiting(
                decision
            )
        if approves:
            return {"region": region, "proposal": proposal.to_dict()}, self._superseded(proposal)
        # A proposal cannot be rejected any more once it was approved, and its gains are written
        number, written = self._taken_up.get(digest), "it was approved before, and written with decision"
        back = f"{written} {number}; to roll it back, order a revert of decision {number}"
        return {"region": region, "tried": False}, back if number is not None else ""

    def _superseded(self, proposal: Proposal) -> str:
        """Why a proposal may not be taken up any more, empty unless this session has made a newer one of its region."""
        made = (d for d in reversed(self._decisions) if d.region == proposal.region and d.action is Action.ADVISE)
        newest = next((one for one in map(Proposal.of, made) if one is not None), proposal)
        return superseded("" if newest.digest == proposal.digest else newest.digest)

    def _not_waiting(self, decision: Decision) -> str:
        """Why a change does not wait for a person's word; empty when it does, and is the region's newest one."""
        changes = (d for d in reversed(self._decisions) if d.region == decision.region and d.action is Action.WRITE)
        other = f"{decision.region} awaits approval of another change than this one"
        return self._not_at(decision.region, TrialPhase.WAITING) or ("" if next(changes, None) is decision else other)

    def _not_at(self, region: str, phase: TrialPhase) -> str:
        """Why an order finds nothing to do, empty when the region is in the phase that it is for."""
        now = self._retuner.trials.phase(self._retuner.table.index(region))
        return "" if now == phase else f"{region} is not {phase}, it is {now}"

    def _closed(self, region: str) -> str:
        if missing := self._no_such(region):
            return missing
        off = self._retuner.settings.mode_of(self._retuner.table.index(region)) == Mode.OFF
        return f"region {region} is off: nothing is written there" if off else ""

    def _no_such(self, region: str) -> str:
        names = self._retuner.table.regions.names
        known = region in names
        return "" if known else f"there is no region {region or 'without a name'}; there are {', '.join(names)}"
