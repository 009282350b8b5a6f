"""The device's memory of gain sets: what runs, what is staged, what is stored, and every answer about them.

A set is staged gain by gain, read back, and committed as a whole; it runs from the next sample on. The promise: the
running set is always one that was committed complete, newer than its predecessor, built on it, with the right CRC-32
and inside the box. A sequence number that was refused or fenced off is burnt: a late copy of its commit does nothing.
A committed set is on trial until it is confirmed: only then may it be stored, and when the firmware has a trial time,
a set that is not confirmed within it gives way to the last confirmed one, under that one's old number.
"""

import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from retuner.drivers.protocol import frames as wire
from retuner.drivers.protocol.checksum import commit_crc, page_crc, set_crc, to_wire
from retuner.schedule.gains import PidGains


class GainSet(NamedTuple):
    """A complete set and its sequence number."""

    seq: int
    gains: PidGains


class Slot(NamedTuple):
    """A stored set with its generation; crc tells whether it was written whole."""

    generation: int
    content: GainSet
    crc: int

    @property
    def whole(self) -> bool:
        """Whether the CRC is right."""
        return self.crc == slot_crc(self.generation, self.content)


def slot_crc(generation: int, content: GainSet) -> int:
    """CRC-32 over generation, sequence and gains."""
    gains = content.gains
    return zlib.crc32(struct.pack("<IHfff", generation, content.seq, gains.kp, gains.ki, gains.kd))


