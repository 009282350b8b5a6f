"""Many seeds over all cores; what is done is kept in a file, so that a campaign can be stopped and gone on with."""

import hashlib
import json
import math
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

from bus_simulation import truth as t
from bus_simulation.bus import Bus
from bus_simulation.device_end import NAME as DEVICE
from bus_simulation.device_end import DeviceEnd, Drawn, LagPlant, Twin
from bus_simulation.firmware import FIRMWARE, FirmwareDevice
from bus_simulation.host_end import HostEnd
from bus_simulation.intruder import Intruder
from bus_simulation.layers.door import Door
from bus_simulation.layers.misread import misread, of_another_epoch
from bus_simulation.layers.one_wrong import OneWrong
from bus_simulation.truth import Ran, Truth, ViolationError
from bus_simulation.weather import CALM, CHANGE_EVERY, draw
from retuner import PidGains, drivers
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import WriteDone
from retuner.drivers.host.running_set import ALONE
from retuner.drivers.protocol.frames import GainBox

# ---- One run: a device, one or two hosts, perhaps an intruder, on a bus in bad weather, all from one seed.
#
# A step is one controller sample: mishaps are drawn, the device answers what has come, makes its sample, the hosts take
# their turns, the device answers again. At the end the weather clears, and what must be known then is.

FIRST = PidGains(1.0, 0.0625, 0.25)
BOX = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0, direction=1)
LEASE_LONGEST = 120  # samples
CALM_STEPS = 60  # within which, and ALONE heartbeats, everything must be known: docs/developers/protocol.md
LEASE_STEPS = 200  # a lease of somebody who is gone has run out by then
ONE_WRONG = 0.5  # share of an intruder's turns in which it also sends something with exactly one thing wrong
WRITE_STEPS = 10  # the promise of the gain transaction on an idle bus


