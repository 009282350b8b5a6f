"""A host that is busy with something else: the link's clock keeps its leases and a thread takes its frames in."""

import itertools
import threading
from collections.abc import Sequence
from pathlib import Path

import can
import pytest

from retuner import LinearProcess, LoopSample, PidGains
from retuner.config.loading import parse_session
from retuner.drivers.bus import shared_link as link_share
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.bus.shared_link import LinkReader, LinkShare
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import Event, LinkState, SamplesLost, WriteDone
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.host.lease_and_commands import UNATTENDED, LeaseKeeper
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import HIGHEST_NODE, Ack, Kind, Lease, Reason
from retuner.drivers.telemetry.signal_source import plant_message
from retuner.session.bench_or_buses import live_buses

CHANNELS = itertools.count()
GAINS, OTHERS = PidGains(1.0, 0.1), PidGains(1.25, 0.125)
LEASE = 30  # samples of a second
NOBODY = 0
PATIENCE_S = 20.0


class Bench:
    """A device and its host on a shared link; the host polls only when told."""

    def __init__(self) -> None:
        self.clock, settings = SimulatedClock(), LinkSettings(channel=f"kept-{next(CHANNELS)}")
        self.far, self.near = CanLink(settings, self.clock), CanLink(settings, self.clock)
        plant = LinearPlant(LinearProcess(1.0, (20.0,)), start_pv=50.0, start_co=50.0)
        self.device = VirtualDevice(VirtualDeviceSettings(GAINS, sample_time_s=1.0), plant)
        self.on_bus = DeviceOnBus(self.device, self.far)
        self.host = CanDevice(LinkShare(self.near).port(1), CanDeviceSettings(sample_time_s=1.0))
        self.events: list[Event] = []

    def run(self, samples: int, *, polled: bool, timer: bool = True) -> None:
        for _ in range(samples):
            self.clock.advance(1.0)
            self.on_bus.sample()
            if timer:
                self.host.keep_lease(self.clock.now_s())
            if polled:
                self.events += self.host.poll(self.clock.now_s())

    @property
    def owner(self) -> int:
        return self.device.lease.owner

    def write(self) -> list[Event]:
        self.events.clear()
        self.host.begin_write(OTHERS, self.clock.now_s())
        self.run(12, polled=True)
        return [event for event in self.events if not isinstance(event, LoopSample)]


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.run(20, polled=True)
    assert made.owner == 1
    return made


@pytest.mark.parametrize("ahead", range(0, 64, 16))
@pytest.mark.parametrize("slow", [False, True])
def test_no_request_is_refused_while_nobody_polls(bench: Bench, ahead: int, slow: bool) -> None:
    """Wherever its counter stands, and though it be a tenth slower than it says: each request is of a time it takes."""
    bench.run(ahead, polled=True)
    ask, answers = bench.device.lease.request, []

    def heard(frame: Lease, epoch: int, sample: int) -> Ack:
        answers.append(ask(frame, epoch, sample))
        return answers[-1]

    bench.device.lease.request = heard
    for second in range(round(UNATTENDED * LEASE) - 5):
        bench.clock.advance(1.0)
        bench.on_bus.answer() if slow and second % 10 == 9 else bench.on_bus.sample()
        bench.host.keep_lease(bench.clock.now_s())
    assert len(answers) > 8
    assert {answer.reason for answer in answers} == {Reason.OK}


def test_a_lease_is_kept_while_the_host_does_something_else(bench: Bench) -> None:
    bench.run(round(UNATTENDED * LEASE) - 5, polled=False)
    assert bench.owner == 1
    (done,) = bench.write()
    assert isinstance(done, WriteDone)
    assert bench.device.running.gains == OTHERS


def test_a_request_of_a_wrong_time_is_made_again_with_what_the_next_poll_knows() -> None:
    keeper = LeaseKeeper(1, 300, 3.0, 0.25)
    assert keeper.due(0.0, 5)
    keeper.on_ack(Ack(Kind.LEASE, 1, Reason.OK, 1))
    assert keeper.prolong(1.1, 9)
    keeper.on_ack(Ack(Kind.LEASE, 1, Reason.STALE, 1))
    assert [frame.stamp for frame in keeper.due(1.12, 7)] == [7]


def test_without_the_timer_it_runs_out(bench: Bench) -> None:
    bench.run(LEASE + 5, polled=False, timer=False)
    assert bench.owner == NOBODY


