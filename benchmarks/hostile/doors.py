"""A device and a host at work, into which hostile frames are thrown: nothing may stop them or change what runs."""

import random
from collections import deque

import can

from retuner import LinearProcess, PidGains
from retuner.drivers.bus.bus import LinkSettings
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import DeviceError, LinkState
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.checksum import frame_crc
from retuner.drivers.protocol.codec import COMMAND_BITS, Codec

NODE = 5
FIRST = PidGains(1.0, 0.0625, 0.5)
STEP_EVERY = 8  # hostile frames to a sample
SEEN_MAX = 500
SAMPLE_S = 2.0


class Wire:
    """The host's link: what it sends goes to the device, what stands in `incoming` it receives."""

    settings = LinkSettings()
    state = LinkState.UP

    def __init__(self) -> None:
        self.incoming: list[can.Message] = []
        self.outgoing: list[can.Message] = []

    def send(self, message: can.Message) -> bool:
        """To the device."""
        self.outgoing.append(message)
        return True

    def receive_all(self, limit: int = 10_000) -> list[can.Message]:
        """What has come for the host."""
        taken, self.incoming = self.incoming[:limit], self.incoming[limit:]
        return taken


class Doors:
    """Both ends, and the frames seen so far, which are what mutants are made of."""

    def __init__(self) -> None:
        self.codec = Codec(NODE)
        plant = LinearPlant(LinearProcess(1.0, (30.0,)), start_pv=50.0)
        self.device = VirtualDevice(VirtualDeviceSettings(FIRST, node=NODE, sample_time_s=SAMPLE_S), plant)
        self.wire = Wire()
        self.host = CanDevice(self.wire, CanDeviceSettings(node=NODE, sample_time_s=SAMPLE_S, connect_samples=1000))
        self.seen: deque[can.Message] = deque(maxlen=SEEN_MAX)
        self.frames = self.samples = self.connected = 0
        self.wrong: list[str] = []

    def hostile(self, rng: random.Random) -> can.Message:
        """A frame of somebody who means harm or is broken."""
        if not self.seen or rng.random() < 0.3:
            id_ = rng.choice((rng.randrange(1 << 11), NODE << COMMAND_BITS | rng.randrange(32), rng.randrange(1 << 29)))
            data = rng.randbytes(rng.choice((0, 1, 2, 5, 6, 7, 8, 8, 8)))
        else:
            model = rng.choice(self.seen)
            id_, data = model.arbitration_id, bytearray(model.data)
            for _ in range(rng.choice((0, 1, 1, 3))):
                if data:
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            if rng.random() < 0.1:
                id_ = NODE << COMMAND_BITS | rng.randrange(32)
        data = bytearray(data)
        if len(data) > 1 and rng.random() < 0.5:
            data[-1] = frame_crc(id_ & 0x7FF, data[:-1])  # somebody who knows the checksum
        kind = rng.random()
        extended = id_ > 0x7FF or kind < 0.03
        if kind > 0.97:
            return can.Message(arbitration_id=id_, is_extended_id=extended, is_remote_frame=True, dlc=len(data))
        fd = kind > 0.94
        return can.Message(arbitration_id=id_, is_extended_id=extended, data=data, is_fd=fd)

    def knock(self, message: can.Message) -> None:
        """The frame reaches both ends; now and then a sample passes."""
        self.wire.incoming += self.device.receive(message)
        self.wire.incoming.append(message)
        self.frames += 1
        if self.frames % STEP_EVERY == 0:
            self.wire.incoming += self.device.step()
            self.seen.extend(self.wire.incoming[-3:])
            self.samples += 1
            try:
                self.host.poll(SAMPLE_S * self.samples)
            except DeviceError as error:  # allowed before the first connection only; a forged identity may say so
                if self.connected:
                    self.wrong.append(f"the host gave up after it had connected: {error}")
            sent, self.wire.outgoing = self.wire.outgoing, []
            self.seen.extend(sent)
            for frame in sent:
                self.wire.incoming += self.device.receive(frame)
            self.connected += self.host.connected
            if self.device.running.gains != FIRST:
                self.wrong.append(f"sample {self.samples}: gains that nobody ordered run: {self.device.running}")

    def broken(self) -> list[str]:
        """What went wrong; also when the two never talked."""
        if self.samples > 1000 and self.connected < self.samples / 100:
            self.wrong.append(f"connected in {self.connected} of {self.samples} samples only")
        return self.wrong
