"""retuner experiment from end to end: recordings, on demand, confirmed and unconfirmed writes, Ctrl-C, bad input."""

import io
import json
import signal
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from command_line import answer, refused
from shared_time import SharedTime

from retuner import LinearProcess, PidGains, load_config
from retuner.adaptive.experiments.phases import Phase
from retuner.adaptive.experiments.plan import Experiment
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.cli import main
from retuner.commands.experiment import ExperimentSignal, plan_for
from retuner.commands.signatures import RelayOptions
from retuner.config.bench_plants import known_plant
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.clock import MonotonicClock
from retuner.drivers.controller.device_process import DeviceOnBus, run_devices
from retuner.drivers.controller.virtual_device import VirtualDevice
from retuner.drivers.device import Bench
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.errors import LedgerError
from retuner.experiment.findings import ExperimentQuestion, evaluate
from retuner.experiment.on_demand import OnDemandExperiment, write_settings
from retuner.experiment.runner import ExperimentRunner
from retuner.ledger import Ledger, LedgerReader
from retuner.session.assembly import link_settings, virtual_device_settings
from retuner.session.bench_or_buses import live, simulated
from retuner.session.running import nothing

SERVO = Path(__file__).parents[1] / "data" / "servo" / "relay.csv"
HEATER = Path(__file__).parents[1] / "data" / "heater" / "open_loop_step.csv"
LOOP = """
schema = 1
loop = { name = "bench", pv_unit = "bar", pv_min = 0.0, pv_max = 10.0, sample_time_s = 0.1 }
schedule = { region = [{ name = "all", kc = 3.0, tau_i_s = 4.0 }] }
output = { directory = "out" }
[device]
kind = "virtual"
seed = 3
[device.plant]
kind = "linear"
k = 0.1
lags_s = [5.0, 0.1]
theta_s = 0.4
start_pv = 4.0
start_co_pct = 40.0
noise = 0.01
"""
TRUE = LinearProcess(0.1, (5.0, 0.1), (), 0.4)


@pytest.fixture
def loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())  # no terminal
    path = tmp_path / "bench.toml"
    path.write_text(LOOP, encoding="utf-8")
    return path


def said(capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    document = json.loads(capsys.readouterr().out)
    assert isinstance(document, dict)
    return document


def rows(folder: Path) -> list[tuple[str, dict[str, object]]]:
    with LedgerReader(folder / "ledger.sqlite") as ledger:
        assert ledger.verify().ok
        return [(row.kind, json.loads(row.text)) for row in ledger.rows()]


# on demand, on the virtual device


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("step", ["--amplitude", "10"]),
        ("relay", ["--amplitude", "10"]),
        ("setpoint", ["--amplitude", "0.3", "--kc0", "70"]),
    ],
)
def test_an_experiment_finds_the_process_and_writes_nothing_unasked(kind, options, loop, capsys):
    assert main(["experiment", kind, str(loop), *options, "--json"]) == 0
    found = said(capsys)
    assert found["experiment"] == kind
    assert found["restored"] is True
    assert found["applied"] is False
    assert found["identifiable"] is True
    model = found["model"]
    slope = model["k"] / model["tau1"] if model["tau1"] else model["k"]
    assert slope == pytest.approx(0.1 / 5.0, rel=0.1)
    assert model["theta"] + model["tau2"] == pytest.approx(0.5, abs=0.12)
    gains = found["gains"]
    assert gains["kc"] == pytest.approx(5.0 / (0.1 * 2 * 0.55), rel=0.2)
    folder = loop.parent / "out-experiment"
    assert {p.name for p in folder.iterdir()} >= {
        "record.csv",
        "trend.csv",
        "experiment.png",
        "summary.json",
        "ledger.sqlite",
        "bus.blf",
    }
    kinds = [row_kind for row_kind, _ in rows(folder)]
    assert "intent" not in kinds
    phases = [body["phase"] for row_kind, body in rows(folder) if row_kind == "experiment"]
    assert phases == ["resting", "before", "preparing", "exciting", "parking", "restoring", "restored"]
    assert json.loads((folder / "summary.json").read_text()) == found


