"""What the ledger keeps of a controller's events, and which of them end a trial."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from retuner.adaptive.orders.operator_orders import accept, acts, approve, pretune, propose, revert, set_mode, unlock
from retuner.adaptive.orders.pending_proposal import Proposal
from retuner.adaptive.setpoint_bumps.bump_planner import BumpPhase
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.decision import Decision, Mode, gains_dict
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.trial.phase import TrialEvent
from retuner.decisions.decider import LATE, LOST, Answer, without_decision
from retuner.drivers.device import (
    CommandFailed,
    DeviceConflict,
    DeviceRestarted,
    DeviceStopped,
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
from retuner.ledger import Row
from retuner.products import product
from retuner.schedule.gains import PidGains

HELD_BY = (LinkChanged, DeviceRestarted, RunningChanged, Reverted, DeviceConflict, DeviceStopped, VariableChanged)
"""Events after which no decision is written for a while."""


IN_PLACE = frozenset(phase.name.lower() for phase in (BumpPhase.WATCHING, BumpPhase.ANNOUNCED))
"""Phases of a bump, as rows name them, in which the setpoint has not been moved."""


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
            return "reverted" if isinstance(event, Reverted) else "foreign", {"gains": gains_dict(event.running.gains)}
        case LeaseChanged() | VariableChanged():
            return "lease" if isinstance(event, LeaseChanged) else "variable", asdict(event)
        case ForeignHost():
            return "foreign_host", {"commands": event.count}
        case DeviceConflict():
            return "conflict", {"node": event.node}
        case SamplesLost():
            why = {"reason": event.reason} if event.reason else {}
            return "lost", {"count": event.count, **why}  # "samples" is the place of every row
        case CommandFailed() | DeviceStopped():
            return "stopped" if isinstance(event, DeviceStopped) else "command", asdict(event)
        case _:
            raise TypeError(f"{type(event).__name__} is not an event that a session records")


def abort_cause(event: Event) -> TrialEvent | None:
    """Why an event ends an undecided trial; None when it does not. What samples tell, the retuner sees by itself."""
    match event:
        case LinkChanged():
            return None if event.state is LinkState.UP else TrialEvent.LINK_LOST
        case LeaseChanged():
            return None if event.ours else TrialEvent.LEASE_LOST
        case VariableChanged():  # nobody can say in which region its responses would be
            return None if event.known else TrialEvent.LOST_TELEMETRY
        case _:
            return ENDS_TRIAL.get(type(event))


ENDS_TRIAL: dict[type, TrialEvent] = {
    DeviceConflict: TrialEvent.LINK_LOST,
    DeviceRestarted: TrialEvent.RESTARTED,
    DeviceStopped: TrialEvent.DEVICE_STOPPED,
    Reverted: TrialEvent.DEVICE_REVERTED,
    WriteUnknown: TrialEvent.WRITE_UNKNOWN,
}
"""Events that end an undecided trial whatever they say."""


def bump_left(rows: Iterable[Row]) -> tuple[float, float] | None:
    """Setpoints before and after a bump that the rows' last session left out; None where it took it back.

    Raises KeyError, TypeError, ValueError: the row is not what a session writes.
    """
    body = next((row.body for row in reversed(tuple(rows)) if row.kind in {"bump", "nudge"}), None)
    if body is None or body["phase"] in IN_PLACE:
        return None
    return float(body["before"]), float(body["to"])


# What enters the pure retuner beside samples, as the ledger keeps it: the rows from which a replay feeds it again.
#
# The session tells the retuner what happened and records a row of it at the same place in the order of samples. Here is
# the way back, a line a kind of row; a kind that is not here told the retuner nothing.


def feed(retuner: Retuner, kind: str, body: Mapping[str, Any], t_s: float) -> Decision | None:
    """Tell the retuner what a row says that it was told; the decision that this led to, if any.

    Raises KeyError, TypeError, ValueError: the row is not what a session writes.
    """
    match kind, body.get("why"):
        case "committed", "retune":
            retuner.committed(retuner.table.index(str(body["region"])), gains_of(body.get("stored") or body["gains"]))
        case ("refused", "retune") | ("dropped", "retune"):
            if body.get("unchanged", True):
                retuner.not_written(retuner.table.index(str(body["region"])))
        case "abort", _:
            return retuner.abort(TrialEvent[str(body["cause"]).upper()])
        case "restored", _:
            retuner.restored()
        case "action", _:  # somebody has turned the controller's direction, or turned it back
            return acts(retuner, gains_of(body["gains"]))
        case "foreign", _:
            gains = gains_of(body["gains"])
            return None if retuner.action_reversed else retuner.edited(gains)
        case "answer", _:  # to the open question, worked out again; or the sentence that was entered in place of one
            question, trouble, code = retuner.open_question, str(body["reason"]), str(body["code"])
            if question is None or question.sample_number != body["asked"]:
                raise ValueError(f"it answers a question of sample {body['asked']}, which is not open")
            if trouble and code not in {LATE, LOST}:
                answer = product("one plant").answered_again(question, code, trouble)
            else:
                answer = without_decision(code, trouble) if trouble else Answer(decide(question))
            return retuner.enter(question, answer.result, retuner.sample_number)
        case "pretune", _:
            at_s, sp, pv, co = (np.array(body["record"][name], dtype=np.float64) for name in ("t", "sp", "pv", "co"))
            return pretune(retuner, retuner.table.index(str(body["region"])), Window(at_s, sp, pv, co))
        case "order", _:
            return _order(retuner, body, t_s) if body["accepted"] and body["due"] else None
        case _:
            pass
    return None


def _order(retuner: Retuner, body: Mapping[str, Any], t_s: float) -> Decision | None:
    if body["order"] == "mode":
        return set_mode(
            retuner, retuner.table.index(str(body["region"])) if body["region"] else None, Mode(body["mode"])
        )
    region = retuner.table.index(str(body["region"]))
    match body["order"]:
        case "approve" if body["proposal"] is not None:
            return approve(retuner, Proposal.from_dict(body["proposal"]), t_s)
        case "approve":
            accept(retuner, region, t_s)
        case "propose":
            return propose(retuner, region, gains_of(body["gains"]), t_s)
        case "revert":
            return revert(retuner, region, gains_of(body["gains"]), t_s)
        case "reject" if body["tried"]:
            return retuner.rolled_back(region)
        case "unlock":
            unlock(retuner, region, t_s)
        case _:
            pass
    return None


def gains_of(body: Mapping[str, Any]) -> PidGains:
    """Gains as rows keep them: parallel form by name; errors as PidGains."""
    return PidGains(float(body["kp"]), float(body["ki"]), float(body["kd"]))
