"""What a session has shown and a person may refer to, read from its ledger: open proposals, changes, tried sets.

Whether a proposal is still open is said here as far as the ledger goes; the session that takes the order looks again.
Of a region's proposals only the newest may be taken up: it knows more than those before it.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from retuner.adaptive.decision import Action
from retuner.adaptive.proposal import Proposal, Standing
from retuner.adaptive.trial.phase import TrialPhase
from retuner.ledger import Row
from retuner.recorded_session import canonical, without_place
from retuner.retuner_events import gains_of
from retuner.schedule.gains import PidGains

SHORT = 8
"""Hexadecimal digits of a hash by which people are told of a proposal."""


class Change(NamedTuple):
    """What a decision stood for: its region, and the gains before it."""

    region: str
    before: PidGains


@dataclass(slots=True)
class Shown:
    """proposals : by hash. newest : hash of the newest proposal, by region. changes : by number of the decision.
    tried : region by hash of the decision that changed it. waiting : hash of the change that has passed and waits for
    a person, by region. in_force : gains by region, as far as decisions and writes tell. last_s : time of the last row,
    s. approved : hashes that were taken already. files : names of order files that it has dealt with.
    """

    proposals: dict[str, Proposal] = field(default_factory=dict)
    newest: dict[str, str] = field(default_factory=dict)
    changes: dict[int, Change] = field(default_factory=dict)
    tried: dict[str, str] = field(default_factory=dict)
    waiting: dict[str, str] = field(default_factory=dict)
    in_force: dict[str, PidGains] = field(default_factory=dict)
    last_s: float = 0.0
    approved: set[str] = field(default_factory=set)
    files: set[str] = field(default_factory=set)

    def standing(self, proposal: Proposal, expires_after_s: float) -> Standing:
        """Whether a proposal is open, as far as the ledger tells."""
        return proposal.standing(self.in_force.get(proposal.region, proposal.before), self.last_s, expires_after_s)

    def successor(self, proposal: Proposal) -> str:
        """Hash of the newest proposal of its region, empty when it is the newest itself."""
        newest = self.newest.get(proposal.region, "")
        return "" if newest == proposal.digest else newest

    def open(self, expires_after_s: float) -> list[Proposal]:
        """The ones that could be taken up, were they not superseded, and nobody has approved yet, oldest first."""
        return [p for p in self.proposals.values()
                if p.digest not in self.approved and self.standing(p, expires_after_s) is Standing.OPEN]  # fmt: skip


def superseded(successor: str) -> str:
    """Why a proposal is not taken up that has a successor (its hash); empty without one."""
    return f"a newer proposal of its region supersedes it: {successor[:SHORT]}" if successor else ""


def shown(rows: Iterable[Row]) -> Shown:
    """Read it off the rows of a ledger."""
    found = Shown()
    for row in rows:
        found.last_s = max(found.last_s, row.clock_s)
        body = row.body
        if row.kind == "decision":
            _decision(found, without_place(body))
        elif row.kind == "committed" and body.get("why") == "retune":
            found.in_force[str(body["region"])] = gains_of(body["gains"])
        elif row.kind == "restore":
            found.in_force[str(body["region"])] = gains_of(body["gains"])
            found.waiting.pop(str(body["region"]), None)
        elif row.kind == "judged" and body.get("trial") == TrialPhase.WAITING:
            found.waiting[str(body["region"])] = _last_tried(found, str(body["region"]))
        elif row.kind == "order":
            _order(found, body)
    return found


def _last_tried(found: Shown, region: str) -> str:
    """Hash of the newest change of a region."""
    return next((digest for digest in reversed(found.tried) if found.tried[digest] == region), "")


def _order(found: Shown, body: Mapping[str, Any]) -> None:
    """One order that was dealt with."""
    found.files.add(str(body.get("file")))
    if body.get("accepted") is True:
        found.approved.add(str(body.get("digest")))
        if found.waiting.get(str(body.get("region"))) == body.get("digest"):
            del found.waiting[str(body["region"])]


def _decision(found: Shown, body: Mapping[str, Any]) -> None:
    """One decision."""
    number, region, before = int(body["number"]), str(body["region"]), gains_of(body["gains_before"])
    digest = hashlib.sha256(canonical(body)).hexdigest()
    found.changes[number] = Change(region, before)
    found.in_force[region] = before
    if body["action"] == Action.ADVISE and body["gains_after"] is not None:
        found.newest[region] = digest
        found.proposals[digest] = Proposal(digest, number, region, float(body["t_s"]), before,
                                           gains_of(body["gains_after"]), body.get("promise"))  # fmt: skip
    elif body["action"] == Action.COMMIT:
        found.tried[digest] = region
