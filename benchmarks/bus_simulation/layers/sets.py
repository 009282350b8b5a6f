"""The layers of gain sets: numbers that are burnt, pages as staged, conditions of a commit, trials, the store."""

import math
import struct

from bus_simulation.layers.seen import Seen, Told, unchanged
from bus_simulation.layers.wire import Ack, Codes, broken, float32, newer, set_crc, u16
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.controller.gain_memory import GainSet

OK, STALE, WRONG_BASE, WRONG_CRC, INCOMPLETE, NOT_FINITE, OUTSIDE_BOX, RATIO, BUSY, ALREADY_RUNNING = range(10)
WRONG_KEY, NOT_STAGED, NOT_OWNER, NOT_CONFIRMED, REVERTED, NO_CODE, WRONG_CODE = range(11, 18)
COMMIT, CONFIRM = 5, 7
SAVE = b"save"


class Sets:
    """What is staged, what waits, what was refused, what is on trial, what is stored.

    settings : of the device. first : how it began. codes : the layer above the conditions.
    """

    def __init__(self, settings: VirtualDeviceSettings, first: Seen, codes: Codes) -> None:
        self._settings, self._codes = settings, codes
        self.stored = self._stored_before = first.running
        self.restarted(first, torn=False)

    def restarted(self, now: Seen, *, torn: bool) -> None:
        """Power came back. torn : the place that was written last is not whole."""
        if torn:
            self.stored = self._stored_before
        if now.running != self.stored:
            raise broken(
                "the_store_keeps_what_is_confirmed", f"{now.running} after a restart, {self.stored} was stored"
            )
        self._stage: tuple[int, dict[int, float]] | None = None
        self._waiting = self._of_running = self.refused = self._refusal = b""
        self._had_code = False
        self._trial_left = 0
        if now.has_staged or now.owner or now.sample or now.refused or now.latest != now.running.seq:
            raise broken("a_restart_begins_anew", f"{now}")
        if now.confirmed != now.running:
            raise broken("trials_end", f"{now.confirmed} is what would come back after a restart with {now.running}")

    def staged(self) -> tuple[int | None, dict[int, float]]:
        """Number and gains of the staged page."""
        return (None, {}) if self._stage is None else self._stage

    def on_stage(self, told: Told) -> None:
        """STAGE: answered only when refused."""
        data, before, after = told.data, told.before, told.after
        seq, item, tag = u16(data[5:]), data[0] & 3, data[0] >> 2
        right = OK
        if not before.owner or tag != before.owner % 64:
            right = NOT_OWNER
        elif self._waiting:
            right = BUSY
        elif seq != self.staged()[0] and not newer(seq, before.latest):
            right = STALE
        got = Ack(told.replies[0]).reason if told.replies else OK
        if got != right:
            raise broken("numbers_are_burnt", f"STAGE {seq} of {tag} after {before} gets {got}, right is {right}")
        if right != OK:
            unchanged("numbers_are_burnt", before, after)
            return
        kept = self.staged()[1] if seq == self.staged()[0] else {}
        self._stage = seq, {**kept, item: float32(data[1:5])}
        unchanged("numbers_are_burnt", before, after._replace(latest=seq, has_staged=True), "latest", "has_staged")
        if after.latest != seq or not after.has_staged:
            raise broken("numbers_are_burnt", f"{after} after STAGE of {seq}")

    def on_abort(self, told: Told, drawn_before: int) -> None:
        """ABORT: three answers, and what is fenced off is gone."""
        seq, before, after = u16(told.data), told.before, told.after
        right = STALE
        if seq == before.running.seq:
            right = ALREADY_RUNNING
        elif seq == self.staged()[0] or newer(seq, before.latest):
            right = OK
        got = Ack(told.replies[0])
        if (got.seq, got.reason) != (seq, right):
            raise broken("fences_hold", f"ABORT {seq} after {before} gets {vars(got)}, right is {right}")
        if right == OK:
            self._stage, self._waiting = None, b""
            self._codes.renewed(drawn_before, f"ABORT of {seq}")
            if after.latest != seq or after.has_staged:
                raise broken("fences_hold", f"{after} after ABORT of {seq}")
        unchanged("fences_hold", before, after, *(("latest", "has_staged") if right == OK else ()))

    def on_commit(self, told: Told, drawn_before: int) -> None:
        """COMMIT: accepted when every condition holds, and only then; not answered before its sample."""
        data, before, after = told.data, told.before, told.after
        got = Ack(told.replies[0]).reason if told.replies else None
        if data == self._of_running or self._waiting or data == self.refused:
            right: int | None = BUSY
            if told.data == self._of_running:
                right = OK
            elif told.data == self._waiting:
                right = None
            elif not self._waiting:
                right = Ack(self._refusal).reason
                if told.replies != [self._refusal]:
                    raise broken("commits_are_answered_again", f"{told.replies}, before {self._refusal.hex()}")
            if got != right:
                raise broken("commits_are_answered_again", f"{told.data.hex()} gets {got}, right is {right}")
            unchanged("commits_are_answered_again", told.before, told.after)
            return
        if u16(data) != self.staged()[0]:
            right = NOT_STAGED if newer(u16(data), before.latest) else STALE
            if got != right:
                raise broken("numbers_are_burnt", f"COMMIT {u16(data)} after {before} gets {got}, right is {right}")
            unchanged("numbers_are_burnt", before, after)
            return
        wrong = self._wrong(data, before)
        if (got is None) is bool(wrong) or (wrong and got not in wrong):
            raise broken("commits_meet_every_condition", f"{data.hex()} after {before} gets {got}, wrong is {wrong}")
        if got is None:
            self._waiting = data
            if self._codes.key is not None:
                self._codes.renewed(drawn_before, "an accepted code")
            unchanged("commits_meet_every_condition", before, after)
            return
        self._stage, self.refused, self._refusal = None, data, told.replies[0]
        if after.has_staged:
            raise broken("numbers_are_burnt", f"{after}: the page of a refused COMMIT is still there")
        unchanged("numbers_are_burnt", before, after, "has_staged")

    def _wrong(self, data: bytes, before: Seen) -> set[int]:
        """Reasons why this commit of the staged page must not run."""
        seq, base, crc = u16(data), u16(data[2:]), data[4:]
        values = self.staged()[1]
        wrong = {WRONG_BASE} if base != before.running.seq else set()
        if len(values) < 3:
            return wrong | {INCOMPLETE}
        gains = (values[0], values[1], values[2])
        wrong |= self._outside(gains, before.running)
        node = self._settings.node
        said = set_crc(node, before.epoch, seq, gains, struct.pack("<HH", base, before.owner))
        if crc != said.to_bytes(4, "little"):
            wrong.add(WRONG_CRC)
        if not wrong and not self._had_code:
            wrong |= {NO_CODE, WRONG_CODE}
        return wrong

    def before_commit(self, data: bytes, before: Seen) -> None:
        """Look at the codes before a COMMIT takes the challenge with it."""
        values = self.staged()[1]
        gains = [values.get(item, 0.0) for item in range(3)]
        node, epoch = self._settings.node, before.epoch
        self._had_code = self._codes.came(node, epoch, before.owner, u16(data), u16(data[2:]), gains)

    def _outside(self, gains: tuple[float, float, float], running: GainSet) -> set[int]:
        """The device's own box."""
        box, old = self._settings.box, (running.gains.kp, running.gains.ki, running.gains.kd)
        wrong = set()
        for new, last, most in zip(gains, old, (box.kp_max, box.ki_max, box.kd_max), strict=True):
            if not math.isfinite(new):
                wrong.add(NOT_FINITE)
            elif abs(new) > most or new * box.direction < 0:
                wrong.add(OUTSIDE_BOX)
            elif new and last and not 1 / box.ratio_max <= new / last <= box.ratio_max:
                wrong.add(RATIO)
        if not any(gains) or min(gains) < 0 < max(gains):
            wrong.add(OUTSIDE_BOX)
        return wrong

    def on_confirm(self, told: Told) -> None:
        """CONFIRM: of the running number, by the owner."""
        seq, before, after = u16(told.data), told.before, told.after
        right = NOT_OWNER if u16(told.data[2:]) != before.owner else STALE if seq != before.running.seq else OK
        self._judged("trials_end", told, right)
        if right == OK and after.confirmed != before.running:
            raise broken("trials_end", f"{after.confirmed} after CONFIRM of {before.running}")
        unchanged("trials_end", before, after, *(("confirmed",) if right == OK else ()))

    def on_store(self, told: Told) -> None:
        """STORE: what runs and is confirmed, with the key, by the owner."""
        data, before = told.data, told.before
        right = OK
        if not before.owner or data[6] != before.owner % 256:
            right = NOT_OWNER
        elif data[2:6] != SAVE:
            right = WRONG_KEY
        elif u16(data) != before.running.seq:
            right = STALE
        elif before.running != before.confirmed:
            right = NOT_CONFIRMED
        self._judged("the_store_keeps_what_is_confirmed", told, right)
        if right == OK and before.running != self.stored:
            self._stored_before, self.stored = self.stored, before.running
        unchanged("the_store_keeps_what_is_confirmed", before, told.after)

    def _judged(self, layer: str, told: Told, right: int) -> None:
        ack = Ack(told.replies[0])
        if (ack.seq, ack.reason) != (u16(told.data), right):
            raise broken(layer, f"{told.data.hex()} gets {vars(ack)}, right is {right}")

    def leased(self, before: Seen, after: Seen) -> None:
        """The lease may have gone to another: what was staged under it is dropped, what was accepted stays."""
        if after.owner == before.owner:
            return
        if not self._waiting:
            self._stage = None
        if after.has_staged != (self._stage is not None):
            raise broken("what_is_staged_ends_with_its_lease", f"{after} after {before}")

    def sampled(self, replies: list[bytes], before: Seen, after: Seen) -> None:
        """A sample: what waits runs, a trial goes on, and nothing else."""
        expected, said = before.running, None
        if self._waiting:
            seq, values = self.staged()
            if seq is None:
                raise broken("commits_meet_every_condition", "a commit waits without a page")
            expected, said = (seq, tuple(values[i] for i in range(3))), (COMMIT, seq, OK)
            self._of_running, self._waiting, self._stage = self._waiting, b"", None
            self._trial_left = self._settings.trial_samples
        elif self._trial_left and before.running != before.confirmed:
            self._trial_left -= 1
            if not self._trial_left:
                expected, said = before.confirmed, (CONFIRM, before.running.seq, REVERTED)
                self._of_running = b""
        now = after.running
        if (now.seq, (now.gains.kp, now.gains.ki, now.gains.kd)) != (
            (expected.seq, (expected.gains.kp, expected.gains.ki, expected.gains.kd))
            if isinstance(expected, GainSet)
            else expected
        ):
            raise broken("commits_meet_every_condition" if said and said[2] == OK else "trials_end",
                         f"{now} runs after a sample, {expected} should")  # fmt: skip
        acks = [Ack(data) for data in replies]
        if [(ack.kind, ack.seq, ack.reason) for ack in acks] != ([said] if said else []):
            raise broken("commits_meet_every_condition", f"a sample says {replies}, right is {said}")
        if after.latest != before.latest or after.confirmed != before.confirmed:
            raise broken("trials_end", f"{after} after {before}")
