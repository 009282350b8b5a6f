"""One run: a device, one or two hosts, perhaps an intruder, on a bus in bad weather, all from one seed.

A step is one controller sample: mishaps are drawn, the device answers what has come, makes its sample, the hosts take
their turns, the device answers again. At the end the weather clears, and what must be known then is.
"""

from collections import Counter
from collections.abc import Callable
from random import Random

from bus_simulation import truth as t
from bus_simulation.bus import Bus
from bus_simulation.device_end import NAME as DEVICE
from bus_simulation.device_end import DeviceEnd, LagPlant
from bus_simulation.host_end import HostEnd
from bus_simulation.intruder import Intruder
from bus_simulation.layers.door import Door
from bus_simulation.layers.misread import misread, of_another_epoch
from bus_simulation.layers.one_wrong import OneWrong
from bus_simulation.truth import Ran, Truth
from bus_simulation.twin import Drawn, Twin
from bus_simulation.weather import CALM, CHANGE_EVERY, draw
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import WriteDone
from retuner.drivers.host.running_set import ALONE
from retuner.drivers.protocol.frames import GainBox
from retuner.schedule.gains import PidGains

FIRST = PidGains(1.0, 0.0625, 0.25)
BOX = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0, direction=1)
LEASE_LONGEST = 120  # samples
CALM_STEPS = 60  # within which, and ALONE heartbeats, everything must be known: docs/developers/protocol.md
LEASE_STEPS = 200  # a lease of somebody who is gone has run out by then
ONE_WRONG = 0.5  # share of an intruder's turns in which it also sends something with exactly one thing wrong
WRITE_STEPS = 10  # the promise of the gain transaction on an idle bus


class World:
    """See the head of this file.

    Parameters
    ----------
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
                self._deceive(self.rng.choice(self.hosts))

    def _deceive(self, host: HostEnd) -> None:
        """Frames to a host with exactly one thing wrong."""
        way, device, client = self.bus.ways[host.name], self.device, host.device
        misread(way, self.rng)
        if client is not None and client.write_seq is not None:
            of_another_epoch(way, self.rng, device.settings.node, device.epoch, host.owner, client.write_seq)

    def change_weather(self) -> None:
        """Another weather."""
        weather = self.bus.weather = draw(self.rng)
        for way in self.bus.ways.values():
            way.cut = weather.out_cut if way.name == DEVICE else weather.back_cut

    def clear_up(self) -> None:
        """No faults from now on."""
        self.bus.weather = CALM
        self.bus.clear()
        self.far.fuse, self.far.down, self.far.hung, self.far.slow = 1 << 60, 0, 0, 1.0
        for host in self.hosts:
            host.clear_up()

    def run(self, steps: int) -> Counter[str]:
        """So many steps in bad weather, then the calm and what must be true then; the counts of what happened.

        Raises
        ------
        ViolationError
            A promise is broken.
        """
        for number in range(steps):
            if number % CHANGE_EVERY == 0:
                self.change_weather()
            self.step()
        self.clear_up()
        for _ in range(CALM_STEPS + ALONE * self.device.settings.heartbeat_samples):
            self.step()
        for host in self.hosts:
            self._known(host)
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

    def _known(self, host: HostEnd) -> None:
        """The host knows what runs."""
        device = host.device
        if device is None:
            raise t.ViolationError("known_after_calm: the host has not come back")
        t.known_after_calm(connected=device.connected, writing=device.writing, running=device.running, truth=self.truth)
        t.ledger_has_every_outcome(host.rows, 0)

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
