"""The storage faults of benchmarks/storage, a small share of each; the full counts are a nightly command."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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
def test_killed_or_refused_at_durable_system_calls_nothing_acknowledged_is_lost() -> None:
    result = part(FAULTS, "sweep", "--every", 23)
    assert result["wrong"] == []
    assert sum(result["durable calls"].values()) > 50
    assert min(result["points"].values()) >= 4, result["points"]


def test_killed_at_random_moments_nothing_acknowledged_is_lost() -> None:
    result = part(FAULTS, "kills", "--count", 60)
    assert result["wrong"] == []
    assert result["killed"] > 50
    assert result["rows"] > 60


def test_full_read_only_missing_and_shared_places_are_one_line_and_lose_nothing() -> None:
    result = part(FAULTS, "disk")
    assert result["wrong"] == []
    assert "another run writes" in result["tried"]["two writers"]
    assert "does not exist" in result["tried"]["missing folder"]
    assert int(result["tried"]["file size limit"].split()[0]) > 10


@pytest.mark.slow
def test_power_cuts_lose_nothing_acknowledged() -> None:
    if not shutil.which("dmsetup") or not shutil.which("linux.uml"):
        pytest.skip("apt-get install user-mode-linux dmsetup")
    result = part(RUNNER, "--uml", "--timeout", 120, "--", sys.executable, "-P", POWER, "--cuts", 4)
    assert result["wrong"] == []
    assert result["cuts"] == {"drop": 2, "refuse": 2}
    assert result["rows"] > 50
