"""Everything that passes a device's door, held to docs/developers/protocol.md layer by layer.

The invariants of truth.py say what must never come of all layers together; a layer whose work another one does as well
may be gone without any of them noticing. Here each is asked by itself.
"""

from collections.abc import Callable

import can

from bus_simulation.layers.answers import Answers
from bus_simulation.layers.commands import LEASED, Commands, Leases
from bus_simulation.layers.law import Law
from bus_simulation.layers.seen import Told, look, unchanged
from bus_simulation.layers.sets import Sets
from bus_simulation.layers.wire import (
    ABORT,
    ACK,
    AUTH,
    CHALLENGE,
    COMMIT,
    CONFIRM,
    HEARTBEAT,
    LEASE,
    READ,
    STATUS,
    STORE,
    TELEMETRY_PV,
    TELEMETRY_SP,
    Codes,
    broken,
    is_foreign,
    is_whole,
    u16,
)
from retuner.drivers.controller.virtual_device import VirtualDevice

ANSWERED = {LEASE, ABORT, STORE, CONFIRM, *LEASED}  # always by one ACK
PLANT = 1 << 16  # identifiers of what plants measure beside pv


class Door:
    """One device's.

    codes : who draws its challenges. It begins to look when it is told the device.
    """

    def __init__(self, key: bytes | None, draw: Callable[[], int]) -> None:
        self.codes = Codes(key, draw)

    def watch(self, device: VirtualDevice) -> None:
        """Begin to look at this device."""
        self._device, settings = device, device.settings
        self._seen = look(device)
        self.sets = Sets(settings, self._seen, self.codes)
        self._answers = Answers(settings, self.sets)
        self._leases, self._commands = Leases(settings.lease_longest), Commands(settings)
        self._law = Law(device)
        self._drawn = self.codes.drawn

    def coming(self, message: can.Message) -> None:
        """A frame is about to reach it."""
        self._drawn = self.codes.drawn
        if message.arbitration_id & 31 == COMMIT and len(message.data) == 8:
            self.sets.before_commit(bytes(message.data), self._seen)

    def came(self, message: can.Message, replies: list[can.Message]) -> None:
        """A frame has reached it, and these were the answers."""
        before, after = self._seen, look(self._device)
        self._seen = after
        told = Told.of(message, replies, before, after)
        # Whether it was a frame of the protocol. If not, it may be counted and have no other effect.
        is_ours = not is_foreign(message, self._device.settings.node)
        good = is_ours and is_whole(message)
        if told.after.refused - told.before.refused != (is_ours and not good):
            raise broken("only_whole_frames_count", f"{message}: {told.before.refused} -> {told.after.refused}")
        if not good:
            unchanged("only_whole_frames_count", told.before, told.after, "refused")
            if told.replies:
                raise broken("only_whole_frames_count", f"{message} gets {told.replies}")
        if not good:
            return
        for reply in replies:
            self._answers.form(reply.arbitration_id, bytes(reply.data), after)
        self._number_of_answers(told, [reply.arbitration_id & 31 for reply in replies])
        self._judge(told, [reply.arbitration_id & 31 for reply in replies])
        self._answers.latest(told)
        # A challenge that is told stays until it has served
        if told.command not in {ABORT, COMMIT} and self.codes.drawn != self._drawn:
            raise broken("codes_are_fresh", f"a new challenge after command {told.command}")

    def _number_of_answers(self, told: Told, commands: list[int]) -> None:
        """As many as the page says."""
        if told.command == READ:
            return
        few, many = (1, 1) if told.command in ANSWERED else (0, 0 if told.command == AUTH else 1)
        if not few <= len(commands) <= many or set(commands) - {ACK}:
            raise broken("answers_fit_their_question", f"command {told.command} gets {commands}")
        if any(reply[0] & 15 != told.command for reply in told.replies):
            raise broken("answers_fit_their_question", f"command {told.command} gets {told.replies}")

    def _judge(self, told: Told, commands: list[int]) -> None:
        """The layer that this command belongs to."""
        match told.command:
            case 1:
                self._leases.asked(told)
                self.sets.leased(told.before, told.after)
            case 2:
                self._answers.read(told, commands)
                if commands == [CHALLENGE]:
                    self.codes.told(told.replies[0], u16(told.data[1:]))
                unchanged("answers_fit_their_question", told.before, told.after)
            case 3:
                self.sets.on_abort(told, self._drawn)
            case 4:
                self.sets.on_stage(told)
            case 5:
                self.sets.on_commit(told, self._drawn)
            case 6:
                self.sets.on_store(told)
            case 7:
                self.sets.on_confirm(told)
            case 11:
                self.codes.take(told.data)
                unchanged("codes_are_fresh", told.before, told.after)
            case _:
                self._commands.came(told)

    def sampled(self, messages: list[can.Message], dt_s: float) -> None:
        """A controller sample, and what it said."""
        before, after = self._seen, look(self._device)
        self._seen = after
        said = [(m.arbitration_id & 31, bytes(m.data)) for m in messages if m.arbitration_id < PLANT]
        for message in messages:
            if message.arbitration_id < PLANT:
                self._answers.form(message.arbitration_id, bytes(message.data), after)
        if (after.sample, after.epoch) != (before.sample + 1, before.epoch):
            raise broken("samples_are_whole", f"{after} after {before}")
        self.sets.sampled([data for command, data in said if command == ACK], before, after)
        self._leases.sampled(before.owner, after.owner)
        self.sets.leased(before, after)
        # ACK if there is one, both halves, and a life sign when it is time
        commands = [command for command, _ in said if command != ACK]
        is_time = after.sample % self._device.settings.heartbeat_samples == 0 or after.sample == 1
        right = [TELEMETRY_PV, TELEMETRY_SP, *([HEARTBEAT, STATUS] if is_time else [])]
        if commands != right or any(command == ACK for command, _ in said[1:]):
            raise broken("samples_are_whole", f"sample {after.sample} says {commands}, right is {right}")
        frames = [data for command, data in said if command != ACK]
        self._answers.sample(frames[0], frames[1], after)
        if is_time:
            self._answers.life(frames[2], frames[3], after)
        self._law.sampled(before, after, dt_s)
        unchanged("samples_are_whole", before, after, "running", "sample", "owner", "has_staged")

    def restarted(self, *, torn: bool) -> None:
        """Power came back. torn : the place of the store that was written last is not whole."""
        before, after = self._seen, look(self._device)
        self._seen = after
        if after.epoch == before.epoch:
            raise broken("epochs_are_new", f"{after.epoch} again after a restart")
        self.sets.restarted(after, torn=torn)
        self._leases, self._commands = self._leases.anew(), Commands(self._device.settings)
        self._law.restarted()
