"""What people order, looked at once more before it is written: an approved proposal, or the way back.

Both are changes like any other: absolute limits, direction, and Ms on what is known of the process now. An approval is
also held to the limits per change and must still start from the gains in force; the way back leads to a set that has
run before, so it is whole or not at all, and only a set that would make the known process unstable is refused.
"""

import math
from dataclasses import dataclass, field

from retuner.adaptive.guard import GuardSettings, change_factor, within_limits
from retuner.adaptive.margins import sensitivity_peak
from retuner.adaptive.process import LinearProcess
from retuner.adaptive.proposal import SAME_GAINS, Proposal, Standing
from retuner.schedule.gains import PidGains

WHOLE = 1 - 1e-6
"""Share of a change that is all of it: the logarithms round."""


@dataclass(frozen=True, slots=True)
class OrderRuling:
    """accepted : whether it may be written. code : for machines. reason : the sentence. numbers : what was weighed."""

    accepted: bool
    code: str
    reason: str
    numbers: dict[str, float] = field(default_factory=dict)


def approval_ruling(
    proposal: Proposal, in_force: PidGains, process: LinearProcess | None, settings: GuardSettings
) -> OrderRuling:
    """Whether an approved proposal may be written.

    in_force : gains of its region now. process : what is known of the region now, sampling included; None for nothing.
    """
    short = proposal.digest[:8]
    if change_factor(in_force, proposal.before) > SAME_GAINS:
        return OrderRuling(False, "approval_other_gains", f"proposal {short} is not written: {Standing.OTHER_GAINS}")
    moved = within_limits(in_force, proposal.after, 1.0, settings)
    if moved is None or moved[1] < WHOLE:
        return OrderRuling(False, "approval_outside_limits", f"proposal {short} is not written: it lies outside the "
                           "limits of a change as they are set now")  # fmt: skip
    before, after = _ms(process, in_force), _ms(process, proposal.after)
    numbers = _numbers(before, after)
    if after > settings.ms_nominal and not after < before:
        reason = f"Ms would be {_text(after)} on the process as it is known now, the limit is {settings.ms_nominal:g}"
        return OrderRuling(False, "approval_not_robust", f"proposal {short} is not written: {reason}", numbers)
    return OrderRuling(True, "approved", f"proposal {short} of {proposal.t_s:,.0f} s was approved", numbers)


def revert_ruling(
    gains: PidGains, in_force: PidGains, process: LinearProcess | None, settings: GuardSettings
) -> OrderRuling:
    """Whether a region may go back to these gains, which were in force before. Arguments as approval_ruling."""
    if gains.direction != in_force.direction:
        return OrderRuling(False, "revert_wrong_sign", "the way back is not taken: these gains act the other way round")
    if change_factor(gains, in_force) <= SAME_GAINS:
        return OrderRuling(False, "revert_in_force", "nothing to take back: these gains are in force")
    if not settings.kc_min <= abs(gains.kp) <= settings.kc_max:
        return OrderRuling(
            False, "revert_outside_limits", "the way back is not taken: it lies outside kc_min and kc_max"
        )
    before, after = _ms(process, in_force), _ms(process, gains)
    numbers = _numbers(before, after)
    if math.isinf(after) and not math.isinf(before):
        return OrderRuling(False, "revert_unstable", "the way back is not taken: on the process as it is known now "
                           "these gains would be unstable", numbers)  # fmt: skip
    return OrderRuling(True, "ordered_back", "a person ordered the way back to these gains", numbers)


def _ms(process: LinearProcess | None, gains: PidGains) -> float:
    """Ms, 0 where no process is known."""
    return 0.0 if process is None else sensitivity_peak(process, gains)


def _numbers(before: float, after: float) -> dict[str, float]:
    """Ms before and after, where they are finite and a process is known."""
    return {name: ms for name, ms in (("ms_before", before), ("ms_after", after)) if 0 < ms < math.inf}


def _text(ms: float) -> str:
    """Ms in words."""
    return "infinite (unstable)" if math.isinf(ms) else f"{ms:.2f}"