def test_a_host_that_hangs_loses_it_as_one_that_has_died(bench: Bench) -> None:
    bench.run(round((UNATTENDED + 1.5) * LEASE), polled=False)
    assert bench.owner == NOBODY
    (done,) = bench.write()  # and takes it again when it is there again
    assert isinstance(done, WriteDone)


def test_requests_whose_answers_were_lost_do_not_make_it_ask_more_often(bench: Bench) -> None:
    counts = []
    for lost in (False, True):
        bench.run(2 * LEASE, polled=False)
        if lost:
            bench.near.receive_all()
        sent = bench.near.counters.sent
        bench.run(10 * LEASE, polled=True)
        counts.append(bench.near.counters.sent - sent)
    assert counts[1] <= counts[0] + 2


def test_what_came_meanwhile_is_all_there(bench: Bench) -> None:
    bench.events.clear()
    bench.run(90, polled=False)
    bench.run(1, polled=True)
    assert sum(isinstance(event, LoopSample) for event in bench.events) == 91
    assert not [event for event in bench.events if isinstance(event, SamplesLost)]


class Read:
    """A link that a thread reads, in real time, and the far end of its bus."""

    def __init__(self) -> None:
        self.clock, settings = MonotonicClock(), LinkSettings(channel=f"read-{next(CHANNELS)}")
        self.far, self.near = CanLink(settings, self.clock), CanLink(settings, self.clock)
        self.share, self.came = LinkShare(self.near), threading.Event()
        self.reader = LinkReader(self.share, self.clock, 0.001, self.came)


def test_a_thread_takes_frames_in_and_looks_after_the_leases() -> None:
    there, asked = Read(), threading.Event()
    port = there.share.port(1)
    there.reader.timers = [lambda _: asked.set()]
    with there.reader:
        there.far.send(can.Message(arbitration_id=1 << 5, is_extended_id=False, data=b"\x01"))
        assert there.came.wait(PATIENCE_S)
        assert asked.wait(PATIENCE_S)
        (message,) = port.receive_all()
    assert bytes(message.data) == b"\x01"
    assert not there.share.read_by_thread


def test_a_thread_that_fails_says_so_and_the_ports_read_for_themselves() -> None:
    there = Read()

    def fail(now_s: float) -> None:
        raise ZeroDivisionError(now_s)

    there.reader.timers = [fail]
    with there.reader:
        assert there.came.wait(PATIENCE_S)
        assert isinstance(there.reader.defect, ZeroDivisionError)
        there.far.send(can.Message(arbitration_id=1 << 5, is_extended_id=False, data=b"\x02"))
        assert [bytes(one.data) for one in there.share.port(1).receive_all()] == [b"\x02"]


def test_what_the_thread_has_not_read_yet_is_no_silence() -> None:
    there = Read()
    there.share.read_by_thread = True  # and the thread does not get to run
    there.far.send(can.Message(arbitration_id=1 << 5, is_extended_id=False, data=b"\x03"))
    assert [bytes(one.data) for one in there.share.port(1).receive_all()] == [b"\x03"]


# Many loops on one link: each host gets its own controller's frames, and one that is not polled takes no memory.


EXAMPLES = Path(__file__).parents[2] / "examples"
NODES = (1, 5, 63)
OTHER = 17  # a node that nobody here watches


class Plant:
    """Devices on links of their own, hosts on ports of one link."""

    def __init__(self, nodes: Sequence[int] = NODES, strangers: tuple[int, ...] = (OTHER,)) -> None:
        self.clock, settings = SimulatedClock(), LinkSettings(channel=f"share-{next(CHANNELS)}")
        self.devices, self.links = [], []
        for node in (*nodes, *strangers):
            firmware = VirtualDeviceSettings(PidGains(node, 0.125), node=node, sample_time_s=1.0)
            plant = LinearPlant(LinearProcess(1.0, (20.0,)), start_pv=float(node))
            self.links.append(CanLink(settings, self.clock))
            self.devices.append(DeviceOnBus(VirtualDevice(firmware, plant), self.links[-1]))
        self.links.append(CanLink(settings, self.clock))
        self.share = LinkShare(self.links[-1])
        self.hosts = {
            node: CanDevice(self.share.port(node), CanDeviceSettings(node=node, sample_time_s=1.0)) for node in nodes
        }
        self.events = {node: [] for node in nodes}

    def run(self, samples: int, watched: Sequence[int] = ()) -> None:
        for _ in range(samples):
            self.clock.advance(1.0)
            for device in self.devices:
                device.sample()
            for node in watched or self.hosts:
                self.events[node] += self.hosts[node].poll(self.clock.now_s())
            for device in self.devices:
                device.answer()

    def samples(self, node: int) -> list[LoopSample]:
        return [event for event in self.events[node] if isinstance(event, LoopSample)]

    def close(self) -> None:
        for link in self.links:
            link.close()


