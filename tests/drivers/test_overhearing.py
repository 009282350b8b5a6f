"""The log of a host, overheard, gives the samples that the host had: bit for bit, through loss, restart and writes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.signals.sample import LoopSample
from retuner.drivers.device import DeviceRestarted
from retuner.drivers.recorded.frame_log import READING_ERRORS, SUFFIXES, Overhearing, read_frames
from retuner.drivers.recorded.recording import RecordingError
from retuner.schedule.gains import PidGains


def read(log: Path) -> tuple[int, str]:
    """Frames that could be read, and what was told at the end."""
    count = 0
    try:
        for _ in read_frames(log):
            count += 1
    except RecordingError as error:
        return count, str(error)
    return count, ""


def overheard(log: Path, lost_contact_after: tuple[int, ...] = (), *, as_host: bool = True) -> list[LoopSample]:
    """Samples of a log; contact was lost after these numbers of them."""
    heard = Overhearing(1, 1.0, "pv", as_host=as_host)
    samples: list[LoopSample] = []
    for message in read_frames(log):
        joined = heard.take(message)
        if joined is not None:
            samples.append(joined.sample)
            if len(samples) in lost_contact_after:
                heard.contact_lost()
    return samples


@pytest.fixture
def logged(make_bench: Callable[..., Any], tmp_path: Path) -> Callable[[], tuple[Any, Path]]:
    """A bench with a log whose host schedules by pv."""
    from retuner.drivers.host.can_settings import CanDeviceSettings

    log = tmp_path / "bus.blf"
    return lambda: (
        make_bench(log=log, host=CanDeviceSettings(sample_time_s=1.0, variable="pv"), sample_time_s=1.0),
        log,
    )


def test_the_samples_are_those_of_the_host_bit_for_bit(logged) -> None:
    bench, log = logged()
    bench.run(40)
    bench.host.send_setpoint(60.0, bench.now_s)
    bench.run(300)
    bench.host.begin_write(PidGains(1.5, 0.125, 0.75), bench.now_s)
    bench.run(60)
    live = bench.samples(bench.events)
    bench.close()
    again = overheard(log)
    assert again == live
    assert len(again) > 390
    assert {sample.revision for sample in again} == {0, 1}


def test_a_restart_and_lost_frames_change_nothing_in_that(logged) -> None:
    bench, log = logged()
    bench.run(40)
    bench.silence(3)
    bench.run(20)
    bench.device.restart()
    bench.run(200)
    live = bench.samples(bench.events)
    bench.close()
    assert overheard(log) == live


def test_the_gap_at_a_restart_is_the_hosts_where_it_is_known(logged) -> None:
    """A host whose clock runs faster than the log's stamps measures other gaps than the stamps show."""
    bench, log = logged()
    bench.run(40)
    bench.silence(7)
    bench.device.restart()
    bench.run(100)
    gaps = [event.gap for event in bench.events if isinstance(event, DeviceRestarted)]
    live = bench.samples(bench.events)
    bench.close()
    assert len(gaps) == 1

    def faster(heard: Overhearing) -> list[LoopSample]:
        samples = []
        for message in read_frames(log):
            message.timestamp /= 50.0
            joined = heard.take(message)
            samples += [joined.sample] if joined else []
        return samples

    assert faster(Overhearing(1, 1.0, "pv", gaps=gaps)) == live
    assert faster(Overhearing(1, 1.0, "pv")) != live


def test_where_contact_was_lost_the_host_began_anew(logged) -> None:
    bench, log = logged()
    bench.run(30)
    before = len(bench.samples(bench.events))
    bench.silence(60)
    assert not bench.host.connected
    bench.run(60)
    live = bench.samples(bench.events)
    bench.close()
    assert overheard(log, (before,)) == live
    assert len(live) > before + 40


def test_a_bystander_hears_from_the_first_heartbeat_on(logged) -> None:
    bench, log = logged()
    bench.run(100)
    live = bench.samples(bench.events)
    bench.close()
    heard = overheard(log, as_host=False)
    assert heard[-1] == live[-1]
    assert len(heard) >= len(live)


@pytest.mark.parametrize("suffix", [".asc", ".log", ".blf"])
def test_every_format_gives_the_same_samples(logged, tmp_path: Path, suffix: str) -> None:
    bench, log = logged()
    bench.run(60)
    bench.close()
    other = tmp_path / f"again{suffix}"
    with can.Logger(other) as writer:
        for message in read_frames(log):
            writer.on_message_received(message)
    assert overheard(other, as_host=False) == overheard(log, as_host=False)


@given(st.binary(max_size=400), st.sampled_from([s for s in SUFFIXES if s != ".mf4"]))
def test_bytes_that_are_no_log_are_one_line(tmp_path_factory: pytest.TempPathFactory, raw: bytes, suffix: str) -> None:
    path = tmp_path_factory.getbasetemp() / f"junk{suffix}"
    path.write_bytes(raw)
    frames, told = read(path)
    assert frames == 0
    assert "\n" not in told


@given(st.integers(0, 4000), st.integers(0, 255))
def test_a_log_with_a_changed_byte_gives_frames_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, at: int, value: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "changed.blf"
    with can.Logger(path) as writer:
        for i in range(40):
            writer.on_message_received(can.Message(i, arbitration_id=40, data=[i] * 8, is_extended_id=False))
    raw = bytearray(path.read_bytes())
    raw[at % len(raw)] = value
    path.write_bytes(raw)
    frames, told = read(path)
    assert frames <= 40
    assert not told or f"damaged after {frames} frames" in told


@pytest.mark.parametrize(
    ("name", "told"), [("none.blf", "no such file"), ("trend.csv", "not a format"), ("folder.blf", "no such file")]
)
def test_what_is_no_log_is_refused(tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "trend.csv").write_text("t,pv\n")
    (tmp_path / "folder.blf").mkdir()
    with pytest.raises(RecordingError, match=told):
        next(read_frames(tmp_path / name))


def test_no_error_of_the_readers_is_everything() -> None:
    assert Exception not in READING_ERRORS
