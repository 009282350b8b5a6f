"""Where a change of gains stands in its region: one enum of phases, one of events, one table.

    IDLE -> WRITING -> TRIAL -> IDLE (or WAITING for a person)      the good way
    a cause that ends trials, in WRITING, TRIAL, AWAY or PAUSED     rollback.py says which set is to run:
        another set, or any evidence against the tried set -> RESTORING -> COOLING -> IDLE (or LOCKED)
        else, the tried set stays -> PAUSED (or ENSURING first, where it may not run) -> TRIAL
    a person's edit, in any phase      -> HELD -> IDLE

What is to run is put into the table by ENTERING the phase, whatever led there. RESTORING and ENSURING are left in one
way only: the controller has reported that it runs that set. Everything else that can happen there leaves them where
they are, except a person's edit.
"""

from enum import StrEnum


class TrialPhase(StrEnum):
    """Phases; the value is what people read."""

    IDLE = "idle"
    WRITING = "writing"
    TRIAL = "on trial"
    AWAY = "on trial, the loop is in another region"
    PAUSED = "on trial, the loop cannot be observed"
    ENSURING = "on trial, not yet sure that the gains are active"
    RESTORING = "rolling back to the verified gains"
    COOLING = "cooling down"
    WAITING = "passed, awaiting operator approval"
    LOCKED = "locked"
    HELD = "on hold: an operator set these gains"


class TrialEvent(StrEnum):
    """Everything that can happen to a change; the value is the clause that people read."""

    PROPOSED = "a change is to be written"
    URGENT = "an urgent change towards stability is to be written"
    ORDERED = "an operator requested a change"
    WRITTEN = "the trial gains are active, as read back"
    NOT_WRITTEN = "nothing was written, the active gains are unchanged"
    GOOD = "a response was better than predicted"
    AS_PROMISED = "a response was as predicted"
    INCONCLUSIVE = "a response was inconclusive"
    PASSED = "enough responses matched the prediction"
    PASSED_FOR_APPROVAL = "enough responses matched the prediction: awaiting operator approval"
    UNDECIDED = "enough responses were inconclusive: trial gains kept"
    UNDECIDED_FOR_APPROVAL = "the responses were inconclusive: awaiting operator approval"
    LEFT = "the loop left the region"
    ENTERED = "the loop came back to the region"
    WORSE = "a response was worse than predicted"
    RUNAWAY = "the loop became unstable"
    SATURATED = "the output stood at a limit"
    MANUAL = "the loop was taken to manual"
    GAP = "samples were missing"
    LOST_TELEMETRY = "no samples came any more"
    LINK_LOST = "the link was lost"
    LEASE_LOST = "another host took write access"
    RESTARTED = "the controller restarted"
    DEVICE_REVERTED = "the controller returned to its confirmed gains"
    DEVICE_STOPPED = "the controller stopped by itself"
    ACTION_TURNED = "the controller acts in the other direction"
    OPERATOR_EDIT = "gains were changed by someone else"
    WRITE_UNKNOWN = "it is unknown whether the write took effect"
    LEFT_INTERPOLATED = "the loop left the region, whose trial gains still affect the interpolation"
    TIMED_OUT = "no response decided the trial in time"
    STOPPED = "the session ended"
    ORDERED_BACK = "an operator requested a rollback"
    STAYS = "trial gains kept"
    ENSURED = "trial gains kept, and checked to be active"
    WATCHED = "the loop can be watched again"
    RESTORED = "the right gains are active, as read back"
    COOLED = "the cool-down is over"
    TOO_MANY_UNDOS = "too many changes were rolled back"
    APPROVED = "an operator approved the trial"
    UNLOCKED = "an operator unlocked the region"
    HOLD_OVER = "the hold on an operator's gains is over"


P, E = TrialPhase, TrialEvent

