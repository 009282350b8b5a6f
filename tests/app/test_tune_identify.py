"""retuner tune and identify: the numbers, the JSON contract, the exit statuses, the one line on bad input."""

import subprocess
import sys
from functools import partial
from pathlib import Path

import command_line
import numpy as np
import pytest
from command_line import printed, refused
from pi_loop import Lag, pi_loop, written

import retuner
from retuner import PidController, PidGains, ProcessModel, ProcessType, identify, tune
from retuner.cli import main

answer = partial(command_line.answer, silent=True)

HEATER = Path(__file__).parents[1] / "data" / "heater" / "open_loop_step.csv"
Capture = pytest.CaptureFixture[str]


def test_tune_has_null_for_no_integral_time_and_for_infinite_margins() -> None:
    delay = answer("tune", "--type", "delay", "--k", "2", "--theta", "3")
    assert delay["gains"] == {"kc": 0.0, "tau_i": None, "tau_d": 0.0}
    assert delay["parallel"] == pytest.approx({"kp": 0.0, "ki": 1 / 12, "kd": 0.0})
    assert answer("tune", "--type", "fopdt", "--k", "1", "--tau1", "5", "--tau-c", "1")["margins"]["gm"] is None


def test_tune_reads_well(capsys: Capture) -> None:
    assert (
        main(
            ["tune", "--type", "sopdt", "--k", "1", "--tau1", "2", "--tau2", "1.2", "--theta", "0.77", "--kind", "pid"]
        )
        == 0
    )
    shown = capsys.readouterr().out
    assert "Kc 1.299" in shown
    assert "tau_D 1.2 s" in shown
    assert "Ms 1.5" in shown


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_form_that_there_is_not_is_refused_also_where_no_gains_are_given(command: str) -> None:
    assert "--form cubic: give one of series" in refused(command, str(HEATER), "--open-loop", "--form", "cubic")


def test_identify_the_real_heater() -> None:
    found = answer("identify", str(HEATER), "--open-loop")
    assert found["identifiable"] is True
    model = found["model"]
    assert model["type"] == "sopdt"  # heater and sensor; the reference fit is first order: 0.361, 138 s, 14.2 s
    assert model["k"] == pytest.approx(0.361, rel=0.02)
    assert model["tau1"] + model["tau2"] / 2 == pytest.approx(138, rel=0.03)
    assert 8 < model["theta"] + model["tau2"] / 2 < 15
    assert 5 < found["std"]["tau1"] < 12  # five percent of it beside the noise
    assert found["margins"]["ms"] < 1.7
    assert found["reason"]


def write(path: Path, **columns: np.ndarray) -> Path:
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="")
    return path


def closed_loop(path: Path, noise: float = 0.01, names: tuple[str, ...] = ("t", "sp", "pv", "co")) -> Path:
    """PI with Kc 2, tau_I 20 s on a lag of 20 s with gain 1, sampled every second, one setpoint step."""
    sp, white = (np.arange(300) >= 60) * 1.0, np.random.default_rng(1).standard_normal(300)
    return written(path, pi_loop(PidGains(2.0, 0.1), Lag(20.0, 3), sp, noise * white), names)


def test_identify_in_closed_loop_with_renamed_columns_and_gains_in_force(tmp_path: Path) -> None:
    path = closed_loop(tmp_path / "loop.csv", names=("time", "target", "level", "valve"))
    found = answer(
        "identify", str(path), "--columns", "t=time,sp=target,pv=level,co=valve", "--kc", "2", "--tau-i", "20"
    )
    assert found["model"]["k"] == pytest.approx(1.0, rel=0.05)
    assert found["model"]["theta"] == pytest.approx(3.0, rel=0.1)
    assert found["margins_in_force"]["stable"] is True
    assert "recommended settings" in printed("identify", path, "--columns", "t=time,sp=target,pv=level,co=valve")


def test_identify_says_no_with_status_1(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    quiet = write(
        tmp_path / "q.csv",
        t=np.arange(200.0),
        sp=np.zeros(200),
        pv=rng.standard_normal(200),
        co=rng.standard_normal(200),
    )
    found = answer("identify", str(quiet), status=1)
    assert found["identifiable"] is False
    assert found["gains"] is None
    assert found["reason"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,sp,pv\n1,2,3\n", "co"),
        ("t,sp,pv,co\n1,2,3,4\n2,2,x,4\n3,2,3,5\n", ":3"),
        ("t,sp,pv,co\n1,2,3,4\n2,2,nan,4\n3,2,3,5\n", "at least 3 samples"),
        ("t,sp,pv,co\n1,2,3,4\n1,2,3,4\n3,2,3,5\n", "at least 3 samples"),
        ("t,sp,pv,co\n1,2,3,4\n2,2,3,5\n3,2,3,6\n", "pv"),
        ("", ""),
    ],
    ids=["missing column", "text", "nan", "time stands", "constant", "empty"],
)
def test_identify_refuses_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert message in refused("identify", str(path))


@pytest.mark.parametrize(
    "options", [["--columns", "pv"], ["--columns", "pv=a,pv=b"], ["--tau-i", "5"], ["--kc", "0", "--tau-i", "5"]]
)
def test_identify_refuses_wrong_options(tmp_path: Path, options: list[str]) -> None:
    path = closed_loop(tmp_path / "loop.csv")
    assert options[0] in refused("identify", str(path), *options)


