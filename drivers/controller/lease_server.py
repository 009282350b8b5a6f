"""The device's side of the lease: which one host may command, and until when, counted in controller samples.

A lease is asked for, prolonged and given back with LEASE frames. Their counter must be newer each time (AUTOSAR E2E: a
repeated frame is never a good one), and their stamp must be of the device's present time: this boot epoch, and the
present or the last STAMP_SAMPLES samples. So no frame of before a restart takes the lease, and nobody keeps the lease
of a dead host alive by sending frames again, in whatever order.
"""

from retuner.drivers.protocol.checksum import STAMP_SAMPLES, lease_stamp
from retuner.drivers.protocol.frames import Ack, Kind, Lease, Reason, newer

COUNTER_BITS = 8
NOBODY = 0


class LeaseDesk:
    """The lease of one device.

    longest_samples : longest lease that is granted; more is asked for in vain.
    """

    def __init__(self, longest_samples: int) -> None:
        self._longest = longest_samples
        self.owner = NOBODY
        self._left = 0
        self._last: Lease | None = None

    def boot(self) -> None:
        """Nobody holds it after a restart."""
        self.owner, self._left, self._last = NOBODY, 0, None

    def request(self, frame: Lease, epoch: int, sample: int) -> Ack:
        """Take, prolong or give back, in this epoch and sample; latest of the answer is the owner in force."""
        reason = self._judge(frame, epoch, sample)
        if reason is Reason.OK and frame != self._last:
            self._last = frame
            self._left = min(frame.samples, self._longest)
            self.owner = frame.owner if self._left else NOBODY
        return Ack(Kind.LEASE, frame.owner, reason, self.owner)

    def _judge(self, frame: Lease, epoch: int, sample: int) -> Reason:
        if frame.stamp not in {lease_stamp(epoch, sample), lease_stamp(epoch, max(sample - STAMP_SAMPLES, 0))}:
            return Reason.STALE
        if self.owner not in {NOBODY, frame.owner}:
            return Reason.NOT_OWNER
        last = self._last
        if last is None or last.owner != frame.owner or frame == last:
            return Reason.OK
        return Reason.OK if newer(frame.counter, last.counter, COUNTER_BITS) else Reason.STALE

    def tick(self) -> bool:
        """One controller sample has passed; whether the lease has just run out."""
        if self.owner == NOBODY:
            return False
        self._left -= 1
        if self._left > 0:
            return False
        self.owner = NOBODY
        return True

    def allows(self, owner: int, modulo: int = 1 << 16) -> bool:
        """Whether this owner (or its remainder that a short frame carries) holds the lease."""
        return self.owner != NOBODY and owner == self.owner % modulo
