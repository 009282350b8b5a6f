"""retuner schedule: the JSON contract, the files that others take, the exit statuses, the one line on bad input."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from command_line import answer, refused
from pi_loop import Lag, pi_loop, written

import retuner
from retuner import Lookup, PidGains
from retuner.adaptive.schedule_choice.boundaries_of_two_variables import Cells
from retuner.adaptive.schedule_choice.schedule_from_records import Design, VariableEvidence
from retuner.adaptive.signals.sample import Window
from retuner.cli import main
from retuner.decision_page.shown_units import show_units
from retuner.schedule.config_section import schedule_section
from retuner.schedule.document import from_toml, to_toml
from retuner.schedule_report.schedule_page import message_sentence, push_sentence, variable_sentence
from retuner.scheduling import RecordedGains, ScheduleDesign, at_limits, table_of

Capture = pytest.CaptureFixture[str]
LOOP = """
schema = 1
[loop]
name = "level"
pv_unit = "%"
pv_min = 0.0
pv_max = 100.0
sample_time_s = 1.0
"""
REST = """
[bus]
interface = "virtual"
[device]
kind = "virtual"
[device.plant]
kind = "linear"
k = 1.0
lags_s = [20.0]
theta_s = 4.0
start_pv = 30.0
start_co_pct = 30.0
[scenario]
duration_s = 100.0
steps = [{ at_s = 0.0, sp = 30.0 }]
"""


def level(path: Path, n: int = 600) -> Path:
    """A first-order process in a loop with PI control, four setpoint steps."""
    sp, noise = np.array([30.0, 45.0, 60.0, 40.0])[4 * np.arange(n) // n], 0.1 * np.random.default_rng(3).normal(size=n)
    return written(path, pi_loop(PidGains(1.2, 0.06), Lag(20.0, 4, at=30.0), sp, noise, co0=30.0))


@pytest.mark.slow
def test_a_schedule_from_one_command_is_taken_by_check_and_export(tmp_path: Path) -> None:
    record, out = level(tmp_path / "level.csv"), tmp_path / "out"
    found = answer("schedule", record, "--by", "pv", "--unit", "%", "--out", out)
    assert found["schema"] == 1
    assert found["variable"] == "pv"
    assert len(found["regions"]) == 1
    assert {"x", "known", "model", "ln_std", "gains", "own", "ms", "ms_worst", "j"} <= set(found["places"][0])
    assert found["next_experiment"]["hold_s"] > 0
    assert [e["variable"] for e in found["candidates"]] == ["pv"]
    assert {Path(name).name for name in found["files"]} == {
        "gains.toml",
        "schedule.toml",
        "schedule.png",
        "report.html",
    }
    table = from_toml((out / "gains.toml").read_text())
    assert table.gains[0].kp == pytest.approx(20 / (2 * 4), rel=0.2)
    assert "<svg" in (out / "report.html").read_text()
    config = tmp_path / "loop.toml"
    config.write_text(LOOP + (out / "schedule.toml").read_text() + REST)
    assert main(["check", str(config)]) == 0
    assert main(["export", str(out / "gains.toml"), "--format", "csv", "--out", "-"]) == 0


def test_records_that_say_nothing_end_with_one_line_or_no(tmp_path: Path, capsys: Capture) -> None:
    still = tmp_path / "still.csv"
    still.write_text("t,sp,pv,co\n" + "\n".join(f"{i},1.0,{1 + i % 2 * 0.01},50.0" for i in range(100)) + "\n")
    assert main(["schedule", str(still), "--by", "pv"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--by", "flow"], "flow"),
        (["--ms", "9"], "ms"),
        (["--lookup", "cubic"], "cubic"),
        (["--low", "50", "--high", "40"], "low"),
        (["--by", "pv", "--low", "70", "--high", "90"], "the records visit"),
        (["--by", "pv", "--low", "70"], "the records visit"),
    ],
)
def test_wrong_options_are_one_line(options: list[str], named: str, tmp_path: Path) -> None:
    record = level(tmp_path / "level.csv", 60)
    assert named in refused("schedule", record, *options)
    if options == ["--by", "flow"]:  # of two records as well, not that the second's sp is another one
        assert 'no column "flow"' in refused("schedule", record, record, *options)


@pytest.mark.slow
def test_where_the_records_never_were_nothing_is_known(tmp_path: Path) -> None:
    record = retuner.read(level(tmp_path / "level.csv"))
    found = retuner.design_schedule(record, by="pv", low=0.0, high=100.0)
    visited = [place.x for place in found.places if place.known]
    low, high = np.quantile(record.recording.window().pv, (0.001, 0.999))
    assert visited
    assert low - 0.1 * (high - low) <= min(visited)
    assert max(visited) <= high + 0.1 * (high - low)


@pytest.mark.slow
def test_in_python_a_path_is_a_record_and_the_design_shows_itself_as_the_command_does(tmp_path, capsys):
    record = level(tmp_path / "level.csv")
    assert main(["schedule", str(record), "--by", "pv", "-q"]) == 0

    found = retuner.design_schedule(record, "pv", name="level")

    assert str(found) + "\n" == capsys.readouterr().out
    assert "\n" not in repr(found)
    assert len(repr(found)) < 120
    assert "data:image/svg+xml" in found._repr_html_()


def test_a_schedule_over_two_variables_is_taken_by_check(tmp_path: Path, capsys: Capture) -> None:
    sets = tuple(PidGains(0.5 + 0.1 * i, 0.05) for i in range(6))
    layout = Cells(Lookup.HARD, (0.0, 50.0, 100.0), (0.0, 30.0, 60.0, 100.0), sets)
    found = SimpleNamespace(layout=layout, variable="pv", second="co", hysteresis=1.0, second_hysteresis=2.0)
    found.min_stay_s = 4.0
    table = table_of(cast("Design", found), "level", "%")
    assert table.regions.shape == (2, 3)
    assert table.at(5, 70.0, 80.0) == layout.gains_at(70.0, 80.0) == sets[5]
    config = tmp_path / "loop.toml"
    config.write_text(LOOP + schedule_section(table) + REST)
    assert main(["check", str(config)]) == 0, capsys.readouterr().err
    assert from_toml(to_toml(table)).gains == table.gains


@pytest.mark.parametrize(("second", "told"), [("flow", "carries flow in place of FILL_IN"), ("co", "")])
def test_what_a_person_must_fill_in_is_told(second: str, told: str) -> None:
    layout = Cells(Lookup.HARD, (0.0, 100.0), (0.0, 50.0, 100.0), (PidGains(0.5, 0.05),) * 2)
    made = SimpleNamespace(layout=layout, variable="pv", second=second, hysteresis=1.0, second_hysteresis=2.0)
    made.min_stay_s = 4.0
    table = table_of(cast("Design", made), "level", "%")
    assert table is not None
    assert ("FILL_IN" in schedule_section(table)) == bool(told)
    said = message_sentence(cast("ScheduleDesign", SimpleNamespace(table=table)))
    assert told in said
    assert bool(said) == bool(told)


def test_which_variable_is_told_with_how_far_the_others_are_behind() -> None:
    weighed = [VariableEvidence("pv", 90.0, -100.0, True), VariableEvidence("flow", 80.0, -103.0, True)]
    found = SimpleNamespace(variable="pv", second="", design=SimpleNamespace(candidates=weighed))
    told = variable_sentence(cast("ScheduleDesign", found))
    assert "flow by 3 nats" in told
    assert "barely distinguish these" in told
    found.design.candidates = weighed[:1]
    assert variable_sentence(cast("ScheduleDesign", found)) == ""


@pytest.mark.slow
def test_a_column_of_the_record_may_be_the_variable_and_others_the_gains(tmp_path: Path) -> None:
    rows = level(tmp_path / "level.csv", 300).read_text().splitlines()
    wide = tmp_path / "wide.csv"
    more = [f"{row},{30 + 20 * np.sin(i / 90):.4f},1.2,0.06" for i, row in enumerate(rows[1:])]
    wide.write_text("\n".join([f"{rows[0]},FI104,KP,KI", *more]) + "\n")
    options = ["--by", "FI104", "--gain-columns", "KP,KI", "--co-max", "100"]

    found = answer("schedule", wide, *options)
    assert [e["variable"] for e in found["candidates"]] == ["FI104"]
    assert "FI105" in refused("schedule", wide, "--by", "FI105")
    assert "--gain-columns" in refused("schedule", wide, "--by", "pv", "--gain-columns", "KP")


@pytest.mark.slow
@pytest.mark.uncounted
def test_gains_are_shown_in_the_units_of_the_controller(tmp_path: Path, capsys: Capture) -> None:
    record = level(tmp_path / "level.csv")
    try:
        assert main(["schedule", str(record), "--by", "pv", "--controller", "pb-rpm", "--pv-span", "100"]) == 0
    finally:
        show_units(None)
    assert "PB in %, reset in repeats/min" in capsys.readouterr().out


def test_gains_in_force_are_those_of_the_samples_nearest_to_a_place() -> None:
    visited = np.linspace(0.0, 100.0, 400)
    kp = np.where(visited < 50, 1.0, 2.0)
    active = RecordedGains(kp, kp / 10, np.zeros(400))
    near = active.near(80.0, visited)
    assert (near.kp, near.ki) == (2.0, 0.2)
    assert active.near(200.0, visited) is None
    with pytest.raises(ValueError, match="finite"):
        RecordedGains(kp * np.nan, kp, kp)


def test_time_at_a_limit_of_the_output_is_told() -> None:
    co = np.clip(np.linspace(-50.0, 150.0, 200), 0.0, 100.0)
    window = Window(np.arange(200.0), co, co, co)
    assert at_limits([window], (None, None)) == pytest.approx(0.5, abs=0.02)
    assert at_limits([window], (0.0, 120.0)) == pytest.approx(0.25, abs=0.02)
    assert at_limits([], (None, None)) == 0.0


@pytest.mark.parametrize("pushed", [True, False])
def test_a_variable_from_outside_is_told_to_leave_the_bands_too_narrow(pushed: bool) -> None:
    form = SimpleNamespace(pushed=pushed, second=None)
    found = SimpleNamespace(variable="flow", design=SimpleNamespace(curves=SimpleNamespace(form=form)))
    assert ("flow comes from outside" in push_sentence(cast("ScheduleDesign", found))) == pushed


# ---- What a schedule from records says of itself: the unit of co in its gains, and what changes along the variable

DAY = Path(__file__).parents[2] / "examples" / "records" / "day.csv"


@pytest.mark.slow
def test_the_gain_table_of_records_names_their_unit_of_co(tmp_path: Path) -> None:
    """co of 4 to 20 mA: read as percent, the gains would be six times off."""
    columns = np.loadtxt(level(tmp_path / "level.csv"), delimiter=",", skiprows=1)
    columns[:, 3] = 4.0 + 0.16 * columns[:, 3]
    np.savetxt(tmp_path / "level.csv", columns, delimiter=",", header="t,sp,pv,co", comments="")
    assert main(["schedule", str(tmp_path / "level.csv"), "--by", "pv", "--out", str(tmp_path / "out")]) == 0
    told = f"in the unit of the records, where it runs from {columns[:, 3].min():g} to {columns[:, 3].max():g}"
    for name in ("gains.toml", "schedule.toml"):
        assert told in (tmp_path / "out" / name).read_text(encoding="utf-8").splitlines()[0]
    text = (tmp_path / "out" / "gains.toml").read_text(encoding="utf-8")
    assert "percent" not in text
    assert from_toml(text).gains
    assert "The process does not change with it." in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.nightly
def test_what_changes_along_the_variable_is_told(tmp_path: Path) -> None:
    assert main(["schedule", str(DAY), "--by", "pv", "--out", str(tmp_path / "out")]) == 0
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "does not change with it" not in report
    assert "The process changes with pv: slope gain k/tau (from " in report
