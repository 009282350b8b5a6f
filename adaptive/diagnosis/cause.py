"""Causes of a loop's behaviour, and the diagnosis that names one of them."""

import math
from dataclasses import dataclass
from enum import StrEnum


class Cause(StrEnum):
    """What is behind the behaviour of a loop. Only three of them may change gains."""

    OK = "ok"
    AGGRESSIVE = "aggressive"
    SLUGGISH = "sluggish"
    SLOW_INTEGRATING = "slow_integrating"
    STICTION = "stiction"
    EXTERNAL = "external"
    SATURATION = "saturation"
    NOISE = "noise"
    UNKNOWN = "unknown"


TUNING_CAUSES = frozenset({Cause.AGGRESSIVE, Cause.SLUGGISH, Cause.SLOW_INTEGRATING})
"""Causes that a change of gains can cure."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One cause with its evidence.

    cause : the cause. confidence : 0 to 1. evidence : numbers by name. reason : one sentence.

    Raises
    ------
    ValueError
        The confidence is outside 0 to 1, or a number of the evidence is NaN.
    """

    cause: Cause
    confidence: float
    evidence: dict[str, float]
    reason: str

    def __post_init__(self) -> None:
        if not 0 <= self.confidence <= 1:
            raise ValueError(f"confidence = {self.confidence} is outside 0 to 1")
        for name, value in self.evidence.items():
            if math.isnan(value):
                raise ValueError(f"evidence {name} is not a number")

    @property
    def retune(self) -> bool:
        """Whether this cause may change gains."""
        return self.cause in TUNING_CAUSES

    def to_dict(self) -> dict[str, object]:
        """Keys cause, confidence, retune, evidence, reason."""
        evidence = {name: value if math.isfinite(value) else None for name, value in self.evidence.items()}
        return {
            "cause": str(self.cause),
            "confidence": self.confidence,
            "retune": self.retune,
            "evidence": evidence,
            "reason": self.reason,
        }