class World:
    """See the head of this file.

    seed : decides everything. make : the device, of the virtual one's interface. twin : another
        implementation that is told the same and must answer the same, byte for byte.
    """

    def __init__(self, seed: int, make: Callable[..., VirtualDevice] = VirtualDevice, twin: type | None = None) -> None:
        rng = self.rng = Random(seed)
        key = rng.randbytes(16) if rng.random() < 0.3 else None
        second = rng.random() < 0.25
        forges = rng.random() < 0.15
        hosts = ("host", "second") if second else ("host",)
        self.bus = Bus(rng, (DEVICE, *hosts))
        self.truth = Truth(Ran(0, 1, 0, FIRST), BOX, authentic=key is not None, forged=forges)
        settings = VirtualDeviceSettings(
            FIRST,
            box=BOX,
            lease_longest_samples=LEASE_LONGEST,
            trial_samples=rng.choice((0, 20, 40)),
            key=key,
            heartbeat_samples=rng.choice((1, 5, 5, 5, 20, 20)),
        )
        drawn = Drawn(rng)
        door = Door(key, drawn.first)
        self.device = make(settings, LagPlant(), nonce=door.codes.draw)
        other = None if twin is None else Twin(self.device, lambda plant: twin(settings, plant, nonce=drawn.second))
        self.far = DeviceEnd(self.bus, self.device, self.truth, rng, door, other)
        eager, same_owner = rng.choice((0.02, 0.1, 0.3)), rng.random() < 0.3
        self.hosts = [
            HostEnd(name, self.bus, self.truth, rng, key=key, same_owner=same_owner, eager=eager) for name in hosts
        ]
        self.intruder = Intruder(self.bus, self.device, self.truth, rng, forges=forges)
        self.one_wrong = OneWrong(self.bus, self.device, rng, door.codes)
        self.step_number = 0

    def step(self) -> None:
        """One controller sample."""
        self.step_number += 1
        bus, weather, random = self.bus, self.bus.weather, self.rng.random
        bus.tick(self.step_number)
        if random() < weather.mishap:
            self._mishap()
        self.far.answer()
        self.far.sample()
        for host in self.hosts:
            if not weather.stall or random() >= weather.stall:
                host.act()
        self.far.answer()
        if weather.intruder and random() < weather.intruder:
            self.intruder.act()
            if random() < ONE_WRONG:
                self.one_wrong.act()
                host = self.rng.choice(self.hosts)
                way, device, client = self.bus.ways[host.name], self.device, host.device
                misread(way, self.rng)
                if client is not None and client.write.seq is not None:
                    of_another_epoch(way, self.rng, device.settings.node, device.epoch, host.owner, client.write.seq)

    def clear_up(self) -> None:
        """No faults from now on."""
        self.bus.weather = CALM
        self.bus.clear()
        self.far.fuse, self.far.down, self.far.hung, self.far.slow = 1 << 60, 0, 0, 1.0
        for host in self.hosts:
            host.clear_up()

    def run(self, steps: int) -> Counter[str]:
        """So many steps in bad weather, then the calm and what must be true then; the counts of what happened.

        Raises ViolationError: a promise is broken.
        """
        for number in range(steps):
            if number % CHANGE_EVERY == 0:
                weather = self.bus.weather = draw(self.rng)
                for way in self.bus.ways.values():
                    way.cut = weather.out_cut if way.name == DEVICE else weather.back_cut
            self.step()
        self.clear_up()
        for _ in range(CALM_STEPS + ALONE * self.device.settings.heartbeat_samples):
            self.step()
        for host in self.hosts:
            device = host.device
            if device is None:
                raise t.ViolationError("known_after_calm: the host has not come back")
            t.known_after_calm(
                connected=device.connected, writing=device.writing, running=device.running, truth=self.truth
            )
            t.ledger_has_every_outcome(host.rows, 0)
        for _ in range(LEASE_STEPS):
            self.step()
        self._write_in_calm()
        counts = self.truth.counts
        counts["faults"] = self.bus.faults
        counts["steps"] = steps
        return counts

    def _mishap(self) -> None:
        """Something happens to a machine."""
        rng = self.rng
        host = rng.choice(self.hosts)
        kind = rng.randrange(8)
        if kind <= 1:
            self.far.fuse = rng.randrange(1, 12)
        elif kind <= 3:
            host.fuse = rng.randrange(1, 14)
        elif kind == 4:
            host.jump(rng.choice((3.0, 50.0, 1000.0, 1e6)))
        elif kind == 5:
            host.drift(rng.choice((0.0, -0.5, -0.1, 0.1, 1.0)))
        elif kind == 6:
            self.far.slow = rng.choice((1.0, 1.0, 0.2, 3.0))
        else:
            self.far.hung = rng.choice((2, 8, 30))

    def _write_in_calm(self) -> None:
        """Whoever holds the lease writes a legal set, and it is done in time."""
        owner, gains = self.device.lease.owner, self.device.running.gains
        writers = [host for host in self.hosts if host.owner == owner]
        if not writers:
            raise t.ViolationError(f"writes_succeed_in_calm: {owner} still holds the lease")
        host = writers[0]
        for _ in range(
            2 if self.truth.forged else 1
        ):  # a host that was deceived may need a refusal to find the numbers
            host.last_outcome = None
            host.begin(PidGains(gains.kp * (0.5 if gains.kp > 1.0 else 2.0), gains.ki, gains.kd))
            for _ in range(WRITE_STEPS):
                self.step()
            if isinstance(host.last_outcome, WriteDone):
                return
        t.writes_succeed_in_calm(host.last_outcome)


# ---- Many seeds over all cores; what is done is kept in a file, so that a campaign can be stopped and gone on with

BATCH = 10  # seeds that a process takes at a time


class Outcome(NamedTuple):
    """What one seed came to: counts, or the promise that it broke (and in which step)."""

    seed: int
    counts: dict[str, int]
    broken: str


DEVICES: dict[str, tuple[type, type | None]] = {
    "virtual": (VirtualDevice, None),
    "firmware": (FirmwareDevice, None),
    "both": (VirtualDevice, FirmwareDevice),
}
"""What is the device, and what is told the same beside it and must answer the same."""


def run_seed(job: tuple[int, int, str]) -> Outcome:
    """One run of (seed, steps, which of DEVICES)."""
    seed, steps, device = job
    world = World(seed, *DEVICES[device])
    try:
        return Outcome(seed, dict(world.run(steps)), "")
    except ViolationError as error:
        return Outcome(seed, {}, f"step {world.step_number}: {error}")
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        return Outcome(
            seed, {}, f"step {world.step_number}: no exception may come out: {type(error).__name__}: {error}"
        )


