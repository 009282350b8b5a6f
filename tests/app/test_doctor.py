"""retuner doctor: each check does the thing itself, and says what to do where it fails."""

import json
import os
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import answer, refused, run

from retuner.cli import main
from retuner.commands import doctor
from retuner.commands.doctor import Level, MachineFinding, findings
from retuner.drivers.device import BusError


def finding(name: str, folder: Path) -> MachineFinding:
    return next(one for one in findings(folder) if one.name.startswith(name))


def test_a_healthy_machine_works_and_every_line_has_its_level(tmp_path: Path) -> None:
    done = run("doctor", "--folder", tmp_path)

    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("retuner works here\n")
    assert f"folder {tmp_path}: a ledger can be kept here" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_quiet_leaves_out_what_works(tmp_path: Path) -> None:
    done = run("doctor", "-q", "--folder", tmp_path)

    assert "\nok " not in "\n" + done.stdout
    assert done.stdout.endswith("retuner works here\n")


def test_json_is_one_document_with_every_finding(tmp_path: Path) -> None:
    told = json.loads(run("doctor", "--folder", tmp_path, "--json").stdout)

    assert told["ok"] is True
    assert {"Python", "retuner", "engine of fits", "virtual bus", "timer"} <= {one["name"] for one in told["findings"]}
    assert all(set(one) == {"name", "level", "what", "remedy"} for one in told["findings"])
    assert all(one["remedy"] for one in told["findings"] if one["level"] != "ok")


def test_a_folder_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    done = run("doctor", "--folder", tmp_path / "nowhere")

    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1


def test_a_folder_that_takes_no_file_is_broken_and_ends_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(doctor, "TemporaryDirectory", full)
    done = run("doctor", "--folder", tmp_path)

    assert done.returncode == 1
    assert f"does not work here: folder {tmp_path}\n" in done.stdout
    assert "No space left on device" in done.stdout


def test_a_missing_package_of_the_base_is_broken_and_of_an_extra_is_not(tmp_path, monkeypatch):
    real = doctor.version

    def without(name: str) -> str:
        if name in {"filterpy", "canopen"}:
            raise PackageNotFoundError(name)
        return "1.0" if name == "pyarrow" else real(name)

    monkeypatch.setattr(doctor, "version", without)

    assert finding("retuner", tmp_path).level == Level.BROKEN
    assert finding("extra canopen", tmp_path) == MachineFinding(
        "extra canopen", Level.OPTIONAL, "canopen is not installed", 'pip install "retuner[canopen]"'
    )
    assert finding("extra parquet", tmp_path).what == "pyarrow 1.0 is there, >=15 is needed"


def test_numpy_in_place_of_the_compiled_engine_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retuner.adaptive.fit.engine._preferred", ["numpy"])

    found = finding("engine of fits", tmp_path)

    assert (found.level, "slower" in found.what) == (Level.OPTIONAL, True)


def test_a_wrong_name_of_an_engine_is_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("retuner.adaptive.fit.engine._preferred", ["fortran"])

    assert finding("engine of fits", tmp_path).level == Level.BROKEN


def test_a_bus_that_cannot_be_opened_tells_its_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(interface: str, *_: object) -> str:
        raise BusError(f"bus {interface}: cannot open it: no; install it")

    monkeypatch.setattr(doctor, "_there_and_back", refused)

    assert finding("udp_multicast", tmp_path).remedy == "install it"
    assert finding("virtual bus", tmp_path).level == Level.BROKEN


def interfaces(folder: Path, monkeypatch: pytest.MonkeyPatch, **flags: str) -> None:
    for name, value in {**flags, "lo": "0x9"}.items():
        (folder / name).mkdir(parents=True)
        (folder / name / "type").write_text("772\n" if name == "lo" else "280\n")
        (folder / name / "flags").write_text(value)
    monkeypatch.setattr(doctor, "NETWORK", folder)


def test_can_interfaces_are_listened_to_and_nothing_is_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[object] = []
    bus = SimpleNamespace(shutdown=lambda: None, send=sent.append)
    interfaces(tmp_path / "net", monkeypatch, can0="0x1", can1="0x0")
    monkeypatch.setattr("retuner.drivers.bus.bus_opening.open_bus", lambda *_: bus)

    told = {one.name: one for one in doctor._socketcan()}

    assert (told["SocketCAN can0"].level, told["SocketCAN can1"].what) == (Level.OK, "is down")
    assert told["SocketCAN can1"].remedy == "ip link set can1 up"
    assert (len(told), sent) == (2, [])


def test_a_late_timer_says_for_which_loops_it_is_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(10**6))
    slow = SimpleNamespace(perf_counter=lambda: next(clock) * 0.06, sleep=lambda _: None, monotonic=lambda: 0.0)
    monkeypatch.setattr(doctor, "time", slow)

    found = doctor._timer()

    assert (found.level, "55.0 ms" in found.what, "0.6 s" in found.remedy) == (Level.OPTIONAL, True, True)


def test_a_narrow_screen_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout", SimpleNamespace(encoding="ascii"))
    monkeypatch.setitem(os.environ, "NO_COLOR", "1")

    found = doctor._terminal()

    assert (found.level, "NO_COLOR" in found.what) == (Level.OPTIONAL, True)


def test_adapters_are_asked_only_when_it_is_wanted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = [{"interface": "pcan", "channel": "PCAN_USBBUS1"}, {"interface": "virtual", "channel": "x"}]
    monkeypatch.setattr("can.detect_available_configs", lambda: seen)

    asked = [one for one in findings(tmp_path, adapters=True) if one.name == "CAN adapters"]

    assert [one.what for one in asked] == ["pcan PCAN_USBBUS1"]
    assert not [one for one in findings(tmp_path) if one.name == "CAN adapters"]


# retuner check refuses what `run` would refuse before it opens a bus: an unknown interface, an unusable key file.


OVEN = Path(__file__).resolve().parents[2] / "examples" / "oven.toml"


def configured(folder: Path, interface: str, key_file: Path | None = None) -> Path:
    text = OVEN.read_text()
    assert 'interface = "virtual"\n' in text
    key = f'key_file = "{key_file}"\n' if key_file else ""
    path = folder / "loop.toml"
    path.write_text(text.replace('interface = "virtual"\n', f'interface = "{interface}"\n{key}'))
    return path


def test_every_problem_is_one_line_with_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = configured(tmp_path, "sockercan", tmp_path / "nokey")
    line = path.read_text().splitlines().index('interface = "sockercan"') + 1
    assert main(["check", str(path)]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f'{path}:{line} bus.interface = "sockercan" is no interface of python-can; choose from ')
    assert "socketcan" in first
    assert second.startswith(f"{path}:{line + 1} bus.key_file is refused: key file {tmp_path / 'nokey'}: ")
    told = answer("check", path, status=2)
    assert [one["key"] for one in told["problems"]] == ["bus.interface", "bus.key_file"]


@pytest.mark.parametrize("interface", ["virtual", "socketcan", "udp_multicast", "kvaser"])
def test_a_known_interface_and_a_good_key_pass(tmp_path: Path, interface: str) -> None:
    key = tmp_path / "key"
    key.write_text("00" * 32)
    key.chmod(0o600)
    assert main(["check", str(configured(tmp_path, interface, key))]) == 0


def test_a_key_that_others_may_read_is_refused(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("00" * 32)
    key.chmod(0o644)
    assert "others can read or write it" in refused("check", str(configured(tmp_path, "virtual", key)))
