"""The link: what it survives, what it drops, how it says no."""

import socket
from pathlib import Path

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message

from retuner.drivers.bus import bus_opening
from retuner.drivers.bus.bus import CanLink, FaultNews, LinkFault, LinkSettings
from retuner.drivers.bus.bus_opening import BusLog, log_parts
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.device import BusError, LinkState
from retuner.drivers.recorded.frame_log import read_frames, read_parts

FRAME = can.Message(arbitration_id=0x21, is_extended_id=False, data=b"\x01\x02")


class FakeBus:
    """A bus that does as it is told: a list of messages or exceptions to receive, and exceptions to send."""

    def __init__(self) -> None:
        self.incoming: list[can.Message | Exception] = []
        self.send_error: Exception | None = None
        self.sent: list[can.Message] = []
        self.closed = False
        self.timeouts: list[float] = []

    def recv(self, timeout: float) -> can.Message | None:
        assert timeout == 0.0
        if not self.incoming:
            return None
        first = self.incoming.pop(0)
        if isinstance(first, Exception):
            raise first
        return first

    def send(self, message: can.Message, timeout: float) -> None:
        assert 0 <= timeout < 1
        self.timeouts.append(timeout)
        if self.send_error:
            raise self.send_error
        self.sent.append(message)

    def fileno(self) -> int:
        return -1

    def shutdown(self) -> None:
        self.closed = True


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> list[FakeBus]:
    """Every bus that is opened from now on; a None in the list `refuse` stands for an opening that fails."""
    opened: list[FakeBus] = []

    def open_bus(*_: object) -> FakeBus:
        opened.append(FakeBus())
        return opened[-1]

    monkeypatch.setattr("retuner.drivers.bus.bus.open_bus", open_bus)
    return opened


def linked(clock: SimulatedClock, **settings: object) -> CanLink:
    return CanLink(LinkSettings(**{"interface": "socketcan", "channel": "can0", **settings}), clock)


def os_error() -> can.CanOperationError:
    error = can.CanOperationError("network is down", 100)
    error.__cause__ = OSError(100, "network is down")
    return error


def test_state_is_the_age_of_the_last_frame(fakes: list[FakeBus]) -> None:
    clock = SimulatedClock()
    link = linked(clock, silent_after_s=5.0)
    assert link.state is LinkState.SILENT
    fakes[0].incoming = [FRAME]
    assert len(link.receive_all()) == 1
    assert link.state is LinkState.UP
    clock.advance(5.0)
    assert link.state is LinkState.UP
    clock.advance(0.1)
    assert link.state is LinkState.SILENT


def test_a_receive_error_closes_the_bus_and_it_is_opened_anew_with_back_off(fakes, monkeypatch):
    clock = SimulatedClock()
    link = linked(clock, reopen_first_s=1.0, reopen_max_s=4.0)
    fakes[0].incoming = [FRAME, os_error(), FRAME]
    assert len(link.receive_all()) == 1
    assert link.state is LinkState.DOWN
    assert fakes[0].closed
    assert not link.send(FRAME)

    attempts = []

    def refuse(*_: object) -> None:
        attempts.append(clock.now_s())
        raise BusError("gone")

    monkeypatch.setattr("retuner.drivers.bus.bus.open_bus", refuse)
    for _ in range(200):
        clock.advance(0.125)
        assert link.receive_all() == []
    pauses = [round(b - a, 1) for a, b in zip([0.0, *attempts], attempts, strict=False)]
    assert pauses[:5] == [1.0, 2.0, 4.0, 4.0, 4.0]

    monkeypatch.setattr("retuner.drivers.bus.bus.open_bus", lambda *_: fakes[0])
    clock.advance(5.0)
    fakes[0].incoming = [FRAME]
    assert len(link.receive_all()) == 1
    assert link.state is LinkState.UP
    assert link.counters.opened == 2


def test_a_link_that_falls_silent_is_opened_anew_because_its_socket_may_be_deaf(fakes: list[FakeBus]) -> None:
    clock = SimulatedClock()
    link = linked(clock, silent_after_s=5.0, reopen_first_s=1.0)
    fakes[0].incoming = [FRAME]
    link.receive_all()
    clock.advance(6.0)
    link.receive_all()
    clock.advance(1.0)
    link.receive_all()
    assert (len(fakes), fakes[0].closed) == (2, True)
    clock.advance(100.0)
    link.receive_all()
    assert len(fakes) == 2, "once is enough until something has been heard"


def test_an_end_that_expects_silence_keeps_its_bus(fakes: list[FakeBus]) -> None:
    clock = SimulatedClock()
    link = linked(clock, silent_after_s=5.0)
    link.expect_silence()
    fakes[0].incoming = [FRAME]
    link.receive_all()
    clock.advance(100.0)
    link.receive_all()
    assert (len(fakes), link.state) == (1, LinkState.SILENT)


