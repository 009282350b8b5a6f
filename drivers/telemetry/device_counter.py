"""How far the device has counted, as its heartbeats say: what old frames that are sent again cannot move.

A heartbeat carries the whole counter and its epoch, so one that was recorded can only say less than the newest has
said. Telemetry carries 8 bits, and a recorded sample looks as if it were ahead. So telemetry counts no further than the
rhythm of the heartbeats allows, and the counter goes back for nothing: a device that counts anew has a new epoch.
"""

from collections import deque
from enum import Enum
from itertools import islice
from operator import sub

LONGEST_BEAT = 100  # samples from heartbeat to heartbeat at most, as docs/developers/protocol.md has it
REMEMBERED = 256  # samples over which the rhythm is looked at: more than two of the longest intervals
LATE = 16  # samples by which a heartbeat may come late, behind newer ones
BEATS_LOST = 2  # intervals that telemetry may go on without a heartbeat: one of them may be lost
SHORTEST_REACH = 8  # samples that telemetry may go on in any case


class Said(Enum):
    """What a heartbeat means."""

    AGREES = "the counter goes on"
    WAITS = "far ahead: the next one has to agree"
    CONTRADICTS = "one device alone does not say this"


class DeviceCounter:
    """The newest heartbeat, and what lies within its reach."""

    def __init__(self) -> None:
        self.newest: int | None = None
        self._beats: deque[int] = deque()
        self._reach = LONGEST_BEAT
        self._leap: int | None = None

    def begin(self, sample: int) -> None:
        """The device counts from here: the first that is known of it, or a restart that a read-back has proved."""
        self.newest, self._leap = sample, None
        self._beats, self._reach = deque([sample]), LONGEST_BEAT

    def forget(self) -> None:
        """Contact was lost: the next heartbeat may be anywhere."""
        self.newest = None

    def beyond(self, sample: int) -> bool:
        """Whether telemetry of this sample is further than the heartbeats have said."""
        return self.newest is None or sample > self.newest + self._reach

    def beat(self, sample: int, last: int | None) -> Said:
        """Take a heartbeat; last : number of the newest whole sample."""
        if self.newest is None:
            if last is not None and sample < last - LONGEST_BEAT - LATE:
                return Said.CONTRADICTS
            self.begin(sample)
            return Said.AGREES
        leap, self._leap = self._leap, None
        if sample <= self.newest:
            return Said.CONTRADICTS if leap is not None or sample < self.newest - REMEMBERED // 2 else Said.AGREES
        if sample > max(self.newest, last or 0) + self._reach and not (
            leap is not None and leap < sample <= leap + BEATS_LOST * LONGEST_BEAT
        ):
            self._leap = sample
            return Said.WAITS
        self.newest = sample
        self._beats.append(sample)
        while sample - self._beats[0] > REMEMBERED:
            self._beats.popleft()
        beats = self._beats
        if beats[-1] - beats[0] < LONGEST_BEAT:
            self._reach = LONGEST_BEAT
        else:
            widest: int = max(map(sub, islice(beats, 1, None), beats))
            self._reach = max(BEATS_LOST * min(widest, LONGEST_BEAT), SHORTEST_REACH)
        return Said.CONTRADICTS if leap is not None and leap > sample else Said.AGREES
