"""examples/own_loop.py: a loop of one's own with a person beside it, over restarts, and over a death at any moment."""

import asyncio
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import made_fmu
import pytest

from retuner import BackgroundRetuner, GainTable, PidGains, Regions, Retuner
from retuner.cli import main
from retuner.decisions.decider import DecideHere

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_loop.py"
PERSONS = PidGains(kp=0.7, ki=0.25)


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("own_loop", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def here(retuner: Retuner) -> BackgroundRetuner:
    """Decisions five samples after the question, whatever the machine does."""
    return BackgroundRetuner(retuner, decider=DecideHere(5))


@pytest.mark.slow
def test_it_retunes_respects_the_person_goes_on_and_takes_back(example, tmp_path, capsys):
    memory, rig = tmp_path / "rig.json", example.Rig(example.COMMISSIONED.gains_of(0), float("inf"))
    asyncio.run(example.session(rig, memory, 95.0, None, here))
    assert 1.0 < rig.gains.kp < 1.6  # SIMC for 2 e^-0.55s / (3 s + 1): 1.36
    rig.write(PERSONS)
    asyncio.run(example.session(rig, memory, 230.0, {205.0: "approve", 208.0: "undo"}, here))
    assert rig.gains == PERSONS
    told = capsys.readouterr().out
    order = [
        "written: Kc 0.6",
        "an operator replaced",
        "| proposed: Kc 0.7",
        "approved by an operator",
        "rolled back to",
    ]
    assert [told.find(one) for one in order] == sorted(told.find(one) for one in order)
    assert min(told.find(one) for one in order) > 0


@pytest.mark.slow
def test_gains_for_a_region_where_the_loop_is_not_are_not_written(example, tmp_path, capsys, monkeypatch):
    """High has a tenth of the right gain; low and mid, where the loop is, tell what high needs."""
    steps = (30.0, 40.0, 30.0, 40.0, 50.0, 60.0)
    setpoint = property(lambda rig: steps[min(int(rig.t_s // 30.0), 5)])
    monkeypatch.setattr(example.Rig, "_setpoint", setpoint)
    good = PidGains(kp=1.2, ki=0.38)
    regions = Regions("sp", "%", ("low", "mid", "high"), 0.0, (45.0, 65.0), 100.0)
    table = GainTable("rig", regions, (good, good, PidGains(0.1, 0.02)))
    monkeypatch.setattr(example, "COMMISSIONED", table)
    rig = example.Rig(good, float("inf"))
    asyncio.run(example.session(rig, tmp_path / "rig.json", 145.0, None, here))
    assert "in the table, to be written when the loop enters the region" in capsys.readouterr().out
    assert rig.gains.kp > 1.0  # of low or mid; high's new ones have 0.2


@pytest.mark.slow
@pytest.mark.parametrize("written", [False, True])
def test_a_process_that_dies_in_a_write_leaves_gains_that_the_next_one_knows(example, tmp_path, capsys, *, written):
    memory, rig = tmp_path / "rig.json", example.Rig(example.COMMISSIONED.gains_of(0), float("inf"))
    write, at_death = rig.write, tmp_path / "at_death.json"

    def dies(gains: PidGains) -> NoReturn:
        shutil.copy(memory, at_death)
        if written:
            write(gains)
        rig.write = write
        raise ConnectionError("the process is gone")

    rig.write = dies
    with pytest.raises(ConnectionError):
        asyncio.run(example.session(rig, memory, 95.0, None, here))
    at_death.replace(memory)
    asyncio.run(example.session(rig, memory, 160.0, None, here))
    assert "an operator" not in capsys.readouterr().out
    assert 1.0 < rig.gains.kp < 1.6


@pytest.mark.nightly
def test_it_runs_as_printed() -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-W", "error", EXAMPLE, "--speed", "200"], capture_output=True, text=True, check=True
    )
    assert done.stdout.count("nobody watches") == 2
    assert "an operator replaced" in done.stdout


# Every example runs and says what it promises.


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
