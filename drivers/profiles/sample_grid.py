"""At which sample a value belongs, for devices that send no sample counter: by the time of its arrival.

Sample n stands at origin + n sample times. Where the controller sends at its own pace, the origin follows the arrivals
slowly, so that neither jitter nor clocks that differ a little lose or invent samples; where it is asked, the host's
clock is the pace.
"""

import math

FOLLOW = 0.05
"""Share of an arrival's distance from its place by which the origin moves: jitter of one arrival does little."""
EARLY = 0.5
"""Samples by which an arrival may be early and still be the next one."""
ROUNDING = 1e-9
LOOKED_AT = 16
"""Samples that were due over which it is looked whether half of them are lost."""
PAUSE = 8
"""More samples lost at once than this are a silence, and say nothing of the pace."""


class SampleGrid:
    """See the head of this file.

    Parameters
    ----------
    sample_time_s : in s. asked : the host's clock is the pace. after_s : samples come behind this time.
    """

    def __init__(self, sample_time_s: float, *, asked: bool = False, after_s: float | None = None) -> None:
        self._sample_time_s, self._asked = sample_time_s, asked
        self._origin_s: float | None = None
        self._last = 0 if after_s is None else math.floor(after_s / sample_time_s)
        self._due = self._taken = 0
        self._told = self._seen = False

    def due(self, now_s: float) -> bool:
        """Whether the next sample is to be taken, or asked for."""
        if self._origin_s is None:
            return True
        early = 0.0 if self._asked else EARLY
        return now_s >= self._origin_s + (self._last + 1 - early) * self._sample_time_s - ROUNDING

    def place(self, now_s: float) -> tuple[float, int] | None:
        """The time of the sample that arrives now, and how many before it never came; None when none is due."""
        if self._origin_s is None:
            self._origin_s = now_s - (self._last + 1) * self._sample_time_s
        if not self.due(now_s):
            return None
        places = (now_s - self._origin_s) / self._sample_time_s
        number = max(round(places) if not self._asked else math.floor(places + ROUNDING), self._last + 1)
        if not self._asked:
            self._origin_s += FOLLOW * (places - number) * self._sample_time_s
        lost = number - self._last - 1
        self._last = number
        # Count what was due and what came since the sample with which the count began
        if self._due >= LOOKED_AT or lost > PAUSE:
            self._due = self._taken = 0
        if lost <= PAUSE and self._seen:
            self._due += 1 + lost
            self._taken += 1
        self._seen = True
        return number * self._sample_time_s, lost

    def half_lost(self) -> str:
        """Why half of all samples are lost, told once; "" while it is fewer, or not known yet."""
        if self._due < LOOKED_AT:
            return ""
        half = 2 * self._taken <= self._due
        told, self._told = self._told, half
        every_s = self._sample_time_s * self._due / self._taken
        how = "their numbers are asked for one by one: map them into a PDO, or " if self._asked else ""
        if told or not half:
            return ""
        here = f"sample_time_s is {self._sample_time_s:g} s"
        return f"half of all samples are lost: one comes every {every_s:.3g} s, {here}; {how}set it to that"
