"""The record of a decision: everything that led to it, in plain values.

A ledger keeps it, and a replay is compared with it byte for byte.
"""

import hashlib
import json
from dataclasses import dataclass
from enum import StrEnum

from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.estimate import ModelEstimate
from retuner.adaptive.guard import Verdict
from retuner.adaptive.response import Response
from retuner.adaptive.rules.tuning import Tuning
from retuner.adaptive.tracker import Surprise
from retuner.schedule.gains import PidGains


class Mode(StrEnum):
    """What the retuner may do."""

    OFF = "off"
    ADVISE = "advise"
    AUTO = "auto"


class Action(StrEnum):
    """What follows from a decision."""

    NONE = "none"
    ADVISE = "advise"
    COMMIT = "commit"


@dataclass(frozen=True, slots=True)
class Decision:
    """One decision on one response.

    number : counts up from 1 per loop. t_s : time of the sample that completed the response. region : name.
    The stages that were not reached are None; `reason` is the sentence of the one that decided.
    gains_before : in force; gains_after : what shall be written (action COMMIT) or is advised.
    records : how many records the region's model rests on.
    """

    number: int
    t_s: float
    loop: str
    region: str
    action: Action
    reason: str
    gains_before: PidGains
    gains_after: PidGains | None = None
    response: Response | None = None
    estimate: ModelEstimate | None = None
    surprise: Surprise | None = None
    records: int = 0
    diagnosis: Diagnosis | None = None
    proposal: Tuning | None = None
    verdict: Verdict | None = None

    def to_dict(self) -> dict[str, object]:
        """Plain values: what the ledger keeps."""
        return {
            "number": self.number,
            "t_s": self.t_s,
            "loop": self.loop,
            "region": self.region,
            "action": str(self.action),
            "reason": self.reason,
            "gains_before": gains_dict(self.gains_before),
            "gains_after": gains_dict(self.gains_after) if self.gains_after else None,
            "response": self.response.to_dict() if self.response else None,
            "estimate": self.estimate.to_dict() if self.estimate else None,
            "surprise": self.surprise.name.lower() if self.surprise else None,
            "records": self.records,
            "diagnosis": self.diagnosis.to_dict() if self.diagnosis else None,
            "proposal": self.proposal.to_dict() if self.proposal else None,
            "verdict": self.verdict.to_dict() if self.verdict else None,
        }

    def canonical(self) -> bytes:
        """The bytes that replay must reproduce: JSON, sorted keys, no spaces, shortest round-trip floats."""
        return json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()

    def digest(self) -> str:
        """SHA-256 of the canonical bytes, in hexadecimal."""
        return hashlib.sha256(self.canonical()).hexdigest()


def gains_dict(gains: PidGains) -> dict[str, float]:
    """Parallel form by name."""
    return {"kp": gains.kp, "ki": gains.ki, "kd": gains.kd}
