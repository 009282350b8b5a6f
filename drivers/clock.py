"""Clocks: the only place of the house that knows what time it is. All others take t or dt as an argument.

Monotonic, never wall time: python-can's own deadlines use the wall clock, and a step of it by -5 s was measured to make
a receive of 1 s last 6 s.
"""

import math
import time
from typing import Protocol


class Clock(Protocol):
    """Seconds that only go forward."""

    def now_s(self) -> float:
        """Seconds since an arbitrary start; never decreases."""

    def wait_until(self, t_s: float) -> None:
        """Return when now_s() has reached t_s; at once when it is past."""

    def left_s(self, t_s: float) -> float:
        """Seconds of the machine's time until t_s; 0 when it is past or when time is simulated."""

    def stamp_s(self) -> float:
        """What to write into records as the time: seconds since 1970, or the simulated time."""


class SimulatedClock:
    """Time that passes only when told to.

    start_s : first reading in seconds.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        """Seconds as last set."""
        return self._now_s

    def advance(self, dt_s: float) -> None:
        """Let dt_s seconds pass. Raises ValueError: dt_s is negative or not finite."""
        if not (math.isfinite(dt_s) and dt_s >= 0):
            raise ValueError(f"dt_s = {dt_s}: give a positive, finite number of seconds")
        self._now_s += dt_s

    def wait_until(self, t_s: float) -> None:
        """Be at t_s at once."""
        self._now_s = max(self._now_s, t_s)

    def left_s(self, t_s: float) -> float:  # noqa: ARG002  simulated time is there as soon as it is wanted
        """No time: there is nothing to wait for."""
        return 0.0

    def stamp_s(self) -> float:
        """The simulated time: records of equal runs are equal."""
        return self._now_s


class MonotonicClock:
    """The machine's monotonic clock, optionally running faster.

    speed : seconds of this clock per second of the machine's, positive. 1 is real time.

    Raises ValueError: speed is not a positive finite number.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not (math.isfinite(speed) and speed > 0):
            raise ValueError(f"speed = {speed}: give a positive finite number, 1 for real time")
        self.speed = speed
        self._start_s = time.monotonic()
        self._epoch_s = time.time() - self._start_s

    def now_s(self) -> float:
        """Seconds since this clock was made, times speed."""
        return (time.monotonic() - self._start_s) * self.speed

    def wait_until(self, t_s: float) -> None:
        """Sleep until now_s() has reached t_s."""
        left_s = self.left_s(t_s)
        if left_s > 0:
            time.sleep(left_s)

    def left_s(self, t_s: float) -> float:
        """Seconds of the machine's time until t_s, 0 when it is past."""
        return max(t_s - self.now_s(), 0.0) / self.speed

    def stamp_s(self) -> float:
        """Seconds since 1970 by the wall clock as it stood when this clock was made, and by the monotonic one since:
        a wall clock that is set back must not make a record's time run backwards.
        """
        return self._epoch_s + time.monotonic()
