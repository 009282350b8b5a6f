"""What to think of the frames of one stream, one after the other and together: after AUTOSAR E2E's model.

Every arrival is classified by its checksum and its counter: OK, REPEATED, SOME_LOST, WRONG_SEQUENCE, WRONG_CRC, and
TIMEOUT when nothing comes. The stream's state follows from the latest WINDOW arrivals by the table below. As in E2E,
some lost frames are no fault of those that came, and a repeated frame never counts as a good one: a stuck repeater is
no life sign. Where E2E leaves open what follows a wrong sequence, the stream goes on from the newest counter seen.
"""

from collections import deque
from enum import Enum, IntEnum

WINDOW = 16  # arrivals that are judged together
MIN_OK = 2  # good ones among them that make a stream valid
MAX_WRONG = 4  # wrong ones among them that it may have


class Arrival(IntEnum):
    """One frame (or none) of a stream."""

    OK = 0
    REPEATED = 1
    SOME_LOST = 2
    WRONG_SEQUENCE = 3
    WRONG_CRC = 4
    TIMEOUT = 5


class Stream(Enum):
    """The latest frames together."""

    NO_DATA = "no data"
    INIT = "too few frames yet"
    VALID = "valid"
    INVALID = "too many wrong frames"


class TelemetryVerdict(Enum):
    """What the window says."""

    FEW = "some frames, not enough"
    ENOUGH = "enough good ones, few wrong ones"
    WRONG = "too many wrong ones"
    SILENCE = "none any more"


S, V = Stream, TelemetryVerdict
TRANSITIONS: dict[tuple[Stream, TelemetryVerdict], Stream] = {
    (S.NO_DATA, V.FEW): S.INIT,
    (S.NO_DATA, V.ENOUGH): S.VALID,
    (S.NO_DATA, V.WRONG): S.INVALID,
    (S.INIT, V.ENOUGH): S.VALID,
    (S.INIT, V.WRONG): S.INVALID,
    (S.INIT, V.SILENCE): S.NO_DATA,
    (S.VALID, V.WRONG): S.INVALID,
    (S.VALID, V.SILENCE): S.NO_DATA,
    (S.INVALID, V.ENOUGH): S.VALID,
    (S.INVALID, V.SILENCE): S.NO_DATA,
}
"""Everything that is not here leaves the state as it is."""

GOOD = frozenset({Arrival.OK, Arrival.SOME_LOST})
WRONG = frozenset({Arrival.WRONG_SEQUENCE, Arrival.WRONG_CRC})


class ArrivalCheck:
    """Classification of one stream."""

    def __init__(self) -> None:
        self.state = Stream.NO_DATA
        self.counts = dict.fromkeys(Arrival, 0)
        self._window: deque[Arrival] = deque()
        self._good = self._wrong = 0

    def ahead(self, steps: int) -> Arrival:
        """A frame with a right checksum whose counter is so many steps ahead of the newest one's."""
        if steps == 1:
            arrival = Arrival.OK
        elif steps > 1:
            arrival = Arrival.SOME_LOST
        else:
            arrival = Arrival.WRONG_SEQUENCE if steps else Arrival.REPEATED
        self.note(arrival)
        return arrival

    def note(self, arrival: Arrival) -> None:
        """Count an arrival and move the state."""
        self.counts[arrival] += 1
        if arrival is Arrival.TIMEOUT:
            self._window.clear()
            self._good = self._wrong = 0
            self._move(TelemetryVerdict.SILENCE)
            return
        self._window.append(arrival)
        self._good += arrival in GOOD
        self._wrong += arrival in WRONG
        if len(self._window) > WINDOW:
            oldest = self._window.popleft()
            self._good -= oldest in GOOD
            self._wrong -= oldest in WRONG
        if self._wrong > MAX_WRONG:
            self._move(TelemetryVerdict.WRONG)
        elif self._good < MIN_OK:
            self._move(TelemetryVerdict.FEW)
        elif self.state is not Stream.VALID:
            self._move(TelemetryVerdict.ENOUGH)

    def _move(self, verdict: TelemetryVerdict) -> None:
        self.state = TRANSITIONS.get((self.state, verdict), self.state)
