"""retuner init by questions and of a record: what it writes is a configuration that check takes."""

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import refused
from pi_loop import Lag, pi_loop, written

from retuner import PidGains, load_config
from retuner.adaptive.signals.sample import Window
from retuner.cli import main
from retuner.config.plants import IdentifiedPlantConfig
from retuner.schedule.late_dataclass import replace


def answered(monkeypatch: pytest.MonkeyPatch, file: Path, *answers: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{one}\n" for one in answers)))
    assert main(["init", str(file), "--ask"]) == 0


def record(path: Path, *, co: float = 1.0) -> Path:
    """The same as a file. co : scale of its column."""
    found = loop_record()
    return written(path, replace(found, co=co * found.co))


def loop_record() -> Window:
    """A loop with Kc 3 and tau_I 20 s on a lag of 20 s."""
    sp, noise = np.where(np.arange(300) >= 100, 53.0, 50.0), 0.05 * np.random.default_rng(3).normal(size=300)
    return pi_loop(PidGains(3.0, 0.15), Lag(20.0, 3, at=50.0), sp, noise, co0=50.0)


def test_the_answers_make_the_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a.toml"
    answered(
        monkeypatch, file, "retuner", "vcan0-of-python", "bus", "7", 'the "big" oven', "K", "20", "10", "300", "0.5",
        "0", "-2.5", "40", "0",
    )  # fmt: skip
    config = load_config(file)
    assert (config.loop.name, config.loop.pv_unit, config.loop.sample_time_s) == ('the "big" oven', "K", 0.5)
    assert (config.loop.pv_min, config.loop.pv_max) == (20.0, 300.0)  # 10 is no high end, 0 no gain: asked again
    assert (config.bus.node, config.bus.channel, config.device, config.scenario) == (7, "bus", None, None)
    assert config.gain_table().gains_of("all").kp == pytest.approx(-2.5)


def test_a_profile_gets_its_place_on_the_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for profile in ("cia404", "odrive"):
        file = tmp_path / f"{profile}.toml"
        answered(monkeypatch, file, profile, "socketcan", "can3", "9")
        config = load_config(file)
        assert (config.node, config.bus.interface, config.bus.channel) == (9, "socketcan", "can3")


def test_the_loop_of_a_record_runs_on_its_own_process(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    assert main(["init", str(file), "--from", str(record(tmp_path / "r.csv"))]) == 0
    config = load_config(file)
    assert isinstance(config.device.plant, IdentifiedPlantConfig)
    assert config.scenario is not None
    assert [step.sp for step in config.scenario.steps] == [50.0, 53.0]
    assert config.gain_table().gains_of("all").kp == pytest.approx(3.0, rel=0.05)
    assert config.loop.pv_min < 50.0
    assert config.loop.pv_max > 53.5


def test_what_a_record_does_not_tell_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "a.toml")
    assert "a configuration has percent" in refused("init", file, "--from", str(record(tmp_path / "raw.csv", co=100.0)))
    share = str(record(tmp_path / "share.csv", co=0.01))
    assert "a configuration has percent" in refused("init", file, "--from", share)
    for command in ("identify", "diagnose"):
        assert main([command, share, "--kc", "3", "--tau-i", "20"]) == 2
        assert "this gain is for co in percent" in (told := capsys.readouterr().err)
        assert "give --scale co=0..1:0..100" in told
    still = tmp_path / "still.csv"
    still.write_text("t,sp,pv,co\n" + "\n".join(f"{i},1,1.{i % 2},50" for i in range(60)), encoding="utf-8")
    assert "does not show the active gains; give --kc" in refused("init", file, "--force", "--from", still)


def test_columns_that_are_not_known_are_to_be_renamed_for_init_has_no_option_that_names_them(tmp_path: Path) -> None:
    own = written(tmp_path / "own.csv", loop_record(), ("Time", "SP1", "T1", "Q1"))
    told = refused("init", tmp_path / "own.toml", "--from", own)
    assert '"pv"; there is Time, SP1, T1, Q1; rename it in the record' in told
    assert "--columns" not in told
