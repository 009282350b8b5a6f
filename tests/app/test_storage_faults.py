"""The storage faults of benchmarks/storage, a small share of each; the full counts are a nightly command."""

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from effort import sized
from two_regions import two_regions

from retuner.cli import main
from retuner.files import write_whole

ROOT = Path(__file__).resolve().parents[2]
FAULTS = ROOT / "benchmarks" / "storage" / "faults.py"
POWER = ROOT / "benchmarks" / "storage" / "power.py"
RUNNER = ROOT / "scripts" / "socketcan" / "run.py"
IMPOSSIBLE = 77  # status of a command whose tools are not installed
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forked children")


def part(*command: object) -> dict:
    """Run one part; its result, or skip where a tool is missing."""
    done = subprocess.run([sys.executable, "-P", *map(str, command)], capture_output=True, text=True, check=False)
    if done.returncode == IMPOSSIBLE:
        reason = done.stderr.strip().splitlines()[-1]
        if os.environ.get("RETUNER_REQUIRE_SOCKETCAN"):
            pytest.fail(reason)
        pytest.skip(reason)
    assert done.stdout, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.uncounted
def test_killed_or_refused_at_durable_system_calls_nothing_acknowledged_is_lost() -> None:
    result = part(FAULTS, "sweep", "--every", sized(37, 37, 23))
    assert result["wrong"] == []
    assert sum(result["durable calls"].values()) > 50
    assert min(result["points"].values()) >= 2, result["points"]


@pytest.mark.slow
def test_killed_at_random_moments_nothing_acknowledged_is_lost() -> None:
    result = part(FAULTS, "kills", "--count", sized(30, 30, 60))
    assert result["wrong"] == []
    assert result["killed"] > sized(24, 24, 50)
    assert result["rows"] > sized(30, 30, 60)


@pytest.mark.slow
def test_full_read_only_missing_and_shared_places_are_one_line_and_lose_nothing() -> None:
    result = part(FAULTS, "disk")
    assert result["wrong"] == []
    assert "another run writes" in result["tried"]["two writers"]
    assert "does not exist" in result["tried"]["missing folder"]
    assert int(result["tried"]["file size limit"].split()[0]) > 10


@pytest.mark.slow
@pytest.mark.uncounted
def test_power_cuts_lose_nothing_acknowledged() -> None:
    if not shutil.which("dmsetup") or not shutil.which("linux.uml"):
        pytest.skip("apt-get install user-mode-linux dmsetup")
    result = part(RUNNER, "--uml", "--timeout", 120, "--", sys.executable, "-P", POWER, "--cuts", 2)
    assert result["wrong"] == []
    assert result["cuts"] == {"drop": 1, "refuse": 1}
    assert result["rows"] > 25


# ---- The hostile inputs of benchmarks/hostile, a few hundred of each; the full counts are a nightly command

INPUTS = Path(__file__).resolve().parents[2] / "benchmarks" / "hostile" / "inputs.py"


def judged(*arguments: object) -> dict:
    done = subprocess.run(
        [sys.executable, "-P", str(INPUTS), *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.stdout, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("kind", "count", "cut_every"),
    [
        pytest.param("dbc", 150, 300, marks=pytest.mark.slow),
        ("config", 600, 5),
        ("gains", 1000, 1),
        ("csv", 1000, 1),
        ("export", 800, 9),
        ("ledger", 600, 61),
    ],
)
def test_a_hostile_file_ends_in_one_line_or_is_harmless(kind: str, count: int, cut_every: int) -> None:
    count = sized(count // 3, count // 3, count)
    result = judged(kind, "--count", count, "--cut-every", cut_every)
    assert result["wrong"] == []
    assert sum(result["mutants"].values()) == count
    assert result["mutants"]["refused"] > count / 2
    assert result["cuts"]["refused"] > 5


@pytest.mark.slow
def test_hostile_files_end_a_command_in_status_2_and_one_line_and_a_broken_ledger_in_1() -> None:
    count = sized(3_000, 3_000, 12_000)
    result = judged("commands", "--count", count)
    assert result["wrong"] == []
    for kind, statuses in result["statuses"].items():
        assert statuses["2"] > count / 600, kind
    assert result["statuses"]["ledger"]["1"] >= 1


def test_hostile_frames_stop_neither_end_and_change_no_gains() -> None:
    count = sized(15_000, 15_000, 60_000)
    result = judged("frames", "--count", count)
    assert result["wrong"] == []
    assert min(result["frames"].values()) > count / 6


def test_hostile_datagrams_are_dropped_and_counted() -> None:
    result = judged("datagrams", "--count", 4000)
    assert result["wrong"] == []
    assert result["datagrams"]["dropped"] > 1500


# The disk is full when a run writes what it leaves: each file that is missing is named, and all others are there


SHORT = two_regions("auto", 40.0, "at_s = 0.0, sp = 2.0", "at_s = 20.0, sp = 3.0")
LEFT = ("trend.csv", "gains.toml", "report.html", "summary.json")


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """The disk has no room for files of these names any more."""
    put_on_disk = os.fsync

    def full_for(folder: Path, *names: str) -> None:
        def refusing(handle: int) -> None:
            inode = os.fstat(handle).st_ino
            if any(path.stat().st_ino == inode for name in names for path in folder.glob(f".{name}.*")):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            put_on_disk(handle)

        monkeypatch.setattr(os, "fsync", refusing)

    return full_for


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path, full: Callable[..., None]) -> None:
    full(tmp_path, "trend.csv")
    with pytest.raises(OSError, match="No space left on device") as refused:
        write_whole(tmp_path / "trend.csv", "1,2,3")
    assert (refused.value.errno, refused.value.filename) == (errno.ENOSPC, str(tmp_path / "trend.csv"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("missing", [*[(name,) for name in LEFT], LEFT], ids=lambda names: names[0] * (len(names) < 2))
def test_what_is_missing_is_named_and_the_rest_is_written(missing, tmp_path, full, capsys):
    config, out = tmp_path / "loop.toml", tmp_path / "out"
    config.write_text(SHORT)
    full(out, *missing)
    assert main(["run", str(config), "--out", str(out), "--no-compare"]) == 2
    said = capsys.readouterr()
    lines = said.err.splitlines()
    for name in LEFT:
        assert (out / name).exists() is (name not in missing)
        assert (f"{out / name}: No space left on device" in lines) is (name in missing)
    assert "Traceback" not in said.err
    assert f"retuner report {out}" in lines[-1]
    assert "ledger head" in said.out
    assert json.loads((out / "summary.json").read_text())["folder"] if "summary.json" not in missing else True
    assert main(["ledger", "verify", str(out)]) == 0
