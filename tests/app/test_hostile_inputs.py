"""The hostile inputs of benchmarks/hostile, a few hundred of each; the full counts are a nightly command."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from effort import sized

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
        ("dbc", 150, 300),
        ("config", 600, 5),
        ("gains", 1000, 1),
        ("csv", 1000, 1),
        ("export", 800, 9),
        ("ledger", 600, 61),
    ],
)
def test_a_hostile_file_ends_in_one_line_or_is_harmless(kind: str, count: int, cut_every: int) -> None:
    count = sized(count // 3, count)
    result = judged(kind, "--count", count, "--cut-every", cut_every)
    assert result["wrong"] == []
    assert sum(result["mutants"].values()) == count
    assert result["mutants"]["refused"] > count / 2
    assert result["cuts"]["refused"] > 5


def test_hostile_files_end_a_command_in_status_2_and_one_line_and_a_broken_ledger_in_1() -> None:
    count = sized(3000, 12_000)
    result = judged("commands", "--count", count)
    assert result["wrong"] == []
    for kind, statuses in result["statuses"].items():
        assert statuses["2"] > count / 600, kind
    assert result["statuses"]["ledger"]["1"] >= 1


def test_hostile_frames_stop_neither_end_and_change_no_gains() -> None:
    count = sized(15_000, 60_000)
    result = judged("frames", "--count", count)
    assert result["wrong"] == []
    assert min(result["frames"].values()) > count / 6


def test_hostile_datagrams_are_dropped_and_counted() -> None:
    result = judged("datagrams", "--count", 4000)
    assert result["wrong"] == []
    assert result["datagrams"]["dropped"] > 1500
