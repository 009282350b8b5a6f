"""A short soak; the 24 hours of 32 loops are a nightly command."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SOAK = Path(__file__).resolve().parents[2] / "benchmarks" / "soak.py"


@pytest.mark.slow
@pytest.mark.uncounted
def test_two_loops_run_for_hours_without_new_handles_or_threads_or_loss() -> None:
    command = [sys.executable, "-P", str(SOAK), "--hours", "6", "--loops", "2", "--slope-max", "2000"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout, done.stderr
    result = json.loads(done.stdout)
    assert result["wrong"] == []
    assert result["samples"] == 2 * 6 * 1800
    assert result["ledger rows"]["decision"] >= 6
