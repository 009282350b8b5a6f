"""A device and its host on a bus of their own in simulated time: what the tests of this folder drive."""

import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from retuner import LinearProcess, LoopSample, PidGains
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import Event
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import GainBox

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[2] / "benchmarks")]  # speaking.py, bus_simulation

CHANNELS = itertools.count()


class Bench:
    """One sample after the other; everything that the host was told is kept. Gains are exact in float32."""

    FIRST = PidGains(1.0, 0.0625, 0.5)
    SECOND = PidGains(1.5, 0.125, 0.75)

    def __init__(
        self,
        *,
        log: Path | None = None,
        host: CanDeviceSettings | None = None,
        link: LinkSettings | None = None,
        make: Callable[..., VirtualDevice] = VirtualDevice,
        **firmware: Any,
    ) -> None:
        plant = LinearPlant(LinearProcess(1.2, (30.0,), (), 4.0), start_pv=50.0, start_co=40.0)
        settings = {"gains": self.FIRST, "box": GainBox(ratio_max=10.0), **firmware}
        self.device = make(VirtualDeviceSettings(**settings), plant)
        self.clock = SimulatedClock()
        link = link or LinkSettings(channel=f"bench-{next(CHANNELS)}")
        self.far, self.near = CanLink(link, self.clock), CanLink(link, self.clock, log)
        self.on_bus = DeviceOnBus(self.device, self.far)
        self.host = CanDevice(self.near, host or CanDeviceSettings())
        self.events: list[Event] = []

    def run(self, samples: int) -> list[Event]:
        """Device sample, host poll, device answers."""
        new: list[Event] = []
        for _ in range(samples):
            self.clock.advance(self.device.settings.sample_time_s)
            self.on_bus.sample()
            new += self.host.poll(self.clock.now_s())
            self.on_bus.answer()
        self.events += new
        return new

    def silence(self, samples: int) -> list[Event]:
        """The device is off: time passes, the host polls, its frames are lost."""
        new: list[Event] = []
        for _ in range(samples):
            self.clock.advance(self.device.settings.sample_time_s)
            new += self.host.poll(self.clock.now_s())
            self.far.receive_all()
        self.events += new
        return new

    @property
    def now_s(self) -> float:
        return self.clock.now_s()

    @staticmethod
    def samples(events: list[Event]) -> list[LoopSample]:
        return [event for event in events if isinstance(event, LoopSample)]

    @staticmethod
    def others(events: list[Event]) -> list[Event]:
        return [event for event in events if not isinstance(event, LoopSample)]

    def close(self) -> None:
        self.near.close()
        self.far.close()


@pytest.fixture
def make_bench() -> Iterator[Callable[..., Bench]]:
    benches: list[Bench] = []

    def make(**arguments: Any) -> Bench:
        benches.append(Bench(**arguments))
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """A connected pair."""
    made = make_bench()
    made.run(5)
    assert made.host.connected
    return made
