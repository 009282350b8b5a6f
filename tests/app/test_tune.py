"""retuner tune: every rule, the comparison, explanations, pictures, and one line on bad input."""

import json
import math
from functools import partial
from pathlib import Path

import command_line
import pytest
from command_line import printed, refused

from retuner import ProcessModel, ProcessType, tune
from retuner.adaptive.rules.registry import RULES
from retuner.cli import main
from retuner.report.rule_comparison import compare_rules

answer = partial(command_line.answer, silent=True)

Capture = pytest.CaptureFixture[str]
FOPDT = ["--type", "fopdt", "--k", "2", "--tau1", "10", "--theta", "2"]
PNG = b"\x89PNG\r\n\x1a\n"


def test_rules_from_readings_need_no_model() -> None:
    found = answer("tune", "--rule", "zn-ultimate", "--ku", "0.95", "--pu", "12", "--kind", "pid")
    assert found["gains"] == pytest.approx({"kc": 0.57, "tau_i": 6.0, "tau_d": 1.5})
    assert found["margins"] is None
    assert found["model"] is None
    found = answer("tune", "--rule", "quarter-decay", "--kq", "2", "--pq", "6")
    assert found["gains"] == pytest.approx({"kc": 2.0, "tau_i": 4.0, "tau_d": 1.0})


def test_a_form_is_converted() -> None:
    sopdt = ["--type", "sopdt", "--k", "1", "--tau1", "8", "--tau2", "2", "--theta", "1", "--kind", "pid"]
    series = answer("tune", *sopdt)
    ideal = answer("tune", *sopdt, "--form", "ideal")
    f = 1 + series["gains"]["tau_d"] / series["gains"]["tau_i"]
    assert ideal["form"] == "ideal"
    assert ideal["gains"]["kc"] == pytest.approx(series["gains"]["kc"] * f)
    assert ideal["gains"]["tau_d"] == pytest.approx(series["gains"]["tau_d"] / f)
    assert ideal["parallel"] == series["parallel"]


def test_wishes() -> None:
    assert answer("tune", *FOPDT, "--ms", "1.4")["margins"]["ms"] == pytest.approx(1.4, abs=1e-6)
    assert answer("tune", *FOPDT, "--gm", "4")["margins"]["gm"] == pytest.approx(4, rel=1e-6)
    assert answer("tune", *FOPDT, "--rule", "optimal", "--ms", "1.8")["margins"]["ms"] == pytest.approx(1.8, abs=1e-6)
    assert answer("tune", *FOPDT, "--c", "1.44")["gains"]["tau_i"] == pytest.approx(1.44 * 4)
    assert answer("tune", *FOPDT, "--rule", "haugen")["gains"]["tau_i"] == pytest.approx(1.44 * 4)


def test_double_integrating_is_pid_of_itself() -> None:
    double = ["--type", "double-integrating", "--k", "0.5", "--theta", "2"]
    found = answer("tune", *double)
    assert found["kind"] == "pid"
    assert found["gains"] == pytest.approx({"kc": 1 / (4 * 0.5 * 16), "tau_i": 16, "tau_d": 16})
    assert "derivative" in refused("tune", *double, "--kind", "pi")


def test_an_unstable_result_is_said_and_is_status_1() -> None:
    unstable = ["--type", "integrating", "--k", "1", "--theta", "1", "--tau-c", "0", "--c", "0.2"]
    found = answer("tune", *unstable, status=1)
    assert found["margins"]["stable"] is False
    assert {value for name, value in found["margins"].items() if name != "stable"} == {None}
    shown = printed("tune", *unstable, status=1)
    assert "UNSTABLE" in shown
    assert "Ms" not in shown


def test_explain() -> None:
    why = answer("tune", *FOPDT, "--explain")["explanation"]
    assert why["numbers"] == pytest.approx({"tau1": 10, "k": 2, "tau_c": 2, "theta": 2, "k'": 0.2, "c": 4})
    assert "Kc = 10/(2 (2 + 2))" in why["with_numbers"][0].replace(" * ", " ")
    assert "Skogestad 2003" in why["source"]
    shown = printed("tune", *FOPDT, "--rule", "cohen-coon", "--kind", "pid", "--explain")
    for text in ("Ti = L (32 + 6 L/tau)/(13 + 8 L/tau)", "L = 2", "tau = 10", "Cohen & Coon 1953", "range"):
        assert text in shown
    assert answer("tune", "--rule", "zn-ultimate", "--ku", "3", "--pu", "7", "--explain")["explanation"]["numbers"] == {
        "Ku": 3.0,
        "Pu": 7.0,
    }


def evaluated(line: str) -> float:
    """The right hand side of an explanation with its numbers, worked out."""
    text = line.partition(" = ")[2].split(" = ")[0]
    text = text.replace(" * ", "*").replace("^", "**").replace(" (", "*(").replace("+*(", "+(").replace("min*(", "min(")
    return eval(text.replace("-*(", "-("), {"min": min})  # the test's own strings


@pytest.mark.parametrize("type_", ["fopdt", "integrating"])
@pytest.mark.parametrize(
    "rule", ["amigo", "cohen-coon", "zn-reaction", "itae-load", "itae-setpoint", "lambda", "imc", "imc-pi"]
)
def test_the_explained_formulas_give_the_settings(rule: str, type_: str) -> None:
    chosen = RULES[rule]
    if ProcessType(type_) not in chosen.types:
        pytest.skip("the rule is not for this type")
    model = ProcessModel(ProcessType(type_), 2.0, 10.0 if type_ == "fopdt" else 0.0, 0.0, 3.0)
    for kind in chosen.kinds:
        if rule == "lambda" and (type_, kind) == ("integrating", "pid"):
            continue
        result = tune(model, rule, kind=kind)
        assert result.explanation is not None
        gains = result.to_dict()["gains"]
        lines = [part for line in result.explanation.with_numbers for part in line.split(", ")]
        expected = [gains["kc"], gains["tau_i"], gains["tau_d"]]
        assert len(lines) == sum(1 for x in expected if x)
        for line, value in zip(lines, expected, strict=False):
            assert evaluated(line) == pytest.approx(value, rel=1e-5), line


