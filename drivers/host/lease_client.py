"""The host's side of the lease: asks for it, prolongs it at a third of its length, and knows who else holds it.

The device alone decides. While another host holds the lease this one observes and asks again from time to time.
"""

from retuner.drivers.device import LeaseChanged
from retuner.drivers.protocol.frames import Ack, Lease, Reason

PROLONG_AT = 1 / 3  # of the lease's length
COUNTER_WRAP = 256
COUNTER_LEAP = 100  # after "stale": an earlier host of this name has counted elsewhere on the circle


class LeaseKeeper:
    """The lease of one device, seen from one host.

    Parameters
    ----------
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
        self._asked_s: float | None = None  # when the oldest request without an answer was sent
        self._since_s = float("-inf")  # from when on the lease in force is counted, on the safe side

    @property
    def asked(self) -> bool:
        """Whether a request is on its way that nobody has answered yet."""
        return self._asked_s is not None and not self._ending

    def forget(self) -> None:
        """The device has restarted, was out of reach, or says that nobody holds it: ask at once."""
        self.held = False
        self._asked_s = None
        self._next_s = float("-inf")

    def due(self, now_s: float, stamp: int | None) -> list[Lease]:
        """The request to send now, if any; stamp is that of the device's time, None while unknown."""
        if self.held and now_s - self._since_s >= self._length_s:
            self.held = False
        if stamp is None or now_s < self._next_s:
            return []
        self._counter = (self._counter + 1) % COUNTER_WRAP
        self._asked_s = now_s if self._asked_s is None else self._asked_s
        self._next_s = float("inf") if self._ending else now_s + self._timeout_s
        return [Lease(self.owner, stamp, 0 if self._ending else self._samples, self._counter)]

    def release(self) -> None:
        """Give the lease back with the next request, and ask no more."""
        self._ending = True
        self._next_s = float("-inf") if self.held else float("inf")
        self.held = False

    def on_ack(self, ack: Ack) -> LeaseChanged | None:
        """An answer has come; the news if the owner has changed between this host and another."""
        if ack.seq != self.owner or self._ending:
            return None
        if ack.reason == Reason.STALE:
            self._counter = (self._counter + COUNTER_LEAP) % COUNTER_WRAP
            return None
        if self._asked_s is not None:
            self._since_s, self._asked_s = self._asked_s, None
        self._next_s = self._since_s + self._length_s * PROLONG_AT
        before, self.held = self.other, ack.reason == Reason.OK
        self.other = None if self.held or not ack.latest else ack.latest
        if self.other == before:
            return None
        return LeaseChanged(ours=self.held, owner=self.owner if self.held else ack.latest)
