"""What a host asks of one controller beside the write of gains (write_protocol.py), each kind in a class of its own.

LeaseKeeper     who may change anything: asked for, prolonged, released
CommandSender   setpoint, mode, load, store, confirm: sent again until they are acknowledged
Probation       a new set runs on probation until the host confirms it

No bus and no clock: frames to send and events to tell come out, acknowledges go in. can_device.py joins them.
"""

import threading
from collections import deque
from collections.abc import Callable

from retuner.drivers.device import CommandDone, CommandFailed, LeaseChanged
from retuner.drivers.protocol.frames import Ack, Confirm, Frame, Kind, Lease, Reason, reason_text
from retuner.schedule.late_dataclass import dataclass

PROLONG_AT = 1 / 3  # of the lease's length
UNATTENDED = 4.0  # lengths of the lease for which it is prolonged although the host does not poll
COUNTER_LEAP = 100  # after "stale": an earlier host of this name has counted elsewhere on the circle


class LeaseKeeper:
    """The lease of one device, seen from one host: asked for, prolonged at a third of its length; who else holds it.

    The device alone decides. While another host holds the lease this one observes and asks again from time to time. Two
    clocks may keep it: the polls of the host (`due`), and a timer of the link (`prolong`), which goes on while the host
    is busy with something else; but not for ever, because a host that hangs must lose its lease as one that has died.

    owner : this host's number. samples : length of the lease in controller samples. length_s : the same in s.
    timeout_s : how long to wait for an answer, s.
    """

    def __init__(self, owner: int, samples: int, length_s: float, timeout_s: float) -> None:
        self.owner = owner
        self.other: int | None = None
        self.held = False
        self._samples, self._length_s, self._timeout_s = samples, length_s, timeout_s
        self._counter = 0
        self._ending = False
        self._next_s = float("-inf")
        self._asked: deque[float] = deque()  # when requests without an answer were sent, one for all repeats of it
        self._since_s = float("-inf")  # from when on the lease in force is counted, on the safe side
        self._polled_s = float("-inf")  # when the host has looked last
        self._lock = threading.Lock()

    @property
    def asked(self) -> bool:
        """Whether a request is on its way that nobody has answered yet."""
        return bool(self._asked) and not self._ending

    def forget(self) -> None:
        """The device has restarted, was out of reach, or says that nobody holds it: ask at once."""
        with self._lock:
            self.held = False
            self._asked.clear()
            self._next_s = float("-inf")

    def due(self, now_s: float, stamp: int | None) -> list[Lease]:
        """The request to send now, if any; stamp is that of the device's time, None while unknown."""
        with self._lock:
            self._polled_s = now_s
            while len(self._asked) > 1 and now_s - self._asked[0] > self._timeout_s:
                self._asked.popleft()  # of several, those that have waited so long are lost, or their answers
            if self.held and now_s - self._since_s >= self._length_s:
                self.held = False
            if stamp is None or now_s < self._next_s:
                return []
            if not self._asked:
                self._asked.append(now_s)
            self._next_s = float("inf") if self._ending else now_s + self._timeout_s
            return [self._request(stamp)]

    def prolong(self, now_s: float, stamp: int) -> list[Lease]:
        """The request that keeps a lease held by this host, if it is time and the last poll is not too long ago; stamp
        is that of the device's time, as it must be by now.
        """
        with self._lock:
            unattended_s = now_s - self._polled_s
            kept = self.held and not self._ending and unattended_s <= UNATTENDED * self._length_s
            if not kept or now_s < self._next_s:
                return []
            self._asked.append(now_s)
            self._next_s = now_s + self._length_s * PROLONG_AT
            return [self._request(stamp)]

    def _request(self, stamp: int) -> Lease:
        self._counter = (self._counter + 1) % COUNTER_WRAP
        return Lease(self.owner, stamp, 0 if self._ending else self._samples, self._counter)

    def release(self) -> None:
        """Give the lease back with the next request, and ask no more."""
        with self._lock:
            self._ending = True
            self._next_s = float("-inf") if self.held else float("inf")
            self.held = False

    def on_ack(self, ack: Ack) -> LeaseChanged | None:
        """An answer has come; the news if the owner has changed between this host and another."""
        if ack.seq != self.owner or self._ending:
            return None
        with self._lock:
            if ack.reason == Reason.STALE:
                self._counter = (self._counter + COUNTER_LEAP) % COUNTER_WRAP
                self._next_s = float("-inf")  # the link's clock was wrong about the device's: with this poll's stamp
                return None
            if self._asked:
                self._since_s = self._asked.popleft()
            self._next_s = self._since_s + self._length_s * PROLONG_AT
            before, self.held = self.other, ack.reason == Reason.OK
            self.other = None if self.held or not ack.latest else ack.latest
        if self.other == before:
            return None
        return LeaseChanged(ours=self.held, owner=self.owner if self.held else ack.latest)


