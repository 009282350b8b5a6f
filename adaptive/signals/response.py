"""A recognised response: the peaks of the control error and what an engineer reads from them.

    overshoot = -E2 / E1,   damping = (E3 - E2) / (E1 - E2),   period = t3 - t1 (or twice t2 - t1)

The same formulas for setpoint and load changes (Foxboro TI 039-200, 1995, figure 1). For a clean second-order decay
both numbers are equal; a large gap between them says that this is no ordinary response.
"""

from enum import StrEnum
from typing import NamedTuple

from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values


class Ending(StrEnum):
    """Why the recogniser stopped looking; the value is the sentence that people see."""

    COMPLETE = "three peaks verified"
    QUIET = "the error came to rest"
    TIMEOUT = "no further peak within the waiting time"
    SETPOINT = "cut short by the next setpoint change"
    GROWN = "its second extreme grew to several times the first"
    UNDONE = "cut short, because the gains on trial were rolled back"


class Peak(NamedTuple):
    """An extreme of the control error: when (s) and how large (pv units, signed)."""

    t_s: float
    e: float


@dataclass(frozen=True, slots=True)
class Response:
    """One response of the loop, from the upset to rest, third peak, time-out or the next upset.

    t_start_s, t_end_s : times of the samples where it was first and last seen.
    peaks : verified extremes of e = sp - pv in order, alternating in sign; at most three.
    ending : why it ended.
    sp_changed : the upset was a setpoint change (otherwise a load).
    band : noise band in pv units within which the error counted as zero.
    taken_over : other gains came into force in mid-response, and this is what they made of it: its first peak is not
    theirs alone, so its peaks are no pattern.
    """

    t_start_s: float
    t_end_s: float
    peaks: tuple[Peak, ...]
    ending: Ending
    sp_changed: bool
    band: float
    taken_over: bool = False

    @property
    def overshoot(self) -> float | None:
        """-E2/E1, or None without a second peak (an overdamped response)."""
        return -self.peaks[1].e / self.peaks[0].e if len(self.peaks) > 1 else None

    @property
    def damping(self) -> float | None:
        """(E3 - E2)/(E1 - E2), or None without a third peak. 0 is dead-beat, 1 an undamped oscillation."""
        if len(self.peaks) < 3:
            return None
        e1, e2, e3 = (p.e for p in self.peaks)
        return (e3 - e2) / (e1 - e2)

    @property
    def period_s(self) -> float | None:
        """Time of a full swing in seconds, or None without a second peak."""
        if len(self.peaks) < 2:
            return None
        first = self.peaks[0].t_s
        return self.peaks[2].t_s - first if len(self.peaks) > 2 else 2 * (self.peaks[1].t_s - first)

    def to_dict(self) -> dict[str, object]:
        """Plain values for a ledger or JSON."""
        return {
            **plain_values(self, "t_start_s t_end_s"),
            "peaks": [[p.t_s, p.e] for p in self.peaks],
            "ending": self.ending.name.lower(),
            "upset": "setpoint" if self.sp_changed else "load",
            **plain_values(self, "overshoot damping period_s band taken_over"),
        }