def test_the_record_that_is_left_can_be_evaluated_again(loop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiment", "setpoint", str(loop), "--amplitude", "0.3", "--kc0", "70", "--json"]) == 0
    first = said(capsys)
    record = loop.parent / "out-experiment" / "record.csv"
    options = ["--from", str(record), "--kc0", "70", "--rule", "setpoint-overshoot"]
    assert main(["experiment", "setpoint", *options, "--json"]) == 0
    again = said(capsys)
    assert again["measured"] == first["measured"]
    assert again["rule"] == "setpoint-overshoot"
    methods = again["methods"]
    assert methods["two-step"] == first["methods"]["two-step"]  # type: ignore[index]  # the same document's shape


def test_confirmed_settings_are_written_read_back_and_recorded(loop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiment", "step", str(loop), "--amplitude", "10", "--yes", "--json"]) == 0
    found = said(capsys)
    assert found["applied"] is True
    assert found["write"] == ""
    kinds = [(kind, body) for kind, body in rows(loop.parent / "out-experiment") if kind in {"intent", "committed"}]
    assert [kind for kind, _ in kinds] == ["intent", "committed"]
    parallel = found["parallel"]
    assert isinstance(parallel, dict)
    committed = kinds[1][1]["gains"]
    assert committed["kp"] == pytest.approx(parallel["kp"], rel=1e-6)
    assert kinds[0][1]["why"] == kinds[1][1]["why"] == "experiment"


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "applied"), [(True, True), (False, False)])
def test_at_a_terminal_the_person_is_asked(answer, applied, loop, monkeypatch, capsys):
    asked = []

    def confirm(text: str, default: bool) -> bool:
        asked.append((text, default))
        return answer

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr("retuner.experiment.on_demand.typer.confirm", confirm)
    assert main(["experiment", "step", str(loop), "--amplitude", "10"]) == 0
    assert asked == [("write these settings to the controller?", False)]
    assert json.loads((loop.parent / "out-experiment" / "summary.json").read_text())["applied"] is applied
    assert ("written, read back and running" in capsys.readouterr().out) is applied


def test_settings_beyond_the_configured_limits_are_not_written_even_when_confirmed(loop, capsys):
    loop.write_text(LOOP + "[adaptation]\nkc_max = 10.0\n", encoding="utf-8")
    assert main(["experiment", "step", str(loop), "--amplitude", "10", "--yes", "--json"]) == 1
    found = said(capsys)
    assert found["applied"] is False
    assert "kc_max" in str(found["write"])


@pytest.mark.slow
@pytest.mark.parametrize("phase", [Phase.RESTING, Phase.PREPARING, Phase.EXCITING, Phase.RESTORING])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_restores_and_says_so(phase, number, loop, monkeypatch):
    told = OnDemandExperiment._on_sample
    sent = []

    def on_sample(self: OnDemandExperiment, sample: LoopSample, at: Phase) -> None:
        told(self, sample, at)
        if at is phase and not sent:
            sent.append(1)
            signal.raise_signal(number)

    monkeypatch.setattr(OnDemandExperiment, "_on_sample", on_sample)
    assert main(["experiment", "relay", str(loop), "--amplitude", "10", "--yes"]) == 130
    summary = json.loads((loop.parent / "out-experiment" / "summary.json").read_text())
    assert summary["ended"]["cause"] == "interrupted"
    assert summary["restored"] is True
    assert summary["applied"] is False
    assert summary["touched"] == (phase is not Phase.RESTING)