COUNTER_WRAP = 256
TRIES = 10
BY_SEQUENCE = (Kind.STORE, Kind.CONFIRM)  # acknowledged by the set's number, not by a counter


@dataclass(slots=True)
class _Waiting:
    """A command that is not acknowledged yet; make builds its frame for a counter."""

    make: Callable[[int], Frame]
    counter: int
    tries: int = 0
    next_s: float = float("-inf")


class CommandSender:
    """Commands under way, at most one of each kind; the latest of a kind counts, repeated until it is acknowledged.

    A repeated frame carries the same counter, so the device acts on it once.

    timeout_s : how long to wait for an acknowledge, s.
    owner : this host's number in the lease.
    check : raises when a frame cannot be sent.
    """

    def __init__(self, timeout_s: float, owner: int, check: Callable[[Frame], object]) -> None:
        self._timeout_s, self._owner, self._check = timeout_s, owner, check
        self._counters: dict[Kind, int] = {}
        self._waiting: dict[Kind, _Waiting] = {}

    def confirm(self, seq: int) -> None:
        """Set seq has proved itself."""
        self.put(Kind.CONFIRM, lambda _: Confirm(seq, self._owner), seq)

    def waits(self, kind: Kind) -> bool:
        """Whether a command of this kind is not acknowledged yet."""
        return kind in self._waiting

    def put(self, kind: Kind, make: Callable[[int], Frame], number: int | None = None) -> None:
        """Send a command from the next `due` on, if check takes it. make : its frame for a counter. number : what its
        acknowledge carries in place of the counter.
        """
        self._check(make(0))
        if number is None:
            number = self._counters[kind] = (self._counters.get(kind, 0) + 1) % COUNTER_WRAP
        self._waiting[kind] = _Waiting(make, number)

    def due(self, now_s: float) -> tuple[list[Frame], list[CommandFailed]]:
        """Frames to send now, and the commands that nobody has answered."""
        frames: list[Frame] = []
        failed: list[CommandFailed] = []
        for kind, waiting in list(self._waiting.items()):
            if now_s < waiting.next_s:
                continue
            if waiting.tries >= TRIES:
                del self._waiting[kind]
                failed.append(CommandFailed(kind.name.lower(), f"no answer to {TRIES} frames"))
                continue
            waiting.tries += 1
            waiting.next_s = now_s + self._timeout_s
            frames.append(waiting.make(waiting.counter))
        return frames, failed

    def on_ack(self, ack: Ack) -> CommandDone | CommandFailed | None:
        """An acknowledge has come; what it means, if it is for a command that waits."""
        kind = next((kind for kind in self._waiting if kind == ack.kind), None)
        if kind is None or ack.seq != self._waiting[kind].counter:
            return None
        waiting = self._waiting[kind]
        if ack.reason == Reason.NOT_OWNER and waiting.tries < TRIES:  # the lease may be on its way: try on
            return None
        if ack.reason == Reason.STALE and kind not in BY_SEQUENCE:  # another host has counted further: go on from there
            self._counters[kind] = (ack.latest + 1) % COUNTER_WRAP
            self._waiting[kind] = _Waiting(waiting.make, self._counters[kind], waiting.tries)
            return None
        del self._waiting[kind]
        if ack.reason == Reason.OK:
            return CommandDone(kind.name.lower())
        return CommandFailed(kind.name.lower(), f"the device refused it: {reason_text(ack)}")


class Probation:
    """The set that waits to be confirmed by this host: after so many samples have shown it running, the link sound.

    samples : samples to be seen with the set before it is confirmed.
    """

    def __init__(self, samples: int) -> None:
        self._samples = samples
        self._left = 0
        self.seq: int | None = None

    def begin(self, seq: int) -> None:
        """Set seq has been written by this host and read back."""
        self.seq, self._left = seq, self._samples

    def end(self) -> None:
        """It is confirmed, or runs no more."""
        self.seq = None

    def again(self) -> None:
        """The confirmation was not answered, or refused: watch on, then confirm once more."""
        self._left = self._samples

    def sample(self, revision: int) -> int | None:
        """A sample under set revision has arrived; the set to confirm now, if any."""
        if self.seq is None or revision != self.seq or self._left < 0:
            return None
        self._left -= 1
        return self.seq if self._left < 0 else None
