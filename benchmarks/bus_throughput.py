"""How much of python-can's own speed is left: the whole path against bare send and recv, in one run.

    python benchmarks/bus_throughput.py [--rounds N] [--loops 32] [--rate 100]

Two figures, both on python-can's virtual bus, CPU time of this thread, medians over interleaved rounds:
- path: encode, send, receive and decode of telemetry through our link and codec, per frame, over a bare
  can.Message(), send and recv of the same number of frames;
- host: share of a core that a host needs for so many loops at so many samples a second: link, decoding, joining,
  lease and life signs, and the retuner's own work per sample.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable

import can

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import TelemetryPv
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

NODE = 5
BURST = 64  # frames between two looks at the bus
FRAMES = 6400
GAINS = PidGains(2.0, 0.25)


def cpu_us(work: Callable[[], None], times: int) -> float:
    """CPU time of one call divided by the frames in it."""
    started = time.thread_time()
    work()
    return (time.thread_time() - started) / times * 1e6


def path(rounds: int) -> dict[str, object]:
    """Our path and the bare one, in turn."""
    clock, codec = SimulatedClock(), Codec(NODE)
    frame = telemetry(codec)
    data = bytes(codec.encode(frame).data)
    a, b = (can.Bus(interface="virtual", channel="bare") for _ in range(2))
    near, far = (CanLink(LinkSettings(channel="ours"), clock) for _ in range(2))

    def bare() -> None:
        for _ in range(FRAMES // BURST):
            for _ in range(BURST):
                a.send(can.Message(arbitration_id=0xB2, is_extended_id=False, data=data), timeout=0.05)
            while b.recv(timeout=0.0) is not None:
                pass

    def ours() -> None:
        for _ in range(FRAMES // BURST):
            for _ in range(BURST):
                far.send(codec.encode(frame))
            for message in near.receive_all():
                codec.decode(message)

    figures = [(cpu_us(bare, FRAMES), cpu_us(ours, FRAMES)) for _ in range(rounds)]
    for bus in (a, b):
        bus.shutdown()
    near.close()
    far.close()
    return {
        "part": "path",
        "bare us": median(bare for bare, _ in figures),
        "ours us": median(o for _, o in figures),
        "ratio": median(ours / bare for bare, ours in figures),
        "frames": FRAMES * rounds,
    }


def telemetry(codec: Codec) -> TelemetryPv:
    """A telemetry frame as a device sends it."""
    device = VirtualDevice(VirtualDeviceSettings(GAINS, node=NODE), LinearPlant(LinearProcess(1.0, (20.0,))))
    frames = (codec.decode(message) for message in device.step())
    return next(frame for frame in frames if isinstance(frame, TelemetryPv))


def median(values: object) -> float:
    """Rounded."""
    return round(statistics.median(values), 3)


class Plant:
    """Devices and their hosts on one bus."""

    def __init__(self, loops: int, rate: float) -> None:
        self.clock, self.period_s = SimulatedClock(), 1.0 / rate
        settings = LinkSettings(channel="many")
        self.devices = []
        for node in range(1, loops + 1):
            firmware = VirtualDeviceSettings(GAINS, node=node, sample_time_s=self.period_s)
            plant = LinearPlant(LinearProcess(1.0, (20.0,)), start_pv=50.0, noise=0.05, seed=node)
            self.devices.append(DeviceOnBus(VirtualDevice(firmware, plant), CanLink(settings, self.clock)))
        self.link = CanLink(settings, self.clock)
        share = LinkShare(self.link)
        self.hosts = [
            CanDevice(share.port(node), CanDeviceSettings(node=node, sample_time_s=self.period_s))
            for node in range(1, loops + 1)
        ]
        table = GainTable("loop", Regions("sp", "-", ("all",), 0.0, (), 100.0, 0.0, 0.0), (GAINS,))
        self.retuners = [Retuner(table, RetunerSettings(self.period_s, 100.0)) for _ in range(loops)]
        self.samples = 0

    def sample(self) -> float:
        """One sample of all loops; CPU seconds of the hosts and retuners alone."""
        self.clock.advance(self.period_s)
        for device in self.devices:
            device.sample()
        started = time.thread_time()
        now_s = self.clock.now_s()
        for host, retuner in zip(self.hosts, self.retuners, strict=True):
            for event in host.poll(now_s):
                if isinstance(event, LoopSample):
                    self.samples += 1
                    retuner.observe(event)
        spent = time.thread_time() - started
        for device in self.devices:
            device.answer()
        return spent

    def close(self) -> None:
        """Close all links."""
        for device in self.devices:
            device.link.close()
        self.link.close()


def host(loops: int, rate: float, seconds: float) -> dict[str, object]:
    """Share of a core for a host of so many loops."""
    plant = Plant(loops, rate)
    for _ in range(30):
        plant.sample()
    plant.samples, received = 0, plant.link.counters.received
    spent = [plant.sample() for _ in range(int(seconds * rate))]
    frames = plant.link.counters.received - received
    plant.close()
    return {
        "part": "host",
        "loops": loops,
        "samples per second and loop": rate,
        "frames per second": frames / seconds,
        "lost": int(seconds * rate) * loops - plant.samples,
        "share of a core": round(sum(spent) / seconds, 3),
        "us per frame": round(sum(spent) / frames * 1e6, 2),
        "99th percentile, share of a period": round(sorted(spent)[-len(spent) // 100] * rate, 2),
    }


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--loops", type=int, default=32)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=5.0)
    chosen = parser.parse_args()
    sys.stdout.write(json.dumps(path(chosen.rounds)) + "\n")
    sys.stdout.write(json.dumps(host(chosen.loops, chosen.rate, chosen.seconds)) + "\n")


if __name__ == "__main__":
    main()
