"""What the ledger keeps of a controller's events, and which of them end a trial."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Protocol

from retuner.adaptive.decision import gains_dict
from retuner.adaptive.trial.phase import TrialEvent
from retuner.drivers.device import (
    CommandFailed,
    DeviceConflict,
    DeviceRestarted,
    Event,
    ForeignHost,
    LeaseChanged,
    LinkChanged,
    LinkState,
    Reverted,
    RunningChanged,
    SamplesLost,
    VariableChanged,
    WriteUnknown,
)

HELD_BY = (LinkChanged, DeviceRestarted, RunningChanged, Reverted, DeviceConflict, VariableChanged)
"""Events after which no decision is written for a while."""


class Recorder(Protocol):
    """Keeps rows for good before it returns: the ledger, seen from here."""

    def __call__(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        """Record one row."""
        ...


def trouble(event: Event) -> tuple[str, dict[str, object]]:
    """The row that tells of an event which is neither a sample nor the end of a write or command."""
    match event:
        case WriteUnknown():
            return "unknown", {"sequence": event.seq, "reason": event.reason}
        case LinkChanged():
            return "link", {"state": event.state.name.lower(), "reason": event.reason}
        case DeviceRestarted():
            return "restart", {"epoch": event.epoch, "gains": gains_dict(event.running.gains), "gap": event.gap}
        case RunningChanged() | Reverted():
            kind = "reverted" if isinstance(event, Reverted) else "foreign"
            return kind, {"gains": gains_dict(event.running.gains)}
        case LeaseChanged() | VariableChanged():
            return "lease" if isinstance(event, LeaseChanged) else "variable", asdict(event)
        case ForeignHost():
            return "foreign_host", {"commands": event.count}
        case DeviceConflict():
            return "conflict", {"node": event.node}
        case SamplesLost():
            return "lost", {"samples": event.count}
        case CommandFailed():
            return "command", {"command": event.command, "reason": event.reason}
        case _:
            raise TypeError(f"{type(event).__name__} is not an event that a session records")


def abort_cause(event: Event) -> TrialEvent | None:
    """Why an event ends an undecided trial; None when it does not. What samples tell, the retuner sees by itself."""
    match event:
        case LinkChanged():
            return None if event.state is LinkState.UP else TrialEvent.LINK_LOST
        case DeviceConflict():
            return TrialEvent.LINK_LOST
        case DeviceRestarted():
            return TrialEvent.RESTARTED
        case Reverted():
            return TrialEvent.DEVICE_REVERTED
        case RunningChanged():
            return TrialEvent.OPERATOR_EDIT
        case LeaseChanged():
            return None if event.ours else TrialEvent.OPERATOR_EDIT
        case WriteUnknown():
            return TrialEvent.WRITE_UNKNOWN
        case VariableChanged():  # nobody can say in which region its responses would be
            return None if event.known else TrialEvent.LOST_TELEMETRY
        case _:
            return None
