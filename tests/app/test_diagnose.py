"""retuner diagnose and identify on records: the JSON contract, the words, the pictures, what a record lacks."""

import json
import re
import runpy
from dataclasses import replace
from functools import partial
from pathlib import Path

import command_line
import numpy as np
import pytest
from command_line import printed, refused
from pi_loop import Lag, pi_loop, written

from retuner import PidGains, ProcessModel, ProcessType, diagnosing, tune
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.enough_data import shortcomings
from retuner.adaptive.explanations.proposed_test import DecidingTest, TestKind
from retuner.adaptive.indexes.screening import screen
from retuner.adaptive.signals.sample import Window
from retuner.cli import main
from retuner.commands.experiment import proposed
from retuner.commands.options import RecordOptions
from retuner.commands.recorded.diagnose import command_for
from retuner.commands.recorded.recorded_loop import controller, read_loop, renamed
from retuner.decision_page.evidence_words import GROUPS, WORDS, evidence_lines, value_text
from retuner.errors import UserError

answer = partial(command_line.answer, silent=True)

SERVO = Path(__file__).parents[1] / "data" / "servo" / "pid_step.csv"
PLANT = Path(__file__).parents[1] / "data" / "plant"
HEATER = Path(__file__).parents[1] / "data" / "heater" / "open_loop_step.csv"
PNG = b"\x89PNG\r\n\x1a\n"
Capture = pytest.CaptureFixture[str]
KEYS = {
    "assumed",
    "by_eye",
    "aim",
    "aimed",
    "rival",
    "cause",
    "confidence",
    "retune",
    "evidence",
    "gains",
    "form",
    "margins",
    "reason",
    "foreseen",
    "gains_in_force",
    "before",
    "model",
    "std",
    "identifiable",
    "notes",
    "next",
    "performance",
    "records",
}


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """A double of the diagnosis that notes what it was asked; aggressive when it is told the gains, else unknown."""
    calls: list[dict] = []

    def double(windows, *, gains=None, co_min=None, co_max=None):
        calls.append({"windows": windows, "gains": gains, "co_min": co_min, "co_max": co_max})
        if gains is None:
            nothing = Diagnosis(Cause.UNKNOWN, 0.0, {}, "the active settings are not known")
            return diagnosing.RecordDiagnosis(nothing, None, None, {})
        told = Diagnosis(Cause.AGGRESSIVE, 0.97, {"ms": 3.1, "gm": float("inf")}, "Ms 3.10 is over 1.8")
        cure = tune(ProcessModel(ProcessType.FOPDT, 1.0, 20.0, 0.0, 3.0))
        return diagnosing.RecordDiagnosis(told, None, cure, {"linear": windows[0].pv[::2]}, active=gains)

    monkeypatch.setattr(diagnosing, "diagnose_windows", double)
    return calls


