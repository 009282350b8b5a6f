"""Every example runs and says what it promises."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import made_fmu
import pytest

from retuner.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"
OF_OTHERS = {"aircraft": "jsbsim", "motor": "gym_electric_motor"}
"""Examples that need a package of others, which no extra installs."""


@pytest.mark.slow
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
    configurations = sorted(path for path in EXAMPLES.rglob("*.toml") if path.stem not in OF_OTHERS)
    assert configurations
    assert [main(["check", str(path)]) for path in configurations] == [0] * len(configurations)


@pytest.mark.parametrize("name", OF_OTHERS)
def test_an_example_on_a_plant_of_others_is_sound_or_says_which_package_it_needs(name, monkeypatch, capsys):
    monkeypatch.chdir(EXAMPLES.parent)
    status = main(["check", f"examples/{name}.toml"])
    if importlib.util.find_spec(OF_OTHERS[name]):
        assert status == 0
    else:
        assert status == 2
        assert f"examples/plants/{name}.py needs {OF_OTHERS[name]}" in capsys.readouterr().err
