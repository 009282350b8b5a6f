"""Somebody else on the bus with the shipped DBC: noise under our identifiers, stale and forged commands, whole sets."""

import contextlib
import struct
import zlib
from collections.abc import Callable
from random import Random

import can

from bus_simulation.bus import STRANGER as NAME
from bus_simulation.bus import Bus
from bus_simulation.truth import Order, Truth
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.protocol.checksum import commit_crc, frame_crc, lease_stamp, page_crc, set_crc, to_wire
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import (
    EPOCH_TAG,
    OWNER_TAG,
    PAGE_TAG,
    RUNNING_TAG,
    STORE_TAG,
    Abort,
    Ack,
    Auth,
    Challenge,
    Commit,
    Confirm,
    Frame,
    Heartbeat,
    Identity,
    Item,
    Lease,
    Load,
    Mode,
    Page,
    PageEnd,
    PageItem,
    Read,
    Setpoint,
    Stage,
    Status,
    Store,
    TelemetryPv,
    TelemetrySp,
)
from retuner.schedule.gains import PidGains

BAD_NUMBERS = (float("nan"), float("inf"), float("-inf"), 1e30, -1.0, 0.0, 1e-40)


class Intruder:
    """It knows everything that is on the bus and all that the device knows but the key.

    forges : whether it also speaks as the device.
    """

    def __init__(self, bus: Bus, device: VirtualDevice, truth: Truth, rng: Random, *, forges: bool) -> None:
        self.bus, self.device, self.truth, self._rng = bus, device, truth, rng
        self._codec = Codec(device.settings.node)
        self._acts: list[Callable[[], None]] = [
            self._noise,
            self._noise,
            self._command,
            self._command,
            self._replay,
            self._replay,
            self._whole_set,
            self._bad_set,
            self._odd_frame,
            self._fence,
        ]
        if forges:
            self._acts += [self._forge] * 5

    def act(self) -> None:
        """Do one of its tricks."""
        self.truth.counts["intruder acts"] += 1
        self._rng.choice(self._acts)()

    def _say(self, frame: Frame) -> None:
        self.bus.send(NAME, self._codec.encode(frame))

    def _raw(self, id_: int, data: bytes) -> None:
        self.bus.send(NAME, can.Message(arbitration_id=id_, is_extended_id=False, data=data))

    def _owner(self) -> int:
        """The owner's number, or one of its own."""
        holder = self.device.lease.owner
        return holder if holder and self._rng.random() < 0.6 else self._rng.randrange(1, 65536)

    def _stamp(self) -> int:
        """Stamp of the device's present time, for the lease."""
        return lease_stamp(self.device.epoch, self.device.sample)

    def _noise(self) -> None:
        """Random bytes under our identifiers, half of them with a right checksum."""
        rng = self._rng
        id_ = 32 + rng.randrange(32)
        data = bytearray(rng.randbytes(rng.choice((8, 8, 8, 8, rng.randrange(9)))))
        if data and rng.random() < 0.5:
            data[-1] = frame_crc(id_, data[:-1])
        self._raw(id_, bytes(data))

    def _command(self) -> None:
        """A single command that is right in form."""
        rng, owner = self._rng, self._owner()
        seq = (self.device.pages.latest + rng.choice((-1, 0, 0, 1, 1, 2, 40000))) % 65536
        counter, running = rng.randrange(256), self.device.running.seq
        frames: tuple[Frame, ...] = (
            Lease(owner, rng.choice((self._stamp(), 7)), rng.choice((0, 5, 300, 65535)), counter),
            Read(rng.randrange(5), rng.randrange(65536)),
            Stage(rng.randrange(3), owner % OWNER_TAG, rng.uniform(-2, 20), seq),
            Commit(seq, running, rng.randrange(1 << 32)),
            Store(running, owner % STORE_TAG),
            Auth(rng.randrange(2), seq % 16, rng.randrange(1 << 48)),
            Setpoint(counter, rng.uniform(20, 80), owner),
            Mode(counter, rng.randrange(2), rng.uniform(0, 100), owner),
            Load(counter, rng.uniform(-10, 10), owner),
        )
        self._say(rng.choice(frames))

    def _fence(self) -> None:
        """An abort of what is being written, or a confirmation of what runs."""
        latest, running = self.device.pages.latest, self.device.running.seq
        self._say(self._rng.choice((Abort(latest), Abort((latest + 1) % 65536), Confirm(running, self._owner()))))

    def _replay(self) -> None:
        """A frame, or a run of frames, that was on the bus before."""
        history = self.bus.history
        if not history:
            return
        start = self._rng.randrange(len(history))
        for message in list(history)[start : start + self._rng.choice((1, 1, 6))]:
            self.bus.send(NAME, message)

    def _whole_set(self) -> None:
        """A set of its own, staged and committed with right numbers, as the owner of the lease or after taking it."""
        rng, device = self._rng, self.device
        old = device.running.gains
        gains = to_wire(PidGains(old.kp * rng.uniform(0.5, 2.0), old.ki * rng.uniform(0.5, 2.0), old.kd or 0.1))
        owner = device.lease.owner or rng.randrange(1, 65536)
        if not device.lease.owner:
            self._say(Lease(owner, self._stamp(), 50, rng.randrange(256)))
        device, base = self.device, self.device.running.seq
        seq = (device.pages.latest + 1) % 65536
        self.truth.ordered(Order(device.epoch, seq, base, gains, owner, NAME))
        for item, value in zip(Item, (gains.kp, gains.ki, gains.kd), strict=True):
            self._say(Stage(item, owner % OWNER_TAG, value, seq))
        for part in (0, 1):
            self._say(Auth(part, seq % 16, self._rng.randrange(1 << 48)))
        self._say(Commit(seq, base, commit_crc(set_crc(device.settings.node, device.epoch, seq, gains), base, owner)))

    def _bad_set(self) -> None:
        """A set that must hardly ever run, with all checksums right."""
        rng, device, base = self._rng, self.device, self.device.running.seq
        node, owner, seq = device.settings.node, device.lease.owner or 5, (device.pages.latest + 1) % 65536
        values = [0.5, 0.05, 0.1]
        values[rng.randrange(3)] = rng.choice(BAD_NUMBERS)
        with contextlib.suppress(ValueError):  # some may be legal after all, on what runs now
            gains = to_wire(PidGains(*values))
            self.truth.ordered(Order(device.epoch, seq, base, gains, owner, NAME))
        for item, value in enumerate(values):
            id_ = node << 5 | 4
            data = struct.pack("<BfH", item | owner % OWNER_TAG << 2, value, seq)
            self._raw(id_, data + bytes([frame_crc(id_, data)]))
        crc = zlib.crc32(struct.pack("<BHHfff", node, device.epoch, seq, *values))
        self._say(Commit(seq, base, commit_crc(crc, base, owner)))

    def _odd_frame(self) -> None:
        """Frames that are no classic data frames with 11-bit identifiers, or belong to other nodes."""
        rng = self._rng
        id_, data = 32 + rng.randrange(32), rng.randbytes(8)
        kind = rng.randrange(5)
        message = can.Message(
            arbitration_id=id_ + 32 * (kind == 4),
            is_extended_id=kind == 0,
            is_remote_frame=kind == 1,
            is_error_frame=kind == 2,
            is_fd=kind == 3,
            data=None if kind == 1 else data,
            dlc=8,
        )
        self.bus.send(NAME, message)

    def _forge(self) -> None:
        """A frame as from the device, with a right checksum."""
        rng, device = self._rng, self.device
        epoch, seq = device.epoch, (device.pages.latest + rng.choice((-1, 0, 1))) % 65536
        gains, token = device.running.gains, rng.randrange(65536)
        kind = rng.choice((1, 3, 4, 5, 5, 3, 6, 7, 8))
        frames: tuple[Frame, ...] = (
            Ack(kind, seq, rng.choice((0, 0, rng.randrange(19))), seq, 0, epoch % EPOCH_TAG),
            Ack(kind, seq, 0, seq, 0, epoch % EPOCH_TAG),
            Heartbeat(rng.choice((device.sample, rng.randrange(1 << 32))), rng.choice((epoch, epoch + 1)) % 65536, 1),
            Status(seq, rng.randrange(65536), 0, 0),
            Identity(rng.choice((2, 9)), rng.randrange(65536), 2.0),
            Challenge(rng.randrange(128), rng.randrange(2), rng.randrange(1 << 48)),
            TelemetryPv(device.sample % 256, 0.0, 0.0),
            TelemetrySp((device.sample + 1) % 256, 0.0, 1, 0, seq % RUNNING_TAG, 0),
            PageItem(rng.randrange(2), rng.randrange(3), token % PAGE_TAG, rng.uniform(0, 9), seq),
            PageEnd(Page.RUNNING, 1, token % PAGE_TAG, seq, page_crc(set_crc(1, epoch, seq, gains), token)),
        )
        self._say(rng.choice(frames))
