"""A long run in simulated time: memory, handles and threads stay what they were.

    python benchmarks/soak.py [--hours 24] [--loops 32] [--seed 1]

So many loops on four buses, each with a device, a host, a session in mode auto and a ledger of its own; a setpoint step
every hour, a change of the process every 6 hours, so that there is something to retune. Once every simulated hour
resident memory, open handles, threads and Python objects are noted. Prints JSON; status 1 when handles or threads
changed, when the memory's slope after the warm-up has a confidence interval above zero and is more than SLOPE_MAX, or
when a loop's samples were lost or its gains are not those of its table.
"""

import argparse
import gc
import json
import os
import random
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from retuner import GainTable, LinearProcess, Mode, PidGains, Regions, Retuner, RetunerSettings
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.ledger import Ledger
from retuner.ledger.trend import Trend
from retuner.session.loop_session import LoopSession
from retuner.session.scenario import ScenarioPlayer

SAMPLE_S = 2.0
STEP_EVERY_S = 3600.0
CHANGE_EVERY_S = 6 * 3600.0
BUSES = 4
TREND_ROWS = 1000  # half an hour, so that the trend is full long before the warm-up ends
DECISIONS = 3  # of a loop that are kept, for the same reason; a session's own limit is DECISIONS_KEPT, 10 kB each
WARM_UP = 0.25  # share of the run whose memory does not count
SLOPE_MAX = 100.0  # kB an hour
FIRST = PidGains(1.0, 0.02)