def test_the_python_interface() -> None:
    data = np.genfromtxt(HEATER, delimiter=",", names=True)
    found = identify(data["t"], np.zeros(len(data)), data["pv"], data["co"], open_loop=True)
    assert found.to_dict()["identifiable"] is True
    result = tune(ProcessModel(ProcessType.FOPDT, 2.0, 10.0, 0.0, 1.0), kind="pi")
    assert result.tuning.gains == PidGains(2.5, 2.5 / 8)
    assert set(retuner.__all__) <= set(dir(retuner))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = retuner.nonsense
    with pytest.raises(ValueError, match="kind 'pd'"):
        tune(ProcessModel(ProcessType.FOPDT, 2.0, 10.0, 0.0, 1.0), kind="pd")


def test_settings_for_a_loop_with_derivative_action_have_one_too() -> None:
    gains, noise = PidGains.from_series(2.0, 60.0, 30.0), np.random.default_rng(4).normal(0.0, 0.02, 1200)
    pid, late = PidController(gains, dt_s=1.0, pv_range=(0, 100), mode="off", tau_f_s=3.0), [0.0] * 6
    first = second = 0.0
    rows = []
    for t, more in enumerate(noise):  # lags of 60 and 30 s, gain 1, dead time 6 s
        sp, pv = (50.0 if t % 600 < 50 else 55.0), 50.0 + second + float(more)
        late.append(pid.step(sp, pv) - 50.0)
        rows.append((float(t), sp, pv, late[-1] + 50.0))
        first += (late.pop(0) - first) / 60.0
        second += (first - second) / 30.0
    record = np.array(rows).T
    found, plain = (identify(*record, gains=given).settings for given in (gains, PidGains(gains.kp, gains.ki)))
    assert (found.kind, plain.kind) == ("pid", "pi")
    assert found.to_dict()["gains"]["tau_d"] == pytest.approx(30.0, rel=0.2)  # type: ignore[index]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "reaches no other process"),
        (["-i", "nosuchbus"], "nosuchbus"),
        (["--speed", "-1"], "--speed"),
        (["--duration", "0"], "--duration"),
    ],
)
def test_device_refuses_in_one_line(options: list[str], message: str) -> None:
    oven = Path(__file__).parents[2] / "examples" / "oven.toml"
    assert message in refused("device", str(oven), *options)


def test_python_dash_m_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-m", "retuner", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("retuner ")


@pytest.mark.slow
def test_gains_are_given_and_shown_in_the_controllers_units(tmp_path: Path) -> None:
    path = str(closed_loop(tmp_path / "loop.csv"))
    plain = answer("identify", path, "--kc", "2", "--tau-i", "20")
    trade = ["--controller", "pb-rpm", "--pv-span", "10"]
    same = answer("identify", path, "--kc", "500", "--tau-i", "3", *trade)  # 100 / 500 % of 10 is 2 %/unit
    assert same["margins_in_force"]["ms"] == pytest.approx(plain["margins_in_force"]["ms"])
    assert "active       PB 500 % reset 3 repeats/min" in printed(
        "diagnose", path, "--kc", "500", "--tau-i", "3", *trade, "--action", "reverse"
    )
    assert "  dialled   PB " in printed("identify", path, *trade)
    assert "dialled" not in printed("identify", path)
    tuned = answer(*TUNE, "--controller", "gain-min", "--pv-span", "200")
    dialled, gains = tuned["dialled"], tuned["gains"]
    assert dialled["gain"] == pytest.approx(2 * gains["kc"])
    assert dialled["tau_i_min"] == pytest.approx(gains["tau_i"] / 60)


TUNE = ("tune", "--type", "fopdt", "--k", "0.361", "--tau1", "138", "--theta", "14.2")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--controller", "px-s"], "use kc-s"),
        (["--controller", "pb-rpm"], "give --pv-span"),
        (["--controller", "pb-rpm", "--pv-span", "0"], "pv_span"),
        (["--controller", "pb-rpm", "--pv-span", "nan"], "pv_span"),
        (["--controller", "kc-s", "--action", "heating"], "reverse or direct"),
        (["--action", "direct"], "--action needs --controller"),
    ],
)
def test_wrong_units_are_refused_in_one_line(options: list[str], said: str) -> None:
    assert said in refused(*TUNE, *options)


def test_a_dial_in_percent_is_not_told_of_an_output_that_is_none(tmp_path: Path) -> None:
    path, trade = str(closed_loop(tmp_path / "loop.csv")), ["--controller", "pb-rpm", "--pv-span", "9"]
    assert "--scale co=0..1:0..100" in refused("diagnose", path, *trade, "--co-min", "0", "--co-max", "1")


def test_gains_that_act_against_the_record_are_refused(tmp_path: Path) -> None:
    path = str(closed_loop(tmp_path / "loop.csv"))
    for command in ("identify", "diagnose"):
        said = refused(command, path, "--kc", "-2", "--tau-i", "20")
        assert "these gains are direct acting; " in said
        assert "shows a reverse-acting controller" in said
