"""Length of a gain transaction on an idle bus: simulated time and real code of both ends, so a fact, no measurement."""

from types import SimpleNamespace

import can
import pytest
from answering_wire import Wire
from bus_simulation.device_end import LagPlant

from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import WriteDone
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.schedule.gains import PidGains

KEY = bytes(range(16))
SAMPLE_S, CONNECTED = 2.0, 8  # Of the controller; samples after which the order is given, right after a poll


@pytest.mark.parametrize(("polls", "samples"), [(1, 3.0), (2, 1.5), (4, 1.25), (10, 1.1)])
@pytest.mark.parametrize(("key", "frames"), [(None, 14), (KEY, 18)], ids=["plain", "with code"])
def test_a_transaction_takes_three_samples_or_less(polls: int, samples: float, key: bytes | None, frames: int) -> None:
    device, answers, swapped = VirtualDevice(VirtualDeviceSettings(PidGains(1, 0.0625), key=key), LagPlant()), [], None

    def receive(message: can.Message) -> list[can.Message]:
        found = device.receive(message)
        answers.extend(found)
        return found

    wire = Wire(SimpleNamespace(receive=receive))
    host = CanDevice(wire, CanDeviceSettings(sample_time_s=SAMPLE_S, key=key))
    for turn in range(-CONNECTED * polls, 4 * polls):
        now_s = (turn / polls + CONNECTED) * SAMPLE_S
        if turn % polls == 0:
            wire.waiting += device.step()
        done = any(isinstance(event, WriteDone) for event in host.poll(now_s + 0.5 * SAMPLE_S / polls))
        if turn == 0:
            del wire.sent[:], answers[:]
            host.begin_write(PidGains(1.5, 0.125), now_s)
        swapped = turn / polls if swapped is None and device.running.seq == 1 else swapped
        if done:
            break
    assert 1 / polls <= swapped <= turn / polls == pytest.approx(samples)
    assert len(wire.sent) + len(answers) == frames
