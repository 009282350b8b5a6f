"""A host that is busy with something else: the link's clock keeps its leases and a thread takes its frames in."""

import itertools
import threading

import can
import pytest

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.bus.bus import CanLink, LinkSettings
from retuner.drivers.bus.link_reader import LinkReader
from retuner.drivers.bus.shared_link import LinkShare
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import Event, SamplesLost, WriteDone
from retuner.drivers.host.can_device import CanDevice, CanDeviceSettings
from retuner.drivers.host.lease_and_commands import UNATTENDED
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import Ack, Lease, Reason
from retuner.schedule.gains import PidGains

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
