"""Where a session or an experiment takes place: on virtual devices in simulated time, or on whatever hangs on buses in
real time.

In simulated time devices and host take turns on python-can's `virtual` bus in one thread: a device makes a sample, the
host takes it in and answers, the device takes the answers in before its next sample. Nothing waits and nothing races,
so the same seed gives the same bytes. Devices with different sample times take their turns in the order of time.

Loops on one bus share its link (shared_link.py), so each frame is read once, however many loops there are.
"""

import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import can

from retuner.config import Config
from retuner.config.session_config import SessionConfig
from retuner.drivers.bus.bus import CanLink, FaultNews, LinkSettings
from retuner.drivers.bus.link_settings import FramePort
from retuner.drivers.bus.shared_link import LinkPort, LinkReader, LinkShare
from retuner.drivers.clock import Clock, MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.device import Bench, Device
from retuner.drivers.host.can_device import CanDevice
from retuner.products import product
from retuner.session.assembly import link_settings, make_device, make_far_side, schedule_inputs
from retuner.session.outputs import log_of_bus
from retuner.stopping import unstoppable

if TYPE_CHECKING:
    from retuner.config.bench_plants import Plants

POLLS_PER_SAMPLE = 4  # looks of the host per sample in real time, at the least, even when no frame wakes it
_channels = itertools.count()


class HostBus(NamedTuple):
    """An end of one bus. loops : indexes of those that hang on it. ports : theirs, in the same order."""

    link: CanLink | LinkShare
    loops: tuple[int, ...]
    ports: tuple[CanLink | LinkPort, ...]


class ReadBus(NamedTuple):
    """One that a thread reads."""

    link: LinkShare
    loops: tuple[int, ...]
    ports: tuple[LinkPort, ...]


class HostBuses:
    """The host's ends of all buses of a session."""

    def __init__(self, buses: Sequence[HostBus | ReadBus]) -> None:
        self.buses = tuple(buses)

    def keep_leases(self, devices: Sequence[Device]) -> None:
        """Do nothing: the polls keep the leases here; `LiveBuses` has a timer for them."""

    def port(self, loop: int) -> FramePort:
        """Where a loop's host sends and receives."""
        return next(port for bus in self.buses for i, port in zip(bus.loops, bus.ports, strict=True) if i == loop)

    def news(self) -> list[tuple[int, list[FaultNews]]]:
        """What the links have to tell, for each loop on them."""
        return [(loop, news) for bus in self.buses if (news := bus.link.news()) for loop in bus.loops]


def _share(link: CanLink, config: SessionConfig, loops: tuple[int, ...]) -> HostBus | ReadBus:
    """A link for its loops: itself for one, a port each for several."""
    return HostBus(link, loops, (link,)) if len(loops) == 1 else _ports(LinkShare(link), config, loops)


def _ports(share: LinkShare, config: SessionConfig, loops: tuple[int, ...]) -> ReadBus:
    ones = [config.loops[i] for i in loops]
    all_of_it = [one.foreign_device is not None or any(schedule_inputs(one).signals) for one in ones]
    ports = [share.whole() if a else share.port(one.bus.node) for one, a in zip(ones, all_of_it, strict=True)]
    return ReadBus(share, loops, tuple(ports))


class BenchLink(CanLink):
    """The host's end of a bench in simulated time, on which a foreign controller answers at once, as firmware does.

    Our own controller is asked and answers from sample to sample, and loses nothing by it; one that must be asked for
    each value would never be heard in its own sample.
    """

    answering: Sequence[DeviceOnBus] = ()

    def receive_all(self, limit: int = 10_000) -> list[can.Message]:
        """What has arrived, answers to what was just asked among it."""
        for device in self.answering:
            device.answer()
        return super().receive_all(limit)


class VirtualBench(NamedTuple):
    """Virtual devices and the host's ends of their buses. turn : lets time go on to the next sample of any device.
    plants : behind the devices.
    """

    buses: HostBuses
    clock: SimulatedClock
    turn: Callable[[], None]
    plants: "Plants"