class Loop:
    """One loop: device and session."""

    def __init__(self, number: int, bus: str, share: LinkShare, clock: SimulatedClock, folder: Path, seed: int) -> None:
        self.rng, self.clock = random.Random(f"{seed} {number}"), clock
        node = number // BUSES + 1
        self.plant = LinearPlant(self._process(), start_pv=50.0, start_co=50.0, noise=0.1, seed=seed + number)
        firmware = VirtualDeviceSettings(FIRST, node=node, sample_time_s=SAMPLE_S)
        self.far = CanLink(LinkSettings(channel=bus), clock)
        self.device = DeviceOnBus(VirtualDevice(firmware, self.plant), self.far)
        self.ledger = Ledger(folder / f"{number}.sqlite")
        self.kinds: Counter[str] = Counter()
        table = GainTable(f"loop {number}", Regions("sp", "-", ("all",), 0.0, (), 100.0, 0.0, 0.0), (FIRST,))
        host = CanDevice(share.port(node), CanDeviceSettings(node=node, sample_time_s=SAMPLE_S, owner=number + 1))
        retuner = Retuner(table, RetunerSettings(SAMPLE_S, 100.0, mode=Mode.AUTO))
        self.session = LoopSession(host, retuner, ScenarioPlayer(None), self._record)
        self.session.trend = Trend(TREND_ROWS)
        self.session.decisions = deque(maxlen=DECISIONS)
        self.high = False

    def _process(self) -> LinearProcess:
        return LinearProcess(self.rng.uniform(0.5, 2.0), (self.rng.uniform(20, 80),), (), self.rng.uniform(4, 16))

    def _record(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        self.kinds[kind] += 1
        self.ledger.append(kind, body, t_s)

    def change_process(self) -> None:
        """Another process from now on, at rest where the old one is."""
        self.plant = LinearPlant(self._process(), start_pv=self.plant.pv, noise=0.1, seed=self.rng.randrange(1 << 30))
        self.device.device.plant = self.plant

    def wrong(self) -> list[str]:
        """What is not as it must be at the end."""
        found = []
        running, table = self.session.device.running, self.session.table.gains[0]
        if running is None or abs(running.gains.kp - table.kp) > 1e-5 * table.kp:
            found.append(f"{running} runs, the table has {table}")
        if self.kinds["lost"] or not self.ledger.verify().ok:
            found.append(f"lost {self.kinds['lost']}")
        return found


def now(hour: float) -> dict[str, float]:
    """What is looked at."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    handles = len(list(Path("/proc/self/fd").iterdir()))
    return {
        "hour": hour,
        "kB": pages * os.sysconf("SC_PAGE_SIZE") / 1024,
        "handles": handles,
        "threads": threading.active_count(),
        "objects": len(gc.get_objects()),
    }


def slope(notes: list[dict[str, float]], name: str) -> tuple[float, float]:
    """Per hour, and half its 95 % confidence interval (residuals taken as independent)."""
    x, y = np.array([note["hour"] for note in notes]), np.array([note[name] for note in notes])
    (b, a), residual = np.polyfit(x, y, 1), 0.0
    residual = float(np.sqrt(np.sum((y - a - b * x) ** 2) / max(len(x) - 2, 1) / np.sum((x - x.mean()) ** 2)))
    return float(b), 1.96 * residual


def soak(hours: float, count: int, seed: int, slope_max: float, folder: Path) -> dict[str, object]:
    clock = SimulatedClock()
    buses = [f"soak-{i}" for i in range(BUSES)]
    near = [CanLink(LinkSettings(channel=bus), clock, folder / f"{bus}.blf") for bus in buses]
    shares = [LinkShare(link) for link in near]
    loops = [Loop(i, buses[i % BUSES], shares[i % BUSES], clock, folder, seed) for i in range(count)]
    notes = []
    samples = int(hours * 3600 / SAMPLE_S)
    for sample in range(1, samples + 1):
        clock.advance(SAMPLE_S)
        for loop in loops:
            loop.device.sample()
        for loop in loops:
            loop.session.poll(clock.now_s())
        _happens(loops, sample * SAMPLE_S)
        if sample % int(3600 / SAMPLE_S) == 0:
            notes.append(now(sample * SAMPLE_S / 3600))
    for loop in loops:
        loop.far.receive_all()
    for _ in range(200):  # writes under way come to their end
        clock.advance(SAMPLE_S)
        for loop in loops:
            loop.device.sample()
            loop.session.poll(clock.now_s())
    wrong = [f"loop {i}: {fault}" for i, loop in enumerate(loops) for fault in loop.wrong()]
    rows = sum((loop.kinds for loop in loops), Counter())
    size = sum(path.stat().st_size for path in folder.iterdir())
    for thing in (*near, *(loop.far for loop in loops), *(loop.ledger for loop in loops)):
        thing.close()
    frames = sum(link.counters.received + link.counters.sent for link in near)
    faults = sum((link.faults.counts for link in near), Counter())
    wrong += [f"on the bus: {dict(faults)}"] if faults else []
    return judged(notes, wrong, slope_max) | {
        "loops": count,
        "hours": hours,
        "seed": seed,
        "samples": samples * count,
        "frames": frames,
        "ledger rows": dict(rows),
        "MB of files": round(size / 1e6, 1),
    }


def _happens(loops: list[Loop], t_s: float) -> None:
    """Steps and changes, the loops one after the other so that they do not all move at once."""
    for i, loop in enumerate(loops):
        if (t_s - i * SAMPLE_S) % STEP_EVERY_S == 0:
            loop.high = not loop.high
            loop.session.device.send_setpoint(60.0 if loop.high else 50.0, loop.clock.now_s())
        if (t_s - i * SAMPLE_S) % CHANGE_EVERY_S == 0:
            loop.change_process()


def judged(notes: list[dict[str, float]], wrong: list[str], slope_max: float) -> dict[str, object]:
    """First and last note after the warm-up, the memory's slope, and what is wrong."""
    counted = notes[int(WARM_UP * len(notes)) :]
    per_hour, half = slope(counted, "kB")
    for name in ("handles", "threads"):
        seen = sorted({note[name] for note in counted})
        wrong += [f"{name} changed: {seen}"] if len(seen) > 1 else []
    if per_hour - half > 0 and per_hour > slope_max:
        wrong.append(f"memory grows by {per_hour:.0f} +- {half:.0f} kB an hour")
    return {
        "first": counted[0],
        "last": counted[-1],
        "kB per hour": round(per_hour, 1),
        "half of its 95 % interval": round(half, 1),
        "wrong": wrong,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--loops", type=int, default=32)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--slope-max", type=float, default=SLOPE_MAX, help="kB an hour (100)")
    chosen = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        result = soak(chosen.hours, chosen.loops, chosen.seed, chosen.slope_max, Path(folder))
    result["seconds"] = round(time.monotonic() - started, 1)
    sys.stdout.write(json.dumps(result) + "\n")
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
