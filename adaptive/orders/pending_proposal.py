"""A proposal that waits for a person: what exactly was proposed, and why it may no longer be taken up.

An approval names the proposal by its hash (of the whole decision), so what is written is what was looked at. A proposal
ends when its time is over, or when other gains have come into force in its region: it was proved from those before.
"""

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from retuner.adaptive.guard.step_size import SAME_GAINS, change_factor
from retuner.adaptive.supervision.decision import Action, Decision
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values


class ProposalStanding(StrEnum):
    """Whether a proposal may be taken up; the value is the sentence that people see."""

    OPEN = "open"
    EXPIRED = "it has expired"
    OTHER_GAINS = "the active gains of its region are not those it was proved from"


@dataclass(frozen=True, slots=True)
class Proposal:
    """One proposal.

    digest : SHA-256 of the decision, hexadecimal. number : of the decision. region : name. t_s : time of the decision.
    before : gains from which it was proved. after : gains that are proposed. prediction : as the decision has it.

    Raises ValueError: the digest is no hash, the time not finite, or the sets act in different directions.
    """

    digest: str
    number: int
    region: str
    t_s: float
    before: PidGains
    after: PidGains
    prediction: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if len(self.digest) != 64 or not set(self.digest) <= set("0123456789abcdef"):
            raise ValueError(f"digest = {self.digest!r} is no SHA-256 in hexadecimal")
        if not math.isfinite(self.t_s):
            raise ValueError(f"t_s = {self.t_s} must be finite")
        if self.before.direction != self.after.direction:
            raise ValueError("the proposed gains have the opposite control action")

    @classmethod
    def of(cls, decision: Decision) -> "Proposal | None":
        """What a decision proposes; None when it proposes nothing."""
        if decision.action != Action.ADVISE or decision.gains_after is None:
            return None
        prediction: Any = decision.to_dict().get("promise")
        return cls(
            decision.digest(),
            decision.number,
            decision.region,
            decision.t_s,
            decision.gains_before,
            decision.gains_after,
            prediction,
        )

    def standing(self, in_force: PidGains, t_s: float, expires_after_s: float) -> ProposalStanding:
        """Whether it may be taken up at t_s, with these gains in force in its region."""
        if t_s - self.t_s > expires_after_s:
            return ProposalStanding.EXPIRED
        same = change_factor(in_force, self.before) <= SAME_GAINS
        return ProposalStanding.OPEN if same else ProposalStanding.OTHER_GAINS

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return plain_values(self, "digest number region t_s before after promise=prediction")

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Proposal":
        """The proposal from its plain form.

        Raises KeyError, TypeError, ValueError: something is missing, or no value of its kind.
        """
        before, after = (
            PidGains(*(float(body[name][gain]) for gain in ("kp", "ki", "kd"))) for name in ("before", "after")
        )
        return cls(
            str(body["digest"]),
            int(body["number"]),
            str(body["region"]),
            float(body["t_s"]),
            before,
            after,
            body["promise"],
        )