@pytest.mark.parametrize(
    "error",
    [
        can.CanTimeoutError("full"),
        can.CanOperationError("no buffer space", 105),
        can.CanOperationError("Transmit buffer full"),
    ],
)
def test_a_full_transmit_queue_is_counted_and_the_bus_stays_open(fakes: list[FakeBus], error: Exception) -> None:
    link = linked(SimulatedClock())
    fakes[0].send_error = error
    assert not link.send(FRAME)
    assert not link.send(FRAME)
    assert link.state is not LinkState.DOWN
    fakes[0].send_error = None
    assert link.send(FRAME)
    assert link.send(FRAME)
    assert (link.counters.send_failures, link.counters.sent) == (2, 2)
    assert link.faults.counts == {LinkFault.TRANSMIT_FULL: 2}
    first, second, third, fourth = fakes[0].timeouts
    assert first > second == third == 0, "while the queue is full nobody waits a second time"
    assert fourth == first


def test_a_send_error_closes_the_bus(fakes: list[FakeBus]) -> None:
    link = linked(SimulatedClock())
    fakes[0].send_error = os_error()
    assert not link.send(FRAME)
    assert link.state is LinkState.DOWN


def test_garbage_datagrams_are_counted_and_passed_over(fakes: list[FakeBus]) -> None:
    garbage = can.CanOperationError("could not unpack received message")
    garbage.__cause__ = ValueError("not msgpack")
    link = linked(SimulatedClock(), garbage_limit=5)
    fakes[0].incoming = [garbage, FRAME, garbage, FRAME]
    assert len(link.receive_all()) == 2
    assert link.counters.garbage == 2
    fakes[0].incoming = [garbage] * 6
    link.receive_all()
    assert link.state is LinkState.DOWN


def test_own_echoes_and_error_frames_are_left_out(fakes: list[FakeBus]) -> None:
    link = linked(SimulatedClock(), interface="udp_multicast")
    link.send(FRAME)
    other = can.Message(arbitration_id=0x21, is_extended_id=False, data=b"\x01\x03")
    error = can.Message(is_error_frame=True)
    fakes[0].incoming = [FRAME, other, error, FRAME]
    assert [m.data for m in link.receive_all()] == [other.data, FRAME.data]
    assert (link.counters.echoes, link.counters.error_frames, link.counters.received) == (1, 1, 2)


def test_closing_twice_does_nothing_and_a_closed_link_stays_closed(fakes: list[FakeBus]) -> None:
    clock = SimulatedClock()
    with linked(clock) as link:
        link.close()
    clock.advance(1e6)
    assert (link.receive_all(), link.send(FRAME), len(fakes)) == ([], False, 1)


@pytest.mark.parametrize(
    ("interface", "channel", "message"),
    [
        ("nonsense", "x", r"bus nonsense x: cannot open it: .*interfaces of python-can: .*socketcan.*virtual"),
        ("udp_multicast", "10.0.0.1", r"give a multicast group such as 239\.74\.163\.2"),
        ("socketcan", "nocan0", r"bus socketcan nocan0: cannot open it: .*(ip link add|no CAN)"),
    ],
)
def test_a_bus_that_does_not_exist_is_one_line_with_advice(interface: str, channel: str, message: str) -> None:
    with pytest.raises(BusError, match=message) as caught:
        CanLink(LinkSettings(interface=interface, channel=channel), SimulatedClock())
    assert "\n" not in str(caught.value)


def test_a_missing_msgpack_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("can.interfaces.udp_multicast.utils.msgpack", None)
    with pytest.raises(BusError, match=r'pip install "retuner\[udp\]"'):
        CanLink(LinkSettings(interface="udp_multicast", channel="239.74.163.2"), SimulatedClock())


def test_udp_multicast_stays_on_this_machine_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {}
    monkeypatch.setattr(bus_opening, "open_group", lambda _, **options: seen.update(options) or FakeBus())
    monkeypatch.setattr(bus_opening.can, "Bus", lambda **arguments: seen.update(arguments) or FakeBus())
    CanLink(LinkSettings(interface="udp_multicast", channel="239.74.163.2"), SimulatedClock())
    assert seen["hop_limit"] == 0
    CanLink(LinkSettings(interface="socketcan", channel="can0", options={"bitrate": 500000}), SimulatedClock())
    assert seen["bitrate"] == 500000


def udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        return free.getsockname()[1]


def heard(link: CanLink, sender: CanLink) -> list[int]:
    """What has arrived before a last frame of a sender on the same bus: datagrams of one machine keep their order."""
    sender.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    ids: list[int] = []
    while 0x7FF not in ids:
        link.wait_until(link._clock.now_s() + 1.0)
        ids += [message.arbitration_id for message in link.receive_all()]
    return ids[:-1]