def loop(path: Path, n: int = 400, noise: float = 0.02, kc: float = 2.0, **spoilt: np.ndarray) -> Path:
    """PI with Kc 2, tau_I 20 s on a lag of 20 s, gain 1, dead time 3 s, sampled every second, setpoint steps."""
    sp, white = 10.0 + 2.0 * (np.arange(n) // 100 % 2), np.random.default_rng(1).normal(size=n)
    found = pi_loop(PidGains(kc, kc / 20), Lag(20.0, 3, at=10.0), sp, noise * white, co0=10.0)
    return written(path, replace(found, **spoilt))


@pytest.mark.parametrize(("kc", "cause"), [(7.0, "aggressive"), (0.5, "sluggish"), (3.0, "ok")])
def test_the_whole_way_from_a_file_to_a_cause(tmp_path, kc, cause):
    """No double: settings read off the record, rivals fitted, margins judged."""
    found = answer("diagnose", str(loop(tmp_path / "a.csv", kc=kc)), "--co-min", "-50", "--co-max", "100")
    assert found["cause"] == cause
    assert found["retune"] == (cause != "ok")
    assert found["gains_in_force"]["forms"]["series"]["kc"] == pytest.approx(kc, rel=0.05)
    assert found["model"]["theta"] + found["model"]["tau2"] == pytest.approx(3.0, abs=0.8)
    if found["retune"]:
        assert 2.0 < found["gains"]["kc"] < 4.5
        assert found["margins"]["ms"] < 1.8
        assert found["foreseen"]["given"] is True
        assert found["foreseen"]["least"] <= found["foreseen"]["saved"] <= found["foreseen"]["most"]
    else:
        assert found["gains"] is None


def test_json_has_its_keys_and_gains_only_where_a_retune_is_right(tmp_path, asked):
    path = str(loop(tmp_path / "a.csv"))
    found = answer("diagnose", path, "--kc", "2", "--tau-i", "20", "--co-min", "0", "--co-max", "100")
    assert set(found) == KEYS
    assert (found["cause"], found["confidence"], found["retune"]) == ("aggressive", 0.97, True)
    assert found["gains"]["tau_i"] == pytest.approx(20.0)
    assert found["form"] == "series"
    assert found["margins"]["ms"] < 1.7
    assert found["foreseen"] is None  # the double knows no process
    assert found["evidence"]["ms"] == 3.1
    assert found["evidence"]["gm"] is None  # infinite
    assert found["evidence"]["setpoint_steps"] == 3
    assert found["gains_in_force"] == {"source": "given", "parallel": {"kp": 2.0, "ki": 0.1, "kd": 0.0}}
    assert (asked[0]["co_min"], asked[0]["co_max"]) == (0.0, 100.0)


def test_settings_in_force_are_read_off_the_record_when_they_are_not_given(tmp_path):
    found = answer("diagnose", str(loop(tmp_path / "a.csv")))
    assert found["gains_in_force"]["source"] == "record"
    assert found["gains_in_force"]["parallel"]["kp"] == pytest.approx(2.0, abs=0.06)
    assert found["gains_in_force"]["parallel"]["ki"] == pytest.approx(0.1, rel=1e-3)
    assert found["gains_in_force"]["forms"]["ideal"]["tau_i"] == pytest.approx(20, rel=0.05)
    assert found["gains_in_force"]["explained"] > 0.999


def test_unknown_is_status_1_with_its_json_and_no_gains(tmp_path, asked):
    noise = np.random.default_rng(3).normal(size=400)
    found = answer("diagnose", str(loop(tmp_path / "a.csv", co=noise)), status=1)
    assert asked[0]["gains"] is None
    assert (found["cause"], found["retune"], found["gains"], found["margins"]) == ("unknown", False, None, None)
    assert "explain" in found["gains_in_force"]["reason"]


@pytest.mark.usefixtures("asked")
def test_a_dead_signal_is_named(tmp_path):
    found = answer("diagnose", str(loop(tmp_path / "a.csv", pv=np.full(400, 3.5e-44))), status=1)
    assert any("dead signal" in note for note in found["notes"])
    assert found["gains"] is None


def test_open_loop_records_have_no_controller(asked):
    found = answer("diagnose", str(HEATER), "--open-loop", status=1)
    assert found["gains_in_force"] is None
    assert asked[0]["gains"] is None
    assert "exclude" in refused("diagnose", str(HEATER), "--open-loop", "--kc", "1")


@pytest.mark.usefixtures("asked")
def test_it_reads_well_in_eight_lines(tmp_path):
    path, picture = str(loop(tmp_path / "a.csv")), tmp_path / "a.png"
    shown = printed("diagnose", path, "--kc", "2", "--tau-i", "20", "--plot", picture).splitlines()
    assert len(shown) <= 8
    assert shown[0] == "AGGRESSIVE (97 %): Ms 3.10 is over 1.8"
    assert shown[1] == "  active       Kc 2 tau_I 20 s"
    assert shown[2].startswith("  recommended  Kc ")
    assert any(line.startswith("  the loop     mean error ") and "Harris index" in line for line in shown)
    assert not any("overshoot of setpoint responses" in line for line in shown)
    assert picture.read_bytes().startswith(PNG)
    more = printed("diagnose", path, "--kc", "2", "--tau-i", "20", "--evidence")
    assert more.splitlines()[: len(shown)] == shown
    assert "overshoot of setpoint responses" in more
    assert "parallel  kp" in more


def test_a_change_is_told_by_what_it_does(tmp_path):
    line = next(
        one
        for one in printed(
            "diagnose", str(loop(tmp_path / "a.csv", kc=7.0)), "--co-min", "-50", "--co-max", "100"
        ).splitlines()
        if one.startswith("  with these")
    )
    found = re.search(r"mean error (\d+) % .*overshoot (\d+) % -> (\d+) %, settles in .* Ms (\S+) -> (\S+)$", line)
    assert found
    error, before, after = (int(found[i]) for i in (1, 2, 3))
    assert error < 90
    assert before > 50
    assert after < 20
    assert float(found[4]) > 2.5
    assert float(found[5]) < 1.8


@pytest.mark.slow
def test_another_aim_than_tight_control_has_settings_of_its_own(tmp_path, capsys):
    path = str(loop(tmp_path / "a.csv", kc=7.0))
    main(["diagnose", path, "--aim", "smooth", "--ymax", "4", "--u0", "2", "--json"])
    found = json.loads(capsys.readouterr().out)["aimed"]
    assert found["rule"] == "simc-smooth"
    assert found["gains"]["kc"] == pytest.approx(0.5, rel=0.01)
    for arguments, told in (
        (("--aim", "loose"), "--aim loose: give one of tight, smooth, averaging"),
        (("--aim", "averaging"), "give --ymax"),
        (("--ymax", "4"), "they go with the other aims"),
        (("--aim", "averaging", "--ymax", "4"), "rule averaging has no settings for type"),
    ):
        assert told in refused("diagnose", path, *arguments)


@pytest.mark.slow
def test_records_of_one_loop_give_one_answer(tmp_path):
    paths = [str(loop(tmp_path / f"{i}.csv", n=n, kc=7.0)) for i, n in enumerate((400, 300))]
    one, both = answer("diagnose", paths[0]), answer("diagnose", *paths)
    assert (one["records"], both["records"]) == (1, 2)
    assert both["cause"] == one["cause"] == "aggressive"
    assert sum(both["causes"].values()) == pytest.approx(1.0)
    assert both["causes"]["aggressive"] >= one["causes"]["aggressive"] - 1e-9


def test_files_of_a_signal_each_are_one_record(tmp_path):
    whole = np.genfromtxt(loop(tmp_path / "a.csv", kc=7.0), delimiter=",", names=True)
    paths = []
    for name in ("sp", "pv", "co"):
        np.savetxt(tmp_path / f"{name}.csv", np.stack([whole["t"], whole[name]], 1), delimiter=",",
                   header=f"t,{name}", comments="")  # fmt: skip
        paths.append(str(tmp_path / f"{name}.csv"))
    found = answer("diagnose", *paths)
    assert (found["records"], found["cause"]) == (1, "aggressive")


def test_records_of_two_loops_are_refused(tmp_path):
    for tag in ("FIC101", "TIC202"):
        whole = np.genfromtxt(loop(tmp_path / "a.csv"), delimiter=",", names=True)
        np.savetxt(tmp_path / f"{tag}.csv", np.stack([whole[n] for n in whole.dtype.names], 1), delimiter=",",
                   header=f"t,{tag}.SP,{tag}.PV,{tag}.OP", comments="")  # fmt: skip
    assert "records of 2 loops" in refused("diagnose", str(tmp_path / "FIC101.csv"), str(tmp_path / "TIC202.csv"))


def test_a_part_of_a_record_is_cut_out(tmp_path):
    path = str(loop(tmp_path / "a.csv"))
    parts = [read_loop(RecordOptions(files=[Path(path)], begin=begin, end=end)).recording.t_s
             for begin, end in (("", ""), ("100", ""), ("100", "250.5"))]  # fmt: skip
    assert [(part[0], part[-1]) for part in parts] == [(0.0, 399.0), (100.0, 399.0), (100.0, 250.0)]
    for wrong, message in (
        (["--from", "tomorrow"], "--from tomorrow: give seconds of the record, or a time as"),
        (["--from", "nan"], "--from nan: give seconds of the record"),
        (["--to", "2026-05-04T08:30"], "has no dates; give seconds of the record"),
        (["--from", "395"], "there are 5 samples; the record runs from 0 s to 399 s"),
    ):
        assert message in refused("diagnose", path, *wrong)


def test_a_record_with_dates_is_cut_by_them(tmp_path):
    path = tmp_path / "dated.csv"
    rows = [f"2026-05-04 08:{i // 60:02d}:{i % 60:02d},10,{10 + i % 3},{20 + i % 5}" for i in range(600)]
    path.write_text("\n".join(["time,sp,pv,co", *rows]), encoding="utf-8")
    read = read_loop(RecordOptions(files=[path], begin="2026-05-04T08:02", end="2026-05-04T08:05:00Z"))
    assert (read.recording.t_s[0], read.recording.t_s[-1]) == (120.0, 300.0)
    said = refused("diagnose", str(path), "--from", "2025-05-04T08:00", "--to", "2025-05-04T09:00")
    assert "0 samples; the record runs from 2026-05-04T08:00:00 to 2026-05-04T08:09:59" in said


@pytest.mark.slow
def test_the_deciding_test_is_told_where_the_odds_are_open():
    found = answer("diagnose", str(PLANT / "FIC46002_1102_1.csv"))
    assert found["confidence"] < 0.9
    assert found["next"]["kind"] in {"setpoint", "valve"}
    assert 0.0 < found["next"]["decides"] <= 1.0
    assert found["next"]["size"] > 0.0 < found["next"]["hold_s"]
    assert 0.0 <= found["performance"]["harris"] <= 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--co-min", "5", "--co-max", "5"], "--co-min 5 is not below --co-max 5"),
        (["--co-min", "nan"], "--co-min nan: give a finite number"),
        (["--co-max", "1"], "--co-max 1: co runs from"),
        (["--tau-i", "20"], "need --kc"),
        (["--kc", "0"], "kc = 0"),
        (["--plot", "a.pdf"], "ends in .png or .svg"),
        (["--columns", "x=1"], "roles are t, date, sp, pv, co"),
        (["--columns", "pv=nothing"], 'no column "nothing"'),
    ],
)
@pytest.mark.usefixtures("asked")
def test_wrong_options_are_refused_by_both_commands(tmp_path, arguments, message):
    path = str(loop(tmp_path / "a.csv"))
    for command in ("diagnose", "identify"):
        assert message in refused(command, path, *arguments)