@pytest.mark.slow
def test_all_rules_side_by_side(tmp_path: Path) -> None:
    picture = tmp_path / "all.png"
    found = answer("tune", *FOPDT, "--all", "--plot", str(picture))
    assert picture.read_bytes().startswith(PNG)
    rows = {(row["rule"], row["kind"]): row for row in found["rules"]}
    assert len(rows) > 25
    assert set(rows["simc", "pi"]) >= {"gains", "parallel", "margins", "j", "iae_setpoint", "iae_load", "form"}
    assert rows["optimal", "pi"]["j"] < rows["simc", "pi"]["j"]
    assert rows["simc", "pi"]["iae_load"] == pytest.approx(
        rows["simc", "pi"]["gains"]["tau_i"] / rows["simc", "pi"]["gains"]["kc"], rel=0.03
    )
    assert {row["rule"] for row in found["left_out"]} >= {"quarter-decay pid", "simc-smooth pi"}
    assert all(row["reason"] for row in found["left_out"])


def test_the_table_of_all_rules() -> None:
    lines = printed(
        "tune", "--type", "integrating", "--k", "-0.1", "--theta", "2", "--all", "--kind", "pi"
    ).splitlines()
    assert lines[0].split() == [
        "rule",
        "kind",
        "form",
        "Kc",
        "tau_I",
        "tau_D",
        "tau_c",
        "Ms",
        "GM",
        "PM",
        "J",
        "IAE",
        "sp",
        "IAE",
        "load",
    ]
    simc = next(line for line in lines if line.startswith("simc "))
    assert simc.split()[:10] == ["simc", "pi", "series", "-2.5", "16", "0", "2", "1.70", "2.963", "46.9"]
    assert any(line.startswith("not applicable: itae-load") for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    [
        ProcessModel(ProcessType.SOPDT, -3.0, 20.0, 5.0, 1.0),
        ProcessModel(ProcessType.INTEGRATING_LAG, 0.1, 0.0, 3.0, 1.0),
        ProcessModel(ProcessType.DELAY, 2.0, theta_s=4.0),
        ProcessModel(ProcessType.FOPDT, 1.0, 0.05, 0.0, 1.0),
        ProcessModel(ProcessType.FOPDT, 1.0, 500.0, 0.0, 1.0),
    ],
)
def test_every_type_has_answers_without_nan_or_zero(model: ProcessModel) -> None:
    for row in compare_rules(model).rows:
        gains = row.result.tuning.gains
        assert (gains.kp or gains.ki) * model.k > 0
        assert all(math.isfinite(x) for x in (gains.kp, gains.ki, gains.kd))
        if row.result.margins and row.result.margins.stable:
            assert row.result.margins.ms >= 1 - 1e-9
            assert row.j is None or row.j > 0.05
    if model.type == ProcessType.DELAY:
        json.dumps(compare_rules(model, kind="pi").to_dict(), allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["simc", "optimal"])
def test_pictures_of_one_rule(tmp_path: Path, rule: str) -> None:
    picture = tmp_path / "one.png"
    assert main(["tune", *FOPDT, "--rule", rule, "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "works from a model"),
        (["--k", "1", "--tau1", "1"], "--type is missing"),
        (["--type", "fopdt", "--tau1", "1"], "--k is missing"),
        ([*FOPDT, "--kind", "pidd"], "pidd"),
        ([*FOPDT, "--tau-c", "nan"], "tau_c = nan"),
        (["--rule", "zn-ultimate", "--ku", "inf", "--pu", "2"], "ku = inf"),
        (["--all"], "--all needs the process"),
        (["--rule", "zn-ultimate", "--ku", "2", "--pu", "3", "--plot", "x.png"], "--plot needs the process"),
        ([*FOPDT, "--form", "series", "--rule", "zn-some-overshoot"], "no series form"),
        (["--type", "fopdt", "--k", "0", "--tau1", "1"], "k = 0"),
        (["--type", "magic", "--k", "1"], "--type magic: give one of fopdt"),
        (["--type", "delay", "--k", "1", "--tau1", "1", "--theta", "1"], "has no tau1"),
        ([*FOPDT, "--form", "cubic"], "cubic"),
        ([*FOPDT, "--rule", "voodoo"], "simc"),
        ([*FOPDT, "--inverse", "-3"], "--inverse -3: "),
        ([*FOPDT, "--plot", "/nonexistent/folder/x.png"], "/nonexistent/folder/x.png"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], message: str) -> None:
    assert message in refused("tune", *arguments)


def test_settings_as_a_vendor_dials_them(capsys: pytest.CaptureFixture[str]) -> None:
    """kc 1 on a span of 200 pv units is a band of 50 %; an integral time of 30 s repeats twice a minute."""
    asked = ["tune", "--type", "fopdt", "--k", "1", "--tau1", "30", "--theta", "15", "--pv-span", "200"]
    assert answer(*asked)["dialled"] == pytest.approx({"band_pct": 50.0, "repeats_per_min": 2.0})
    assert main(asked) == 0
    assert "set as    proportional band 50 %  2 repeats/min" in capsys.readouterr().out
    assert "--pv-span" in refused(*asked[:-1], "0")
