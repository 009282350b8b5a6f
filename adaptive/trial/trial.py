"""One region's trial as a value: its phase, the verified set and the tried one, what was promised, what was seen."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from retuner.adaptive.trial.expectation import Promise
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.adaptive.trial.runaway import RunawayState
from retuner.schedule.gains import PidGains


@dataclass(frozen=True, slots=True)
class Trial:
    """See the head of this file.

    old : the verified set, as the table had it; new : the tried one. since_s : when the change was asked for, s.
    kept : responses that kept the promise. undos : changes undone in a row in this region, since one has passed.
    until_s : end of the cool-down, s. cause : why the set was or is taken back. seen : where the watch stands.
    """

    phase: TrialPhase = TrialPhase.IDLE
    old: PidGains | None = None
    new: PidGains | None = None
    promise: Promise | None = None
    since_s: float = 0.0
    kept: int = 0
    undos: int = 0
    until_s: float = 0.0
    cause: TrialEvent | None = None
    seen: RunawayState | None = None

    def to_dict(self) -> dict[str, object]:
        """Plain JSON values."""
        return {
            "phase": self.phase.name.lower(),
            "old": _gains_out(self.old),
            "new": _gains_out(self.new),
            "promise": self.promise.to_dict() if self.promise else None,
            "since_s": self.since_s,
            "kept": self.kept,
            "undos": self.undos,
            "until_s": self.until_s,
            "cause": self.cause.name.lower() if self.cause else None,
            "seen": _seen_out(self.seen),
        }

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Trial":
        """And back.

        Raises
        ------
        KeyError, TypeError, ValueError
            Something is missing, or no value of its kind.
        """
        return cls(
            phase=TrialPhase[str(body["phase"]).upper()],
            old=_gains_in(body["old"]),
            new=_gains_in(body["new"]),
            promise=Promise.from_dict(body["promise"]) if body["promise"] else None,
            since_s=float(body["since_s"]),
            kept=int(body["kept"]),
            undos=int(body["undos"]),
            until_s=float(body["until_s"]),
            cause=TrialEvent[str(body["cause"]).upper()] if body["cause"] else None,
            seen=_seen_in(body["seen"]),
        )


def _gains_out(gains: PidGains | None) -> list[float] | None:
    """kp, ki, kd."""
    return [gains.kp, gains.ki, gains.kd] if gains else None


def _gains_in(values: list[float] | None) -> PidGains | None:
    """And back."""
    return PidGains(*values) if values else None


def _seen_out(seen: RunawayState | None) -> dict[str, float | None] | None:
    """By name; null where infinite."""
    if seen is None:
        return None
    return {name: None if math.isinf(value) else value for name, value in seen._asdict().items()}


def _seen_in(body: Mapping[str, Any] | None) -> RunawayState | None:
    """And back."""
    if body is None:
        return None
    at = {name: math.inf if value is None else float(value) for name, value in body.items()}
    return RunawayState(
        at["sp"],
        at["extreme"],
        at["last"],
        int(at["grown"]),
        int(at["stayed"]),
        int(at["limit"]),
        int(at["swings"]),
        at["since_s"],
        at["wave_s"],
        at["inside_s"],
        bool(at["joined"]),
    )
