"""Everything that a host asks of one controller: the lease, the write of a gain set, its confirmation, commands.

No bus and no clock: frames to send and events to tell come out, acknowledges and read-backs go in. Who is connected
and what runs is can_device.py's business.
"""

from collections.abc import Callable
from dataclasses import dataclass

from retuner.adaptive.signals.sample import LoopMode
from retuner.drivers.device import (
    CommandDone,
    CommandFailed,
    Event,
    RunningSet,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
)
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.host.lease_client import LeaseKeeper
from retuner.drivers.host.page_reader import PageReader
from retuner.drivers.host.write_protocol import Sequence, WriteOrder, WriteProtocol
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.frames import (
    EPOCH_TAG,
    STORE_TAG,
    Ack,
    Challenge,
    Confirm,
    Frame,
    Kind,
    Load,
    Mode,
    Reason,
    Setpoint,
    Store,
    reason_text,
)
from retuner.schedule.gains import PidGains

# Setpoint, mode, load, store and confirm: single-frame commands, repeated until the device has acknowledged them.
#
# The latest command of a kind counts. A repeated frame carries the same counter, so the device acts on it once.


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
    """Commands under way, at most one of each kind.

    timeout_s : how long to wait for an acknowledge, s.
    owner : this host's number in the lease.
    check : raises when a frame cannot be sent.
    """

    def __init__(self, timeout_s: float, owner: int, check: Callable[[Frame], object]) -> None:
        self._timeout_s, self._owner, self._check = timeout_s, owner, check
        self._counters: dict[Kind, int] = {}
        self._waiting: dict[Kind, _Waiting] = {}

    def setpoint(self, sp: float) -> None:
        """Set the target, pv unit."""
        self._put(Kind.SETPOINT, lambda counter: Setpoint(counter, sp, self._owner))

    def mode(self, *, auto: bool, co: float) -> None:
        """Auto, or manual with co percent."""
        mode = LoopMode.AUTO if auto else LoopMode.MANUAL
        self._put(Kind.MODE, lambda counter: Mode(counter, mode, co, self._owner))

    def load(self, load: float) -> None:
        """Disturb a simulated plant, percent of co."""
        self._put(Kind.LOAD, lambda counter: Load(counter, load, self._owner))

    def store(self, seq: int) -> None:
        """Keep set seq over a restart."""
        self._put(Kind.STORE, lambda _: Store(seq, self._owner % STORE_TAG), seq)

    def confirm(self, seq: int) -> None:
        """Set seq has proved itself."""
        self._put(Kind.CONFIRM, lambda _: Confirm(seq, self._owner), seq)

    def waits(self, kind: Kind) -> bool:
        """Whether a command of this kind is not acknowledged yet."""
        return kind in self._waiting

    def _put(self, kind: Kind, make: Callable[[int], Frame], number: int | None = None) -> None:
        """Send a command from the next `due` on; number takes the counter's place in its acknowledge."""
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


# When a set that was written may be confirmed: after so many samples have shown it running and the link sound.


class Probation:
    """The set that waits to be confirmed by this host.

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


GAIN_KINDS = (Kind.STAGE, Kind.COMMIT, Kind.ABORT)


class HostRequests:
    """The requests of one host to one controller.

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

        Raises WriteRefusedError: a write is under way, another host holds the lease, or the gains do not fit the wire.
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

        Raises WriteRefusedError: it is on probation.
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
            self.sequence.correct(ack, self.write.seq)
            self.write.on_ack(ack)
            self._notice_owner(ack)
            return None
        if ack.kind == Kind.LEASE:
            news = self.lease.on_ack(ack)
            if self.lease.other is not None:
                self.write.on_other_owner(self.lease.other)
            return news
        self._notice_owner(ack)
        event = self.commands.on_ack(ack)
        if ack.kind != Kind.CONFIRM or event is None:
            return event
        if isinstance(event, CommandFailed):  # the controller would still go back to the set before
            self.probation.again()
            return event
        self.probation.end()
        return None

    def _notice_owner(self, ack: Ack) -> None:
        """A refusal that tells what this host's clock does not: the lease has run out. It is taken again at once."""
        if ack.reason == Reason.NOT_OWNER and self.lease.held:
            self.lease.forget()

    def due(self, now_s: float, stamp: int | None) -> tuple[list[Frame], list[Event]]:
        """Frames to send now, the lease's first, and what came to nothing; without a stamp no lease is asked for."""
        frames: list[Frame] = [*self.lease.due(now_s, stamp)]
        if self.write.needs_number and self.write.base is not None and self.lease.held:
            number = self.sequence.after(self.write.base)
            self.sequence.note(number)
            self.write.renumber(number)
        frames += self.write.due(now_s, owned=self.lease.held, asked=self.lease.asked)
        events: list[Event] = []
        unknown = self.write.unknown()
        if unknown is not None:
            events.append(unknown)
        commands, failed = self.commands.due(now_s)
        if any(failure.command == "confirm" for failure in failed):
            self.probation.again()
        return [*frames, *commands], [*events, *failed]
