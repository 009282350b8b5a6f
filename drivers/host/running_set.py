"""What a host may believe about the set that a device runs.

Only a read-back whose CRC-32 fits a boot epoch that a heartbeat has told. A heartbeat with another epoch alone proves
nothing (it may be an old one come late): it raises a doubt, and the next read-back, asked for after it, settles it.
And a device that has booted may be another one: its first read-back counts only once it has said again who it is.

A device never goes back to an epoch that it has left, and never says two things at a time. A read-back that goes back,
heartbeats in a short time that a read-back has disproved or whose counter goes back (device_counter.py), two epochs
that take turns before any is known, samples that say something else under a number that was there, or heartbeats that
all come twice, come from a second device under the same node number, or from a repeater: then nothing is believed until
ALONE heartbeats in a row have been of one epoch and of one mind.
"""

from enum import Enum

from retuner.drivers.device import RunningSet
from retuner.drivers.host.page_reader import ReadBack
from retuner.drivers.protocol.checksum import set_crc
from retuner.drivers.protocol.frames import Heartbeat


class Belief(Enum):
    """What a read-back has shown."""

    NOTHING = "its CRC fits no epoch"
    FIRST = "the first set known"
    SAME = "the set known before"
    CHANGED = "another set in the same epoch"
    RESTARTED = "the device has booted"
    CONFLICT = "two devices answer under this node number"


ALONE = 5  # heartbeats in a row of one epoch after which a conflict is over
DISPROVED_MAX = 4  # contradictions before that which make a conflict
DOUBLED_MAX = 12  # heartbeats in a row that came twice: a bus that doubles frames now and then does not do that


class RunningBelief:
    """The running set and the epoch of one node.

    node : for the CRC.
    """

    def __init__(self, node: int) -> None:
        self._node = node
        self._before: RunningSet | None = None
        self._candidate: Heartbeat | None = None
        self._left: set[int] = set()  # epochs that the device has left
        self._told: set[int] = set()  # epochs that were told before one was known
        self._newest: Heartbeat | None = None
        self._is_double, self._doubled = False, 0
        self._last_epoch = self._in_a_row = self._disproved = 0
        self._conflict = self._identified = self._untold = False
        self.running: RunningSet | None = None
        self.epoch: int | None = None
        self.boot_sample = 0

    @property
    def doubtful(self) -> bool:
        """Whether what runs has to be read (again)."""
        return self.running is None or self._candidate is not None

    @property
    def unidentified(self) -> bool:
        """Whether a device has booted, or another one answers, that has not said who it is."""
        return self._candidate is not None and self.epoch is not None and not self._identified

    def identify(self) -> None:
        """The device has said who it is, and is the right one."""
        self._identified = True

    @property
    def in_conflict(self) -> bool:
        """Whether two devices answer, as far as is known now."""
        return self._conflict

    def conflict_news(self) -> bool:
        """Whether a conflict has begun that this has not told yet."""
        untold, self._untold = self._untold, False
        return untold

    def contradicted(self) -> None:
        """Something was said that one device alone does not say."""
        self._in_a_row = 0
        self._disproved += 1
        if self._disproved >= DISPROVED_MAX and not self._conflict:
            self._suspect()

    def doubt(self) -> None:
        """What runs is not known any more."""
        self.running = None

    def on_heartbeat(self, heartbeat: Heartbeat) -> bool:
        """Take a life sign; whether it belongs to the epoch that is known."""
        if heartbeat == self._newest:  # two devices that are alike in everything say everything twice
            self._is_double = True
            self._doubled += 1
        elif not self._is_double:
            self._doubled = 0
        if heartbeat != self._newest:
            self._newest, self._is_double = heartbeat, False
        if self._doubled >= DOUBLED_MAX:
            self.contradicted()
        self._in_a_row = self._in_a_row + 1 if heartbeat.epoch == self._last_epoch else 1
        self._last_epoch = heartbeat.epoch
        if self._in_a_row >= ALONE:
            self._disproved = 0
            if self._conflict:
                self._conflict = False
                self._left.clear()
        if heartbeat.epoch == self.epoch:
            return True
        if self.epoch is None and heartbeat.epoch in self._told and self._in_a_row == 1:  # back from another one
            self.contradicted()
        self._told.add(heartbeat.epoch)
        if self._candidate is None or self._candidate.epoch != heartbeat.epoch:
            self._identified = False
            self._candidate = heartbeat
        elif heartbeat.sample > self._candidate.sample:  # an older one was sent again
            self._candidate = heartbeat
        return False

    def on_page(self, page: ReadBack) -> Belief:
        """Take a read-back of the running page."""
        candidate = self._candidate
        if self._conflict:
            return Belief.NOTHING
        if self.epoch is not None and self._fits(page, self.epoch):
            self._disproved += candidate is not None
            self._candidate = None
            if self._disproved >= DISPROVED_MAX:
                return self._suspect()
            return self._believe(page, Belief.SAME)
        if candidate is not None and self._fits(page, candidate.epoch):
            if self.unidentified:
                self.running = None
                return Belief.NOTHING
            if candidate.epoch in self._left:
                return self._suspect()
            verdict = Belief.FIRST
            if self.epoch is not None:
                verdict = Belief.RESTARTED
                self._left.add(self.epoch)
            self.epoch, self.boot_sample, self._candidate = candidate.epoch, candidate.sample, None
            return self._believe(page, verdict)
        return Belief.NOTHING

    def _suspect(self) -> Belief:
        """Two devices answer: believe nothing for a while."""
        self._conflict, self._in_a_row, self._disproved, self.running = True, 0, 0, None
        self._untold = True
        return Belief.CONFLICT

    def _fits(self, page: ReadBack, epoch: int) -> bool:
        """Whether the device's CRC is that of these gains in this epoch."""
        return page.gains is not None and page.fits(set_crc(self._node, epoch, page.seq, page.gains))

    def _believe(self, page: ReadBack, verdict: Belief) -> Belief:
        if page.gains is None or self.epoch is None:
            return Belief.NOTHING
        crc = set_crc(self._node, self.epoch, page.seq, page.gains)
        before, self._before = self._before, RunningSet(page.seq, page.gains, crc)
        self.running = self._before
        if verdict is Belief.SAME and before is not None and before != self.running:
            return Belief.CHANGED
        return verdict
