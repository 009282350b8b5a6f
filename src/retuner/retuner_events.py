"""What enters the pure retuner beside samples, as the ledger keeps it: the rows from which a replay feeds it again.

The session tells the retuner what happened and records a row of it at the same place in the order of samples. Here is
the way back, a line a kind of row; a kind that is not here told the retuner nothing.
"""

from collections.abc import Mapping
from typing import Any

from retuner.adaptive.decision import Decision
from retuner.adaptive.retuner import Retuner
from retuner.schedule.gains import PidGains


def feed(retuner: Retuner, kind: str, body: Mapping[str, Any], t_s: float) -> Decision | None:
    """Tell the retuner what a row says that it was told; the decision that this led to, if any.

    Raises
    ------
    KeyError, TypeError, ValueError
        The row is not what a session writes.
    """
    del t_s
    match kind, body.get("why"):
        case "committed", "retune":
            retuner.committed(retuner.table.index(str(body["region"])), gains_of(body["gains"]))
        case _:
            pass
    return None


def gains_of(body: Mapping[str, Any]) -> PidGains:
    """Gains as rows keep them: parallel form by name; errors as PidGains."""
    return PidGains(float(body["kp"]), float(body["ki"]), float(body["kd"]))
