"""How long a gain transaction takes on an idle bus, in controller samples of simulated time: real code of both ends."""

from typing import NamedTuple

import can

from bus_simulation.device_end import LagPlant
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import LinkState, WriteDone
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.schedule.gains import PidGains

SAMPLE_S = 2.0
CONNECT_SAMPLES = 8
LONGEST = 100  # samples


class Transaction(NamedTuple):
    """From the order on: samples until the new set ran, until the host had read it back, frames of both ends."""

    swap_samples: float
    done_samples: float
    frames: int


class _Wire:
    """An idle bus: what is sent is there, and answered, at once."""

    settings, state = LinkSettings(), LinkState.UP

    def __init__(self, device: VirtualDevice) -> None:
        self._device = device
        self.inbox: list[can.Message] = []
        self.frames = 0

    def send(self, message: can.Message) -> bool:
        """To the device, whose answers wait for the host's next poll."""
        answers = self._device.receive(message)
        self.inbox += answers
        self.frames += 1 + len(answers)
        return True

    def receive_all(self) -> list[can.Message]:
        """What has arrived."""
        messages, self.inbox = self.inbox, []
        return messages


def transaction(polls_per_sample: int, key: bytes | None = None) -> Transaction:
    """One write by a host that polls so often; the order is given right after a poll.

    Raises RuntimeError: the write was not done.
    """
    device = VirtualDevice(VirtualDeviceSettings(PidGains(1.0, 0.0625), key=key), LagPlant())
    wire = _Wire(device)
    host = CanDevice(wire, CanDeviceSettings(sample_time_s=SAMPLE_S, key=key))
    swapped: float | None = None
    for turn in range((CONNECT_SAMPLES + LONGEST) * polls_per_sample):
        now_s = turn * SAMPLE_S / polls_per_sample
        if turn % polls_per_sample == 0:
            wire.inbox += device.step()
        events = host.poll(now_s + 0.5 * SAMPLE_S / polls_per_sample)
        samples = (turn - CONNECT_SAMPLES * polls_per_sample) / polls_per_sample
        if samples == 0:
            wire.frames = 0
            host.begin_write(PidGains(1.5, 0.125), now_s)
        if swapped is None and device.running.seq == 1:
            swapped = samples
        if swapped is not None and any(isinstance(event, WriteDone) for event in events):
            return Transaction(swapped, samples, wire.frames)
    raise RuntimeError("the write was not done")