def test_another_group_and_unicast_are_no_part_of_a_udp_multicast_bus() -> None:
    port, clock = udp_port(), MonotonicClock()
    groups = ("239.74.163.2", "239.74.163.2", "239.74.163.3")
    settings = [LinkSettings(interface="udp_multicast", channel=group, options={"port": port}) for group in groups]
    with CanLink(settings[0], clock) as near, CanLink(settings[1], clock) as far, CanLink(settings[2], clock) as other:
        other.send(FRAME)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(pack_message(FRAME), ("127.0.0.1", port))
        far.send(can.Message(arbitration_id=0x22, is_extended_id=False))
        assert heard(near, far) == [0x22]


# ---- A bus log keeps to its size: two parts, the older one replaced, no frame lost between them

LIMIT = 400_000
SLACK = 100_000  # the frames between two looks, in a format that does not compress


def frame(number: int) -> can.Message:
    return can.Message(arbitration_id=0x123, data=number.to_bytes(8, "big"))


def written(path: Path, frames: int, limit: float) -> int:
    """Write numbered frames at 100 a second; the greatest size that the folder had."""
    clock, greatest = SimulatedClock(), 0
    log = BusLog(path, clock, limit)
    for number in range(frames):
        assert log.write(frame(number), received=True)
        clock.advance(0.01)
        if number % 500 == 0:
            greatest = max(greatest, sum(file.stat().st_size for file in path.parent.iterdir()))
    assert log.stop()
    return greatest


def numbers(path: Path) -> list[int]:
    return [int.from_bytes(message.data, "big") for message in read_parts(path)]


@pytest.mark.parametrize(("name", "frames"), [("bus.blf", 60_000), ("bus.asc", 20_000)])
def test_a_log_keeps_to_its_size_and_its_end_is_whole(tmp_path: Path, name: str, frames: int) -> None:
    greatest = written(tmp_path / name, frames, LIMIT)
    assert LIMIT / 2 < greatest < LIMIT + SLACK
    parts = log_parts(tmp_path / name)
    assert len(parts.paths) == 2 == len(list(tmp_path.iterdir()))
    assert parts.gone >= 1
    kept = numbers(tmp_path / name)
    assert kept == list(range(kept[0], frames))
    assert kept[0] > 0


def test_with_the_first_rotation_nothing_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_opening, "LOOK_EVERY", 700)
    written(tmp_path / "bus.blf", 1000, 2.0)
    assert log_parts(tmp_path / "bus.blf") == ((tmp_path / "bus-1.blf", tmp_path / "bus.blf"), 0)
    assert numbers(tmp_path / "bus.blf") == list(range(1000))


def test_without_a_limit_there_is_one_part(tmp_path: Path) -> None:
    written(tmp_path / "bus.blf", 20_000, float("inf"))
    assert [file.name for file in tmp_path.iterdir()] == ["bus.blf"]
    assert log_parts(tmp_path / "bus.blf") == ((tmp_path / "bus.blf",), 0)
    assert len(list(read_frames(tmp_path / "bus.blf"))) == 20_000


def test_what_a_log_is_to_keep_is_on_disk_before_it_ends(tmp_path: Path) -> None:
    log, stamps = BusLog(tmp_path / "bus.blf", MonotonicClock()), []
    for number in range(10):
        log.keep = log.keep or number == 5
        message = frame(number)
        assert log.write(message, received=True)
        stamps.append(message.timestamp)
        if number == 7:
            assert numbers(tmp_path / "bus.blf") == list(range(6))
    assert log.stop()
    read = list(read_frames(tmp_path / "bus.blf"))
    assert [int.from_bytes(one.data, "big") for one in read] == list(range(10))
    assert [one.timestamp for one in read] == pytest.approx(stamps, abs=1e-5)


def test_other_files_are_no_parts(tmp_path: Path) -> None:
    for name in ("bus-0.blf", "bus-.blf", "bus-1.asc", "pretune-bus.blf", "bus-2.blf.tmp", "bus-12.blf", "bus-3.blf"):
        (tmp_path / name).touch()
    parts = log_parts(tmp_path / "bus.blf")
    assert [path.name for path in parts.paths] == ["bus-3.blf", "bus-12.blf", "bus.blf"]
    assert parts.gone == 2
    assert log_parts(tmp_path / "nowhere" / "bus.blf") == ((tmp_path / "nowhere" / "bus.blf",), 0)


def test_a_rotation_that_fails_ends_the_log_and_the_link_goes_on(tmp_path, monkeypatch):
    def refused(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(bus_opening, "LOOK_EVERY", 2)
    monkeypatch.setattr(Path, "replace", refused)
    clock = SimulatedClock()
    with CanLink(LinkSettings(channel="rotation", log_bytes_max=2.0), clock, tmp_path / "bus.blf") as link:
        assert [link.send(frame(number)) for number in range(4)] == [True] * 4
        assert link.news() == [FaultNews(LinkFault.LOG, 1)]
    assert numbers(tmp_path / "bus.blf") == [0, 1]


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan")])
def test_a_size_that_is_none_is_refused(size: float) -> None:
    with pytest.raises(ValueError, match="log_bytes_max"):
        LinkSettings(log_bytes_max=size)