def test_an_abort_is_the_answer_no(loop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiment", "step", str(loop), "--amplitude", "10", "--time", "1", "--yes", "--json"]) == 1
    found = said(capsys)
    assert found["ended"]["cause"] == "time"  # type: ignore[index]  # a document of known shape
    assert found["applied"] is False
    assert main(["experiment", "step", str(loop), "--amplitude", "20", "--deviation", "0.5", "--json"]) in {0, 1}
    assert said(capsys)["restored"] is True


def test_a_controller_that_dies_is_told_with_the_state_to_bring_back(loop, monkeypatch, capsys):
    told, sample_of = OnDemandExperiment._on_sample, DeviceOnBus.sample
    dead = []

    def on_sample(self: OnDemandExperiment, sample: LoopSample, at: Phase) -> None:
        told(self, sample, at)
        dead.extend([1] if at is Phase.EXCITING else [])

    def sample(self: DeviceOnBus, dt_s: float | None = None) -> None:
        if dead:
            self.link.receive_all()
        else:
            sample_of(self, dt_s)

    monkeypatch.setattr(OnDemandExperiment, "_on_sample", on_sample)
    monkeypatch.setattr(DeviceOnBus, "sample", sample)
    assert main(["experiment", "relay", str(loop), "--amplitude", "10", "--yes", "--json"]) == 1
    shown = capsys.readouterr()
    assert "NOT RESTORED" in shown.err
    assert "sp 4, mode auto" in shown.err
    assert shown.err.count("\n") == 1
    found = json.loads(shown.out)
    assert found["restored"] is False
    assert found["ended"] == {**found["ended"], "phase": "stranded", "cause": "silent"}


@pytest.mark.parametrize("rows_kept", [0, 1, 2, 5])
def test_a_ledger_that_fails_is_one_line_and_the_loop_is_as_before(rows_kept, loop, monkeypatch, capsys):
    kept = []
    append = Ledger.append

    def full(self: Ledger, kind: str, body: dict[str, object], clock_s: float) -> object:
        if len(kept) == rows_kept:
            raise LedgerError("the disk is full")
        kept.append(kind)
        return append(self, kind, body, clock_s)

    monkeypatch.setattr(Ledger, "append", full)
    assert main(["experiment", "step", str(loop), "--amplitude", "10", "--yes"]) == 2
    assert capsys.readouterr().err == "the disk is full\n"
    folder = loop.parent / "out-experiment"
    assert folder.exists() == (rows_kept > 0)
    if folder.exists():
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["restored"] is True
        assert summary["applied"] is False
        assert summary["ended"]["cause"] == "recorder"


ON_DEMAND_REFUSED = [
    (["step", "--amplitude", "0"], "amplitude = 0"),
    (["step", "--amplitude", "nan"], "amplitude = nan"),
    (["step", "--amplitude", "70"], "--amplitude"),
    (["relay", "--amplitude", "-5"], "amplitude = -5"),
    (["relay", "--cycles", "1"], "cycles = 1"),
    (["relay", "--bias", "0.9"], "bias = 0.9"),
    (["relay", "--hysteresis", "-1"], "--hysteresis -1"),
    (["setpoint", "--kc0", "0"], "gain of the experiment is 0"),
    (["step", "--pv-low", "5"], "--pv-low"),
    (["step", "--pv-low", "8", "--pv-high", "2"], "lower end"),
    (["step", "--deviation", "0"], "deviation = 0"),
    (["step", "--time", "-1"], "time_s = -1"),
    (["step", "--rest", "-1"], "rest_time_s = -1"),
    (["step", "--method", "eye"], "--method eye"),
    (["step", "--rule", "luck"], "--rule luck"),
    (["step", "--speed", "3"], "--speed"),
    (["step", "--from", "x.csv"], "not both"),
]


@pytest.mark.parametrize(("arguments", "words"), ON_DEMAND_REFUSED)
def test_bad_options_are_one_line_status_2_and_leave_nothing_behind(arguments, words, loop):
    assert words in refused("experiment", arguments[0], loop, *arguments[1:], "--json")
    assert not (loop.parent / "out-experiment").exists()


def test_without_config_or_recording_one_line_says_what_to_give() -> None:
    assert "CONFIG" in refused("experiment", "step")


def test_a_configuration_without_a_device_is_refused(loop: Path) -> None:
    loop.write_text(LOOP[: LOOP.index("[device]")], encoding="utf-8")
    assert "[device]" in refused("experiment", "step", loop)


# live: a device in its own thread on a bus in real time, faster


def test_a_live_bus_is_experimented_with_and_restored(loop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config(loop)
    config = config.model_copy(update={"bus": config.bus.model_copy(update={"channel": "experiment-live"})})
    speed, stop, shared = 20.0, threading.Event(), SharedTime(2)
    shared.govern(monkeypatch)
    plant = known_plant(config)
    assert plant is not None
    machine = VirtualDevice(virtual_device_settings(config), plant)

    def be_device() -> None:
        clock = MonotonicClock(speed)
        try:
            with CanLink(link_settings(config, speed), clock) as link:
                run_devices([DeviceOnBus(machine, link)], clock, stop=stop.is_set)
        finally:
            shared.leave()

    thread = threading.Thread(target=be_device)
    thread.start()
    try:
        plan = plan_for(config, Experiment.RELAY, RelayOptions(), ExperimentSignal(10.0, cycles=2, bias=0.3))
        with live(config, speed) as bench:
            conductor = ExperimentRunner(bench.device, plan, 0.1, bench.device.settings.silent_s, nothing)
            while not conductor.phase.over:
                conductor.poll(bench.turn())
    finally:
        stop.set()
        shared.leave()
        thread.join()
    assert conductor.phase is Phase.RESTORED
    assert conductor.cause is None
    assert machine.auto
    assert machine.sp == pytest.approx(4.0, abs=0.1)
    found = evaluate(Window.of(conductor.excited), ExperimentQuestion(Experiment.RELAY))
    assert found.ultimate is not None
    model = found.fit.estimate.log.model()
    assert model.slope == pytest.approx(0.02, rel=0.2)
    assert 2.0 < found.ultimate[1] < 5.0  # 2.2 s without noise, hysteresis and the delay of a host in real time


# the write itself


@pytest.fixture
def connected(loop: Path) -> Iterator[tuple[Bench, PidGains]]:
    with simulated(load_config(loop), lambda _: None) as bench:
        for _ in range(20):
            bench.device.poll(bench.turn())
        yield bench, bench.device.running.gains


class Kept(list[str]):
    """The kinds of rows that were recorded."""

    def __call__(self, kind: str, t_s: float, body: object) -> None:
        del t_s, body
        self.append(kind)


def test_a_write_on_another_base_than_shown_is_refused(connected: tuple[Bench, PidGains]) -> None:
    (bench, base), kept = connected, Kept()
    reason = write_settings(bench, 0.1, kept, PidGains(5.0, 1.0), PidGains(base.kp * 2, base.ki))
    assert "have changed since these settings were shown" in reason
    assert kept == ["refused"]
    assert bench.device.running.gains == base


def test_a_set_outside_the_box_is_refused_by_the_controller_and_told(connected: tuple[Bench, PidGains]) -> None:
    (bench, base), kept = connected, Kept()
    assert write_settings(bench, 0.1, kept, PidGains(-5.0, -1.0), base)
    assert kept == ["intent", "refused"]
    assert bench.device.running.gains == base


def test_a_set_that_runs_under_a_later_number_is_written(connected, monkeypatch):
    (bench, base), kept = connected, Kept()
    begin = bench.device.begin_write  # a set is staged again, with the next number, where its lease ran out meanwhile
    monkeypatch.setattr(bench.device, "begin_write", lambda gains, now_s: begin(gains, now_s) - 1)
    assert write_settings(bench, 0.1, kept, PidGains(5.0, 1.0), base) == ""
    assert kept == ["intent", "committed"]


def test_ctrl_c_during_a_write_is_heard_after_its_end(connected: tuple[Bench, PidGains]) -> None:
    (bench, base), kept = connected, Kept()
    turns = iter(range(1000))

    def turn() -> float:
        if next(turns) == 3:
            raise KeyboardInterrupt
        return bench.turn()

    with pytest.raises(KeyboardInterrupt):
        write_settings(Bench(bench.device, turn, bench.silent_s), 0.1, kept, PidGains(5.0, 1.0), base)
    assert kept == ["intent", "committed"]
    assert bench.device.running.gains == PidGains(5.0, 1.0)


# recordings


def test_the_heater_step_is_identified_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "heater.png"
    assert main(["experiment", "step", "--from", str(HEATER), "--json", "--plot", str(picture)]) == 0
    found = said(capsys)
    assert found["model"]["k"] == pytest.approx(0.361, rel=0.05)  # type: ignore[index]  # a document of known shape
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_an_export_with_units_and_stamps_is_the_same_experiment(tmp_path, capsys):
    model = dict(answer("experiment", "step", "--from", HEATER)["model"])
    names, *rows = [line.split(",") for line in HEATER.read_text().splitlines()]
    assert names[0] == "t"
    begin = datetime(2024, 3, 14, 6, tzinfo=UTC)
    place = {name: names.index(name) for name in ("t", "pv", "co")}
    lines = ["Zeit;Istwert;Stellwert"]
    for row in rows:
        t, pv, co = (row[place[name]] for name in ("t", "pv", "co"))
        stamp = f"{begin + timedelta(seconds=float(t)):%d.%m.%Y %H:%M:%S.%f}"
        lines.append(";".join([stamp, f"{pv.replace('.', ',')} °C", co.replace(".", ",")]))
    file = tmp_path / "heater.csv"
    file.write_text("\n".join(lines), encoding="latin-1")

    assert main(["experiment", "step", "--from", str(file), "--json"]) == 0
    shown = capsys.readouterr()
    again = json.loads(shown.out)["model"]
    assert again.pop("type") == model.pop("type")
    assert again == pytest.approx(model, rel=1e-5)
    assert "decimal comma" in shown.err
    assert "pv in °C, as its values say" in shown.err


def test_the_servo_relay_gives_settings_by_the_ultimate_rules(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--from", str(SERVO), "--rule", "zn-ultimate", "--kind", "pid", "--json"]
    assert main(["experiment", "relay", *options]) == 0
    found = said(capsys)
    ultimate, gains = found["measured"]["ultimate"], found["gains"]  # type: ignore[index]  # a document of known shape
    assert ultimate["pu"] == pytest.approx(0.041, abs=0.001)
    assert gains["kc"] == pytest.approx(0.6 * ultimate["ku"])
    assert gains["tau_i"] == pytest.approx(ultimate["pu"] / 2)
    assert gains["tau_d"] == pytest.approx(ultimate["pu"] / 8)


def test_without_a_usable_method_the_answer_is_no_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiment", "step", "--from", str(HEATER), "--method", "two-point", "--json"]) == 1
    found = said(capsys)
    assert found["gains"] is None
    assert "more than one step" in str(found["reason"])


def swing_file(path: Path, kc: float) -> Path:
    plant = LinearPlant(LinearProcess(4.0, (7.0,), (), 3.5), start_co=0.0, co_min=-1e9, co_max=1e9)
    co, lines = 0.0, ["t,sp,pv,co"]
    for i in range(2000):
        pv = plant.step(co, 0.0, 0.1)
        sp = 1.0 if i > 20 else 0.0
        co = kc * (sp - pv)
        lines.append(f"{i * 0.1!r},{sp!r},{pv!r},{co!r}")
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_a_sustained_swing_gives_the_ultimate_gain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Putra's example 4 e^-3.5s/(7s + 1): printed Ku 0.95, Pu 12, Ziegler-Nichols 0.57, 6.0, 1.5."""
    file = swing_file(tmp_path / "swing.csv", 0.95)
    options = ["--from", str(file), "--kc", "0.95", "--kind", "pid", "--json"]
    assert main(["experiment", "ultimate", *options]) == 0
    gains = said(capsys)["gains"]
    assert gains["kc"] == pytest.approx(0.57)
    assert gains["tau_i"] == pytest.approx(6.0, abs=0.06)
    assert gains["tau_d"] == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize(("kc", "words"), [(0.7, "raise the gain"), (1.1, "lower the gain")])
def test_a_swing_that_is_not_sustained_says_where_to_go(kc, words, tmp_path, capsys):
    file = swing_file(tmp_path / "swing.csv", kc)
    assert main(["experiment", "ultimate", "--from", str(file), "--kc", str(kc)]) == 1
    assert words in capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "text", "words"),
    [
        ("relay", "t,pv,co\n0,1,1\n1,2,1\n2,3,1\n3,4,1\n", "co is 1"),
        ("setpoint", "t,pv,co\n0,1,1\n1,2,2\n2,3,1\n", "sp"),
        ("step", "t,pv\n0,1\n", 'no column "co"'),
        ("step", "t,pv,co\n0,1,1\n1,2,x\n2,3,1\n", ":3: co"),
    ],
)
def test_recordings_that_cannot_be_used_are_one_line(kind, text, words, tmp_path):
    file = tmp_path / "bad.csv"
    file.write_text(text, encoding="utf-8")
    assert words in refused("experiment", kind, "--from", file, "--json")


def test_a_short_record_of_noise_carries_no_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(7)
    lines = ["t,sp,pv,co", *(f"{i},0.0,{rng.normal()!r},{float(i > 20)}" for i in range(60))]
    file = tmp_path / "noise.csv"
    file.write_text("\n".join(lines).replace("np.float64(", "").replace(")", ""), encoding="utf-8")
    assert main(["experiment", "step", "--from", str(file), "--json"]) == 1
    assert said(capsys)["identifiable"] is False
