"""Ultimate gain from the swing itself: period and decay of pv under proportional control (Ziegler & Nichols 1942).

At the ultimate gain the swing neither grows nor dies: Ku is the controller's gain, Pu the period. Where the amplitude
falls to a quarter in a period, gain and period are Kq and Pq of the quarter-decay rule (Harriott 1964).
Periods are read between upward crossings of the mean; a crossing counts only after pv has been on the other side by
more than the noise. The decay is the geometric mean of the ratios of successive half-heights.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.experiments.plan import CLEAR
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

FEWEST_PERIODS = 3
"""Whole periods from which a period and a decay are given."""
SUSTAINED = (0.9, 1.1)
"""Ratio of successive amplitudes within which a swing is sustained."""
QUARTER = (0.18, 0.35)
"""Ratio of successive amplitudes that counts as quarter decay."""


@dataclass(frozen=True, slots=True)
class Swing:
    """An oscillation of pv.

    period_s, period_std_s : mean and standard deviation over the periods. amplitude : half the height, mean.
    decay : ratio of one period's height to the one before. periods : how many.
    """

    period_s: float
    period_std_s: float
    amplitude: float
    decay: float
    periods: int

    @property
    def sustained(self) -> bool:
        """Whether it neither grows nor dies."""
        return SUSTAINED[0] <= self.decay <= SUSTAINED[1]

    @property
    def quarter_decay(self) -> bool:
        """Whether it dies by about a quarter a period."""
        return QUARTER[0] <= self.decay <= QUARTER[1]

    def verdict(self) -> str:
        """What the gain of the experiment was, in words."""
        if self.sustained:
            return "sustained: the gain is the ultimate gain Ku"
        if self.quarter_decay:
            return f"each swing is {self.decay:.2f} of the one before: quarter decay, the gain is Kq"
        if self.decay > 1:
            return f"each swing is {self.decay:.2f} times the one before: lower the gain towards Ku"
        return f"each swing is {self.decay:.2f} of the one before: raise the gain towards Ku"

    def to_dict(self) -> dict[str, float | int | bool]:
        """Keys as in the JSON output of `retuner experiment ultimate`."""
        return {
            "period": self.period_s,
            "period_std": self.period_std_s,
            "amplitude": self.amplitude,
            "decay": self.decay,
            "periods": self.periods,
            "sustained": self.sustained,
            "quarter_decay": self.quarter_decay,
        }


def swing(window: Window) -> Swing:
    """Read period and decay off a record.

    Raises
    ------
    ValueError
        pv does not swing, or for fewer than three periods.
    """
    # The level about which pv swings: the mean of the last half, where a start has died out
    level = float(np.mean(window.pv[len(window.pv) // 2 :]))
    times, spans = _upward(window.t_s, window.pv - level)
    periods = np.diff(np.array(times))
    heights = np.array([float(np.ptp(window.pv[a:b])) / 2 for a, b in spans])
    whole = heights > 2 * CLEAR * noise_sigma(window.pv)  # what has died into the noise shows no period any more
    last = len(whole) if np.all(whole) else int(np.argmin(whole))
    periods, heights = periods[:last], heights[:last]
    if last < FEWEST_PERIODS:
        raise ValueError(
            f"pv oscillates for {last} periods beyond its noise, and {FEWEST_PERIODS} are needed: record "
            "longer, or raise the gain"
        )
    decay = float((heights[-1] / heights[0]) ** (1 / (len(heights) - 1)))
    return Swing(float(np.mean(periods)), float(np.std(periods)), float(np.mean(heights)), decay, len(periods))


def _upward(t_s: FloatArray, y: FloatArray) -> tuple[list[float], list[tuple[int, int]]]:
    """Times of upward crossings of zero (interpolated), and the samples between each two."""
    band = CLEAR * noise_sigma(y)
    times, indices = [], []
    armed = False
    for i in range(1, len(y)):
        if y[i] < -band or (band == 0 and y[i] < 0):
            armed = True
        if armed and y[i] >= band and y[i] > 0:
            j = i - int(np.argmax(y[i - 1 :: -1] <= 0))  # back to the sample after the last one below
            share = -y[j - 1] / (y[j] - y[j - 1]) if y[j] != y[j - 1] else 0.0
            times.append(float(t_s[j - 1] + share * (t_s[j] - t_s[j - 1])))
            indices.append(j)
            armed = False
    return times, [(indices[i], indices[i + 1]) for i in range(len(indices) - 1)]
