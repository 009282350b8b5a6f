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
        """Take in what has come; the decisions that follow from it."""
        made = []
        for box in self._boxes:
            for found in box.take():
                decision = self._one(found, t_s)
                if decision is not None:
                    made.append(decision)
        return made

    def _one(self, found: Found, t_s: float) -> Decision | None:
        """Record an order, then tell the retuner of it."""
        body: dict[str, object] = {"file": one_line(found.name)[:LONGEST]}
        if found.order is None:
            self._record("order", t_s, {**body, "accepted": False, "reason": found.refused})
            return None
        meant, reason = self._meant(found.order, t_s)
        body |= {**found.order.to_dict(), **meant, "accepted": not reason, "reason": reason}
        self._record("order", t_s, body)
        return feed(self._retuner, "order", body, t_s)

    def _meant(self, order: Order, t_s: float) -> tuple[dict[str, object], str]:
        """What an order means in full, and why it cannot be told to the retuner."""
        if order.kind is OrderKind.APPROVE:
            return self._approved(order, t_s)
        if order.kind is OrderKind.REVERT:
            change = self._changes.get(order.decision)
            if change is None:
                return {}, f"no decision {order.decision} in this session"
            return {"region": change.region, "gains": gains_dict(change.before)}, self._closed(change.region)
        return {}, self._closed(order.region)

    def _approved(self, order: Order, t_s: float) -> tuple[dict[str, object], str]:
        """A proposal, or a change that has passed its trial and waits for a person."""
        proposal = self._proposals.get(order.digest)
        if proposal is not None:
            meant: dict[str, object] = {"region": proposal.region, "proposal": proposal.to_dict()}
            return meant, self._closed(proposal.region) or self._over(proposal, t_s)
        region = self._tried.get(order.digest)
        if region is not None:
            return {"region": region, "proposal": None}, self._closed(region)
        return {"proposal": None}, f"no proposal {order.digest[:8]} in this session"

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
