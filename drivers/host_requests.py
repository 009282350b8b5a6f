"""Everything that a host asks of one controller: the lease, the write of a gain set, its confirmation, commands.

No bus and no clock: frames to send and events to tell come out, acknowledges and read-backs go in. Who is connected
and what runs is can_device.py's business.
"""

from collections.abc import Callable

from retuner.drivers.can_settings import CanDeviceSettings
from retuner.drivers.checksum import to_wire
from retuner.drivers.command_sender import CommandSender
from retuner.drivers.device import CommandFailed, Event, RunningSet, WriteDone, WriteFailed, WriteRefusedError
from retuner.drivers.frames import EPOCH_TAG, Ack, Challenge, Frame, Kind
from retuner.drivers.lease_keeper import LeaseKeeper
from retuner.drivers.page_reader import PageReader
from retuner.drivers.probation import Probation
from retuner.drivers.write_protocol import Sequence, WriteOrder, WriteProtocol
from retuner.schedule.gains import PidGains

GAIN_KINDS = (Kind.STAGE, Kind.COMMIT, Kind.ABORT)


class HostRequests:
    """The requests of one host to one controller.

    Parameters
    ----------
    settings : address and patience.
    reader : asks for pages; shared with whoever else reads pages of this device.
    check : raises FrameError when a frame cannot be sent.
    """

    def __init__(self, settings: CanDeviceSettings, reader: PageReader, check: Callable[[Frame], object]) -> None:
        self._settings, self._reader, self._check = settings, reader, check
        length = settings.lease_length
        self.lease = LeaseKeeper(settings.owner, length, length * settings.sample_time_s, settings.reply_s)
        self.write = WriteProtocol(reader, settings.reply_s)
        self.commands = CommandSender(settings.reply_s, settings.owner, check)
        self.sequence = Sequence()
        self.probation = Probation(settings.probation_samples)

    def begin_write(self, gains: PidGains, running: RunningSet, epoch: int) -> int:
        """Start the two-phase write; its sequence number.

        Raises
        ------
        WriteRefusedError
            A write is under way, another host holds the lease, or the gains do not fit the wire.
        """
        if self.write.busy:
            raise WriteRefusedError("a write is under way; wait for its WriteDone or WriteFailed")
        if self.lease.other is not None:
            raise WriteRefusedError(f"host {self.lease.other} holds the lease; stop it, or wait until it runs out")
        settings = self._settings
        seq = self.sequence.after(running.seq)
        try:
            wire = to_wire(gains)
            order = WriteOrder(settings.node, epoch, seq, running.seq, wire, settings.owner, settings.key)
            for frame in order.stage():
                self._check(frame)
        except ValueError as error:
            raise WriteRefusedError(str(error)) from error
        self.sequence.note(seq)
        self.write.begin(order)
        return seq

    def on_restart(self) -> None:
        """The device has booted: it has forgotten the lease and what was staged."""
        self.write.on_restart()
        self.lease.forget()

    def on_running(self, running: RunningSet) -> WriteDone | WriteFailed | None:
        """The running set as read back; the outcome of a write if it was the last step of one."""
        outcome = self.write.on_running(running)
        if isinstance(outcome, WriteDone):
            self.probation.begin(running.seq)
        elif running.seq != self.probation.seq:
            self.probation.end()
        return outcome

    def confirm(self) -> bool:
        """Confirm the running set without any more probation; whether no confirmation of it is open."""
        seq = self.probation.seq
        if seq is not None and not self.commands.waits(Kind.CONFIRM):
            self.commands.confirm(seq)
        return seq is None

    def store(self, seq: int) -> None:
        """Keep the running set over a restart.

        Raises
        ------
        WriteRefusedError
            It is on probation.
        """
        if seq == self.probation.seq:
            raise WriteRefusedError(f"set {seq} is on probation; store it once it is confirmed")
        self.commands.store(seq)

    def on_sample(self, revision: int) -> None:
        """A sample under set revision has arrived: a set that has been seen long enough is confirmed."""
        proven = self.probation.sample(revision)
        if proven is not None:
            self.commands.confirm(proven)

    def on_challenge(self, challenge: Challenge) -> None:
        """The device's challenge has come."""
        if self._reader.is_newest(challenge):
            self.write.on_challenge(challenge)

    def on_ack(self, ack: Ack, epoch: int | None) -> Event | None:
        """An answer to a request; the news if there are any. One given in another epoch answers nothing."""
        if epoch is None or ack.epoch != epoch % EPOCH_TAG:
            return None
        if ack.kind in GAIN_KINDS:
            self.sequence.note(ack.latest)
            self.write.on_ack(ack)
            return None
        if ack.kind == Kind.LEASE:
            return self.lease.on_ack(ack)
        event = self.commands.on_ack(ack)
        if ack.kind != Kind.CONFIRM or event is None:
            return event
        if isinstance(event, CommandFailed):  # the controller would still go back to the set before
            self.probation.again()
            return event
        self.probation.end()
        return None

    def due(self, now_s: float, lease_epoch: int | None) -> tuple[list[Frame], list[Event]]:
        """Frames to send now, the lease's first, and what came to nothing; without lease_epoch none is asked for."""
        frames: list[Frame] = [*self.lease.due(now_s, lease_epoch), *self.write.due(now_s)]
        events: list[Event] = []
        unknown = self.write.unknown()
        if unknown is not None:
            events.append(unknown)
        commands, failed = self.commands.due(now_s)
        if any(failure.command == "confirm" for failure in failed):
            self.probation.again()
        return [*frames, *commands], [*events, *failed]
