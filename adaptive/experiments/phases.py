"""The states of an experiment on demand, as data: one enum, one table, every way out ends in the verified old state.

    CONNECTING -> RESTING -> PREPARING -> EXCITING -> PARKING -> RESTORING -> RESTORED
    aborted in CONNECTING or RESTING: RESTORED at once, nothing has been touched yet
    aborted in PREPARING or EXCITING: PARKING; in PARKING or RESTORING: goes on
    old state not verified in time: STRANDED

PARKING holds the output where it was before the controller takes over again; RESTORING sends gains, setpoint and mode
of before and waits until they have been read back. What calls for leaving is an abort, whatever its cause; an abort
while the old state is being restored changes nothing: restoring goes on.
"""

from enum import Enum, auto


class Phase(Enum):
    """How far an experiment is."""

    CONNECTING = "waiting for the controller"
    RESTING = "checking that the loop is at rest"
    PREPARING = "taking control"
    EXCITING = "test running"
    PARKING = "returning the output"
    RESTORING = "restoring the initial state"
    RESTORED = "initial state restored and read back"
    STRANDED = "initial state not verified"

    @property
    def over(self) -> bool:
        """Whether nothing more happens."""
        return self in {Phase.RESTORED, Phase.STRANDED}

    @property
    def touched(self) -> bool:
        """Whether the controller may be in another state than before."""
        return self in {Phase.PREPARING, Phase.EXCITING, Phase.PARKING, Phase.RESTORING}


class Happening(Enum):
    """What moves an experiment on."""

    CONNECTED = auto()
    AT_REST = auto()
    PREPARED = auto()
    FINISHED = auto()
    ABORTED = auto()
    PARKED = auto()
    VERIFIED = auto()
    GIVEN_UP = auto()


class AbortCause(Enum):
    """Why an experiment was aborted; the text goes on with what was seen."""

    PV_BAND = "pv left its band"
    NO_ROOM = "the output has no room for this amplitude"
    SATURATED = "the output does not follow"
    TIME = "the time limit has passed"
    NEVER_SWITCHED = "the relay never switched back"
    NOT_AT_REST = "the loop did not come to rest"
    WRONG_MODE = "the controller is in the wrong mode"
    SILENT = "telemetry was lost"
    RESTARTED = "the controller has restarted"
    FOREIGN = "someone else changed the controller"
    REFUSED = "the controller refused a command"
    INTERRUPTED = "stopped by the user"
    RECORDER = "the ledger cannot be written"


P, H = Phase, Happening
TRANSITIONS: dict[Phase, dict[Happening, Phase]] = {
    P.CONNECTING: {H.CONNECTED: P.RESTING, H.ABORTED: P.RESTORED},
    P.RESTING: {H.AT_REST: P.PREPARING, H.ABORTED: P.RESTORED},
    P.PREPARING: {H.PREPARED: P.EXCITING, H.ABORTED: P.PARKING},
    P.EXCITING: {H.FINISHED: P.PARKING, H.ABORTED: P.PARKING},
    P.PARKING: {H.PARKED: P.RESTORING, H.ABORTED: P.PARKING, H.GIVEN_UP: P.STRANDED},
    P.RESTORING: {H.VERIFIED: P.RESTORED, H.ABORTED: P.RESTORING, H.GIVEN_UP: P.STRANDED},
    P.RESTORED: {H.ABORTED: P.RESTORED},
    P.STRANDED: {H.ABORTED: P.STRANDED},
}
"""Where each happening leads; what is not in the table cannot happen there."""


def after(phase: Phase, happening: Happening) -> Phase:
    """The next phase. Raises ValueError: this cannot happen in this phase."""
    try:
        return TRANSITIONS[phase][happening]
    except KeyError:
        raise ValueError(f"{happening.name} cannot happen in {phase.name}") from None
