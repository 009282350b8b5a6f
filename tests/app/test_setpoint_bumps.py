"""Setpoint bumps through the whole stack: a quiet loop learns by them, and no end of a session leaves one out."""

import json
from pathlib import Path

import pytest
from command_line import answer
from recorded import bodies
from wire import Wire

from retuner.adaptive.setpoint_bumps.bump_planner import BumpPhase
from retuner.adaptive.setpoint_bumps.bump_settings import BumpSettings
from retuner.adaptive.setpoint_bumps.loop_bumps import LoopBumps
from retuner.adaptive.supervision.decision import Mode
from retuner.cli import main
from retuner.config.adaptation import AdaptationConfig
from retuner.config.loading import UnusableError, parse_config
from retuner.ledger.chain import Row
from retuner.session.ledger_rows import bump_left
from retuner.session.loop_session import LoopSession
from retuner.session.running import with_what_was_left

LOOP = """
schema = 1
loop = {{ name = "tank", pv_unit = "degC", pv_min = 0.0, pv_max = 100.0, sample_time_s = 1.0 }}
schedule = {{ variable = "sp", region = [{{ name = "all", kc = 1.0, tau_i_s = 120.0 }}] }}
scenario = {{ duration_s = 1300.0, steps = [{{ at_s = 0.0, sp = 50.0 }}] }}
device.seed = 1
adaptation.mode = "auto"
[adaptation.bumps]
allowed = {allowed}
percent = 2.0
after_h = 0.1
announce_s = 30.0
most_per_day = 4
[device.plant]
kind = "linear"
k = 1.0
lags_s = [40.0]
theta_s = 4.0
start_pv = 50.0
start_co_pct = 50.0
noise = 0.05
"""
SHORT_S = 2200.0
SOON = BumpSettings(allowed=True, percent=2.0, after_h=0.0, announce_s=0.0)


def ran(folder: Path, allowed: str) -> Path:
    (folder / "tank.toml").write_text(LOOP.format(allowed=allowed))
    run = folder / "run"
    assert main(["run", str(folder / "tank.toml"), "--no-compare", "--out", str(run), "--json"]) == 0
    return run


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_quiet_loop_learns_by_bumps_and_a_replay_decides_the_same(tmp_path, capsys):
    run = ran(tmp_path, "true")
    decisions = json.loads(capsys.readouterr().out)["decisions"]
    assert "commit" in [decision["action"] for decision in decisions]
    rows = bodies(run, "bump")
    assert [row["cause"] for row in rows[:5]] == ["due", "begun", "taken", "at_rest", "back"]
    assert (rows[1]["setpoint"], rows[3]["setpoint"], rows[-1]["phase"]) == (52.0, 50.0, "watching")
    assert main(["replay", str(run), "--json"]) == 0


def test_without_leave_the_setpoint_is_never_moved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = ran(tmp_path, "false")
    assert json.loads(capsys.readouterr().out)["decisions"] == []
    assert bodies(run, "bump") == []


@pytest.mark.slow
def test_the_example_bumps_to_and_fro_within_its_budget_and_tells_it_beforehand(tmp_path):
    text = (Path(__file__).parents[2] / "examples" / "bumps.toml").read_text(encoding="utf-8")
    early = [line for line in text.splitlines() if "at_s" not in line or float(line.split()[3].strip(",")) < SHORT_S]
    short, run = tmp_path / "bumps.toml", tmp_path / "run"
    short.write_text("\n".join(early).replace("9600.0", f"{SHORT_S}").replace("after_h = 0.5 ", "after_h = 0.2 "))
    committed = [d for d in answer("run", short, "--no-compare", "--out", run)["decisions"] if d["action"] == "commit"]
    assert "setpoint steps to and fro" in committed[0]["reason"]
    rows = [row for row in bodies(run, "bump") if row["cause"] in {"due", "begun", "back"}]
    assert [row["cause"] for row in rows] == ["due", "begun", "back"]
    assert "in 60 s the setpoint goes from 50 to 52 and 48 in turn" in rows[0]["reason"]


@pytest.fixture
def wire():
    wire = Wire()
    yield wire
    wire.close()


def bumped(wire: Wire) -> LoopSession:
    """The setpoint is out."""
    wire.session.bumps = LoopBumps(SOON, wire.session.retuner)
    for _ in range(200):
        wire.run(1)
        if wire.session.bumps.planner.phase is BumpPhase.HOLDING:
            assert wire.device.sp == 52.0
            return wire.session
    raise AssertionError("no bump was made")