@pytest.fixture
def plant():
    made = Plant()
    yield made
    made.close()


def test_every_host_hears_its_own_controller(plant: Plant) -> None:
    plant.run(30)
    for node, host in plant.hosts.items():
        assert host.connected
        assert host.running.gains == PidGains(node, 0.125)
        assert len(plant.samples(node)) > 20
        assert {round(sample.pv) for sample in plant.samples(node)} == {node}
        assert host.refused_frames == 0
    assert plant.share.unclaimed > 60, "frames of the node that nobody watches"
    assert plant.share.port(1).state is LinkState.UP
    assert plant.share.port(1) is plant.share.port(1)


@pytest.mark.parametrize("loop", ["aircraft", "bench"])
def test_a_signal_that_schedules_is_heard_on_a_bus_too(loop: str) -> None:
    """A port gave its host the frames of the node alone: no region was ever known, in real time only."""
    clock, config = MonotonicClock(), parse_session((EXAMPLES / f"{loop}.toml").read_text())
    with live_buses(config, 1.0, clock) as buses:
        with CanLink(LinkSettings(channel=config.loops[0].bus.channel), clock) as far:
            far.send(plant_message(1, 30.0))
            far.send(can.Message(arbitration_id=config.loops[0].bus.node << 5, is_extended_id=False))
        heard = [*buses.port(0).receive_all(), *buses.port(0).receive_all()]
    assert [message.is_extended_id for message in heard] == ([True, False] if loop == "aircraft" else [False])


def test_a_host_that_is_not_polled_takes_no_memory_and_sees_the_gap(plant, monkeypatch):
    monkeypatch.setattr(link_share, "WAITING_MAX", 20)
    plant.run(30)
    plant.run(18, watched=(1, 63))
    assert plant.share.port(5).dropped > 0
    plant.run(20)
    lost = sum(event.count for event in plant.events[5] if isinstance(event, SamplesLost))
    times = [sample.t_s for sample in plant.samples(5)]
    assert lost >= 5
    assert len(times) + lost == times[-1] - times[0] + 1
    assert plant.hosts[5].connected


def test_a_limit_leaves_the_rest_for_later(plant: Plant) -> None:
    port = plant.share.port(7)
    for i in range(5):
        port.give(can.Message(arbitration_id=7 << 5, is_extended_id=False, data=[i]))
    assert [message.data[0] for message in port.receive_all(limit=2)] == [0, 1]
    assert [message.data[0] for message in port.receive_all()] == [2, 3, 4]


@pytest.mark.parametrize("node", [0, 64])
def test_a_node_that_cannot_be_is_refused(plant: Plant, node: int) -> None:
    with pytest.raises(ValueError, match="from 1 to 63"):
        plant.share.port(node)


def test_63_loops_on_one_bus_are_written_at_once_each_with_its_own() -> None:
    plant = Plant(range(1, HIGHEST_NODE + 1), ())
    plant.run(5)
    wanted = {node: PidGains(1.25 * node, 0.0625) for node in plant.hosts}
    for node, host in plant.hosts.items():
        host.begin_write(wanted[node], plant.clock.now_s())
    plant.run(8)
    done = [node for node, events in plant.events.items() for event in events if isinstance(event, WriteDone)]
    assert done == list(wanted)
    assert [one.device.running.gains for one in plant.devices] == list(wanted.values())
    assert sum(host.refused_frames + host.foreign_commands for host in plant.hosts.values()) == 0
    plant.close()


def test_the_same_node_on_two_buses_is_two_loops() -> None:
    plants, new = [Plant((7,), ()) for _ in range(2)], PidGains(8.0, 0.25)
    for sample in range(14):
        for plant in plants:
            plant.run(1)
        if sample == 5:
            plants[1].hosts[7].begin_write(new, plants[1].clock.now_s())
    assert [plant.devices[0].device.running.gains for plant in plants] == [PidGains(7, 0.125), new]
    for plant in plants:
        plant.close()
