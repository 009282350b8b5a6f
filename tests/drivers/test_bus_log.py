"""A bus log keeps to its size: two parts, the older one replaced, no frame lost between them."""

from pathlib import Path

import can
import pytest

from retuner.drivers.bus import bus_opening
from retuner.drivers.bus.bus import CanLink, FaultNews, LinkFault, LinkSettings
from retuner.drivers.bus.bus_opening import BusLog, log_parts
from retuner.drivers.clock import SimulatedClock
from retuner.drivers.recorded.frame_log import read_frames, read_parts

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


def test_other_files_are_no_parts(tmp_path: Path) -> None:
    for name in ("bus-0.blf", "bus-.blf", "bus-1.asc", "pretune-bus.blf", "bus-2.blf.tmp", "bus-12.blf", "bus-3.blf"):
        (tmp_path / name).touch()
    parts = log_parts(tmp_path / "bus.blf")
    assert [path.name for path in parts.paths] == ["bus-3.blf", "bus-12.blf", "bus.blf"]
    assert parts.gone == 2
    assert log_parts(tmp_path / "nowhere" / "bus.blf") == ((tmp_path / "nowhere" / "bus.blf",), 0)


def test_a_rotation_that_fails_ends_the_log_and_the_link_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
