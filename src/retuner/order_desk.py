"""Where a session takes in what people order: looked at, recorded with who and why, then told to the retuner.

Nothing is told that is not in the ledger first, and it is told by the function that a replay uses (retuner_events.py).
What a person may refer to is what the session itself has shown: proposals by their hash, decisions by their number;
and, at the start, the proposals and decisions of the session before it in the same folder.
"""

from collections import OrderedDict
from collections.abc import Mapping
from typing import NamedTuple, Protocol

from retuner.adaptive.decision import Action, Decision, Mode, gains_dict
from retuner.adaptive.proposal import Proposal, Standing
from retuner.adaptive.retuner import Retuner
from retuner.adaptive.trial.phase import TrialPhase
from retuner.errors import one_line
from retuner.orders import LONGEST, Found, Order, OrderBox, OrderKind
from retuner.retuner_events import feed
from retuner.schedule.gains import PidGains

KEPT = 5000
"""Decisions and proposals that an order may refer to, the newest ones."""


class Recorder(Protocol):
    """Keeps rows for good before it returns; session.py has the same."""

    def __call__(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record one row."""
        ...


class Waiting(NamedTuple):
    """An accepted order that waits until the loop is in its region: what is written must be seen to work."""

    region: str
    body: dict[str, object]


class Change(NamedTuple):
    """What a decision stood for: its region, and the gains before it."""

    region: str
    before: PidGains


class OrderDesk:
    """Orders to one session.

    Parameters
    ----------
    boxes : where orders lie: the session's own folder, and first that of the session before it. retuner : is told.
    record : keeps rows for good. expires_after_s : how long a proposal may be approved after it was made.
    """

    def __init__(self, boxes: tuple[OrderBox, ...], retuner: Retuner, record: Recorder, expires_after_s: float) -> None:
        self._boxes = boxes
        self._expires_after_s = expires_after_s
        self._retuner = retuner
        self._record = record
        self._proposals: OrderedDict[str, Proposal] = OrderedDict()
        self._changes: OrderedDict[int, Change] = OrderedDict()
        self._tried: OrderedDict[str, str] = OrderedDict()
        self._waiting: list[Waiting] = []

    def decided(self, decision: Decision) -> None:
        """Note a decision that orders may refer to."""
        self._changes[decision.number] = Change(decision.region, decision.gains_before)
        proposal = Proposal.of(decision)
        if proposal is not None:
            self._proposals[proposal.digest] = proposal
        if decision.action is Action.COMMIT:
            self._tried[decision.digest()] = decision.region
        for kept in (self._changes, self._proposals, self._tried):
            if len(kept) > KEPT:
                kept.popitem(last=False)

    def carry(self, proposals: Mapping[str, Proposal], changes: Mapping[int, Change]) -> None:
        """What the session before this one had shown; its numbers are of no use once this one has decided."""
        self._proposals.update(proposals)
        self._changes.update(changes)

    def take(self, t_s: float) -> list[Decision]:
        """Take in what has come, and what waited for the region that the loop is in; the decisions that follow."""
        made = [self._due(order, t_s) for order in self._here()] if self._waiting else []
        for box in self._boxes:
            made += [self._one(found, t_s) for found in box.take()]
        return [decision for decision in made if decision is not None]

    def _one(self, found: Found, t_s: float) -> Decision | None:
        """Record an order, then tell the retuner of it, or keep it until the loop is in its region."""
        body: dict[str, object] = {"file": one_line(found.name)[:LONGEST]}
        if found.order is None:
            self._record("order", t_s, {**body, "accepted": False, "due": False, "reason": found.refused})
            return None
        meant, reason = self._meant(found.order, t_s)
        body |= {**found.order.to_dict(), **meant, "accepted": not reason, "reason": reason}
        order = Waiting(str(body["region"]), body)
        writes = bool(body.get("proposal") or body.get("gains"))
        if reason or self._is_here(order) or not writes:
            return self._due(order, t_s)
        self._waiting.append(order)
        self._record("order", t_s, {**body, "due": False, "reason": f"waits until the loop is in {order.region}"})
        return None

    def _due(self, order: Waiting, t_s: float) -> Decision | None:
        """Tell the retuner of an order, after it was recorded."""
        body, proposal = {**order.body, "due": True}, self._proposals.get(str(order.body.get("digest")))
        if proposal is not None and body["accepted"] and self._over(proposal, t_s):
            body |= {"accepted": False, "reason": self._over(proposal, t_s)}
        self._record("order", t_s, body)
        return feed(self._retuner, "order", body, t_s)

    def _is_here(self, order: Waiting) -> bool:
        """Whether the loop is in the order's region."""
        region = self._retuner.region
        return region is not None and self._retuner.table.regions.names[region] == order.region

    def _here(self) -> list[Waiting]:
        """Those that waited for the region that the loop is in now; they wait no longer."""
        here = [order for order in self._waiting if self._is_here(order)]
        if here:
            self._waiting = [order for order in self._waiting if order not in here]
        return here

    def _meant(self, order: Order, t_s: float) -> tuple[dict[str, object], str]:
        """What an order means in full, and why it cannot be told to the retuner."""
        if order.kind is OrderKind.APPROVE:
            return self._approved(order, t_s)
        if order.kind is OrderKind.REVERT:
            change = self._changes.get(order.decision)
            if change is None:
                return {}, f"no decision {order.decision} in this session"
            return {"region": change.region, "gains": gains_dict(change.before)}, self._closed(change.region)
        return {}, self._closed(order.region) or self._not_at(order.region, TrialPhase.LOCKED)

    def _approved(self, order: Order, t_s: float) -> tuple[dict[str, object], str]:
        """A proposal, or a change that has passed its trial and waits for a person."""
        proposal = self._proposals.get(order.digest)
        if proposal is not None:
            meant: dict[str, object] = {"region": proposal.region, "proposal": proposal.to_dict()}
            return meant, self._closed(proposal.region) or self._over(proposal, t_s)
        region = self._tried.get(order.digest)
        if region is not None:
            return {"region": region, "proposal": None}, self._not_at(region, TrialPhase.WAITING)
        return {"proposal": None}, f"no proposal {order.digest[:8]} in this session"

    def _not_at(self, region: str, phase: TrialPhase) -> str:
        """Why an order finds nothing to do, empty when the region is in the phase that it is for."""
        now = self._retuner.desk.phase(self._retuner.table.index(region))
        return "" if now == phase else f"{region} is not {phase}, it is {now}"

    def _over(self, proposal: Proposal, t_s: float) -> str:
        """Why a proposal may not be taken up any more, empty when it may."""
        standing = proposal.standing(self._retuner.table.gains_of(proposal.region), t_s, self._expires_after_s)
        return "" if standing is Standing.OPEN else str(standing)

    def _closed(self, region: str) -> str:
        """Why nothing may be ordered for a region, empty when it may."""
        names = self._retuner.table.regions.names
        if region not in names:
            return f"there is no region {region}; there are {', '.join(names)}"
        off = self._retuner.settings.mode_of(names.index(region)) == Mode.OFF
        return f"region {region} is off: nothing is written there" if off else ""
