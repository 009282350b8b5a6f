"""Where a change of gains stands in its region: one enum of phases, one of events, one table.

    IDLE -> WRITING -> TRIAL -> IDLE (or WAITING for a person)      the good way
    any abort cause in WRITING, TRIAL or AWAY -> RESTORING -> COOLING -> IDLE (or LOCKED)

The old set is put back by ENTERING RESTORING, whatever led there, and RESTORING is left in one way only: the controller
has reported that it runs the verified set again. Everything else that can happen there leaves it where it is.
"""

from enum import StrEnum


class TrialPhase(StrEnum):
    """Phases; the value is what people read."""

    IDLE = "idle"
    WRITING = "writing"
    TRIAL = "on trial"
    AWAY = "on trial, the loop is in another region"
    RESTORING = "restoring the verified set"
    COOLING = "cooling down"
    WAITING = "passed, waiting for a person"
    LOCKED = "locked out"


class TrialEvent(StrEnum):
    """Everything that can happen to a change; the value is the clause that people read."""

    PROPOSED = "a change is to be written"
    URGENT = "an urgent change in the safe direction is to be written"
    WRITTEN = "the controller runs the tried set, as read back"
    NOT_WRITTEN = "nothing was written, the controller runs what it ran"
    GOOD = "a response was better than promised"
    AS_PROMISED = "a response was as promised"
    INCONCLUSIVE = "a response says nothing for or against"
    PASSED = "enough responses kept the promise"
    PASSED_FOR_APPROVAL = "enough responses kept the promise; a person has the next word"
    LEFT = "the loop left the region"
    ENTERED = "the loop came back to the region"
    WORSE = "a response was worse than promised"
    RUNAWAY = "the loop began to run away"
    SATURATED = "the output stood at a limit"
    MANUAL = "the loop was taken to manual"
    LOST_TELEMETRY = "samples are missing"
    LINK_LOST = "the link was lost"
    RESTARTED = "the controller restarted"
    DEVICE_REVERTED = "the controller went back to its confirmed set"
    DEVICE_STOPPED = "the controller stopped by itself"
    OPERATOR_EDIT = "somebody else wrote gains"
    WRITE_UNKNOWN = "it is not known whether the write took effect"
    LEFT_INTERPOLATED = "the loop left the region, where the tried set still takes part in the interpolation"
    TIMED_OUT = "no response decided the trial in time"
    STOPPED = "the session ends"
    ORDERED_BACK = "a person wants the old set back"
    RESTORED = "the controller runs the verified set, as read back"
    COOLED = "the cool-down is over"
    TOO_MANY_UNDOS = "too many changes had to be undone"
    APPROVED = "a person approved what was tried"
    UNLOCKED = "a person took the lock off"


P, E = TrialPhase, TrialEvent

UNDOS = (E.WORSE, E.RUNAWAY)
"""Causes that speak against the tried set: each doubles the cool-down, and many lock the region."""
ABORTS = (
    *UNDOS,
    E.SATURATED,
    E.MANUAL,
    E.LOST_TELEMETRY,
    E.LINK_LOST,
    E.RESTARTED,
    E.DEVICE_REVERTED,
    E.DEVICE_STOPPED,
    E.OPERATOR_EDIT,
    E.WRITE_UNKNOWN,
    E.LEFT_INTERPOLATED,
    E.TIMED_OUT,
    E.STOPPED,
    E.ORDERED_BACK,
)
"""Causes that end an undecided trial on the verified old set."""
UNDECIDED = (P.WRITING, P.TRIAL, P.AWAY)
"""Phases in which a set that has not passed may run, or would be written again."""

TRANSITIONS: dict[tuple[TrialPhase, TrialEvent], TrialPhase] = {
    (P.IDLE, E.PROPOSED): P.WRITING,
    (P.IDLE, E.URGENT): P.WRITING,
    (P.COOLING, E.URGENT): P.WRITING,
    (P.WRITING, E.WRITTEN): P.TRIAL,
    (P.WRITING, E.NOT_WRITTEN): P.IDLE,
    (P.TRIAL, E.LEFT): P.AWAY,
    (P.AWAY, E.ENTERED): P.TRIAL,
    (P.TRIAL, E.PASSED): P.IDLE,
    (P.TRIAL, E.PASSED_FOR_APPROVAL): P.WAITING,
    **{(phase, cause): P.RESTORING for phase in UNDECIDED for cause in ABORTS},
    (P.WAITING, E.APPROVED): P.IDLE,
    (P.WAITING, E.ORDERED_BACK): P.RESTORING,
    (P.RESTORING, E.RESTORED): P.COOLING,
    (P.COOLING, E.TOO_MANY_UNDOS): P.LOCKED,
    (P.COOLING, E.COOLED): P.IDLE,
    (P.LOCKED, E.UNLOCKED): P.IDLE,
}
"""Everything that is not here leaves the phase as it is."""


def after(phase: TrialPhase, event: TrialEvent) -> TrialPhase:
    """The phase after an event."""
    return TRANSITIONS.get((phase, event), phase)
