"""Real SocketCAN: controllers and sessions as processes on vcan0, and a listener that decodes frames by the DBC.

The virtual device, the firmware in C and a CANopen node that knows nothing of us (examples/nodes) are retuned there.

vcan0 is this kernel's where it makes one, else that of a user-mode Linux; see scripts/socketcan/run.py. Where there is
neither, the test is skipped with the command that would change it; RETUNER_REQUIRE_SOCKETCAN=1 makes that a failure.
"""

import json
import math
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import can
import cantools
import pytest
from once import once

from retuner.config import load_config
from retuner.ledger import LedgerReader

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
NODES = ROOT / "examples" / "nodes"
RUNNER = ROOT / "scripts" / "socketcan" / "run.py"
IMPOSSIBLE = 77  # the runner's status when there is no way to a vcan0
NODE = 5  # as in tank.toml
MARGIN = 0.2  # share by which the written gains may miss those of SIMC for the true plant


def run_inside(*command: str | Path, timeout_s: float = 240) -> subprocess.CompletedProcess[str]:
    """Run a command where there is a vcan0, or skip."""
    done = subprocess.run(
        [sys.executable, RUNNER, "--timeout", str(timeout_s), "--", *map(str, command)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    if done.returncode == IMPOSSIBLE:
        reason = done.stderr.strip().splitlines()[-1]
        if os.environ.get("RETUNER_REQUIRE_SOCKETCAN"):
            pytest.fail(f"RETUNER_REQUIRE_SOCKETCAN is set, but {reason}")
        pytest.skip(reason)
    return done


def run_on_vcan(out: Path, *groups: str) -> None:
    """Loops on one vcan0, of one boot, and what they leave in a folder."""
    folder = ROOT / "drivers" / "firmware"
    subprocess.run(["make", "-s", "-C", folder, f"BUILD={out}", "all"], check=True, timeout=120)
    job = [sys.executable, "-P", HERE / "loops_job.py", out / "retuner-firmware", out, *groups]
    done = run_inside(*job, timeout_s=900)
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stderr, end="")


@pytest.fixture(scope="module")
def loops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the virtual device and the session with it left: the nightly's, for imports take a minute there.

    In CI a device and a host speak on vcan0 in test_faults.py, and both commands over udp_multicast as README prints
    them.
    """
    return once(tmp_path_factory, "socketcan-loops", lambda out: run_on_vcan(out, "tank"))


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that controllers of others, the firmware and its examination left: minutes, so the nightly's.

    In CI such controllers speak over udp_multicast, and the firmware is examined on a bus of its own. One emulated CPU
    bears two loops only while the machine does nothing else.
    """
    groups = ("firmware", "zone+conformance", "axis")
    return once(tmp_path_factory, "socketcan-strangers", lambda out: run_on_vcan(out, *groups))


def ended(folder: Path, name: str) -> tuple[int, int]:
    """Exit status of the session with a loop, and of its device; nothing told a traceback."""
    outcome = next(group for group in json.loads((folder / "outcome.json").read_text()) if name in group["device"])
    told = "".join((folder / f"{name}.{end}").read_text() for end in ("err", "device"))
    assert "Traceback" not in told
    assert outcome["heard"], told
    return outcome["run"][name], outcome["device"][name]


def kinds(folder: Path, name: str) -> list[str]:
    """The rows of a loop's ledger, whose chain holds and whose head is the one that was told."""
    with LedgerReader(folder / name / "ledger.sqlite") as ledger:
        assert ledger.verify().ok
        assert ledger.head() == json.loads((folder / f"{name}.json").read_text())["ledger_head"]
        return [row.kind for row in ledger.rows()]


def of_node(path: Path, node: int) -> Iterator[can.Message]:
    """The frames under a node's identifiers, as the native protocol has them."""
    with can.LogReader(path) as log:
        yield from (one for one in log if one.arbitration_id >> 5 == node and not one.is_extended_id)


@pytest.mark.nightly
def test_both_processes_end_well(loops: Path) -> None:
    assert ended(loops, "tank") == (0, 130)  # Ctrl-C
    assert " samples" in (loops / "tank.device").read_text()


@pytest.mark.nightly
def test_the_loop_was_retuned_and_the_ledger_says_so(loops: Path) -> None:
    found = kinds(loops, "tank")
    assert found.index("intent") < found.index("committed")
    config = load_config(HERE / "tank.toml")
    before = config.gains()[0]
    after = json.loads((loops / "tank.json").read_text())["gains"][0]
    plant = config.device.plant
    assert plant.kind == "linear"
    simc_kp = plant.lags_s[0] / (plant.k * 2 * plant.theta_s)  # tau_c = theta
    assert after["kp"] != before.kp
    assert math.isclose(after["kp"], simc_kp, rel_tol=MARGIN)


@pytest.mark.nightly
def test_every_frame_on_the_bus_decodes_by_the_dbc(loops: Path) -> None:
    database = cantools.database.load_string(files("retuner.drivers").joinpath("retuner.dbc").read_text(), "dbc")
    names = Counter[str]()
    for message in of_node(loops / "capture.log", NODE):
        layout = database.get_message_by_frame_id(1 << 5 | message.arbitration_id % 32)  # the DBC is that of node 1
        assert len(message.data) == layout.length
        values = layout.decode(bytes(message.data))
        assert isinstance(values, dict)
        assert all(math.isfinite(v) for v in values.values() if isinstance(v, int | float)), (layout.name, values)
        names[layout.name] += 1
    assert names["TELEMETRY_PV"] > 250
    assert min(names[name] for name in ("HEARTBEAT", "SETPOINT", "STAGE", "COMMIT", "ACK", "PAGE")) >= 1, names


@pytest.mark.nightly
def test_the_run_logged_the_same_bus(loops: Path) -> None:
    logged = Counter(message.arbitration_id for message in of_node(loops / "tank" / "bus.blf", NODE))
    heard = Counter(message.arbitration_id for message in of_node(loops / "capture.log", NODE))
    assert set(logged) <= set(heard)
    stage_and_commit = {NODE << 5 | 4, NODE << 5 | 5}
    assert {i: logged[i] for i in stage_and_commit} == {i: heard[i] for i in stage_and_commit}


@pytest.mark.nightly
def test_the_firmware_in_c_is_retuned_by_what_it_does_itself(strangers: Path) -> None:
    assert ended(strangers, "firmware") == (0, 0)
    found = kinds(strangers, "firmware")
    assert found.index("intent") < found.index("committed") < found.index("trial")
    before = load_config(NODES / "firmware.toml").gains()[0]
    after = json.loads((strangers / "firmware.json").read_text())["gains"][0]
    assert after["kp"] > 1.3 * before.kp  # its plant: 1.2, 30 s, 5 s of dead time; SIMC has 2.5


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["zone", "axis"])
def test_a_strangers_controller_is_retuned_by_its_description_and_40_lines(name: str, strangers: Path) -> None:
    assert len((NODES / f"{name}.toml").read_text().splitlines()) < 40
    assert ended(strangers, name) == (0, 0)
    assert "committed" in kinds(strangers, name)
    assert (strangers / f"{name}.device").read_text()  # and the controller tells its new gains too