class Campaign:
    """Seeds from first on, counted up.

    first, seeds, steps : seeds first .. first + seeds - 1, each so many steps.
    state : file that keeps what is done; None for none. What other code has done is kept beside it and its seeds are
        passed over, so that every night looks at new ones. device : which of DEVICES. hours : after which no seed is
        begun.
    """

    def __init__(
        self,
        first: int,
        seeds: int,
        steps: int,
        state: Path | None,
        *,
        device: str = "virtual",
        hours: float = math.inf,
    ) -> None:
        self.first, self.seeds, self.steps, self._device = first, seeds, steps, device
        self._state = state
        self.done: set[int] = set()
        self.counts: Counter[str] = Counter()
        self.broken: dict[int, str] = {}
        self.busy_s = 0.0
        self.before: list[dict[str, object]] = []
        self._hours = hours
        # hash of the code under test and of this harness: results of other code are not added up
        digest = hashlib.sha256()
        here, there = Path(__file__).parent, Path(str(drivers.__file__)).parent
        loaded = {
            name.rpartition(".")[2] for name in sys.modules if name.startswith(("retuner.drivers.", "bus_simulation."))
        }
        for path in sorted((*here.glob("*.py"), *there.rglob("*.py"), *there.glob("*.dbc"))):
            if path.stem in loaded or path.suffix == ".dbc":
                digest.update(path.name.encode() + path.read_bytes())
        for path in sorted(FIRMWARE.glob("*.[ch]")):
            digest.update(path.read_bytes())
        self._key = f"{digest.hexdigest()[:16]} {steps} {device}"
        if state is not None and state.exists():
            kept = json.loads(state.read_text(encoding="utf-8"))
            self.before = list(kept.get("before", ()))
            if kept.get("key") != self._key:
                told = {name: kept[name] for name in ("key", "done", "counts", "broken")}
                self.before.append({**told, "done": [min(told["done"], default=0), max(told["done"], default=-1)]})
            self.first = max([self.first, *(one["done"][1] + 1 for one in self.before)])
            if kept.get("key") == self._key:
                self.done = set(kept["done"])
                self.counts = Counter(kept["counts"])
                self.broken = {int(seed): why for seed, why in kept["broken"].items()}
                self.busy_s = kept["busy_s"]

    def run(self, processes: int) -> Iterator[Outcome]:
        """Run what is not done yet; outcomes as they come."""
        todo = [
            (seed, self.steps, self._device)
            for seed in range(self.first, self.first + self.seeds)
            if seed not in self.done
        ]
        began = last_saved = time.monotonic()
        before_s = self.busy_s
        with multiprocessing.Pool(processes) as pool:
            for outcome in pool.imap_unordered(run_seed, todo, chunksize=min(BATCH, 1 + len(todo) // processes // 4)):
                self.done.add(outcome.seed)
                self.counts.update(outcome.counts)
                if outcome.broken:
                    self.broken[outcome.seed] = outcome.broken
                now = time.monotonic()
                self.busy_s = before_s + now - began
                if now - last_saved > 10.0 or outcome.broken:
                    last_saved = now
                    self.save()
                yield outcome
                if now - began > 3600.0 * self._hours:
                    pool.terminate()
                    break
        self.save()

    def steps_of_all(self) -> int:
        """Fault-injected steps of this code and all before it."""
        return self.counts["steps"] + sum(int(dict(one["counts"]).get("steps", 0)) for one in self.before)

    def save(self) -> None:
        """Keep what is done."""
        if self._state is None:
            return
        self._state.parent.mkdir(parents=True, exist_ok=True)
        whole = {
            "key": self._key,
            "done": sorted(self.done),
            "counts": self.counts,
            "broken": self.broken,
            "busy_s": self.busy_s,
            "before": self.before,
        }
        fresh = self._state.with_suffix(".new")
        fresh.write_text(json.dumps(whole), encoding="utf-8")
        fresh.replace(self._state)
