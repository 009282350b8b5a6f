"""retuner run --pretune: first model and settings from a commanded step, and every way in which there are none."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from command_line import answer
from recorded import bodies

from retuner import Action, GainTable, LoopSample, Mode, PidGains, Regions, Retuner, RetunerSettings, load_config
from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.experiments.phases import AbortCause, Phase
from retuner.cli import main
from retuner.drivers.controller.device_process import DeviceOnBus
from retuner.errors import LedgerError
from retuner.experiment.runner import ExperimentRunner
from retuner.session.ledger_rows import feed
from retuner.session.pretuning import row
from retuner.session.running import Run

LOOP = """
schema = 1
loop = {{ name = "tank", pv_unit = "degC", pv_min = 0.0, pv_max = 100.0, sample_time_s = 1.0 }}
schedule = {{ variable = "sp", region = [{{ name = "all", kc = 1.5, tau_i_s = 80.0 }}] }}
scenario = {{ duration_s = 20.0, steps = [{{ at_s = 0.0, sp = 50.0 }}] }}
device.seed = 1
[device.plant]
kind = "linear"
k = 1.0
lags_s = [40.0]
theta_s = 4.0
start_pv = 50.0
start_co_pct = {start_co}
noise = 0.05
"""

Made = Callable[..., Path]


@pytest.fixture
def loop(tmp_path: Path) -> Made:
    def make(start_co: float = 50.0) -> Path:
        path = tmp_path / "tank.toml"
        path.write_text(LOOP.format(start_co=start_co))
        return path

    return make


def ran(path: Path, *options: str) -> tuple[int, Path]:
    folder = path.parent / "run"
    return main(["run", str(path), "--pretune", "--no-compare", "--out", str(folder), "--json", *options]), folder


def test_the_first_settings_come_from_the_step_and_a_replay_decides_them_again(loop, capsys):
    status, folder = ran(loop(), "--mode", "auto")
    assert status == 0
    document = json.loads(capsys.readouterr().out)
    first = document["decisions"][0]
    assert (first["action"], first["basis"], first["records"]) == ("commit", "pretune", 1)
    assert first["reason"].startswith("pretune, from a commanded step of co")
    model = first["estimate"]["model"]
    assert (model["k"], model["tau1"], model["theta"]) == pytest.approx((1.0, 40.0, 4.0), rel=0.1)
    assert first["verdict"]["accepted"]
    assert first["promise"] is not None
    assert first["gains_after"]["kp"] > 1.5
    assert bodies(folder, "committed")[0]["why"] == "retune"
    phases = [body["phase"] for body in bodies(folder, "experiment")]
    assert phases == ["resting", "before", "preparing", "exciting", "parking", "restoring", "restored"]
    assert len(bodies(folder, "pretune")) == 1
    assert (folder / "pretune-bus.blf").exists()
    assert "pretune = true" in (folder / "config.toml").read_text()
    replayed = answer("replay", folder)
    assert replayed["identical"]
    assert replayed["decisions"][0]["basis"] == "pretune"


def test_in_advise_the_settings_are_a_proposal_and_nothing_is_written(loop, capsys):
    status, folder = ran(loop())
    assert status == 0
    first = json.loads(capsys.readouterr().out)["decisions"][0]
    assert (first["action"], first["basis"]) == ("advise", "pretune")
    assert first["gains_after"] is not None
    assert not bodies(folder, "intent")


def test_where_nothing_but_watching_is_allowed_nothing_is_moved(loop: Made, capsys: pytest.CaptureFixture[str]) -> None:
    status, folder = ran(loop(), "--mode", "off")
    assert status == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "mode off only watches" in error
    assert not folder.exists()


def test_an_aborted_step_is_taken_back_and_the_run_goes_on_without_it(loop, capsys, monkeypatch):
    poll_of = ExperimentRunner.poll

    def poll(self: ExperimentRunner, now_s: float) -> None:
        poll_of(self, now_s)
        if self.phase is Phase.EXCITING and len(self.samples) - self.excited_from == 5:
            self.abort(AbortCause.FOREIGN, "by the test")

    monkeypatch.setattr(ExperimentRunner, "poll", poll)
    status, folder = ran(loop())
    assert status == 0
    assert all(decision["basis"] != "pretune" for decision in json.loads(capsys.readouterr().out)["decisions"])
    rows = bodies(folder, "experiment")
    assert rows[-1]["phase"] == "restored"
    assert "by the test" in rows[-1]["cause"]
    assert not bodies(folder, "pretune")
    assert bodies(folder, "end")[0]["interrupted"] is False


def test_a_loop_without_room_for_the_step_is_one_line_and_untouched(loop, capsys):
    status, _ = ran(loop(start_co=97.0))
    assert status == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "nothing was changed" in error
    assert "97" in error


def test_a_controller_that_never_comes_back_does_not_begin_a_run(loop, capsys, monkeypatch):
    sample_of, note_of = DeviceOnBus.sample, ExperimentRunner._note
    dead: list[bool] = []

    def note(self: ExperimentRunner, body: Mapping[str, Any]) -> None:
        note_of(self, body)
        dead.extend([True] if body.get("phase") == "exciting" else [])

    def sample(self: DeviceOnBus, dt_s: float | None = None) -> None:
        if dead:
            self.link.receive_all()
        else:
            sample_of(self, dt_s)

    monkeypatch.setattr(ExperimentRunner, "_note", note)
    monkeypatch.setattr(DeviceOnBus, "sample", sample)
    status, folder = ran(loop())
    assert status == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "NOT RESTORED" in error
    assert "sp 50, mode auto" in error
    assert bodies(folder, "experiment")[-1]["phase"] == "stranded"
    assert not bodies(folder, "link")


@pytest.mark.parametrize("phase", ["resting", "exciting"])
def test_a_ledger_that_fails_ends_the_step_and_the_loop_is_as_before(phase: str, loop: Made) -> None:
    seen: list[Phase] = []
    moved = ExperimentRunner._move
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ExperimentRunner, "_move", lambda self, what: (moved(self, what), seen.append(self.phase))[0])

        def record(kind: str, t_s: float, body: Mapping[str, object]) -> None:
            del kind, t_s
            if body.get("phase") == phase:
                raise LedgerError("the disk is full")

        config = load_config(loop())
        config = config.model_copy(update={"adaptation": config.adaptation.model_copy(update={"pretune": True})})
        with pytest.raises(LedgerError, match="the disk is full"):
            Run(config, record).simulated()
    assert seen[-1] is Phase.RESTORED


def test_ctrl_c_takes_the_step_back_before_it_ends_the_run(loop: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[tuple[Phase, AbortCause | None]] = []
    poll_of, conduct_of = ExperimentRunner.poll, ExperimentRunner.conduct

    def poll(self: ExperimentRunner, now_s: float) -> None:
        poll_of(self, now_s)
        if self.phase is Phase.EXCITING and len(self.samples) - self.excited_from == 5:
            raise KeyboardInterrupt

    def conduct(self: ExperimentRunner, turn: Callable[[], float]) -> None:
        conduct_of(self, turn)
        ended.append((self.phase, self.cause))

    monkeypatch.setattr(ExperimentRunner, "poll", poll)
    monkeypatch.setattr(ExperimentRunner, "conduct", conduct)
    assert ran(loop())[0] == 130
    assert ended == [(Phase.RESTORED, AbortCause.INTERRUPTED)]


def stepped() -> list[LoopSample]:
    """An exact step of 5 % on e^-4s/(40 s + 1), a little noise that repeats."""
    rows, x = [], 0.0
    for i in range(120):
        wobble = 0.02 * ((i * 7919) % 13 - 6) / 6
        rows.append(LoopSample(float(i), 50.0, 50.0 + x + wobble, 55.0 if i >= 30 else 50.0, mode=0))
        x += ((5.0 if i - 4 >= 30 else 0.0) - x) * 0.0247
    return rows


@pytest.mark.parametrize("mode", Mode)
def test_what_follows_is_the_modes_affair(mode: Mode) -> None:
    table = GainTable("loop", Regions("sp", "-", ("all",), 0.0, (), 100.0), (PidGains(1.5, 1.5 / 80),))
    retuner = Retuner(table, RetunerSettings(1.0, 100.0, mode))
    retuner.observe(LoopSample(500.0, 50.0, 50.0, 50.0))
    body = json.loads(json.dumps(row("all", stepped())))
    decision = feed(retuner, "pretune", body, 500.0)
    assert 0 in retuner.region_models
    wanted = {Mode.OFF: Action.NONE, Mode.ADVISE: Action.ADVISE, Mode.TRIAL: Action.WRITE, Mode.AUTO: Action.WRITE}
    assert decision.action is wanted[mode]
    assert decision.basis is Basis.PRETUNE
    assert (decision.gains_after is None) == (mode is Mode.OFF)


def test_a_record_that_shows_nothing_changes_nothing() -> None:
    table = GainTable("loop", Regions("sp", "-", ("all",), 0.0, (), 100.0), (PidGains(1.5, 1.5 / 80),))
    retuner = Retuner(table, RetunerSettings(1.0, 100.0, Mode.AUTO))
    retuner.observe(LoopSample(500.0, 50.0, 50.0, 50.0))
    flat = [s._replace(pv=50.0 + 0.02 * ((i * 7919) % 13 - 6)) for i, s in enumerate(stepped())]
    decision = feed(retuner, "pretune", row("all", flat), 500.0)
    assert decision.action is Action.NONE
    assert decision.gains_after is None
    assert decision.reason.startswith("pretune")
