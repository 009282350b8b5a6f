"""One region's trial as a value: its phase, the set before and the tried one, what was promised, what was seen."""

import math
from collections.abc import Mapping
from typing import Any

from retuner.adaptive.trial.diverging_trial import TWICE, DivergenceState
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.rollback import Rollback, RollbackNumbers, SetsThatRan
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_value, plain_values

MOST_EARLIER = 4  # sets that are remembered of those that ran in a region


@dataclass(frozen=True, slots=True)
class Trial:
    """See the head of this file.

    old : the set before, as the table had it; new : the tried one. ran : whether it is known to have run.
    since_s : when the change was asked for, s.
    kept : responses that kept the promise; silent : that said nothing for or against it.
    rollbacks : in a row in this region, since a change has passed. edits : how often a person took ours away.
    until_s : end of the cool-down, or of the time for which a person's gains are held, s.
    cause : the last one that could have ended the trial. back : what it led to (see rollback.py).
    earlier : sets that ran here before the old one, the newest first. seen : where the watch stands.
    """

    phase: TrialPhase = TrialPhase.IDLE
    old: PidGains | None = None
    new: PidGains | None = None
    prediction: Prediction | None = None
    ran: bool = False
    since_s: float = 0.0
    kept: int = 0
    silent: int = 0
    rollbacks: int = 0
    edits: int = 0
    until_s: float = 0.0
    cause: TrialEvent | None = None
    back: Rollback | None = None
    earlier: tuple[PidGains, ...] = ()
    seen: DivergenceState | None = None

    @property
    def sets(self) -> SetsThatRan:
        """The sets among which it is decided what is to run. Raises ValueError: nothing was ever changed here."""
        if self.old is None:
            raise ValueError("nothing was ever changed here")
        said = self.prediction
        swung = said.decay_seen if said else None
        swings = max(said.decay_before(setpoint=True), said.decay_before(setpoint=False)) if said else 0.0
        unstable = said is not None and said.unstable_before and bool(self.old.ki)  # without ki none comes to rest
        left_range = self.seen is not None and self.seen.ends >= TWICE
        tried = self.new if self.ran else None
        return SetsThatRan(self.old, tried, self.earlier, swung, swings, unstable, left_range)

    def with_earlier(self, gains: PidGains | None) -> "Trial":
        """The trial with one more set that ran here."""
        if gains is None:
            return self
        return replace(self, earlier=(gains, *(one for one in self.earlier if one != gains))[:MOST_EARLIER])

    def to_dict(self) -> dict[str, object]:
        """Plain JSON values."""
        back, seen = self.back, self.seen
        return {
            "phase": self.phase.name.lower(),
            "old": _gains_out(self.old),
            "new": _gains_out(self.new),
            **plain_values(self, "promise=prediction ran since_s kept silent undos=rollbacks edits until_s"),
            "cause": self.cause.name.lower() if self.cause else None,
            "back": back and {"gains": _gains_out(back.gains), **plain_values(back, "stays reason numbers")},
            "earlier": [_gains_out(gains) for gains in self.earlier],
            "seen": seen and plain_value(seen._asdict()),
        }

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Trial":
        """The trial from its plain form.

        Raises KeyError, TypeError, ValueError: something is missing, or no value of its kind.
        """
        seen = back = None
        if body["seen"] is not None:
            at = {name: math.inf if value is None else float(value) for name, value in body["seen"].items()}
            seen = DivergenceState(**{name: kind(at[name]) for name, kind in WATCHED.items() if name in at})
        if (led := body["back"]) is not None:
            numbers = RollbackNumbers(**led["numbers"]) if led["numbers"] else None
            back = Rollback(PidGains(*led["gains"]), bool(led["stays"]), str(led["reason"]), numbers)
        return cls(
            phase=TrialPhase[str(body["phase"]).upper()],
            old=PidGains(*body["old"]) if body["old"] else None,
            new=PidGains(*body["new"]) if body["new"] else None,
            prediction=Prediction.from_dict(body["promise"]) if body["promise"] else None,
            ran=bool(body["ran"]),
            since_s=float(body["since_s"]),
            kept=int(body["kept"]),
            silent=int(body["silent"]),
            rollbacks=int(body["undos"]),
            edits=int(body["edits"]),
            until_s=float(body["until_s"]),
            cause=TrialEvent[str(body["cause"]).upper()] if body["cause"] else None,
            back=back,
            earlier=tuple(PidGains(*gains) for gains in body["earlier"]),
            seen=seen,
        )


def _gains_out(gains: PidGains | None) -> list[float] | None:
    return [gains.kp, gains.ki, gains.kd] if gains else None


WATCHED = DivergenceState.__annotations__
