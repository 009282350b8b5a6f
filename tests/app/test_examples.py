"""Every example runs and says what it promises."""

import subprocess
import sys
from pathlib import Path

import made_fmu
import pytest

from retuner.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_one_sample_at_a_time_cures_the_loop() -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-W", "error", EXAMPLES / "one_sample_at_a_time.py"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "sluggish" in done.stdout
    gains = done.stdout.split("kp ")[-1]
    assert 40 < float(gains.split(",")[0]) < 55  # SIMC for 0.1 e^-5s / (50 s + 1), sampled every second: 45


def test_every_example_configuration_is_sound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES.parent)  # as the pages call them
    made_fmu.heater(EXAMPLES.parent / "runs")  # as examples/heater.toml has it
    configurations = sorted(EXAMPLES.rglob("*.toml"))
    assert configurations
    assert [main(["check", str(path)]) for path in configurations] == [0] * len(configurations)
