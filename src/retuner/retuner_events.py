"""What enters the pure retuner beside samples, as the ledger keeps it: the rows from which a replay feeds it again.

The session tells the retuner what happened and records a row of it at the same place in the order of samples. Here is
the way back, a line a kind of row; a kind that is not here told the retuner nothing.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from retuner.adaptive.by_order import accept, approve, revert, unlock
from retuner.adaptive.decision import Decision
from retuner.adaptive.pretune import pretune
from retuner.adaptive.proposal import Proposal
from retuner.adaptive.retuner import Retuner
from retuner.adaptive.sample import Window
from retuner.adaptive.trial.phase import TrialEvent
from retuner.schedule.gains import PidGains


def feed(retuner: Retuner, kind: str, body: Mapping[str, Any], t_s: float) -> Decision | None:
    """Tell the retuner what a row says that it was told; the decision that this led to, if any.

    Raises
    ------
    KeyError, TypeError, ValueError
        The row is not what a session writes.
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
        case "pretune", _:
            return pretune(retuner, retuner.table.index(str(body["region"])), record_of(body["record"]))
        case "order", _:
            return _order(retuner, body, t_s) if body["accepted"] and body["due"] else None
        case _:
            pass
    return None


def _order(retuner: Retuner, body: Mapping[str, Any], t_s: float) -> Decision | None:
    """What a person ordered."""
    region = retuner.table.index(str(body["region"]))
    match body["order"]:
        case "approve" if body["proposal"] is not None:
            return approve(retuner, Proposal.from_dict(body["proposal"]), t_s)
        case "approve":
            accept(retuner, region, t_s)
        case "revert":
            return revert(retuner, region, gains_of(body["gains"]), t_s)
        case "unlock":
            unlock(retuner, region, t_s)
        case _:
            pass
    return None


def record_of(body: Mapping[str, Any]) -> Window:
    """The record of a commanded step as rows keep it; errors as Window."""
    return Window(*(np.array(body[name], dtype=np.float64) for name in ("t", "sp", "pv", "co")))


def gains_of(body: Mapping[str, Any]) -> PidGains:
    """Gains as rows keep them: parallel form by name; errors as PidGains."""
    return PidGains(float(body["kp"]), float(body["ki"]), float(body["kd"]))