ROLLBACK_CAUSES = (E.WORSE, E.RUNAWAY)
"""Causes that speak against the tried set: each doubles the cool-down, and many lock the region."""
SILENT = (
    E.SATURATED, E.MANUAL, E.GAP, E.LOST_TELEMETRY, E.LINK_LOST, E.LEASE_LOST, E.RESTARTED, E.DEVICE_REVERTED,
    E.DEVICE_STOPPED, E.ACTION_TURNED, E.WRITE_UNKNOWN, E.LEFT_INTERPOLATED, E.TIMED_OUT, E.STOPPED,
)  # fmt: skip
"""Causes that say nothing of the set."""
ABORTS = (*ROLLBACK_CAUSES, *SILENT, E.ORDERED_BACK)
"""Causes that end an undecided trial where the tried set does not stay."""
UNSURE = (
    E.LINK_LOST, E.LEASE_LOST, E.LOST_TELEMETRY, E.RESTARTED, E.DEVICE_REVERTED, E.DEVICE_STOPPED, E.ACTION_TURNED,
    E.WRITE_UNKNOWN, E.STOPPED,
)  # fmt: skip
"""Events after which the controller may run something else, or may come to."""
LASTING = (E.SATURATED, E.MANUAL, E.GAP, E.LOST_TELEMETRY, E.LEFT_INTERPOLATED, E.TIMED_OUT)
"""Events that every sample or every poll tells anew: once the session ends they ask for nothing more."""
UNDECIDED = (P.WRITING, P.TRIAL, P.AWAY, P.PAUSED, P.ENSURING)
"""Phases in which a set that has not passed may run, or would be written again."""
TO_BE_SEEN = (P.RESTORING, P.ENSURING)  # phases that wait until the controller has reported what it runs

TRANSITIONS: dict[tuple[TrialPhase, TrialEvent], TrialPhase] = {
    (P.IDLE, E.PROPOSED): P.WRITING,
    (P.IDLE, E.URGENT): P.WRITING,
    (P.COOLING, E.URGENT): P.WRITING,
    (P.IDLE, E.ORDERED): P.WRITING,
    (P.HELD, E.ORDERED): P.WRITING,
    (P.WRITING, E.WRITTEN): P.TRIAL,
    (P.WRITING, E.NOT_WRITTEN): P.IDLE,
    (P.TRIAL, E.LEFT): P.AWAY,
    (P.PAUSED, E.LEFT): P.AWAY,
    (P.AWAY, E.ENTERED): P.TRIAL,
    (P.TRIAL, E.PASSED): P.IDLE,
    (P.TRIAL, E.PASSED_FOR_APPROVAL): P.WAITING,
    **{(phase, E.UNDECIDED): P.IDLE for phase in (P.TRIAL, P.AWAY)},
    **{(phase, E.UNDECIDED_FOR_APPROVAL): P.WAITING for phase in (P.TRIAL, P.AWAY)},
    **{(phase, cause): P.RESTORING for phase in UNDECIDED for cause in ABORTS},
    (P.TRIAL, E.STAYS): P.PAUSED,
    **{(phase, E.ENSURED): P.ENSURING for phase in (P.TRIAL, P.PAUSED)},
    (P.RESTORING, E.ENSURED): P.ENSURING,
    (P.PAUSED, E.WATCHED): P.TRIAL,
    (P.WAITING, E.APPROVED): P.IDLE,
    (P.WAITING, E.ORDERED_BACK): P.RESTORING,
    (P.RESTORING, E.RESTORED): P.COOLING,
    (P.ENSURING, E.RESTORED): P.PAUSED,
    (P.COOLING, E.TOO_MANY_UNDOS): P.LOCKED,
    (P.COOLING, E.COOLED): P.IDLE,
    (P.LOCKED, E.UNLOCKED): P.IDLE,
    **{(phase, E.OPERATOR_EDIT): P.HELD for phase in TrialPhase if phase not in {P.HELD, P.LOCKED}},
    (P.HELD, E.HOLD_OVER): P.IDLE,
}
"""Everything that is not here leaves the phase as it is."""


def after(phase: TrialPhase, event: TrialEvent) -> TrialPhase:
    """The phase after an event."""
    return TRANSITIONS.get((phase, event), phase)
