"""The trend of a run: every sample with the region and the gains that were in force."""

from dataclasses import dataclass, field

import numpy as np

from retuner.adaptive.sample import FloatArray, LoopSample
from retuner.schedule.gains import PidGains

COLUMNS = ("t", "sp", "pv", "co", "x", "mode", "limited", "region", "sequence", "kp", "ki", "kd")
"""t in s, sp and pv in pv units, co in percent, region as index, sequence of the gain set, parallel gains."""


@dataclass(slots=True)
class Trend:
    """Rows of COLUMNS, in the order of time."""

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, sample: LoopSample, region: int, gains: PidGains) -> None:
        """Take one sample."""
        s = sample
        self.rows.append((s.t_s, s.sp, s.pv, s.co, s.x, s.mode, s.limited, region, s.revision,
                          gains.kp, gains.ki, gains.kd))  # fmt: skip

    def columns(self) -> dict[str, FloatArray]:
        """Arrays by column name, each of shape (n,)."""
        table = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), len(COLUMNS))
        return {name: table[:, i] for i, name in enumerate(COLUMNS)}