@pytest.mark.nightly
def test_its_gains_travel_by_sdo_in_an_order_that_was_proved(strangers: Path) -> None:
    with LedgerReader(strangers / "zone" / "ledger.sqlite") as ledger:
        orders = [row.body for row in ledger.rows() if row.kind == "order_of_writes"]
    assert all(order["proved"] for order in orders), orders
    with can.LogReader(strangers / "capture.log") as capture:
        written = [message.data for message in capture if message.arbitration_id == 0x609 and message.data[0] == 0x2B]
    assert (0x2110, 2) in {(int.from_bytes(data[1:3], "little"), data[3]) for data in written}  # Tn


@pytest.mark.nightly
def test_the_firmware_in_c_keeps_the_protocol_on_a_real_bus(strangers: Path) -> None:
    assert ended(strangers, "conformance") == (0, 0)
    examined = json.loads((strangers / "conformance.json").read_text())
    assert examined["findings"] == []
    assert examined["tried"] > 150


@pytest.mark.slow
@pytest.mark.uncounted
def test_the_runner_hands_on_output_and_status() -> None:
    done = run_inside("sh", "-c", "ip -brief link show vcan0; echo to stderr >&2; exit 5")
    assert done.returncode == 5, done.stderr
    assert "vcan0" in done.stdout
    assert "to stderr" in done.stderr


@pytest.mark.slow
@pytest.mark.uncounted
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
@pytest.mark.uncounted
def test_kernel_can_is_used_where_there_is_one() -> None:
    done = run_inside(sys.executable, RUNNER, "--", "ip", "-brief", "link", "show", "vcan0")
    assert done.returncode == 0, done.stderr
    assert "vcan0 of this kernel" in done.stderr
    assert "vcan0" in done.stdout
