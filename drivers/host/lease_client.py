"""The host's side of the lease: asks for it, prolongs it at a third of its length, and knows who else holds it.

The device alone decides. While another host holds the lease this one observes and asks again from time to time.

Two clocks may keep it: the polls of the host (`due`), and a timer of the link (`prolong`), which goes on while the host
is busy with something else; but not for ever, because a host that hangs must lose its lease as one that has died.
"""

import threading
from collections import deque

from retuner.drivers.device import LeaseChanged
from retuner.drivers.protocol.frames import Ack, Lease, Reason

PROLONG_AT = 1 / 3  # of the lease's length
UNATTENDED = 4.0  # lengths of the lease for which it is prolonged although the host does not poll
COUNTER_WRAP = 256
COUNTER_LEAP = 100  # after "stale": an earlier host of this name has counted elsewhere on the circle


class LeaseKeeper:
    """The lease of one device, seen from one host.

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
            if not self.held or self._ending or now_s < self._next_s:
                return []
            if unattended_s > UNATTENDED * self._length_s:
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
                return None
            if self._asked:
                self._since_s = self._asked.popleft()
            self._next_s = self._since_s + self._length_s * PROLONG_AT
            before, self.held = self.other, ack.reason == Reason.OK
            self.other = None if self.held or not ack.latest else ack.latest
        if self.other == before:
            return None
        return LeaseChanged(ours=self.held, owner=self.owner if self.held else ack.latest)
