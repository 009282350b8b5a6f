"""Every way a link fails has a name, a count and a rationed telling; the socket's own knowledge is used."""

import select
import socket
import struct
import sys
from collections.abc import Iterator

import can
import pytest

from retuner.drivers.bus import bus
from retuner.drivers.bus.bus import (
    TELL_EVERY_S,
    CanLink,
    FaultBook,
    FaultNews,
    LinkFault,
    LinkSettings,
    SocketProbe,
    fault_of_error,
    fault_of_frame,
    is_full,
    is_garbage,
)
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.device import LinkState

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="the counters are Linux's")


def error_frame(kind: int, state: int = 0) -> can.Message:
    return can.Message(is_error_frame=True, arbitration_id=kind, data=bytes([0, state, 0, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize(
    ("kind", "state", "fault"),
    [
        (0x40, 0, LinkFault.BUS_OFF),
        (0x44, 0x30, LinkFault.BUS_OFF),
        (0x20, 0, LinkFault.NO_ACKNOWLEDGE),
        (0x04, 0x01, LinkFault.OVERFLOW),
        (0x04, 0x20, LinkFault.ERROR_PASSIVE),
        (0x04, 0x08, LinkFault.ERROR_WARNING),
        (0x04, 0x40, LinkFault.ERROR_FRAME),
        (0x08, 0, LinkFault.ERROR_FRAME),
        (0x100, 0, LinkFault.ERROR_FRAME),
    ],
)
def test_error_frames_are_read(kind: int, state: int, fault: LinkFault) -> None:
    assert fault_of_frame(error_frame(kind, state)) is fault


def test_an_error_frame_without_data_is_read_as_well() -> None:
    assert fault_of_frame(can.Message(is_error_frame=True, arbitration_id=4, data=b"")) is LinkFault.ERROR_FRAME


def with_cause(error: can.CanError, cause: BaseException) -> can.CanError:
    error.__cause__ = cause
    return error


def test_errors_of_the_system_are_named() -> None:
    for number, fault in [
        (100, LinkFault.INTERFACE_DOWN),
        (19, LinkFault.INTERFACE_GONE),
        (6, LinkFault.INTERFACE_GONE),
        (105, LinkFault.TRANSMIT_FULL),
        (5, LinkFault.SEND),
    ]:
        error = with_cause(can.CanOperationError("x", number), OSError(number, "x"))
        assert fault_of_error(error, LinkFault.SEND) is fault
        if number != 105:  # python-can's own error is needed to tell a full queue
            assert fault_of_error(OSError(number, "x"), LinkFault.SEND) is fault
    assert fault_of_error(ValueError("x"), LinkFault.RECEIVE) is LinkFault.RECEIVE
    assert fault_of_error(can.CanOperationError("Transmit buffer full"), LinkFault.SEND) is LinkFault.TRANSMIT_FULL


def test_a_full_queue_and_garbage_are_told_apart_from_a_broken_bus() -> None:
    assert is_full(can.CanTimeoutError("x"))
    assert not is_full(with_cause(can.CanOperationError("x"), ValueError("x")))
    assert not is_full(can.CanInitializationError("x"))
    assert not is_full(OSError(100, "x"))
    assert is_garbage(with_cause(can.CanOperationError("x"), ValueError("x")))
    assert not is_garbage(with_cause(can.CanOperationError("x"), OSError(100, "x")))


def test_a_fault_is_told_at_once_and_then_now_and_then() -> None:
    book = FaultBook()
    assert book.news(0.0) == []
    book.note(LinkFault.GARBAGE)
    assert book.news(0.0) == [FaultNews(LinkFault.GARBAGE, 1)]
    for _ in range(50):
        book.note(LinkFault.GARBAGE)
        assert book.news(TELL_EVERY_S - 1.0) == []
    book.note(LinkFault.OVERFLOW, 7)
    assert book.news(TELL_EVERY_S - 1.0) == [FaultNews(LinkFault.OVERFLOW, 7)]
    assert book.news(TELL_EVERY_S) == [FaultNews(LinkFault.GARBAGE, 50)]
    assert book.news(1e9) == []
    assert book.counts == {LinkFault.GARBAGE: 51, LinkFault.OVERFLOW: 7}


@pytest.fixture
def heard() -> Iterator[tuple[CanLink, can.BusABC, SimulatedClock]]:
    clock = SimulatedClock()
    settings = LinkSettings(channel="link-faults", reopen_first_s=1.0)
    with CanLink(settings, clock) as link, can.Bus(interface="virtual", channel="link-faults") as other:
        yield link, other, clock


def test_bus_off_closes_the_bus_and_it_comes_back(heard: tuple[CanLink, can.BusABC, SimulatedClock]) -> None:
    link, other, clock = heard
    frame = can.Message(arbitration_id=0x30, is_extended_id=False, data=b"x")
    other.send(frame)
    other.send(error_frame(0x40))
    other.send(frame)
    assert len(link.receive_all()) == 1
    assert link.state is LinkState.DOWN
    assert not link.send(frame)
    assert link.news() == [FaultNews(LinkFault.BUS_OFF, 1)]
    clock.advance(1.0)
    link.receive_all()
    other.send(frame)
    assert len(link.receive_all()) == 1
    assert link.state is LinkState.UP


def test_error_passive_is_told_and_the_bus_stays_open(heard: tuple[CanLink, can.BusABC, SimulatedClock]) -> None:
    link, other, _ = heard
    other.send(error_frame(0x04, 0x10))
    assert link.receive_all() == []
    assert link.news() == [FaultNews(LinkFault.ERROR_PASSIVE, 1)]
    assert link.counters.opened == 1


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        yield made


@linux_only
def test_the_probe_counts_what_the_kernel_drops(receiver: socket.socket) -> None:
    probe = SocketProbe(receiver.fileno())
    assert receiver.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= 212_992
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(500):
            sender.sendto(b"x" * 16, receiver.getsockname())
    dropped = probe.drops()
    receiver.settimeout(0.0)
    got = 0
    while select.select([receiver], [], [], 0.0)[0]:
        got += len(receiver.recv(100)) > 0
    assert (got + dropped, probe.drops()) == (500, 0)
    assert dropped > 0
    probe.close()
    probe.close()
    assert probe.drops() == 0
    assert receiver.fileno() >= 0, "the bus keeps its own handle"


@linux_only
def test_a_socket_bound_elsewhere_is_seen(receiver: socket.socket) -> None:
    for name, unbound in [("", False), ("vcan0", True), ("127.0.0.1", False)]:
        probe = SocketProbe(receiver.fileno(), name)
        assert probe.is_unbound() is unbound
        probe.close()


def test_without_a_socket_the_probe_knows_nothing() -> None:
    probe = SocketProbe(-1, "vcan0")
    assert (probe.drops(), probe.is_unbound()) == (0, False)


class Told:
    """A probe that says what it is told to."""

    def __init__(self, *_: object) -> None:
        self.lost, self.unbound = 0, False
        PROBES.append(self)

    def drops(self) -> int:
        lost, self.lost = self.lost, 0
        return lost

    def is_unbound(self) -> bool:
        return self.unbound

    def close(self) -> None:
        pass


PROBES: list[Told] = []


def test_the_link_tells_overflow_and_leaves_a_socket_whose_interface_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "SocketProbe", Told)
    clock = SimulatedClock()
    with CanLink(LinkSettings(channel="link-told", reopen_first_s=1.0), clock) as link:
        link.expect_silence()  # a device: silence says nothing to it
        PROBES[-1].lost = 4722
        link.receive_all()
        assert link.counters.overflows == 4722
        assert link.news() == [FaultNews(LinkFault.OVERFLOW, 4722)]
        PROBES[-1].unbound = True
        clock.advance(1.0)
        link.receive_all()
        assert link.state is LinkState.DOWN
        assert link.news() == [FaultNews(LinkFault.INTERFACE_GONE, 1)]
        clock.advance(1.0)
        link.receive_all()
        assert (link.state, link.counters.opened) == (LinkState.SILENT, 2)


def test_a_log_that_cannot_take_a_number_ends_and_the_link_goes_on(tmp_path) -> None:
    clock = SimulatedClock(1e6)
    with CanLink(LinkSettings(channel="link-log"), clock, tmp_path / "a.blf") as link:

        def refuse(_: can.Message) -> None:
            raise struct.error("argument out of range")

        link._log._writer.on_message_received = refuse
        assert link.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert link.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert link.news() == [FaultNews(LinkFault.LOG, 1)]