@pytest.mark.parametrize("command", ["diagnose", "identify"])
def test_records_too_short_for_anything_are_refused(tmp_path, command):
    assert "19 samples are too few for a loop; give at least 20" in refused(
        command, str(loop(tmp_path / "a.csv", n=19))
    )


def test_shared_options_are_read_once_for_both_commands(tmp_path):
    path = loop(tmp_path / "a.csv")
    assert read_loop(RecordOptions(files=[path])).recording.sp is not None
    assert controller(RecordOptions(files=[path])) is None
    assert renamed("pv=temp, co=out") == {"pv": "temp", "co": "out"}
    with pytest.raises(UserError, match="each role once"):
        renamed("pv=a,pv=b")


def test_identify_draws_its_record(tmp_path, capsys):
    picture = tmp_path / "heater.png"
    assert main(["identify", str(HEATER), "--open-loop", "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(PNG)
    assert "recommended settings" in capsys.readouterr().out


def test_identify_takes_the_limits_of_co(tmp_path):
    """co was recorded as the controller wished it; the valve stood at its limit."""
    n = 400
    wish = np.where((np.arange(n) // 80) % 2 == 0, 0.0, 30.0)
    pv, x = np.zeros(n), 0.0
    rng = np.random.default_rng(2)
    for i in range(n):
        pv[i] = x + 0.02 * rng.normal()
        x += (1 - np.exp(-1 / 20)) * (2.0 * min(wish[i - 4] if i >= 4 else 0.0, 10.0) - x)
    path = str(loop(tmp_path / "a.csv", pv=pv, co=wish))
    free = answer("identify", path, "--open-loop")
    limited = answer("identify", path, "--open-loop", "--co-max", "10")
    assert free["model"]["k"] == pytest.approx(2 / 3, rel=0.02)
    assert limited["model"]["k"] == pytest.approx(2.0, rel=0.02)


def test_what_a_record_lacks_is_said_with_what_would_be_needed():
    t = np.arange(60.0)
    wave = np.sin(2 * np.pi * t / 5)
    record = Window(t, np.zeros(60), wave, -wave)
    found = shortcomings(record, screen(record))
    assert any("60 samples are little: 100" in sentence for sentence in found)
    assert any("sample every 0.5 s or faster" in sentence for sentence in found)
    coarse = ProcessModel(ProcessType.FOPDT, 1.0, 2.0, 0.0, 1.0)
    assert (
        "the lag of the process, 2 s, has 2.0 samples: sample every 0.5 s"
        in shortcomings(record, screen(record), coarse)[-1]
    )
    fine = Window(np.arange(1000.0), np.zeros(1000), np.sin(np.arange(1000) / 9), np.cos(np.arange(1000) / 9))
    assert shortcomings(fine, screen(fine), ProcessModel(ProcessType.FOPDT, 1.0, 20.0, 0.0, 5.0)) == ()


def test_the_proposed_test_is_a_command_that_can_be_run(tmp_path: Path) -> None:
    told = DecidingTest(TestKind.SETPOINT, 4.4, 1020.0, 0.84)
    command = command_for(told).split()
    assert command[:4] == ["retuner", "experiment", "setpoint", "CONFIG"]
    file = tmp_path / "found.json"
    file.write_text(json.dumps({"next": told.to_dict()}), encoding="utf-8")
    assert proposed(file) == (float(command[5]), float(command[7]))
    file.write_text(json.dumps({"next": replace(told, kind=TestKind.VALVE).to_dict()}), encoding="utf-8")
    with pytest.raises(UserError, match=r"retuner experiment valve CONFIG --step 4\.4 --hold 1020 --short"):
        proposed(file)
    file.write_text(json.dumps({"next": None}), encoding="utf-8")
    with pytest.raises(UserError, match="no test in it"):
        proposed(file)


def test_words_for_numbers_known_and_unknown():
    lines = "\n".join(
        evidence_lines(
            {
                "period_s": 40.0,
                "regularity": 3.0,
                "ms": 2.5,
                "linear_left": 1.2,
                "some_number": -3.2,
                "offset": 0.2,
                "quantum_pv": 0.0,
            }
        )
    )
    assert "oscillation period" in lines
    assert "40 s" in lines
    assert "1.2 x noise" in lines
    assert "some number" in lines
    assert "mean error" not in lines
    irregular = {"period_s": 40.0, "regularity": 0.4, "jump_share": 0.3}
    assert "period" not in "\n".join(evidence_lines(irregular))
    assert value_text("gm", float("inf")) == "none"
    assert value_text("tone_share", 0.5) == "50.0%"
    assert {name for names in GROUPS.values() for name in names} <= set(WORDS)


def test_the_page_of_the_indexes_is_what_the_glossary_says():
    root = Path(__file__).parents[2]
    page = runpy.run_path(str(root / "scripts" / "document_indexes.py"))["page"]()
    assert (root / "docs" / "diagnose.md").read_text() == page, "run: python scripts/document_indexes.py"