@contextmanager
def virtual_bench(
    config: SessionConfig,
    say: Callable[[str], None],
    log: Path | None = None,
    first: Callable[[VirtualBench], None] | None = None,
) -> Iterator[VirtualBench]:
    """The configured virtual devices on buses of their own in this process, in simulated time.

    say : takes a line on a plant that does something wrong. log : file for the traffic of the first bus; the others'
    names follow from it (log_of_bus).
    first : is given a bench whose links are its own and log nothing, before the host's links open.

    Raises UserError, DeviceError: a loop has no [device], or a bus log cannot be opened.
    """
    clock = SimulatedClock()
    settings = [replace(_settings(config, loops), channel=f"retuner-{next(_channels)}") for loops in config.buses]
    with ExitStack() as stack:
        devices: dict[int, DeviceOnBus] = {}
        plants: Plants = stack.enter_context(product("plants").Plants(config.loops, say))
        for bus, loops in zip(settings, config.buses, strict=True):
            far = _share(stack.enter_context(CanLink(bus, clock)), config, loops)
            for i, port in zip(loops, far.ports, strict=True):
                devices[i] = DeviceOnBus(make_far_side(config.loops[i], plants.plants[i]), port)
        periods_s = [one.loop.sample_time_s for one in config.loops]
        next_s = list(periods_s)

        def turn() -> None:
            """Let time go on to the next sample of any device, and have it made."""
            now_s = min(next_s)
            clock.wait_until(now_s)
            for i, period_s in enumerate(periods_s):
                if next_s[i] <= now_s:
                    devices[i].sample()
                    next_s[i] += period_s

        def hosted(links: Sequence[CanLink]) -> VirtualBench:
            buses = HostBuses([_share(link, config, loops) for link, loops in zip(links, config.buses, strict=True)])
            for bus in buses.buses:
                link = bus.link.link if isinstance(bus.link, LinkShare) else bus.link
                if isinstance(link, BenchLink):
                    link.answering = [devices[i] for i in bus.loops if config.loops[i].foreign_device is not None]
            return VirtualBench(buses, clock, turn, plants)

        if first is not None:
            with opened(settings, clock, before(log)) as links:
                first(hosted(links))
        with opened(settings, clock, log) as links:
            yield hosted(links)


@contextmanager
def far_ends(
    config: SessionConfig, speed: float, clock: Clock, epoch: Callable[[], int], say: Callable[[str], None]
) -> Iterator[list[DeviceOnBus]]:
    """The configured virtual devices on real buses, for a process of their own. epoch : a number for each boot.
    say : as virtual_bench.

    Raises UserError, DeviceError: a loop has no [device], or a bus cannot be opened.
    """
    with ExitStack() as stack:
        devices: dict[int, DeviceOnBus] = {}
        plants = stack.enter_context(product("plants").Plants(config.loops, say, speed)).plants
        for loops in config.buses:
            link = stack.enter_context(CanLink(_settings(config, loops, speed), clock))
            for i, port in zip(loops, _share(link, config, loops).ports, strict=True):
                devices[i] = DeviceOnBus(make_far_side(config.loops[i], plants[i], epoch()), port)
        yield [devices[i] for i in range(len(config.loops))]


def before(log: Path | None) -> Path | None:
    """The log of what happens on the bus before a session."""
    return None if log is None else log.with_name(f"pretune-{log.name}")


@contextmanager
def opened(settings: Sequence[LinkSettings], clock: Clock, log: Path | None) -> Iterator[list[CanLink]]:
    """The host's ends of the buses, each with its log. Raises DeviceError: a bus or a log cannot be opened."""
    with ExitStack() as stack:
        yield [
            stack.enter_context(BenchLink(one, clock, log_of_bus(log, number) if log else None))
            for number, one in enumerate(settings)
        ]


def _settings(config: SessionConfig, loops: Sequence[int], speed: float = 1.0) -> LinkSettings:
    """How the bus of some loops is opened: as patient as the most patient of them."""
    wanted = [link_settings(config.loops[i], speed) for i in loops]
    return replace(wanted[0], silent_after_s=max(one.silent_after_s for one in wanted))


