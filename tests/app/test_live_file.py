"""The live file: what a session writes and another process reads, with nothing between them that could wait."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from retuner.adaptive.signals.sample import LoopSample
from retuner.config.loading import load_config
from retuner.drivers.device import RunningSet
from retuner.live_view import live_file
from retuner.live_view.live_file import FIELDS, RING, LiveFileError, LiveReader, LiveWriter, place, thinned
from retuner.live_view.loop_seen import LoopObserver
from retuner.live_view.watching_session import Publisher, head_of
from retuner.schedule.gains import PidGains
from retuner.session.assembly import make_retuner
from retuner.session.outputs import live_file as live_path

ROOT = Path(__file__).resolve().parents[2]


def row(t_s: float, pv: float = 1.0) -> tuple[float, ...]:
    return (t_s, 1.0, pv, 50.0, 0.0, 0.0, 1.0, 0.1, 0.0)


def test_what_is_written_is_read_while_it_grows(tmp_path: Path) -> None:
    writer = LiveWriter(tmp_path / "live", {"loop": "oven"})
    reader = LiveReader(tmp_path / "live")
    assert reader.head == {"loop": "oven"}
    assert reader.state() == {}
    for i in range(10):
        writer.sample(row(float(i)))
    fresh = reader.since(0)
    assert fresh.table[:, 0].tolist() == list(range(10))
    assert (fresh.following, fresh.missed) == (10, False)
    writer.sample(row(10.0))
    writer.state({"t_s": 10.0})
    assert reader.since(fresh.following).table[:, 0].tolist() == [10.0]
    assert reader.state() == {"t_s": 10.0}
    assert reader.since(99).missed  # another session began in its place


def test_who_sleeps_too_long_is_told_that_samples_are_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_file, "RING", 100)
    writer, samples = LiveWriter(tmp_path / "live", {}), 1000
    reader = LiveReader(tmp_path / "live")
    for i in range(samples):
        writer.sample(row(float(i), float(i % 10)))
    fresh = reader.since(5)
    assert fresh.missed
    assert fresh.table[-1, 0] == samples - 1
    assert 90 <= len(fresh.table) <= 100


def test_coarser_rings_reach_further_back_and_keep_what_stands_out(tmp_path, monkeypatch):
    monkeypatch.setattr(live_file, "RING", 100)
    writer, reader = LiveWriter(tmp_path / "live", {}), None
    for i in range(3000):
        writer.sample(row(float(i), 99.0 if i == 700 else 1.0))
    reader = LiveReader(tmp_path / "live")
    whole = reader.span(0.0, 3000.0, 60)
    assert len(whole) <= 60
    assert whole[0, 0] <= 64
    assert 99.0 in whole[:, 2]
    near = reader.span(2950.0, 3000.0, 200)
    assert near[:, 0].tolist() == list(range(2950, 3000))
    assert len(reader.span(5000.0, 6000.0, 10)) == 0


def test_the_thinned_rows_are_in_order_with_the_extremes_and_the_newest() -> None:
    table = np.zeros((1000, len(FIELDS)))
    table[:, 0] = np.arange(1000)
    table[123, 2], table[777, 2] = 5.0, -5.0
    kept = thinned(table, 50)
    assert len(kept) <= 50
    assert {123.0, 777.0, 999.0} <= set(kept[:, 0])
    assert (np.diff(kept[:, 0]) > 0).all()
    assert thinned(table[:7], 50) is not None


def test_a_torn_document_is_not_taken(tmp_path: Path) -> None:
    writer = LiveWriter(tmp_path / "live", {})
    writer.state({"a": 1})
    raw = bytearray((tmp_path / "live").read_bytes())
    raw[live_file.STATE + 10] ^= 1
    (tmp_path / "live").write_bytes(bytes(raw))
    assert LiveReader(tmp_path / "live").state() == {}
    writer.state({"too large": "x" * live_file.SLOT})
    assert writer.trouble == ""


@pytest.mark.parametrize("content", [b"", b"something else", live_file.MAGIC])
def test_another_file_is_refused_in_a_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "live").write_bytes(content)
    with pytest.raises(LiveFileError, match="is no live file"):
        LiveReader(tmp_path / "live")
    with pytest.raises(LiveFileError, match="No such file"):
        LiveReader(tmp_path / "none")


def test_a_sample_is_found_where_it_was_put() -> None:
    assert place(0, 0) == live_file.SAMPLES
    assert place(1, 0) - place(0, RING - 1) == live_file.SAMPLE.size
    assert place(2, RING + 3) == place(2, 3)


def test_a_full_disk_ends_the_watching_and_not_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config(ROOT / "examples" / "oven.toml")
    retuner, told = make_retuner(config), []

    class Controller:
        running = RunningSet(1, PidGains(1.0, 0.1, 0.0), 0)

    observer = LoopObserver(retuner, Controller())
    publisher = Publisher(tmp_path, head_of(config, retuner.table), observer, told.append)
    samples = [LoopSample(t_s=2.0 * i, sp=50.0, pv=49.0, co=30.0, x=50.0) for i in range(6)]
    for sample in samples[:3]:
        retuner.observe(sample)
        publisher.sample(sample)
    reader = LiveReader(live_path(tmp_path, 1))
    assert reader.head["regions"] == ["low", "middle", "high"]
    assert reader.since(0).table[:, 2].tolist() == [49.0] * 3
    assert reader.state()["regions"][0]["settings"] == "Kc 0.22 tau_I 260 s"

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    for sample in samples[3:]:
        publisher.sample(sample)
    assert len(told) == 1
    assert "No space left on device; the session continues" in told[0]
