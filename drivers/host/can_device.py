"""The host's side of one controller on CAN: everything happens in poll(), nothing blocks, no thread, no clock.

Connecting is SEARCHING (who is there: protocol, frame layout, sample time) -> READING (what runs) -> CONNECTED. What
runs is known from read-back alone (running_set.py); when the device falls silent it is unknown until read again.
Only the host that holds the lease (lease_and_commands.py) may change anything; the others watch. A write begins in
`begin_write` as an order; write_protocol.py has its frames, which `_send_due` sends at each poll, as retuner.dbc lays
them out.
"""

from collections.abc import Callable
from enum import Enum

from retuner.adaptive.signals.sample import LoopMode
from retuner.drivers.bus.link_settings import FramePort
from retuner.drivers.device import (
    CommandFailed,
    Contact,
    DeviceConflict,
    DeviceMismatchError,
    DeviceRestarted,
    DeviceSilentError,
    Event,
    ForeignHost,
    LinkChanged,
    LinkState,
    Reverted,
    RunningChanged,
    RunningSet,
    SamplesLost,
    WriteDone,
    WriteRefusedError,
)
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.host.lease_and_commands import CommandSender, LeaseKeeper, Probation
from retuner.drivers.host.page_reader import PageReader, ReadBack
from retuner.drivers.host.running_set import Belief, RunningBelief
from retuner.drivers.host.write_protocol import SequenceNumbers, WriteOrder, WritePhase, WriteProtocol
from retuner.drivers.protocol import frames
from retuner.drivers.protocol.checksum import STAMP_SAMPLES, lease_stamp, to_wire
from retuner.drivers.protocol.codec import Codec, FrameError, Refusal, Refused, schema
from retuner.drivers.protocol.frames import PROTOCOL_VERSION, Identity
from retuner.drivers.state_machine import StateMachine
from retuner.drivers.telemetry.device_counter import Said
from retuner.drivers.telemetry.sample_assembly import SampleJoiner
from retuner.drivers.telemetry.telemetry_quality import Stream
from retuner.schedule.gains import PidGains

TOLERANCE = 1e-6  # relative, of the sample time: float32 on the wire


def mismatch(identity: Identity, sample_time_s: float) -> str:
    """What is wrong with who is there, or an empty string; sample_time_s is the one that the host expects."""
    if identity.protocol != PROTOCOL_VERSION:
        return f"it speaks protocol {identity.protocol}, this host {PROTOCOL_VERSION}; update the older of them"
    if identity.schema != schema():
        return f"its frame layout is {identity.schema:#06x}, here {schema():#06x}; use one retuner.dbc on both"
    if abs(identity.sample_time - sample_time_s) > TOLERANCE * sample_time_s:
        return f"its sample time is {identity.sample_time:g} s, configured are {sample_time_s:g} s; make them equal"
    return ""


SLOWER_SAMPLES = STAMP_SAMPLES // 2
"""Samples by which a device may be behind its sample time, or ahead of it, over a time in which nobody looked; a stamp
that is older than the device's time by less than STAMP_SAMPLES counts, one that is younger does not."""


GAIN_KINDS = (frames.Kind.STAGE, frames.Kind.COMMIT, frames.Kind.ABORT)
TWO_DEVICES = "two devices answer under this number, or one is repeated; give each a number of its own"
"""Why a host does not connect."""


class ConnectPhase(Enum):
    """How far the connection is."""

    SEARCHING = "searching"
    READING = "reading"
    CONNECTED = "connected"


class ConnectInput(Enum):
    """What can happen to it."""

    IDENTIFIED = "the right device has said who it is"
    RUNNING_READ = "the active gains are read back"
    LOST = "nothing heard for too long, or the bus is gone"


