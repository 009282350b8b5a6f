"""retuner run from end to end on a quick loop: cured, recorded, repeatable, interruptible; and what refuses to run."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import can
import cantools
import numpy as np
import pytest
from command_line import answer, refused, run
from once import once
from two_regions import two_regions

from retuner import Action, GainTable, Mode, PidGains, Regions, Retuner, RetunerSettings, drivers, load_config
from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.orders.operator_orders import pretune
from retuner.adaptive.signals.sample import FloatArray, LoopSample, Window
from retuner.adaptive.supervision.admission import AdmissionSettings, admit
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.without_model.pattern_rule import MOVING, PatternReading, PatternSettings, pattern_rule
from retuner.adaptive.without_model.proposal_without_model import SlowReading, SlowSettings, slow_oscillation_online
from retuner.cli import main
from retuner.commands import run as commands_run
from retuner.config.bench_plants import known_plant
from retuner.drivers.device import WriteRefusedError
from retuner.ledger import Ledger, LedgerReader
from retuner.ledger.chain import Row
from retuner.report.scores import region_scores, twin_steps
from retuner.schedule.document import from_toml
from retuner.session.outputs import fresh_folder
from retuner.session.running import Run, nothing
from retuner.session.session import Session

QUICK = two_regions(
    "auto",
    160.0,
    "at_s = 0.0, sp = 2.0",
    "at_s = 20.0, sp = 3.0",
    "at_s = 50.0, load = -5.0",
    "at_s = 80.0, sp = 2.0",
    "at_s = 110.0, sp = 3.0",
    "at_s = 140.0, sp = 7.0",
)
BRIEF = two_regions("auto", 70.0, "at_s = 0.0, sp = 2.0", "at_s = 20.0, sp = 3.0")
"""One setpoint step, which is answered by one change."""


@pytest.fixture
def quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "quick.toml"
    path.write_text(QUICK, encoding="utf-8")
    return path


class Finished(NamedTuple):
    """What one run of the quick loop, with its comparison, left and printed; to be read only."""

    out: Path
    shown: str


def head_of(out: Path) -> str:
    with LedgerReader(out / "ledger.sqlite") as ledger:
        return ledger.head()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    def run(folder: Path) -> None:
        shown = io.StringIO()
        (folder / "quick.toml").write_text(QUICK, encoding="utf-8")
        with contextlib.redirect_stdout(shown):
            assert main(["run", str(folder / "quick.toml"), "--out", str(folder / "out")]) == 0
        (folder / "shown").write_text(shown.getvalue(), encoding="utf-8")

    folder = once(tmp_path_factory, "quick-run", run)
    return Finished(folder / "out", (folder / "shown").read_text(encoding="utf-8"))


@pytest.mark.uncounted
def test_a_sluggish_loop_is_cured_over_can_and_everything_is_left_behind(finished: Finished) -> None:
    assert "sluggish" in finished.shown
    assert "written: Kc 5" in finished.shown
    out = finished.out
    summary = json.loads((out / "summary.json").read_text())
    assert summary["interrupted"] is False
    low, high = summary["scores"]
    assert low["changes"] >= 1
    assert low["ms_after"] <= 1.8
    assert low["iae"] < low["iae_fixed"]
    assert high["changes"] == 0
    table = from_toml((out / "gains.toml").read_text())
    assert table.gains_of("low").kp == pytest.approx(low["after"]["kp"])
    assert table.revision == summary["revision"] >= low["changes"]  # a change undone at the end is a revision too
    report = (out / "report.html").read_text()
    assert report.count('aria-label="Trend with the regions"') == 1
    assert not any(f'{name}="{scheme}' in report for name in ("src", "href") for scheme in ("http", "//"))
    trend = np.genfromtxt(out / "trend.csv", delimiter=",", names=True)
    assert len(trend) == pytest.approx(1600, abs=5)
    assert np.all(np.diff(trend["t"]) > 0)


def test_the_ledger_has_the_row_before_the_effect(finished: Finished) -> None:
    with LedgerReader(finished.out / "ledger.sqlite") as ledger:
        assert ledger.verify().ok
        rows = [(row.kind, json.loads(row.text)) for row in ledger.rows()]
    kinds = [kind for kind, _ in rows]
    assert kinds[0] == "session"
    assert kinds[-1] == "end"
    first = next(i for i, (kind, body) in enumerate(rows) if kind == "intent" and body["why"] == "retune")
    done = next(i for i, (kind, body) in enumerate(rows) if kind == "committed" and body["why"] == "retune")
    assert kinds[first - 1] == "decision"
    assert first < done
    assert kinds.count("intent") == kinds.count("committed")


def test_the_bus_log_decodes_with_the_shipped_dbc(finished: Finished) -> None:
    database = cantools.database.load_file(Path(drivers.__file__).parent / "retuner.dbc")
    assert isinstance(database, cantools.database.Database)
    by_command = {message.frame_id & 0x1F: message for message in database.messages}
    seen = set()
    for frame in can.BLFReader(finished.out / "bus.blf"):
        message = by_command[frame.arbitration_id & 0x1F]
        message.decode(bytes(frame.data))
        seen.add(message.name)
    assert {"TELEMETRY_PV", "TELEMETRY_SP", "STAGE", "COMMIT", "ACK", "SETPOINT", "HEARTBEAT"} <= seen


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_same_seed_gives_the_same_ledger_and_another_seed_another(quick: Path) -> None:
    for run_, seed in enumerate((3, 3, 4)):
        quick.write_text(BRIEF.replace("seed = 3", f"seed = {seed}"), encoding="utf-8")
        main(["run", str(quick), "--no-compare", "--out", f"run{run_}"])
    first, same, other = (head_of(quick.parent / f"run{run_}") for run_ in range(3))
    assert first == same != other


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_run_that_ends_just_after_a_setpoint_step_has_its_report_and_summary(quick: Path) -> None:
    ending = QUICK.replace("duration_s = 160.0", "duration_s = 140.5")
    assert ending != QUICK
    quick.write_text(ending)
    assert main(["run", str(quick), "--no-compare"]) == 0
    out = quick.parent / "out"
    assert json.loads((out / "summary.json").read_text())["interrupted"] is False
    assert main(["report", str(out)]) == 0


@pytest.mark.slow
def test_gains_of_the_wrong_sign_are_told_before_anything_runs(quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick.write_text(QUICK.replace("kc = ", "kc = -"))
    assert main(["run", str(quick), "--out", str(quick.parent / "out"), "--no-compare"]) == 2
    told = capsys.readouterr().out.splitlines()
    assert "needs a reverse-acting controller; these gains are direct acting" in told[0]


@pytest.mark.slow
@pytest.mark.uncounted
def test_advise_changes_nothing(quick: Path) -> None:
    quick.write_text(BRIEF, encoding="utf-8")
    document = answer("run", quick, "--mode", "advise", "--no-compare")
    assert {d["action"] for d in document["decisions"]} <= {"advise", "none"}
    assert "advise" in {d["action"] for d in document["decisions"]}
    assert document["revision"] == 0


def test_an_earlier_run_is_moved_aside_and_foreign_folders_are_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    assert fresh_folder(folder).moved is None
    (folder / "ledger.sqlite").write_text("old")
    assert fresh_folder(folder).moved == tmp_path / "run-1"
    assert (tmp_path / "run-1" / "ledger.sqlite").read_text() == "old"
    assert list(folder.iterdir()) == []
    (folder / "thesis.txt").write_text("precious")
    assert main(["run", "examples/none.toml", "--out", str(folder)]) == 2
    assert (folder / "thesis.txt").read_text() == "precious"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--mode", "sometimes"], "sometimes"),
        (["--speed", "fast"], "--speed fast"),
        (["--speed", "10"], "simulated time"),
        (["-i", "nosuchbus", "--speed", "1"], "nosuchbus"),
    ],
)
def test_wrong_use_is_one_line_and_status_2_and_leaves_nothing(quick, arguments, message):
    assert message in refused("run", quick, *arguments)
    assert not (quick.parent / "out").exists()


def test_a_failed_start_leaves_no_folder_that_was_not_there(quick: Path) -> None:
    out = quick.parent / "deep" / "er" / "out"
    assert "nosuchbus" in refused("run", quick, "-i", "nosuchbus", "--speed", "1", "--out", out)
    assert not (quick.parent / "deep").exists()
    (quick.parent / "deep").mkdir()
    assert main(["run", str(quick), "-i", "nosuchbus", "--speed", "1", "--out", str(out)]) == 2
    assert list((quick.parent / "deep").iterdir()) == []


def test_a_second_run_in_the_folder_of_a_living_one_is_refused_and_takes_nothing_away(quick):
    folder = quick.parent / "out"
    folder.mkdir()
    with Ledger(folder / "ledger.sqlite") as ledger:
        ledger.append("k", {}, 0.0)
        assert "another run writes this ledger" in refused("run", quick)
        assert [path.name for path in quick.parent.iterdir() if path.is_dir()] == ["out"]
        assert ledger.append("k", {}, 1.0).seq == 2


def test_parquet_without_pyarrow_is_refused_before_the_run(quick, monkeypatch):
    quick.write_text(QUICK + 'trend = "parquet"\n', encoding="utf-8")
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert 'pip install "retuner[parquet]"' in refused("run", quick)
    assert not (quick.parent / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("failing", "rows"), [("session", 0), ("decision", 1), ("intent", 2), ("committed", 3)])
def test_a_ledger_that_fails_changes_nothing_more_and_ends_the_run_in_one_line(quick, monkeypatch, failing, rows):
    write = Ledger.append
    wrote: list[str] = []

    def append(self: Ledger, kind: str, body: Mapping[str, object], clock_s: float) -> Row:
        if kind == failing or len(wrote) > rows:
            self._connection.execute("PRAGMA max_page_count = 1")  # a full disk, as SQLite sees it
            body = {**body, "long": "x" * 200_000}
        row = write(self, kind, body, clock_s)
        wrote.append(kind)
        return row

    monkeypatch.setattr(Ledger, "append", append)
    done = run("run", quick, "--no-compare")
    assert done.returncode == 2
    assert "database or disk is full" in done.stderr
    assert done.stderr.count("\n") == 1
    out = quick.parent / "out"
    if failing == "session":
        assert not out.exists()
        return
    with LedgerReader(out / "ledger.sqlite") as reader:
        kinds = [row.kind for row in reader.rows()]
        assert reader.verify().ok
    assert kinds == wrote
    assert failing not in kinds
    summary = json.loads((out / "summary.json").read_text())
    database = cantools.database.load_file(Path(drivers.__file__).parent / "retuner.dbc")
    assert isinstance(database, cantools.database.Database)
    commit = database.get_message_by_name("COMMIT").frame_id & 0x1F
    commits = sum(frame.arbitration_id & 0x1F == commit for frame in can.BLFReader(out / "bus.blf"))
    assert commits == kinds.count("intent") == summary["revision"]  # what was written had been recorded before


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_bus_log_that_fails_is_told_and_the_run_goes_on(quick: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(can.BLFWriter, "on_message_received", full)
    quick.write_text(BRIEF, encoding="utf-8")
    assert main(["run", str(quick), "--no-compare"]) == 0
    with LedgerReader(quick.parent / "out" / "ledger.sqlite") as reader:
        rows = [json.loads(row.text) for row in reader.rows() if row.kind == "bus"]
    assert rows == [{"fault": "the bus log cannot be written", "times": 1, "samples": 0}]


@pytest.mark.slow
def test_ctrl_c_leaves_a_whole_report_and_a_whole_ledger(quick: Path) -> None:
    longer = QUICK.replace("duration_s = 160.0", "duration_s = 1e7")
    quick.write_text(longer, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "retuner", "run", str(quick)],
        cwd=quick.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    assert any(b"written: Kc" in line for line in process.stdout)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130, errors
    assert (quick.parent / "out" / "report.html").stat().st_size > 10_000
    with LedgerReader(quick.parent / "out" / "ledger.sqlite") as reader:
        assert reader.verify().ok
        assert list(reader.rows())[-1].kind == "end"


@pytest.mark.slow
@pytest.mark.uncounted
def test_ctrl_c_in_the_comparison_run_keeps_the_run_that_is_over(quick: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = Run.simulated
    began: list[Run] = []

    def simulated(self: Run) -> Session:
        began.append(self)
        if len(began) == 2:
            raise KeyboardInterrupt
        return runs(self)

    monkeypatch.setattr(Run, "simulated", simulated)
    quick.write_text(BRIEF, encoding="utf-8")
    assert main(["run", str(quick)]) == 130
    assert len(began) == 2
    assert json.loads((quick.parent / "out" / "summary.json").read_text())["interrupted"] is True
    names = {path.name for path in (quick.parent / "out").iterdir()}
    assert {"report.html", "summary.json", "gains.toml", "trend.csv"} <= names
    score = json.loads((quick.parent / "out" / "summary.json").read_text())["scores"][0]
    assert score["changes"] >= 1
    assert score["iae_fixed"] is None


@pytest.mark.slow
def test_a_signal_in_the_middle_of_a_row_waits_until_what_the_row_tells_of_is_done(quick, monkeypatch):
    write = Ledger.append

    def append(self: Ledger, kind: str, body: Mapping[str, object], clock_s: float) -> Row:
        if kind == "committed" and body["why"] == "retune":
            os.kill(os.getpid(), signal.SIGINT)
        return write(self, kind, body, clock_s)

    monkeypatch.setattr(Ledger, "append", append)
    assert main(["run", str(quick)]) == 130
    summary = json.loads((quick.parent / "out" / "summary.json").read_text())
    with LedgerReader(quick.parent / "out" / "ledger.sqlite") as reader:
        assert reader.verify().ok
        rows = list(reader.rows())
    kinds = [row.kind for row in rows]
    assert kinds[kinds.index("committed") :] == ["committed", "trial", "abort", "decision", "restored", "end"]
    assert json.loads(rows[-2].text)["gains"] == summary["scores"][0]["after"] != summary["scores"][0]["before"]


# ---- The demo's promise, on another seed: every region robust on the true oven and better than fixed gains

MS_ANYWHERE = 1.85
"""A region is tuned to Ms 1.6 for its mean; one set serves two setpoints, and at the worse of them Ms is 1.79 to 1.81
in the middle region on every seed tried (1, 101 to 106)."""
OVEN = Path(__file__).parents[2] / "examples" / "oven.toml"


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(101, 107))
def test_every_region_ends_robust_and_better_than_fixed_gains(seed: int) -> None:
    config = load_config(OVEN)
    config = config.model_copy(update={"device": config.device.model_copy(update={"seed": seed})})
    retuned = Run(config, nothing).simulated().loops[0]
    fixed = Run(config, nothing, mode=Mode.OFF).simulated().loops[0]
    run, still = retuned.trend.columns(), fixed.trend.columns()
    table = config.gain_table()
    plant = known_plant(config)
    scores = region_scores(table, retuned.table, retuned.changes, run, still, plant.linearise, 2.0)
    assert len(scores) == 3
    for score in scores:
        assert score.changes >= 1
        assert score.ms_after is not None
        assert score.ms_after <= MS_ANYWHERE
        assert score.iae_fixed is not None
        assert score.iae < 0.8 * score.iae_fixed
    # the comparison is fair: with fixed gains the controller did run each region's own set
    assert fixed.table == table
    for region, gains in enumerate(table.gains):
        inside = np.flatnonzero(still["region"] == region)
        assert np.mean(np.abs(still["kp"][inside] / gains.kp - 1) < 1e-6) > 0.99
    assert {twin.region for twin in twin_steps(run, retuned.scenario.played)} == {0, 1, 2}


# ---- A run on a controller that acts the wrong way does not end as if all were well

BENCH = Path(__file__).parents[2] / "examples" / "bench.toml"


@pytest.mark.slow
def test_a_run_that_ended_the_wrong_way_says_so_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "bench.toml"
    text = BENCH.read_text(encoding="utf-8")
    assert "k = 0.4" in text
    config.write_text(text.replace("k = 0.4", "k = -0.4"), encoding="utf-8")
    assert main(["run", str(config), "--out", str(tmp_path / "out"), "--no-compare"]) == 2
    said = capsys.readouterr()
    assert "the controller acts the wrong way; turn its action" in said.err
    assert (tmp_path / "out" / "report.html").is_file()
    assert "Traceback" not in said.err


def test_a_run_that_the_device_ends_says_why() -> None:
    """With no setpoint in a device's description, a scenario's step of it ends the run."""

    class Ended(SimpleNamespace):
        def simulated(self) -> None:
            raise WriteRefusedError("the mapping has no entry for setpoint")

    ended = Ended(session=SimpleNamespace(loops=[SimpleNamespace(trend=SimpleNamespace(rows=1))]), ended_by="")
    job = SimpleNamespace(config=SimpleNamespace(simulated=True))
    session, stopped = commands_run._play(job, ended)  # type: ignore[arg-type]
    assert (session, stopped) == (ended.session, True)
    assert ended.ended_by == "the mapping has no entry for setpoint"


# A short soak; the 24 hours of 32 loops are a nightly command


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


# Real records: a servo under PID is admitted and read, a heater's step makes the first model and settings


DATA = Path(__file__).parents[1] / "data"


def columns(name: str) -> FloatArray:
    return np.loadtxt(DATA / name, delimiter=",", skiprows=1).T


def table(gains: PidGains) -> GainTable:
    return GainTable("real", Regions("sp", "-", ("all",), -1e6, (), 1e6), (gains,))


@pytest.fixture(scope="module")
def servo() -> tuple[ResponseFinder, Completed, PidGains]:
    """The first completed response of the servo's record (its gains are not told; these have its time scale)."""
    gains = PidGains(1.0, 1.0 / 0.04)
    finder = ResponseFinder(table(gains).regions, table(gains).at, RetunerSettings(0.002, 130.0))
    for t, sp, pv, co in columns("servo/pid_step.csv").T:
        seen = finder.step(LoopSample(float(t), float(sp), float(pv), float(co)))
        if isinstance(seen, Completed):
            return finder, seen, gains
    raise AssertionError("no response was recognised")


