"""Real SocketCAN: a device and a host as two processes on vcan0, and a listener that decodes every frame by the DBC.

vcan0 is this kernel's where it makes one, else that of a user-mode Linux; see scripts/socketcan/run.py. Where there is
neither, the test is skipped with the command that would change it; RETUNER_REQUIRE_SOCKETCAN=1 makes that a failure.
"""

import json
import math
import os
import subprocess
import sys
from collections import Counter
from importlib.resources import files
from pathlib import Path

import can
import cantools
import pytest
from once import once

from retuner.config import load_config
from retuner.ledger import LedgerReader

HERE = Path(__file__).resolve().parent
RUNNER = HERE.parents[1] / "scripts" / "socketcan" / "run.py"
IMPOSSIBLE = 77  # the runner's status when there is no way to a vcan0
SPEED = "10"  # times real time: 20 samples a second on an emulated CPU with 100 ticks
NODE = 5  # as in tank.toml
MARGIN = 0.2  # share by which the written gains may miss those of SIMC for the true plant


def run_inside(*command: str | Path, timeout_s: float = 240) -> subprocess.CompletedProcess[str]:
    """Run a command where there is a vcan0, or skip."""
    done = subprocess.run(
        [sys.executable, RUNNER, "--timeout", str(timeout_s), "--", *map(str, command)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == IMPOSSIBLE:
        reason = done.stderr.strip().splitlines()[-1]
        if os.environ.get("RETUNER_REQUIRE_SOCKETCAN"):
            pytest.fail(f"RETUNER_REQUIRE_SOCKETCAN is set, but {reason}")
        pytest.skip(reason)
    return done


@pytest.fixture(scope="module")
def retuned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that one retuning run over vcan0 left."""

    def retune(out: Path) -> None:
        done = run_inside(sys.executable, "-P", HERE / "retune_job.py", HERE / "tank.toml", out, SPEED)
        assert done.returncode == 0, done.stdout + done.stderr
        print(done.stderr, end="")

    return once(tmp_path_factory, "socketcan-retuned", retune)


@pytest.mark.slow
def test_both_processes_end_well(retuned: Path) -> None:
    outcome = json.loads((retuned / "outcome.json").read_text())
    errors = (retuned / "run.err").read_text() + (retuned / "device.err").read_text()
    assert outcome["heard"], errors
    assert outcome["run"] == 0, errors
    assert outcome["device"] == 130, errors  # Ctrl-C
    assert "Traceback" not in errors
    assert " samples" in (retuned / "device.err").read_text()


@pytest.mark.slow
def test_the_loop_was_retuned_and_the_ledger_says_so(retuned: Path) -> None:
    with LedgerReader(retuned / "run" / "ledger.sqlite") as ledger:
        assert ledger.verify().ok
        kinds = [row.kind for row in ledger.rows()]
        assert kinds.index("intent") < kinds.index("committed")
        assert ledger.head() == json.loads((retuned / "run.json").read_text())["ledger_head"]
    config = load_config(HERE / "tank.toml")
    before = config.gains()[0]
    after = json.loads((retuned / "run.json").read_text())["gains"][0]
    assert config.device is not None
    plant = config.device.plant
    assert plant.kind == "linear"
    simc_kp = plant.lags_s[0] / (plant.k * 2 * plant.theta_s)  # tau_c = theta
    assert after["kp"] != before.kp
    assert math.isclose(after["kp"], simc_kp, rel_tol=MARGIN)


@pytest.mark.slow
def test_every_frame_on_the_bus_decodes_by_the_dbc(retuned: Path) -> None:
    database = cantools.database.load_string(files("retuner.drivers").joinpath("retuner.dbc").read_text(), "dbc")
    names = Counter[str]()
    with can.LogReader(retuned / "capture.log") as capture:
        for message in capture:
            node, command = divmod(message.arbitration_id, 32)
            layout = database.get_message_by_frame_id(1 << 5 | command)  # the DBC is written for node 1
            assert node == NODE
            assert not message.is_extended_id
            assert len(message.data) == layout.length
            values = layout.decode(bytes(message.data))
            assert isinstance(values, dict)
            assert all(math.isfinite(v) for v in values.values() if isinstance(v, int | float)), (layout.name, values)
            names[layout.name] += 1
    assert names["TELEMETRY_PV"] > 250
    assert min(names[name] for name in ("HEARTBEAT", "SETPOINT", "STAGE", "COMMIT", "ACK", "PAGE")) >= 1, names


@pytest.mark.slow
def test_the_run_logged_the_same_bus(retuned: Path) -> None:
    with can.LogReader(retuned / "run" / "bus.blf") as log:
        logged = Counter(message.arbitration_id for message in log)
    with can.LogReader(retuned / "capture.log") as capture:
        heard = Counter(message.arbitration_id for message in capture)
    assert set(logged) <= set(heard)
    stage_and_commit = {NODE << 5 | 4, NODE << 5 | 5}
    assert {i: logged[i] for i in stage_and_commit} == {i: heard[i] for i in stage_and_commit}


@pytest.mark.slow
def test_a_canopen_node_is_retuned_too(tmp_path: Path) -> None:
    done = run_inside(sys.executable, "-P", HERE / "retune_job.py", HERE / "zone.toml", tmp_path, SPEED, timeout_s=400)
    assert done.returncode == 0, done.stdout + done.stderr
    outcome = json.loads((tmp_path / "outcome.json").read_text())
    errors = (tmp_path / "run.err").read_text() + (tmp_path / "device.err").read_text()
    assert (outcome["heard"], outcome["run"], outcome["device"]) == (True, 0, 130), errors
    with LedgerReader(tmp_path / "run" / "ledger.sqlite") as ledger:
        rows = list(ledger.rows())
    orders = [row.body for row in rows if row.kind == "order_of_writes"]
    assert orders[0]["proved"], orders
    committed = [row.body for row in rows if row.kind == "committed"]
    assert committed, errors
    with can.LogReader(tmp_path / "capture.log") as capture:
        written = [message.data for message in capture if message.arbitration_id == 0x605 and message.data[0] == 0x23]
    objects = {int.from_bytes(data[1:3], "little") for data in written}
    assert {0x6450, 0x6452} <= objects  # by SDO, as any CANopen tool would see it


@pytest.mark.slow
def test_the_runner_hands_on_output_and_status() -> None:
    done = run_inside("sh", "-c", "ip -brief link show vcan0; echo to stderr >&2; exit 5")
    assert done.returncode == 5, done.stderr
    assert "vcan0" in done.stdout
    assert "to stderr" in done.stderr


@pytest.mark.slow
def test_the_runner_ends_what_takes_too_long() -> None:
    done = run_inside("sh", "-c", "while :; do :; done", timeout_s=6)
    assert done.returncode == 75
    assert "not done after 6 s" in done.stderr


def test_the_runner_says_what_is_missing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, RUNNER, "--", "true"], capture_output=True, text=True, check=False, env={"PATH": str(tmp_path)}
    )
    assert done.returncode == IMPOSSIBLE
    assert "apt-get install -y user-mode-linux" in done.stderr


@pytest.mark.slow
def test_kernel_can_is_used_where_there_is_one() -> None:
    done = run_inside(sys.executable, RUNNER, "--", "ip", "-brief", "link", "show", "vcan0")
    assert done.returncode == 0, done.stderr
    assert "vcan0 of this kernel" in done.stderr
    assert "vcan0" in done.stdout


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the firmware in C left: examined and run against on vcan0."""

    def examine(out: Path) -> None:
        folder = HERE.parents[1] / "drivers" / "firmware"
        subprocess.run(["make", "-s", "-C", folder, f"BUILD={out}", "all"], check=True, timeout=120)
        program = out / "retuner-firmware"
        done = run_inside(sys.executable, "-P", HERE / "firmware_job.py", program, out, SPEED)
        assert done.returncode == 0, done.stdout + done.stderr

    return once(tmp_path_factory, "socketcan-firmware", examine)


@pytest.mark.slow
def test_the_firmware_in_c_keeps_the_protocol_on_a_real_bus(firmware: Path) -> None:
    examined = json.loads((firmware / "conformance.json").read_text())
    assert examined["findings"] == []
    assert examined["tried"] > 150


@pytest.mark.slow
def test_a_session_writes_its_gains_to_the_firmware_in_c(firmware: Path) -> None:
    outcome = json.loads((firmware / "outcome.json").read_text())
    assert outcome == {"conformance": 0, "run": 0, "device": 0}, (firmware / "run.json").read_text()
    with LedgerReader(firmware / "run" / "ledger.sqlite") as ledger:
        assert ledger.verify().ok
        assert "committed" in [row.kind for row in ledger.rows()]
