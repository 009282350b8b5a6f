"""All 63 nodes on one bus, written to at once over one link; and the same node number on two buses."""

from speaking import FIRST, SECOND

from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import WriteDone
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import HIGHEST_NODE
from retuner.schedule.gains import PidGains

PLANT = LinearProcess(1.2, (30.0,))


class Row:
    """Devices on a bus of their own, and their hosts on one link."""

    def __init__(self, name: str, nodes: range, clock: SimulatedClock) -> None:
        self.clock = clock
        self.far, self.near = (CanLink(LinkSettings(channel=name), clock) for _ in range(2))
        self.devices = [
            VirtualDevice(VirtualDeviceSettings(FIRST, node=node), LinearPlant(PLANT, start_pv=50.0, start_co=40.0))
            for node in nodes
        ]
        share = LinkShare(self.near)
        self.hosts = [CanDevice(share.port(node), CanDeviceSettings(node=node)) for node in nodes]

    def sample(self) -> list:
        """One controller sample of all; what the hosts tell but samples."""
        for device in self.devices:
            for message in device.step():
                self.far.send(message)
        events = [host.poll(self.clock.now_s()) for host in self.hosts]
        for message in self.far.receive_all():
            for device in self.devices:
                for reply in device.receive(message):
                    self.far.send(reply)
        return events

    def close(self) -> None:
        self.near.close()
        self.far.close()


def test_63_loops_on_one_bus_are_written_at_once_each_with_its_own() -> None:
    clock = SimulatedClock()
    row = Row("row of 63", range(1, HIGHEST_NODE + 1), clock)
    for _ in range(5):
        clock.advance(2.0)
        row.sample()
    wanted = [PidGains(1.0 + node / 64, 0.0625) for node in range(HIGHEST_NODE)]
    for host, gains in zip(row.hosts, wanted, strict=True):
        host.begin_write(gains, clock.now_s())
    done = 0
    for _ in range(8):
        clock.advance(2.0)
        done += sum(isinstance(event, WriteDone) for events in row.sample() for event in events)
    assert done == HIGHEST_NODE
    assert [device.running.gains for device in row.devices] == wanted
    assert sum(host.refused_frames + host.foreign_commands for host in row.hosts) == 0
    row.close()


def test_the_same_node_on_two_buses_is_two_loops() -> None:
    clock = SimulatedClock()
    rows = [Row(name, range(7, 8), clock) for name in ("first bus", "second bus")]
    for step in range(14):
        clock.advance(2.0)
        for row in rows:
            row.sample()
        if step == 5:
            rows[1].hosts[0].begin_write(SECOND, clock.now_s())
    assert [row.devices[0].running.gains for row in rows] == [FIRST, SECOND]
    for row in rows:
        row.close()