def test_a_real_response_is_admitted_and_its_pattern_read(servo: tuple[ResponseFinder, Completed, PidGains]) -> None:
    finder, seen, gains = servo
    window = finder.window(seen.response)
    assert admit(window, finder.samples, seen.response, AdmissionSettings()).admitted
    advice = pattern_rule(seen.response, window, gains, None, PatternSettings())
    assert advice.reading is PatternReading.CALM  # it overshoots by two percent
    assert advice.numbers.to_dict()["overshoot"] == pytest.approx(0.02, abs=0.01)
    assert advice.reading in MOVING


def test_the_slow_oscillation_rule_says_why_it_is_silent_on_it(servo):
    _, seen, gains = servo
    advice = slow_oscillation_online(seen.response, gains, None, SlowSettings())
    assert advice.reading is not SlowReading.APPLIES
    assert advice.tuning is None


def test_a_real_step_of_a_heater_makes_the_first_settings() -> None:
    t, pv, co = columns("heater/open_loop_step.csv")
    gains = PidGains(2.0, 2.0 / 300)
    retuner = Retuner(table(gains), RetunerSettings(1.0, 100.0, Mode.AUTO))
    retuner.observe(LoopSample(float(t[-1]) + 10.0, float(pv[0]), float(pv[0]), float(co[0])))
    decision = pretune(retuner, 0, Window(t, np.full_like(pv, pv[0]), pv, co))
    model = retuner.region_models[0].log.model()
    assert model.k / (model.tau1_s + model.theta_s) == pytest.approx(0.361 / 152, rel=0.15)  # the record's own notes
    assert decision.basis is Basis.PRETUNE
    assert decision.action is Action.WRITE
    assert decision.gains_after.ki > gains.ki
