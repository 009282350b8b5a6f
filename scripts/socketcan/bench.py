"""A device and a host in real time on SocketCAN, in one thread, each on a socket of its own; and what must hold.

Everything that the host is told is counted; after whatever was done to the bus, settle() waits until both are well
again and tells what is not as it must be: no gains run that were not ordered as a set, the host knows which, and every
sample has come or was reported lost.
"""

import random
import subprocess
from collections import Counter
from collections.abc import Callable

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.bus.bus import CanLink, LinkFault, LinkSettings
from retuner.drivers.clock import MonotonicClock
from retuner.drivers.controller.device_process import DeviceOnBus, fresh_epoch
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import LinkChanged, SamplesLost, WriteDone, WriteRefusedError
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.frames import GainBox
from retuner.schedule.gains import PidGains

NODE = 5
SAMPLE_S = 0.05
FIRST = PidGains(1.0, 0.0625, 0.5)
LOOK_S = 0.01  # longest time between two looks at the bus: a tick of the user-mode kernel
PATIENCE_S = 20.0  # for everything to be well again
FIRMWARE = VirtualDeviceSettings(
    FIRST, node=NODE, sample_time_s=SAMPLE_S, box=GainBox(kp_max=1000.0, ki_max=100.0, ratio_max=1000.0, direction=1)
)
HOST = CanDeviceSettings(
    node=NODE, sample_time_s=SAMPLE_S, silent_samples=10, connect_samples=400, lease_samples=20, lease_floor_s=1.0
)


def sh(*command: str) -> None:
    """Run a command of iproute2 or can-utils that must succeed."""
    subprocess.run(command, check=True, capture_output=True)


def link(channel: str, clock: MonotonicClock) -> CanLink:
    """An impatient link: these tests make hundreds of outages."""
    settings = LinkSettings("socketcan", channel, silent_after_s=1.0, reopen_first_s=0.05, reopen_max_s=0.4)
    return CanLink(settings, clock)


def some_gains(rng: random.Random) -> PidGains:
    """Gains as they stand on the wire, so that they can be compared."""
    return to_wire(PidGains(rng.uniform(0.5, 20.0), rng.uniform(0.01, 1.0), rng.uniform(0.0, 1.0)))


class Bench:
    """Both ends. far, near : interface of the device and of the host."""

    def __init__(self, far: str = "vcan0", near: str = "vcan0", seed: int = 1) -> None:
        self.rng, self.clock = random.Random(seed), MonotonicClock()
        plant = LinearPlant(LinearProcess(1.0, (1.0,)), start_pv=50.0)
        self.device = VirtualDevice(FIRMWARE, plant, fresh_epoch())
        self.far, self.near = link(far, self.clock), link(near, self.clock)
        self.on_bus = DeviceOnBus(self.device, self.far)
        self.host = CanDevice(self.near, HOST)
        self.told: Counter[str] = Counter()
        self.faults: Counter[LinkFault] = Counter()
        self.times: list[float] = []
        self.lost = 0
        self.ordered = {FIRST}
        self.wrong: list[str] = []
        self._next_s = self.clock.now_s()

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let time pass, or until something holds; how long it took."""
        began_s = now_s = self.clock.now_s()
        while now_s - began_s < seconds and not until():
            if now_s >= self._next_s:
                self.on_bus.sample()
                self._next_s = max(self._next_s + SAMPLE_S, now_s)
            else:
                self.on_bus.answer()
            for event in self.host.poll(now_s):
                self.told[type(event).__name__] += 1
                if isinstance(event, LoopSample):
                    if self.times and event.t_s <= self.times[-1]:
                        self.wrong.append(f"time stands still: {event.t_s} after {self.times[-1]}")
                    self.times.append(event.t_s)
                elif isinstance(event, SamplesLost):
                    self.lost += event.count
                elif isinstance(event, LinkChanged):
                    self.told[f"link {event.state.name.lower()}"] += 1
                elif isinstance(event, WriteDone) and event.running.gains not in self.ordered:
                    self.wrong.append(f"reported as running, never ordered: {event.running}")
            for fault, times in (*self.near.news(), *self.far.news()):
                self.faults[fault] += times
            if self.device.running.gains not in self.ordered:
                self.wrong.append(f"gains run that nobody ordered: {self.device.running}")
                self.ordered.add(self.device.running.gains)
            self.near.wait_until(min(self._next_s, now_s + LOOK_S))
            now_s = self.clock.now_s()
        return now_s - began_s

    def order(self) -> None:
        """Ask for a write of new gains, if that can be asked now."""
        gains = some_gains(self.rng)
        try:
            self.host.begin_write(gains, self.clock.now_s())
        except WriteRefusedError:
            self.told["write not begun"] += 1
        else:
            self.told["writes begun"] += 1
            self.ordered.add(gains)

    def well(self) -> bool:
        """Connected, no write open, and samples come."""
        fresh = bool(self.times) and self.clock.now_s() - self._last_sample_s() < 4 * SAMPLE_S
        return self.host.connected and not self.host.writing and fresh

    def _last_sample_s(self) -> float:
        """When the newest sample of the host was made, on this clock."""
        behind = self.device.sample - round(self.times[-1] / SAMPLE_S)
        return self._next_s - (behind + 1) * SAMPLE_S

    def settle(self) -> list[str]:
        """Wait until all is well; everything that is not as it must be."""
        took_s = self.run(PATIENCE_S, self.well)
        if not self.well():
            self.wrong.append(f"not well after {took_s:.0f} s: {self.host.machine.phase}, writing {self.host.writing}")
        if self.host.running is None or self.host.running[:2] != tuple(self.device.running):
            self.wrong.append(f"the host believes {self.host.running}, {self.device.running} runs")
        made = round((self.times[-1] - self.times[0]) / SAMPLE_S) + 1 if self.times else 0
        if len(self.times) + self.lost != made:
            self.wrong.append(f"{made} samples made, {len(self.times)} came, {self.lost} were reported lost")
        ends = self.told["WriteDone"] + self.told["WriteFailed"]
        if ends != self.told["writes begun"]:
            self.wrong.append(f"{self.told['writes begun']} writes begun, {ends} ended")
        return self.wrong

    def report(self) -> dict[str, object]:
        """Counts of everything."""
        wrong, faults = self.settle(), self.near.faults.counts + self.far.faults.counts
        return {
            "samples": len(self.times),
            "lost and reported": self.lost,
            "told": dict(self.told),
            "faults": {str(fault): times for fault, times in faults.items()},
            "wrong": wrong[:10],
        }

    def close(self) -> None:
        """Close both links."""
        self.near.close()
        self.far.close()