class GainPages:
    """Pages of one loop.

    node : for the CRC of a set.
    box : what may run.
    first : gains that run when nothing is stored (sequence 0); rounded to float32.
    trial_samples : samples within which a set must be confirmed; 0: it need not be, but is not stored before.
    keep : begins to write a set into non-volatile memory and says how it ended: True it is there, False it could not be
        written, None: `stored` tells later.
    """

    def __init__(
        self,
        node: int,
        box: wire.GainBox,
        first: PidGains,
        trial_samples: int = 0,
        keep: Callable[[], bool | None] = lambda: True,
    ) -> None:
        self._node, self._box, self._trial_samples = node, box, trial_samples
        self._first, self._keep = GainSet(0, to_wire(first)), keep
        self.slots: list[Slot | None] = [None, None]
        self.boot(0)

    def boot(self, epoch: int) -> None:
        """Start anew: run the newest whole slot, else the first set; forget what was staged."""
        self._epoch = epoch
        self.running = self._stored()
        self.confirmed = self.running
        self.latest = self.running.seq
        self._trial_left = 0
        self._commit_of_running: wire.Commit | None = None
        self._staged: dict[int, float] = {}
        self._staged_seq: int | None = None
        self._pending: tuple[wire.Commit, GainSet] | None = None
        self._last_answer: tuple[wire.Commit, wire.Ack] | None = None
        self._storing: tuple[int, Slot] | None = None

    @property
    def has_staged(self) -> bool:
        """Whether a page is staged."""
        return self._staged_seq is not None

    @property
    def is_stored(self) -> bool:
        """Whether the running set would survive a restart."""
        return any(slot is not None and slot.whole and slot.content == self.running for slot in self.slots)

    @property
    def on_trial(self) -> bool:
        """Whether the running set waits for its confirmation."""
        return self.running != self.confirmed

    def stage(self, frame: wire.Stage) -> wire.Ack | None:
        """Put one gain into the staged page; an answer only when refused, the read-back tells the rest."""
        if self._pending is not None:
            return self._ack(wire.Kind.STAGE, frame.seq, wire.Reason.BUSY, frame.item)
        if frame.seq != self._staged_seq:
            if not wire.newer(frame.seq, self.latest):
                return self._ack(wire.Kind.STAGE, frame.seq, wire.Reason.STALE, frame.item)
            self._staged, self._staged_seq, self.latest = {}, frame.seq, frame.seq
        self._staged[frame.item] = frame.value
        return None

    def commit(
        self, frame: wire.Commit, owner: int, code: Callable[[wire.Commit, PidGains], wire.Reason]
    ) -> wire.Ack | None:
        """Check a commit; None when it is good and waits for the next sample, else the answer.

        owner : holder of the lease. code : says whether the commit is authentic; asked last.
        """
        if frame == self._commit_of_running:
            return self._ack(wire.Kind.COMMIT, frame.seq, wire.Reason.OK)
        if self._pending is not None:
            return None if frame == self._pending[0] else self._ack(wire.Kind.COMMIT, frame.seq, wire.Reason.BUSY)
        if self._last_answer is not None and frame == self._last_answer[0]:
            return self._last_answer[1]
        if frame.seq != self._staged_seq:
            reason = wire.Reason.NOT_STAGED if wire.newer(frame.seq, self.latest) else wire.Reason.STALE
            return self._ack(wire.Kind.COMMIT, frame.seq, reason)
        reason, item = self._judge(frame, owner, code)
        if reason is wire.Reason.OK:
            self._pending = frame, GainSet(frame.seq, self._staged_gains())
            return None
        self._forget_staged()
        answer = self._ack(wire.Kind.COMMIT, frame.seq, reason, item)
        self._last_answer = frame, answer
        return answer

    def _judge(
        self, frame: wire.Commit, owner: int, code: Callable[[wire.Commit, PidGains], wire.Reason]
    ) -> tuple[wire.Reason, int]:
        """Every condition of a commit, in the order in which they are told."""
        if frame.base != self.running.seq:
            return wire.Reason.WRONG_BASE, wire.Item.KP
        missing = [item for item in wire.Item if item not in self._staged]
        if missing:
            return wire.Reason.INCOMPLETE, missing[0]
        reason, item = self._box.refusal(
            (self._staged[wire.Item.KP], self._staged[wire.Item.KI], self._staged[wire.Item.KD]), self.running.gains
        )
        if reason is not wire.Reason.OK:
            return reason, item
        gains = self._staged_gains()
        if frame.crc != commit_crc(set_crc(self._node, self._epoch, frame.seq, gains), frame.base, owner):
            return wire.Reason.WRONG_CRC, wire.Item.KP
        return code(frame, gains), wire.Item.KP

    def swap(self) -> wire.Ack | None:
        """Run the committed set from now on, if there is one: call between reading pv and working out co."""
        if self._pending is None:
            return None
        frame, self.running = self._pending
        self._pending, self._commit_of_running = None, frame
        self._trial_left = self._trial_samples
        self._forget_staged()
        return self._ack(wire.Kind.COMMIT, frame.seq, wire.Reason.OK)

    def revert(self, *, seen: bool = True) -> wire.Ack | None:
        """One sample of the trial time has passed; when it is over, run the confirmed set from now on, and say so.

        seen : whether pv was a number in this sample; without one the end of the trial waits for the next.
        """
        if not self._trial_left or not self.on_trial or (self._trial_left == 1 and not seen):
            return None
        self._trial_left -= 1
        if self._trial_left:
            return None
        seq, self.running = self.running.seq, self.confirmed
        self._commit_of_running = None
        return self._ack(wire.Kind.CONFIRM, seq, wire.Reason.REVERTED)

    def confirm(self, frame: wire.Confirm) -> wire.Ack:
        """The running set has proved itself."""
        if frame.seq != self.running.seq:
            return self._ack(wire.Kind.CONFIRM, frame.seq, wire.Reason.STALE)
        self.confirmed = self.running
        return self._ack(wire.Kind.CONFIRM, frame.seq, wire.Reason.OK)

    def drop_staged(self) -> None:
        """Whoever was staging may not command any more; its number stays burnt, an accepted commit stays accepted."""
        if self._pending is None:
            self._forget_staged()

    def abort(self, frame: wire.Abort) -> wire.Ack:
        """Fence a sequence number off: unless it runs already, it never will."""
        seq = frame.seq
        if seq == self.running.seq:
            return self._ack(wire.Kind.ABORT, seq, wire.Reason.ALREADY_RUNNING)
        if seq == self._staged_seq or wire.newer(seq, self.latest):
            self._pending = None
            self._forget_staged()
            self.latest = seq
            return self._ack(wire.Kind.ABORT, seq, wire.Reason.OK)
        return self._ack(wire.Kind.ABORT, seq, wire.Reason.STALE)

    def store(self, frame: wire.Store) -> wire.Ack | None:
        """Keep the running set: into the slot that is not the newest, so that the other one stays whole meanwhile.

        None while it is being written: `stored` gives the answer.
        """
        if frame.key != wire.STORE_KEY:
            return self._ack(wire.Kind.STORE, frame.seq, wire.Reason.WRONG_KEY)
        if frame.seq != self.running.seq:
            return self._ack(wire.Kind.STORE, frame.seq, wire.Reason.STALE)
        if self.on_trial:
            return self._ack(wire.Kind.STORE, frame.seq, wire.Reason.NOT_CONFIRMED)
        if self.is_stored:
            return self._ack(wire.Kind.STORE, frame.seq, wire.Reason.OK)
        if self._storing is not None:
            same = self._storing[1].content == self.running
            return None if same else self._ack(wire.Kind.STORE, frame.seq, wire.Reason.BUSY)
        generations = [slot.generation if slot is not None and slot.whole else 0 for slot in self.slots]
        older = generations.index(min(generations))
        generation = max(generations) + 1
        self._storing = older, Slot(generation, self.running, slot_crc(generation, self.running))
        self.slots[older] = None  # nobody knows what stands there meanwhile
        done = self._keep()
        return None if done is None else self.stored(done=done)

    def stored(self, *, done: bool) -> wire.Ack | None:
        """The set that is being kept is there (done), or could not be written; None when nothing is being kept."""
        if self._storing is None:
            return None
        (place, slot), self._storing = self._storing, None
        if done:
            self.slots[place] = slot
        return self._ack(wire.Kind.STORE, slot.content.seq, wire.Reason.OK if done else wire.Reason.NOT_STORED)

    def read(self, frame: wire.Read) -> list[wire.PageItem | wire.PageEnd]:
        """A page as it stands: the gains that are there, and its end."""
        page, token = frame.page, frame.token % wire.PAGE_TAG
        if page == wire.Page.STAGED:
            seq = self._staged_seq if self._staged_seq is not None else self.latest
            values = {item: self._staged[item] for item in wire.Item if item in self._staged}
        else:
            content = self.running if page == wire.Page.RUNNING else self._stored()
            seq = content.seq
            values = dict(zip(wire.Item, (content.gains.kp, content.gains.ki, content.gains.kd), strict=True))
        complete = len(values) == len(wire.Item)
        gains, crc = None, 0
        with suppress(ValueError):  # what PidGains refuses may be staged, but never run: it has CRC 0
            gains = PidGains(*(values[item] for item in wire.Item)) if complete else None
        if gains is not None:
            crc = page_crc(set_crc(self._node, self._epoch, seq, gains), frame.token)
        items = [wire.PageItem(page, item, token, value, seq) for item, value in values.items()]
        return [*items, wire.PageEnd(page, int(complete), token, seq, crc)]

    def _stored(self) -> GainSet:
        whole = [slot for slot in self.slots if slot is not None and slot.whole]
        newest = max(whole, key=lambda slot: slot.generation, default=None)
        return newest.content if newest else self._first

    def _staged_gains(self) -> PidGains:
        return PidGains(self._staged[wire.Item.KP], self._staged[wire.Item.KI], self._staged[wire.Item.KD])

    def _forget_staged(self) -> None:
        """Empty the staged page; its number stays burnt."""
        self._staged, self._staged_seq = {}, None

    def _ack(self, kind: wire.Kind, seq: int, reason: wire.Reason, item: int = wire.Item.KP) -> wire.Ack:
        return wire.Ack(kind, seq, reason, self.latest, item)
