"""What device.Device promises, over every bus that this machine has: python-can's virtual bus and udp_multicast."""

import itertools
import socket
import subprocess
import sys
import textwrap
import time

import can
import pytest
from bus_simulation.firmware import FirmwareDevice

from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.device import BusError, CommandDone, Device, WriteDone, WriteFailed
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.schedule.gains import PidGains

GROUP = "239.74.163.2"
PATIENCE_S = 30.0  # for what a busy machine delivers or starts late


def udp_settings() -> LinkSettings:
    """On a port that nobody uses: neither another worker of this test run, nor another run."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    settings = LinkSettings(interface="udp_multicast", channel=GROUP, options={"port": port})
    try:
        CanLink(settings, SimulatedClock()).close()
    except BusError as error:
        pytest.skip(f"no multicast on this machine: {error}")
    return settings


def await_all(link: CanLink, other: CanLink, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is simulated, the kernel's datagrams are not: what the other has sent is waited for."""
    receive_now = link.receive_all

    def receive_all(limit: int = 10_000) -> list[can.Message]:
        messages, until_s = receive_now(limit), time.monotonic() + PATIENCE_S
        while link.counters.received < other.counters.sent and time.monotonic() < until_s:
            messages += receive_now(limit)
        return messages

    monkeypatch.setattr(link, "receive_all", receive_all)


@pytest.fixture(params=["virtual", "udp_multicast", "firmware in C"])
def pair(request: pytest.FixtureRequest, make_bench, monkeypatch: pytest.MonkeyPatch):
    link = udp_settings() if request.param == "udp_multicast" else None
    made = make_bench(link=link, make=FirmwareDevice if request.param == "firmware in C" else VirtualDevice)
    await_all(made.near, made.far, monkeypatch)
    await_all(made.far, made.near, monkeypatch)
    made.run(8)
    assert made.host.connected
    return made


def test_it_is_a_device(pair) -> None:
    device: Device = pair.host
    assert device.connected
    assert device.running is not None
    assert not device.writing


def test_samples_come_one_by_one_in_order(pair) -> None:
    samples = pair.samples(pair.run(50))
    assert len(samples) == 50
    assert [b.t_s - a.t_s for a, b in itertools.pairwise(samples)] == [2.0] * 49


def test_a_write_is_done_and_reports_what_runs(pair) -> None:
    seq = pair.host.begin_write(PidGains(1.1, 0.07), pair.now_s)
    (done,) = pair.others(pair.run(10))
    assert isinstance(done, WriteDone)
    assert (done.seq, done.gains) == (seq, pair.device.running.gains)


def test_a_refused_write_ends_on_the_old_set(pair) -> None:
    pair.host.begin_write(PidGains(100.0, 0.07), pair.now_s)
    (failed,) = pair.others(pair.run(12))
    assert isinstance(failed, WriteFailed)
    assert failed.running.gains == pair.FIRST == pair.device.running.gains


def test_commands_are_done(pair) -> None:
    pair.host.send_setpoint(66.0, pair.now_s)
    pair.host.send_load(3.0, pair.now_s)
    pair.host.store(pair.now_s)
    commands = {e.command for e in pair.run(6) if isinstance(e, CommandDone)}
    assert commands == {"setpoint", "load", "store"}
    assert (pair.device.sp, pair.device.load) == (66.0, 3.0)


def test_own_frames_do_not_come_back(pair) -> None:
    pair.host.begin_write(pair.SECOND, pair.now_s)
    pair.run(20)
    assert pair.host.foreign_commands == 0
    assert pair.host.refused_frames == 0
    assert pair.device.refused == 0


DEVICE_PROCESS = """
    import sys
    from retuner.adaptive.process.model import LinearProcess
    from retuner.drivers.bus.bus import CanLink, LinkSettings
    from retuner.drivers.clock import MonotonicClock
    from retuner.drivers.controller.device_process import DeviceOnBus, run_devices
    from retuner.drivers.plants.linear_plant import LinearPlant
    from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
    from retuner.schedule.gains import PidGains

    clock = MonotonicClock(speed=50.0)
    plant = LinearPlant(LinearProcess(1.2, (30.0,), (), 4.0), start_pv=50.0, start_co=40.0)
    device = VirtualDevice(VirtualDeviceSettings(PidGains(1.0, 0.0625)), plant)
    settings = LinkSettings(interface="udp_multicast", channel=sys.argv[1], options={"port": int(sys.argv[2])})
    with CanLink(settings, clock) as link:
        run_devices([DeviceOnBus(device, link)], clock, until_s=50.0 * 60)
"""


@pytest.mark.slow
def test_two_processes_in_real_time_at_bench_speed() -> None:
    settings = udp_settings()
    command = [sys.executable, "-P", "-c", textwrap.dedent(DEVICE_PROCESS), GROUP, str(settings.options["port"])]
    clock = MonotonicClock(speed=50.0)
    long = 50.0 * PATIENCE_S
    patience = CanDeviceSettings(connect_floor_s=long, silent_samples=long, reply_floor_s=long, lease_floor_s=long)
    outcomes, samples = [], 0
    with subprocess.Popen(command) as process, CanLink(settings, clock) as link:
        try:
            while not link.receive_all():  # a question to nobody would be waited for as long as one to a slow device
                assert clock.now_s() < long
                link.wait_until(clock.now_s() + 1.0)
            host = CanDevice(link, patience)
            while not outcomes:
                events = host.poll(clock.now_s())
                outcomes += [e for e in events if isinstance(e, (WriteDone, WriteFailed))]
                samples += len(events)
                if host.connected and not host.writing and not outcomes:
                    host.begin_write(PidGains(1.5, 0.125), clock.now_s())
                link.wait_until(clock.now_s() + 1.0)
        finally:
            process.terminate()
    assert isinstance(outcomes[0], WriteDone)
    assert outcomes[0].gains == PidGains(1.5, 0.125)
    assert samples > 1
    assert link.counters.echoes > 0
