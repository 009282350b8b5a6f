"""Lets a virtual device run on a bus: in lock-step with simulated time, or against the machine's clock."""

import secrets
from collections.abc import Callable
from typing import NamedTuple, Protocol

import can

from retuner.drivers.bus.bus import CanLink
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
        ...

    def step(self, dt_s: float | None = None) -> list[can.Message]:
        """One controller sample; the frames that it sends."""
        ...

    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame from the bus; the frames that answer it."""
        ...


class DeviceOnBus:
    """A virtual device and its end of a bus.

    Parameters
    ----------
    device : firmware and plant.
    link : open bus, used by this device alone.
    """

    def __init__(self, device: BusDevice, link: CanLink) -> None:
        self.device, self.link = device, link
        self.samples = 0
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


def run_device(
    on_bus: DeviceOnBus, clock: Clock, *, until_s: float = float("inf"), stop: Callable[[], bool] = lambda: False
) -> RunReport:
    """Run a device until the clock reads until_s or stop() says so: a sample every sample time, answers in between.

    The sampling is kept from the first instant on, so small delays do not add up. When the machine falls behind by more
    than LATE_SAMPLES, the missed instants are skipped and counted: a real controller cannot make up for them either.
    """
    period_s = on_bus.device.sample_time_s
    next_s = clock.now_s() + period_s
    samples = overruns = 0
    while next_s <= until_s and not stop():
        clock_s = clock.now_s()
        if clock_s < next_s:
            on_bus.link.wait_until(next_s)
            on_bus.answer()
            continue
        on_bus.sample()
        samples += 1
        next_s += period_s
        late = (clock.now_s() - next_s) / period_s
        if late > LATE_SAMPLES:
            overruns += int(late)
            next_s += int(late) * period_s
    return RunReport(samples, overruns)
