"""The trend of a loop as arrays: what `retuner.simulate` gives, and what a `PidController` keeps of its own loop."""

import importlib.util
from array import array
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from retuner.adaptive import display_hook
from retuner.adaptive.loop.replayed import mean_error, way
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("t", "sp", "pv", "co", "kp", "ki", "kd")
Frame: TypeAlias = Any  # A pandas.DataFrame; pandas is not imported until asked for


@dataclass(frozen=True, slots=True)
class LoopTrend(display_hook.Drawn):
    """What a loop did, sample by sample; all arrays of shape (n,).

    Attributes
    ----------
    t_s : seconds.
    sp, pv : pv units.
    co : co units, held until the next sample.
    kp, ki, kd : parallel gains in force, NaN where the controller does not tell them.
    """

    t_s: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray
    kp: FloatArray
    ki: FloatArray
    kd: FloatArray

    def __repr__(self) -> str:
        told = f"mean error {self.error:.3g}, co travel {self.travel:.4g}" if len(self.t_s) else "nothing yet"
        return f"LoopTrend({len(self.t_s)} samples: {told}, gains changed {len(self.changes_s)} times)"

    def plot(self) -> "Figure":
        """The picture: setpoint and pv above, co below, a line where gains changed."""
        figure: Figure = display_hook.figure(self)
        return figure

    @property
    def error(self) -> float:
        """Mean of |sp - pv|, pv units."""
        return mean_error(self.sp, self.pv)

    @property
    def travel(self) -> float:
        """Sum of the moves of co, co units."""
        return way(self.co)

    @property
    def changes_s(self) -> list[float]:
        """When other gains came into force, seconds."""
        gains = np.nan_to_num(np.stack([self.kp, self.ki, self.kd]))
        return [float(self.t_s[i]) for i in np.flatnonzero(np.any(np.diff(gains, axis=1) != 0.0, axis=0)) + 1]

    @property
    def window(self) -> Window:
        """The trend as a record for a fit; ValueError where it has fewer than three samples."""
        return Window(self.t_s, self.sp, self.pv, self.co)

    def part(self, from_s: float, until_s: float) -> "LoopTrend":
        """The samples with from_s <= t < until_s."""
        keep = (self.t_s >= from_s) & (self.t_s < until_s)
        return LoopTrend(*(values[keep] for values in self.columns().values()))

    def columns(self) -> dict[str, FloatArray]:
        """Arrays by name: t, sp, pv, co, kp, ki, kd."""
        return dict(zip(COLUMNS, (self.t_s, self.sp, self.pv, self.co, self.kp, self.ki, self.kd), strict=True))

    def frame(self) -> Frame:
        """A pandas.DataFrame of the columns; where pandas is not installed the columns themselves."""
        if importlib.util.find_spec("pandas") is None:
            return self.columns()
        return import_module("pandas").DataFrame(self.columns())


class History:
    """The newest samples of a loop, in one flat array: 56 bytes each.

    most : samples that are kept at least; 0 for none at all.

    Raises ValueError: most is negative.
    """

    def __init__(self, most: int) -> None:
        if most < 0:
            raise ValueError(f"history = {most} samples: give 0 or more")
        self._most, self._values = most, array("d")

    def add(self, row: tuple[float, ...]) -> None:
        """Take a sample: the numbers of COLUMNS."""
        if not self._most:
            return
        self._values.extend(row)
        if len(self._values) >= 2 * self._most * len(COLUMNS):
            self._values = self._values[-self._most * len(COLUMNS) :]

    def trend(self) -> LoopTrend:
        """The newest samples as a trend."""
        table = np.array(self._values, dtype=np.float64).reshape(-1, len(COLUMNS))[-self._most or len(self._values) :]
        return LoopTrend(*table.T)
