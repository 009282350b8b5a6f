"""Many loops on one link: each host gets its own controller's frames, and one that is not polled takes no memory."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import can
import pytest

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import LoopSample
from retuner.config.loading import parse_session
from retuner.drivers.bus import shared_link as link_share
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import LinkState, SamplesLost, WriteDone
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import HIGHEST_NODE
from retuner.drivers.telemetry.signal_source import plant_message
from retuner.schedule.gains import PidGains
from retuner.session.bench_or_buses import live_buses

EXAMPLES = Path(__file__).parents[2] / "examples"
NODES = (1, 5, 63)
CHANNELS = itertools.count()
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