P, C = ConnectPhase, ConnectInput
CONNECTION: dict[tuple[ConnectPhase, ConnectInput], ConnectPhase] = {
    (P.SEARCHING, C.IDENTIFIED): P.READING,
    (P.READING, C.RUNNING_READ): P.CONNECTED,
    (P.READING, C.LOST): P.SEARCHING,
    (P.CONNECTED, C.RUNNING_READ): P.CONNECTED,
    (P.CONNECTED, C.LOST): P.SEARCHING,
}
"""Everything that is not here leaves the phase as it is: an answer that comes twice, or late."""


class CanDevice:
    """A controller on CAN: device.Device says what its methods promise.

    link : open bus of its own, or this node's port of a shared one.
    settings : address and patience. after_s : time of the newest sample that an earlier session has seen, s: a device
    that has restarted since and counts anew goes on behind it.
    """

    def __init__(self, link: FramePort, settings: CanDeviceSettings, after_s: float | None = None) -> None:
        self.link, self.settings = link, settings
        self.machine = StateMachine(CONNECTION, ConnectPhase.SEARCHING)
        self.foreign_commands = 0  # frames to this node from another host
        self.refused_frames = 0
        self._codec = Codec(settings.node)
        self._reader = PageReader(settings.owner)
        self._belief = RunningBelief(settings.node)
        length = settings.lease_length
        self.lease = LeaseKeeper(settings.owner, length, length * settings.sample_time_s, settings.reply_s)
        self.write = WriteProtocol(self._reader, settings.reply_s)
        self.commands = CommandSender(settings.reply_s, settings.owner, self._codec.encode)
        self.sequence = SequenceNumbers()
        self.probation = Probation(settings.probation_samples)
        self._joiner = SampleJoiner(settings.sample_time_s, settings.variable, settings.node, after_s)
        self._contact = Contact(settings.silent_s, settings.connect_s)
        self._sample_s = self._ask_s = float("-inf")
        self._told_wrong = ""  # what was told of a device that is not the right one
        self._events: list[Event] = []

    @property
    def connected(self) -> bool:
        """Whether the device is heard and its running set is known."""
        return self.machine.phase is ConnectPhase.CONNECTED and self._belief.running is not None

    @property
    def running(self) -> RunningSet | None:
        """The set that runs, from read-back; None while unknown."""
        return self._belief.running

    @property
    def writing(self) -> bool:
        """Whether a write is under way or its result unknown."""
        return self.write.busy

    @property
    def epoch(self) -> int | None:
        """Boot epoch of the device, as read-back has proved it."""
        return self._belief.epoch

    def poll(self, now_s: float) -> list[Event]:
        """Take what has arrived, send what is due, tell what happened: see device.Device."""
        for message in self.link.receive_all():
            frame = self._codec.decode(message)
            if isinstance(frame, Refused):
                self.refused_frames += not self._joiner.tap.take(message) and frame.refusal is not Refusal.FOREIGN
            elif isinstance(frame, frames.DeviceFrame):
                self._contact.heard_s = now_s
                self._take(frame, now_s)
            else:
                # Somebody else commands this controller
                self.foreign_commands += 1
                if self.foreign_commands.bit_count() == 1:
                    self._events.append(ForeignHost(self.foreign_commands))
        self._notice_silence(now_s)
        if self._belief.conflict_news():
            self._events.append(DeviceConflict(self.settings.node))
        self._ask(now_s)
        self._send_due(now_s)
        events, self._events = self._events, []
        return events

    def _take(self, frame: frames.DeviceFrame, now_s: float) -> None:
        match frame:
            case frames.TelemetryPv() | frames.TelemetrySp() if self.machine.phase is ConnectPhase.CONNECTED:
                before = self._joiner.contradictions
                joined = self._joiner.take(frame)
                if self._joiner.contradictions > before:
                    self._belief.contradicted()
                if joined is not None:  # both halves of a sample are here
                    self._sample_s = now_s
                    self._events += [SamplesLost(joined.lost, joined.sample.t_s)] if joined.lost else []
                    self._events += [*self._joiner.tap.news(), joined.sample]
                    self._on_running_number(joined.sample.revision)
                    proven = self.probation.sample(joined.sample.revision)
                    if proven is not None:
                        self.commands.confirm(proven)
            case frames.Heartbeat():
                if self._belief.on_heartbeat(frame) and self._joiner.set_reference(frame.sample) is Said.CONTRADICTS:
                    self._belief.contradicted()
            case frames.Status():
                self.sequence.note(frame.latest)
                self._on_running_number(frame.running)
            case frames.Identity():
                self._on_identity(frame, now_s)
            case frames.PageItem() | frames.PageEnd():
                # A whole read-back, or none yet
                page = self._reader.take(frame)
                if page is not None and page.page == frames.Page.STAGED:
                    self.write.on_staged(page)
                elif page is not None and page.page == frames.Page.RUNNING:
                    self._on_running(page, now_s)
            case frames.Challenge() if self._reader.is_newest(frame):
                self.write.on_challenge(frame)
            case frames.Ack():
                event = self._on_ack(frame)
                self._events += [event] if event is not None else []

    def _on_ack(self, ack: frames.Ack) -> Event | None:
        """An answer to a request; the news if there are any. One given in another epoch answers nothing."""
        epoch = self._belief.epoch
        if epoch is None or ack.epoch != epoch % frames.EPOCH_TAG:
            return None
        if ack.kind == frames.Kind.LEASE:
            news = self.lease.on_ack(ack)
            if self.lease.other is not None:
                self.write.on_other_owner(self.lease.other)
            return news
        event: Event | None = None
        if ack.kind in GAIN_KINDS:
            self.sequence.correct(ack, self.write.seq)
            self.write.on_ack(ack)
        else:
            event = self.commands.on_ack(ack)
        if ack.reason == frames.Reason.NOT_OWNER and self.lease.held:  # it has run out, which this clock does not tell
            self.lease.forget()
        if ack.kind != frames.Kind.CONFIRM or event is None:
            return event
        if isinstance(event, CommandFailed):  # the controller would still go back to the set before
            self.probation.again()
            return event
        self.probation.end()
        return None

    def _on_running_number(self, seq: int) -> None:
        """A number that is not the known one means that somebody else has written, if no write asks what runs."""
        running = self._belief.running
        if running is not None and seq != running.seq and self.write.phase is not WritePhase.READING:
            self._belief.doubt()

    def _on_identity(self, identity: frames.Identity, now_s: float) -> None:
        """Who is there: go on only with the right one, at the first connection and after every restart."""
        if self.machine.phase is not ConnectPhase.SEARCHING and not self._belief.unidentified:
            return
        wrong = mismatch(identity, self.settings.sample_time_s)
        if wrong and not self._contact.made:
            raise DeviceMismatchError(f"{self._where}: {wrong}")
        if wrong and wrong != self._told_wrong:
            self._events.append(LinkChanged(LinkState.SILENT, f"the device that answers is another: {wrong}"))
        self._told_wrong = wrong
        if wrong:
            self._lose()
            return
        self._belief.identify()
        if self.machine.take(ConnectInput.IDENTIFIED):
            self._ask_s = now_s

    def _on_running(self, page: ReadBack, now_s: float) -> None:
        verdict, running = self._belief.on_page(page), self._belief.running
        if verdict is Belief.NOTHING or running is None:
            return
        if verdict is Belief.FIRST:
            self._joiner.set_reference(self._belief.boot_sample)
        if verdict is Belief.RESTARTED:
            gap = self._joiner.restart_after(self._belief.boot_sample, now_s - self._sample_s)
            self.write.on_restart()
            self.lease.forget()  # as the device has
            self._events.append(DeviceRestarted(self._belief.epoch or 0, running, gap))
        before = self.machine.phase
        if self.machine.take(ConnectInput.RUNNING_READ) and before is ConnectPhase.READING:
            self._contact.made = True
            self._events.append(LinkChanged(LinkState.UP, "controller found, active gains read back"))
        outcome = self.write.on_running(running)
        if isinstance(outcome, WriteDone):
            self.probation.begin(running.seq)
        elif running.seq != self.probation.seq:
            self.probation.end()
        if outcome is not None:
            self._events.append(outcome)
        elif verdict is Belief.CHANGED and not self.write.busy:
            back = not frames.newer(running.seq, self._joiner.running)
            self._events.append(Reverted(running) if back else RunningChanged(running))
        self._joiner.running = running.seq

    def _notice_silence(self, now_s: float) -> None:
        """Forget everything when nothing was heard for too long, or there is no bus."""
        reason = self._contact.lost(now_s, self.link.state)
        if self.machine.phase is ConnectPhase.SEARCHING or not reason:
            if self._contact.in_vain(now_s):
                silent = f"no answer within {self.settings.connect_s:g} s of the loop's time; "
                silent += "is the device running there, under this node number?"
                raise DeviceSilentError(f"{self._where}: {TWO_DEVICES if self._belief.in_conflict else silent}")
            return
        if self.machine.phase is ConnectPhase.CONNECTED:
            state = LinkState.DOWN if self.link.state is LinkState.DOWN else LinkState.SILENT
            self._events.append(LinkChanged(state, reason))
        self._lose()

    def _lose(self) -> None:
        """Begin anew with the question who is there."""
        self.machine.take(ConnectInput.LOST)
        self._belief.doubt()
        self._joiner.forget()
        self.lease.forget()

    @property
    def _where(self) -> str:
        return f"node {self.settings.node} on {self.link.settings.interface} {self.link.settings.channel}"

    def _ask(self, now_s: float) -> None:
        """Ask who is there, or what runs, as long as it is not known."""
        phase, belief, reads = self.machine.phase, self._belief, self.write.phase is WritePhase.READING
        who = phase is ConnectPhase.SEARCHING or belief.unidentified
        if (phase is ConnectPhase.CONNECTED and not belief.doubtful) or (reads and not who):
            self._ask_s = now_s
        elif now_s >= self._ask_s:
            self._ask_s = now_s + self.settings.reply_s
            if who:
                self._send(self._reader.ask(frames.Page.IDENTITY))
            if phase is not ConnectPhase.SEARCHING and not reads:
                self._send(self._reader.ask(frames.Page.RUNNING))

    def _send_due(self, now_s: float) -> None:
        """What the lease, the write and the commands want to send now."""
        epoch, sample = self._belief.epoch, self._joiner.device_sample
        stamp = None
        if self.machine.phase is ConnectPhase.CONNECTED and epoch is not None and sample is not None:
            stamp = lease_stamp(epoch, sample)
        due: list[frames.Frame] = [*self.lease.due(now_s, stamp)]
        if self.write.busy:
            if self.write.needs_number and self.write.base is not None and self.lease.held:
                self.write.renumber(self.sequence.after(self.write.base, use=True))
            due += self.write.due(now_s, owned=self.lease.held, asked=self.lease.asked)
            unknown = self.write.unknown()
            self._events += [unknown] if unknown is not None else []
            self._joiner.ordered = self.write.seq
        commands, failed = self.commands.due(now_s)
        for failure in failed:
            if failure.command == "confirm":
                self.probation.again()
        self._events += failed
        for frame in [*due, *commands]:
            self._send(frame)

    def _send(self, frame: frames.Frame) -> None:
        """Put a frame on the bus; what is lost is sent again by whoever waits for its answer."""
        self.link.send(self._codec.encode(frame))

    def begin_write(self, gains: PidGains, now_s: float, *, back: bool = False) -> int:
        """Start the two-phase write: see device.Device. WriteProtocol.due has its frames, now and at each poll."""
        running, epoch, settings = self._belief.running, self._belief.epoch, self.settings
        if running is None or epoch is None or not self.connected:
            raise self._refused("not connected, active gains unknown; wait for LinkChanged(UP)")
        if self._joiner.arrivals.state is Stream.INVALID and not back:
            raise self._refused("too many of the latest telemetry frames were wrong; wait")
        if self.write.busy:
            raise self._refused("a write is under way; wait for its WriteDone or WriteFailed")
        if self.lease.other is not None:
            raise self._refused(f"host {self.lease.other} holds the lease; stop it, or wait until it runs out")
        seq = self.sequence.after(running.seq)
        try:
            order = WriteOrder(settings.node, epoch, seq, running.seq, to_wire(gains), settings.owner, settings.key)
            for frame in order.stage():
                self._codec.encode(frame)  # can it be sent?
        except ValueError as error:
            raise self._refused(str(error)) from error
        self.sequence.note(seq)
        self.write.begin(order)
        self._send_due(now_s)
        return seq

    def _refused(self, why: str) -> WriteRefusedError:
        return WriteRefusedError(f"{self._where}: {why}")

    def send_setpoint(self, sp: float, now_s: float) -> None:
        """Set the target in pv units: see device.Device."""
        owner = self.settings.owner
        self._command(frames.Kind.SETPOINT, lambda counter: frames.Setpoint(counter, sp, owner), now_s)

    def send_mode(self, *, auto: bool, co: float, now_s: float) -> None:
        """Auto, or manual with co percent: see device.Device."""
        mode, owner = LoopMode.AUTO if auto else LoopMode.MANUAL, self.settings.owner
        self._command(frames.Kind.MODE, lambda counter: frames.Mode(counter, mode, co, owner), now_s)

    def send_load(self, load: float, now_s: float) -> None:
        """Disturb a simulated plant, percent of co: see device.Device."""
        owner = self.settings.owner
        self._command(frames.Kind.LOAD, lambda counter: frames.Load(counter, load, owner), now_s)

    def store(self, now_s: float) -> None:
        """Keep the running set: see device.Device."""
        running = self._belief.running
        if running is None:
            raise self._refused("the active gains are unknown, so they cannot be stored")
        if running.seq == self.probation.seq:
            raise self._refused(f"set {running.seq} is on probation; store it once it is confirmed")
        frame = frames.Store(running.seq, self.settings.owner % frames.STORE_TAG)
        self._command(frames.Kind.STORE, lambda _: frame, now_s, running.seq)

    def confirm(self, now_s: float) -> bool:
        """Confirm the running set without any more probation; whether it is: see device.Device."""
        seq = self.probation.seq
        if seq is not None and not self.commands.waits(frames.Kind.CONFIRM):
            self.commands.confirm(seq)
        self._send_due(now_s)
        return seq is None

    def keep_lease(self, now_s: float) -> None:
        """Prolong the lease if it is time, from whatever thread: the link's clock calls this beside the polls.

        A host that does not poll does not see how far the device has counted; it has gone on by its sample time.
        """
        epoch, sample = self._belief.epoch, self._joiner.device_sample
        if self.machine.phase is not ConnectPhase.CONNECTED or epoch is None or sample is None:
            return
        unseen = int((now_s - self._sample_s) / self.settings.sample_time_s) if self._sample_s > float("-inf") else 0
        stamp = lease_stamp(epoch, sample + max(unseen - SLOWER_SAMPLES, 0))
        for frame in self.lease.prolong(now_s, stamp):
            self._send(frame)

    def release(self, now_s: float) -> None:
        """Give the lease back, so that another host need not wait until it runs out; for the end of a session."""
        self.lease.release()
        self._send_due(now_s)

    def _command(
        self, kind: frames.Kind, make: Callable[[int], frames.Frame], now_s: float, number: int | None = None
    ) -> None:
        try:
            self.commands.put(kind, make, number)
        except FrameError as error:
            raise self._refused(str(error)) from error
        self._send_due(now_s)
