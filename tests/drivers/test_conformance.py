"""The examination finds nothing wrong with what keeps the protocol, and something with everything that does not."""

import itertools
import re
import socket
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import can
import pytest
from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FirmwareDevice
from bus_simulation.in_thread import InThread
from bus_simulation.mutants import MUTANTS, Mutant
from command_line import refused
from effort import sized

from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.conformance import frame_checks
from retuner.drivers.conformance.chapters import CHAPTERS, OTHERS_S, chapters, nodes_heard, sample_time_of
from retuner.drivers.conformance.conversation import Conversation, NoAnswerError, OnBus
from retuner.drivers.conformance.examination import Examination, examine
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import BusError, CommandDone, Device, WriteDone, WriteFailed
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.protocol.frames import GainBox, Reason
from retuner.schedule.gains import PidGains

KEY = bytes(range(16))
TRIAL = 20
PAGE = Path(__file__).resolve().parents[2] / "docs" / "developers" / "protocol.md"


def examined(make=FirmwareDevice, *, key: bytes | None = KEY, gains: PidGains | None = None, **more) -> Examination:
    first = gains or PidGains(1.0, 0.0625, 0.25)
    box = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0, direction=first.direction)
    settings = VirtualDeviceSettings(first, box=box, key=key, trial_samples=TRIAL, heartbeat_samples=5)
    device = make(settings, LagPlant(), **more)
    device.step()
    return examine(Conversation(InThread(device), 1, key), chapters(TRIAL))


@pytest.mark.parametrize("make", [VirtualDevice, FirmwareDevice])
@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize("gains", [PidGains(1.0, 0.0625, 0.25), PidGains(-2.0, -0.1), PidGains(0.0, 0.5)])
def test_nothing_is_wrong_with_what_keeps_the_protocol(make, key: bytes | None, gains: PidGains) -> None:
    found = examined(make, key=key, gains=gains)
    assert found.findings == []
    assert len(found.left_out) == (gains.kp == 0)
    assert found.tried > 150


@pytest.mark.parametrize("mutant", MUTANTS[:: sized(6, 6, 1)], ids=lambda mutant: mutant.name)
def test_every_mutant_is_found(mutant: Mutant) -> None:
    found = examined(changes=((mutant.old, mutant.new),))
    assert found.findings != []


MISSED = (
    "a commit runs under another number than its stage",
    "a refused commit is judged anew",
    "a second commit takes the place of the one that waits",
    "staged over a commit that waits",
    "an abort asks for the lease",
    "a lease's stamp of the last 64 samples is refused",
    "a lease's stamp of long ago counts",
    "one CRC of a sample in 40 is wrong",
    "one checksum of a frame in 40 is wrong",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", MISSED)
def test_what_an_examination_had_missed_is_found(name: str) -> None:
    """Without a key; every mutant is examined with one."""
    mutant = next(one for one in MUTANTS if one.name == name)
    assert examined(key=None, changes=((mutant.old, mutant.new),)).findings != []


class Wire:
    """A bus on which one device is, in simulated time: it answers late, but within its sample, and in order."""

    def __init__(self, late_s: float, sample_s: float) -> None:
        box = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0)
        settings = VirtualDeviceSettings(
            PidGains(1.0, 0.0625, 0.25), box=box, trial_samples=0, heartbeat_samples=2, sample_time_s=sample_s
        )
        self.device, self.clock = VirtualDevice(settings, LagPlant()), SimulatedClock()
        self._late_s, self._sample_s, self._next_s = late_s, sample_s, sample_s
        self._coming: list[tuple[float, can.Message]] = []

    def send(self, message: can.Message) -> bool:
        self._pass()
        at_s = self.clock.now_s() + self._late_s
        self._coming += [(at_s, answer) for answer in self.device.receive(message)]
        return True

    def wait_until(self, t_s: float) -> None:
        self.clock.wait_until(t_s)
        self._pass()

    def receive_all(self) -> list[can.Message]:
        due = [message for at_s, message in self._coming if at_s <= self.clock.now_s()]
        self._coming = [one for one in self._coming if one[0] > self.clock.now_s()]
        return due

    def _pass(self) -> None:
        while self._next_s <= self.clock.now_s():
            self._coming += [(self._next_s, message) for message in self.device.step()]
            self._next_s += self._sample_s


