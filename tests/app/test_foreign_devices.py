"""Controllers that are not ours, from the configuration to the ledger: checked, run, refused in one clear line."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import answer, printed, refused

from retuner import PidGains, load_config
from retuner.adaptive.trial.phase import TrialEvent, TrialPhase, after
from retuner.cli import main
from retuner.config.described import make_access
from retuner.drivers.bus.bus import CanLink
from retuner.drivers.controller.firmware_settings import VirtualDeviceSettings
from retuner.drivers.device import DeviceStopped
from retuner.drivers.plants.plant import Plant
from retuner.drivers.profiles.bench_loop import BenchLoop
from retuner.ledger import LedgerReader
from retuner.session.ledger_rows import abort_cause, trouble

EXAMPLES = Path(__file__).parents[2] / "examples"
PROFILES = ("odrive", "cia402", "cia404")


def rows(folder: Path, kind: str) -> list[dict[str, object]]:
    with LedgerReader(folder / "ledger.sqlite") as ledger:
        return [dict(row.body) for row in ledger.rows() if row.kind == kind]


def run(config: Path, out: Path, *more: str) -> dict[str, object]:
    result: dict[str, object] = answer("run", config, "--out", out, "--no-compare", *more)
    return result


@pytest.mark.parametrize("profile", PROFILES)
def test_the_examples_are_short_and_those_that_init_writes(profile: str, tmp_path: Path) -> None:
    text = (EXAMPLES / f"{profile}.toml").read_text()
    assert len(text.splitlines()) < 40
    assert main(["init", str(tmp_path / "mine.toml"), "--profile", profile]) == 0
    assert (tmp_path / "mine.toml").read_text() == text


@pytest.mark.slow
def test_a_set_of_three_messages_is_written_in_an_order_that_was_proved(tmp_path):
    text = (EXAMPLES / "cia404.toml").read_text().replace("duration_s = 6000.0", "duration_s = 900.0")
    text = text.replace("kc = 2.0", "kc = 3.2").replace("tau_i_s = 120.0", "tau_i_s = 50.0")
    config = tmp_path / "loop.toml"
    steps = "    { at_s = 0.0, sp = 150.0 }, { at_s = 100.0, sp = 170.0 },\n]\n"
    config.write_text(text[: text.index("    { at_s = 0.0")] + steps)
    run(config, tmp_path / "run")
    orders = rows(tmp_path / "run", "order_of_writes")
    committed = rows(tmp_path / "run", "committed")
    assert committed
    assert orders[0]["proved"] is True
    assert 1.0 < float(str(orders[0]["ms_between"])) < 2.1
    decision = next(row for row in rows(tmp_path / "run", "decision") if row["gains_after"])
    assert committed[0]["gains"] == decision["gains_after"]  # what was proved is what the node holds, bit for bit
    again = answer("replay", tmp_path / "run")
    assert (again["identical"], again["samples"]) == (True, rows(tmp_path / "run", "end")[0]["samples"])


def test_a_log_without_notes_of_samples_says_so(tmp_path: Path) -> None:
    text = (EXAMPLES / "odrive.toml").read_text().replace("duration_s = 120.0", "duration_s = 4.0")
    (tmp_path / "loop.toml").write_text(text[: text.index("steps = [")] + "steps = [{ at_s = 0.0, sp = 0.0 }]\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CanLink, "note", lambda *_: None)  # as releases before did
        run(tmp_path / "loop.toml", tmp_path / "run")
    assert "no sample is noted in it" in printed("replay", tmp_path / "run", status=1)


@pytest.mark.slow
def test_without_read_back_and_without_the_users_word_it_is_advice(tmp_path):
    text = (EXAMPLES / "odrive.toml").read_text().replace('accept = ["no_read_back"]', "")
    config = tmp_path / "loop.toml"
    config.write_text(
        text.replace("duration_s = 120.0", "duration_s = 40.0").replace(
            text[text.index("{ at_s = 50.0") : text.index("]\n", text.index("{ at_s = 50.0"))], ""
        )
    )
    result = run(config, tmp_path / "run")
    assert result["decisions"]
    for kind in ("intent", "committed", "trial"):
        assert rows(tmp_path / "run", kind) == []


CO = "co = { scale = 5.0 }"
GAINS = "gains = { scale = 50.0 }"
BAD = [
    ('profile = "odrive"', 'profile = "odrives"', ':24 device.profile = "odrives" is no profile; there is cia402,'),
    (CO, 'co = { signal = "Iq_Wanted" }', "device.co.signal: odrive-cansimple.dbc: message 'Axis0_Get_Iq' has no"),
    (CO, 'dbc = "nowhere.dbc"', "device.dbc: nowhere.dbc: cannot be read: No such file or directory"),
    (CO, 'pv = { message = "Axis0_Enc" }', "device.pv.message: odrive-cansimple.dbc: no message 'Axis0_Enc'; there"),
    (GAINS, "gains = { scale = 0.0 }", "device.gains.kp: "),
    (GAINS, "gains = { scal = 50.0 }", "device.gains.scal is not a known key; did you mean scale?"),
    ("node = 0", "node = 99", "has no identifier"),
    ("node = 0", 'node = 0\nfixed = { "Axis0_Set_Input_Vel.Torque" = 1.0 }', "has no signal 'Torque'; there is Input_"),
    ('accept = ["no_read_back"]', 'accept = ["anything"]', "device.accept"),
    (
        CO,
        f'{CO}\nsetpoint = {{ message = "Axis0_Set_Vel_Gains", signal = "Vel_Gain" }}',
        "device.gains.kp: odrive-cansimple.dbc: Axis0_Set_Vel_Gains.Vel_Gain is both setpoint and gains.kp; give each",
    ),
]


@pytest.mark.parametrize(("before", "after", "told"), BAD)
def test_what_is_wrong_is_one_line_with_the_key(before, after, told, tmp_path):
    text = (EXAMPLES / "odrive.toml").read_text()
    assert before in text
    path = tmp_path / "loop.toml"
    path.write_text(text.replace(before, after))
    (line,) = refused("check", path).splitlines()
    assert told in line


CIA404 = 'profile = "cia404"'
BAD_OBJECTS = [
    (CIA404, f'{CIA404}\nsetpoint = {{ object = "6130:1" }}', "device.setpoint.object: cia404.eds: object 6130:1 (AI"),
    (CIA404, f'{CIA404}\npv = {{ object = "6131" }}', "device.pv.object: cia404.eds: no object '6131'; there is"),
    (CIA404, f'{CIA404}\npv = {{ object = "6130" }}', "device.pv.object: cia404.eds: object 6130 has parts; name one"),
    (CIA404, f'{CIA404}\npv = {{ object = "6130:7" }}', "device.pv.object: cia404.eds: object 6130 has no part '7'"),
    (CIA404, f'{CIA404}\npv = {{ object = "1018:1" }}\neds = "pyproject.toml"', "device.eds: pyproject.toml: "),
    ('kind = "canopen"', 'kind = "dbc"', 'device.profile = "cia404" is for kind = "canopen"'),
    ("node = 5", "node = 5\n[loop.x]", "not a known key"),
]


@pytest.mark.parametrize(("before", "after", "told"), BAD_OBJECTS)
def test_what_is_wrong_with_objects_is_told_too(before, after, told, tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text((EXAMPLES / "cia404.toml").read_text().replace(before, after))
    assert told in refused("check", path)


def test_gains_that_the_device_cannot_hold_are_refused_before_anything_runs(tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text((EXAMPLES / "cia402.toml").read_text().replace("kc = 1.5", "kc = -1.5"))
    assert "cannot hold the gains of region all: kp: -15000 is outside 0 to" in refused("check", path)


def test_a_controller_that_runs_what_no_region_has_is_not_written_over(tmp_path, capsys, monkeypatch):
    made = BenchLoop.__init__

    def otherwise(loop: BenchLoop, settings: VirtualDeviceSettings, plant: Plant) -> None:
        made(loop, replace(settings, gains=PidGains(3.0, 0.02)), plant)

    monkeypatch.setattr(BenchLoop, "__init__", otherwise)
    assert main(["run", str(EXAMPLES / "cia404.toml"), "--out", str(tmp_path / "run"), "--no-compare"]) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert "it runs kp = 3, ki = 0.02, kd = 0 (parallel), which no region has" in told


def test_another_number_for_an_action_replaces_that_of_the_profile(tmp_path: Path) -> None:
    path = tmp_path / "loop.toml"
    text = (EXAMPLES / "cia404.toml").read_text()
    path.write_text(text.replace('profile = "cia404"', 'profile = "cia404"\ngains = { kp = { object = "6450:1" } }'))
    device = load_config(path).foreign_device
    assert device is not None
    assert [str(gain.quantity) for gain in device.gains.gains()] == ["kp", "tn", "tv"]


def test_without_the_package_the_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "retuner.drivers.canopen.canopen_access", None)
    assert 'pip install "retuner[canopen]"' in refused("check", EXAMPLES / "cia404.toml")


def test_a_stop_of_the_device_ends_a_trial_and_is_told() -> None:
    stopped = DeviceStopped("emergency 0x4210")
    assert trouble(stopped) == ("stopped", {"reason": "emergency 0x4210"})
    cause = abort_cause(stopped)
    assert cause is TrialEvent.DEVICE_STOPPED
    assert after(TrialPhase.TRIAL, cause) is TrialPhase.RESTORING


def test_a_virtual_device_needs_a_profile_or_a_configuration() -> None:
    assert main(["device"]) == 2
    assert "there is cia402, cia404, odrive" in refused("device", "--profile", "nothing")


# What docs/devices.md says that a profile can do is what it can do.


ROOT = Path(__file__).parents[2]


def promised() -> dict[str, dict[str, bool]]:
    """The table of the page: promise to profile to whether it holds."""
    text = (ROOT / "docs" / "devices.md").read_text()
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    start = next(
        i for i, cells in enumerate(lines) if cells[1:] == ["native", *PROFILES] or cells == ["native", *PROFILES]
    )
    names = ("native", *PROFILES)
    rows = [cells for cells in lines[start + 1 :] if len(cells) == 5]
    return {cells[0]: dict(zip(names, (cell == "yes" for cell in cells[1:]), strict=True)) for cells in rows}


@pytest.mark.parametrize("profile", PROFILES)
def test_the_page_says_what_the_profile_can_do(profile: str) -> None:
    config = load_config(ROOT / "examples" / f"{profile}.toml")
    assert config.foreign_device is not None
    access = make_access(config, config.foreign_device)
    table = promised()
    assert len(table) == 7
    assert table["whole set at once"][profile] == access.units.atomic
    assert table["gains read back"][profile] == access.reads_back
    assert table["each write acknowledged"][profile] == access.acknowledges
    stops = bool(config.foreign_device.stop) or config.foreign_device.kind == "canopen"  # emergencies
    assert table["tells of a stop of its own"][profile] == stops
    assert all(table["whole set at once"][name] for name in ("native",))
