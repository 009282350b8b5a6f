"""Lets a virtual device run on a bus: in lock-step with simulated time, or against the machine's clock."""

import secrets
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import can

from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.shared_link import LinkPort
from retuner.drivers.clock import Clock

LATE_SAMPLES = 1.0  # behind by more than this many samples, the device gives up catching up and counts an overrun


def fresh_epoch() -> int:
    """A boot epoch for a device process that remembers none: random, so that a host sees that it is another boot."""
    return secrets.randbelow(1 << 16)


class BusDevice(Protocol):
    """A controller in software: our own virtual device, or one of a foreign kind."""

    @property
    def sample_time_s(self) -> float:
        """Controller sample time, s."""

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample; the frames that it sends."""

    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame from the bus; the frames that answer it."""


class DeviceOnBus:
    """A virtual device and its end of a bus.

    device : firmware and plant.
    link : open bus, used by this device alone; or a port of its own on a shared one.
    """

    def __init__(self, device: BusDevice, link: CanLink | LinkPort) -> None:
        self.device, self.link = device, link
        self.samples = self.overruns = 0
        link.expect_silence()

    def sample(self, dt_s: float | None = None) -> None:
        """One controller sample: answer what has arrived, step, send."""
        self.answer()
        self.samples += 1
        for message in self.device.step(dt_s):
            self.link.send(message)

    def answer(self) -> None:
        """Answer what has arrived."""
        for message in self.link.receive_all():
            for reply in self.device.receive(message):
                self.link.send(reply)


class RunReport(NamedTuple):
    """What a run of the device came to."""

    samples: int
    overruns: int


def run_devices(
    devices: Sequence[DeviceOnBus],
    clock: Clock,
    *,
    until_s: float = float("inf"),
    stop: Callable[[], bool] = lambda: False,
) -> RunReport:
    """Run devices until the clock reads until_s or stop() says so: samples at their times, answers in between.

    The sampling is kept from the first instant on, so small delays do not add up. When the machine falls behind by more
    than LATE_SAMPLES, the missed instants are counted and time stands still for all devices alike: were it for one of
    them only, a plant that they share would go on between two samples of the others by more than these believe.
    """
    periods_s = [one.device.sample_time_s for one in devices]
    next_s = [clock.now_s() + period_s for period_s in periods_s]
    samples = overruns = 0
    while min(next_s) <= until_s and not stop():
        i = next_s.index(min(next_s))
        if clock.now_s() < next_s[i]:
            devices[0].link.wait_until(next_s[i])
            for one in devices:
                one.answer()
            continue
        devices[i].sample()
        samples += 1
        next_s[i] += periods_s[i]
        late = (clock.now_s() - next_s[i]) / periods_s[i]
        if late > LATE_SAMPLES:
            overruns += int(late)
            devices[i].overruns += int(late)
            next_s = [at_s + int(late) * periods_s[i] for at_s in next_s]
    return RunReport(samples, overruns)