def test_a_session_that_ends_puts_the_setpoint_back_first(wire: Wire) -> None:
    session = bumped(wire)
    wire.end()
    assert (wire.device.sp, session.left_open) == (50.0, "")
    assert [body["cause"] for kind, body in wire.rows if kind == "bump"][-2:] == ["ended", "back"]


def test_a_defect_puts_it_back_as_well(wire: Wire) -> None:
    session = bumped(wire)
    session.fail("a defect")
    wire.run(60)
    assert (wire.device.sp, session.finished) == (50.0, True)


def test_a_ledger_that_fails_begins_no_bump(wire: Wire) -> None:
    wire.session.bumps = LoopBumps(SOON, wire.session.retuner)
    keep = wire.session._to_ledger

    def full(kind: str, t_s: float, body: object) -> None:
        if kind == "bump":
            wire.session.freeze("the disk is full")
        keep(kind, t_s, body)

    wire.session._to_ledger = full
    wire.run(100)
    assert wire.device.sp == 50.0


def test_a_session_that_cannot_bring_it_back_says_so(wire: Wire) -> None:
    session = bumped(wire)
    wire.heard = lambda message: message is None
    session.stop("the test is over")
    wire.run(300)
    assert session.left_open == "the setpoint is still bumped"


@pytest.mark.parametrize("mode", [Mode.OFF, Mode.ADVISE])
def test_where_nothing_may_be_written_nothing_is_bumped(mode: Mode) -> None:
    wire = Wire(mode=mode)
    wire.session.bumps = LoopBumps(SOON, wire.session.retuner)
    wire.run(200)
    assert (wire.device.sp, "bump" in wire.kinds) == (50.0, False)
    wire.close()


def test_no_bump_crosses_a_boundary_of_its_region(wire: Wire) -> None:
    wire.session.bumps = LoopBumps(SOON, wire.session.retuner)
    wire.device.sp = 57.0
    wire.run(400)
    made = [body["to"] for kind, body in wire.rows if kind == "bump"]
    assert made
    assert made[0] == 55.0


def row(kind: str, body: dict[str, object]) -> Row:
    return Row(1, 0.0, kind, json.dumps(body), "", "")


def test_rows_tell_what_a_session_left_out() -> None:
    out = row("bump", {"phase": "holding", "before": 50.0, "to": 52.0})
    back = row("bump", {"phase": "watching", "before": 50.0, "to": 52.0})
    assert bump_left([out, row("decision", {})]) == (50.0, 52.0)
    assert bump_left([out, back]) is None
    assert bump_left([]) is None
    with pytest.raises(KeyError):
        bump_left([row("bump", {})])
    assert bump_left([row("nudge", {"phase": "holding", "before": 50.0, "to": 52.0})]) == (50.0, 52.0), (
        "an older ledger"
    )


@pytest.mark.parametrize("allowed", [True, False])
def test_a_bump_left_out_is_told_where_bumps_are_no_longer_allowed(wire: Wire, allowed: bool) -> None:
    bumps = LoopBumps(BumpSettings(allowed=allowed), wire.session.retuner)
    said: list[str] = []
    left = [row("bump", {"phase": "holding", "before": 50.0, "to": 52.0})]
    assert (with_what_was_left(bumps, lambda: left, said.append) is bumps) == allowed
    assert bumps.planner.out == allowed
    assert ["from 50 to 52" in line for line in said] == [True] * (not allowed)


def test_the_former_name_of_the_section_is_still_read() -> None:
    told = AdaptationConfig.model_validate({"nudge": {"allowed": True, "percent": 2.0}})
    assert told == AdaptationConfig.model_validate({"bumps": {"allowed": True, "percent": 2.0}})
    with pytest.raises(ValueError, match="nudge"):
        AdaptationConfig.model_validate({"nudge": {}, "bumps": {}})


def test_what_is_wrong_under_the_former_name_is_told_with_its_line_and_key() -> None:
    text = LOOP.format(allowed="true").replace("adaptation.bumps", "adaptation.nudge").replace("= 2.0", "= 99.0")
    with pytest.raises(UnusableError) as told:
        parse_config(text)
    (flaw,) = told.value.findings
    line = text.split("\n").index("percent = 99.0") + 1
    assert (flaw.line, flaw.key) == (line, "adaptation.nudge.percent")
    assert flaw.message.startswith("= 99.0 must be at most 5")