@pytest.mark.parametrize(("late_s", "sample_s"), [(0.0, 1.0), (0.9, 1.0), (0.045, 0.05)])
def test_answers_within_one_sample_are_not_condemned(late_s: float, sample_s: float) -> None:
    """Nor is a life sign of a sample that comes between a question and its answer."""
    wire = Wire(late_s, sample_s)
    link: Any = wire
    found = examine(Conversation(OnBus(link, wire.clock, 1, sample_s), 1), chapters())
    assert found.findings == []
    assert found.tried > 150


def test_counters_that_an_examiner_before_has_used_are_no_fault() -> None:
    box = GainBox(kp_max=100.0, ki_max=10.0, kd_max=50.0, ratio_max=10.0)
    device = VirtualDevice(VirtualDeviceSettings(PidGains(1.0, 0.0625, 0.25), box=box, trial_samples=0), LagPlant())
    device.step()
    talk = Conversation(InThread(device), 1)
    talk.own()
    assert frame_checks.manual(talk) is Reason.OK
    talk.counter(200)  # 56 behind
    assert frame_checks.manual(talk) is Reason.OK
    talk.own()
    talk.counter(200)
    found = Examination(talk)
    frame_checks.stamps(found)
    assert found.findings == []


def test_an_examination_of_a_device_that_runs_takes_25_samples() -> None:
    wire = Wire(0.0, 1.0)
    wire.wait_until(200.0)
    wire.receive_all()
    link: Any = wire
    assert examine(Conversation(OnBus(link, wire.clock, 1, 1.0), 1), chapters()).findings == []
    assert wire.clock.now_s() - 200.0 < 25 + 8  # and eight where a period of stamps is about to end


def test_the_node_and_its_sample_time_are_found_by_listening() -> None:
    wire = Wire(0.0, 0.4)
    link: Any = wire
    assert nodes_heard(link, wire.clock) == [1]
    assert sample_time_of(link, wire.clock, 1) == pytest.approx(wire.device.settings.sample_time_s)
    assert wire.clock.now_s() < 2 * OTHERS_S
    assert sample_time_of(link, wire.clock, 2) is None


def test_a_stranger_on_the_bus_is_no_node_and_is_not_spoken_to() -> None:
    wire = Wire(0.0, 0.4)
    wire.device.step = lambda: [can.Message(arbitration_id=3 << 5 | command, data=bytes(8), is_extended_id=False)
                                for command in range(32)]  # fmt: skip
    wire.send = lambda _: pytest.fail("a frame was sent")
    link: Any = wire
    assert nodes_heard(link, wire.clock) == []


class SameEpoch(VirtualDevice):
    """It forgets to take a new epoch."""

    def restart(self) -> None:
        self._boot()


class Dumb(VirtualDevice):
    """It sends telemetry and answers nothing."""

    def receive(self, _: can.Message) -> list[can.Message]:
        return []


def test_an_epoch_kept_over_a_restart_is_found() -> None:
    said = {finding.said for finding in examined(SameEpoch).findings}
    assert "the epoch is the same after a restart" in said


def test_a_device_that_says_nothing_cannot_be_examined() -> None:
    with pytest.raises(NoAnswerError, match="no Identity"):
        examined(Dumb)


def test_chapters_are_those_of_the_page() -> None:
    heads = set(re.findall(r"^## (.*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    assert {chapter for chapter, _ in CHAPTERS} <= heads


def test_nobody_there_is_one_line() -> None:
    assert "node 1 on virtual nobody: no Identity" in refused(
        "conformance", "-i", "virtual", "-c", "nobody", "--node", "1", "--sample-time", "0.01"
    )


@pytest.mark.parametrize("option", ["--speed", "--sample-time"])
def test_numbers_that_are_none_are_refused(option: str) -> None:
    assert f"{option} nan: give a positive number" in refused("conformance", "-i", "virtual", "-c", "x", option, "nan")


# What device.Device promises, over every bus that this machine has: python-can's virtual bus and udp_multicast


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