LONGEST_PAUSE_S = 0.005  # longest time for which frames gather before they are taken together, s of the machine's time


class LiveBuses(HostBuses):
    """Buses in real time, each read by a thread of its own (shared_link.py).

    buses : with their readers. clock : theirs. came : set by the readers when frames have come.
    """

    def __init__(
        self, buses: Sequence[ReadBus], readers: Sequence[LinkReader], clock: Clock, came: threading.Event
    ) -> None:
        super().__init__(buses)
        self._read = tuple(buses)
        self._readers, self._clock, self._came = readers, clock, came

    def heard(self) -> set[int]:
        """The loops for which frames have come that they have not taken yet."""
        return {i for bus in self._read for i, port in zip(bus.loops, bus.ports, strict=True) if port.waiting}

    def keep_leases(self, devices: Sequence[Device]) -> None:
        """Have the readers keep the leases of these devices, one a loop in the order of the loops."""
        for bus, reader in zip(self._read, self._readers, strict=True):
            own = (devices[i] for i in bus.loops)
            reader.timers = [device.keep_lease for device in own if isinstance(device, CanDevice)]

    def keep_logs(self) -> None:
        """Have on disk the frames that a row of the ledger rests on: a process that is killed loses the others."""
        for bus in self._read:
            bus.link.link.keep_log()

    def wait_until(self, t_s: float) -> None:
        """Return when frames have come, or the clock has reached t_s."""
        for reader in self._readers:
            if reader.defect is not None:
                defect, reader.defect = reader.defect, None
                raise defect
        self._came.wait(self._clock.left_s(t_s))
        self._came.clear()


@contextmanager
def live_buses(
    config: SessionConfig, speed: float, clock: MonotonicClock, log: Path | None = None
) -> Iterator[LiveBuses]:
    """The configured buses in real time. Raises DeviceError: a bus or its log cannot be opened."""
    settings = [_settings(config, loops, speed) for loops in config.buses]
    pause_s = min(min(one.loop.sample_time_s for one in config.loops) / POLLS_PER_SAMPLE, LONGEST_PAUSE_S * clock.speed)
    came = threading.Event()
    with opened(settings, clock, log) as links, ExitStack() as stack:
        shares = [LinkShare(link) for link in links]
        buses = [_ports(share, config, loops) for share, loops in zip(shares, config.buses, strict=True)]
        readers = [stack.enter_context(LinkReader(share, clock, pause_s, came)) for share in shares]
        yield LiveBuses(buses, readers, clock, came)


# Where an experiment takes place: a device and a turn, which lets some time pass and says what time it is. The turn of
# the live bus may be interrupted, that of the simulated one not, because device and host share a thread there.


@contextmanager
def simulated(config: Config, say: Callable[[str], None], log: Path | None = None) -> Iterator[Bench]:
    """The configured virtual device, a sample a turn. say : as virtual_bench.

    Raises UserError, DeviceError: the configuration has no [device], or the bus log cannot be opened.
    """
    with virtual_bench(SessionConfig((config,)), say, log) as bench:

        def turn() -> float:
            with unstoppable():
                bench.turn()
            return bench.clock.now_s()

        device = make_device(config, bench.buses.port(0))
        yield Bench(device, turn, device.settings.silent_s)


@contextmanager
def live(config: Config, speed: float, log: Path | None = None) -> Iterator[Bench]:
    """Whatever answers on the configured bus, some turns a sample. Raises DeviceError: the bus does not open."""
    clock = MonotonicClock(speed)
    with CanLink(link_settings(config, speed), clock, log) as link:
        device = make_device(config, link, speed)

        def turn() -> float:
            link.wait_until(clock.now_s() + config.loop.sample_time_s / POLLS_PER_SAMPLE)
            return clock.now_s()

        try:
            yield Bench(device, turn, device.settings.silent_s)
        finally:
            device.release(clock.now_s())
