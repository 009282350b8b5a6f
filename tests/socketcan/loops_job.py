"""Run where there is a vcan0: several controllers, a session with each, and a listener that writes down every frame.

    python loops_job.py FIRMWARE OUT NAME[+NAME] ...

Loops that are joined share the bus and the time; "conformance" is the examination of the firmware in C. Leaves in OUT
capture.log (candump's format), conformance.json, outcome.json (exit statuses by loop), and of each loop NAME.err,
NAME.json (what `retuner run --json` printed), NAME.device and the folder NAME that a run leaves.
"""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import can

CHANNEL = "vcan0"
PATIENCE_S = 90.0  # for every controller's first frame: imports take their time on one emulated CPU
HERE = Path(__file__).resolve().parent
NODES = HERE.parents[1] / "examples" / "nodes"
RETUNER = [sys.executable, "-P", "-c", "import sys; from retuner.cli import main; sys.exit(main())"]
BUS = ["-i", "socketcan", "-c", CHANNEL]
SPEED = "10"  # times real time: 20 samples a second on an emulated CPU with 100 ticks
PLANT = ["-n", "2", "-t", "0.5", "-g", "10", "-w", "0.05"]  # 5 s of dead time, and noise
Process = subprocess.Popen[bytes]


class Loop(NamedTuple):
    """The controller's command, an identifier that it sends under, the configuration, and its speed."""

    device: list[str]
    heard: int
    config: Path
    speed: str = SPEED


def loops(firmware: str, store: Path) -> dict[str, Loop]:
    """All there are, by name."""
    tank, python, board = HERE / "tank.toml", [sys.executable, "-P"], [firmware, "-i", CHANNEL, "-x", SPEED]
    own, zone = ["device", str(tank), *BUS, "--speed", SPEED], [str(NODES / "zone_node.py"), *BUS, "--speed", SPEED]
    return {
        "tank": Loop([*RETUNER, *own], 5 << 5 | 0x12, tank),
        "axis": Loop([*python, str(NODES / "axis_node.py"), *BUS], 3 << 5 | 0x09, NODES / "axis.toml", "1"),
        "zone": Loop([*python, *zone], 0x709, NODES / "zone.toml"),
        "firmware": Loop([*board, *PLANT], 2 << 5 | 0x12, NODES / "firmware.toml"),
        "conformance": Loop([*board, "-n", "1", "-s", str(store)], 1 << 5 | 0x12, Path()),
    }


def await_frames(bus: can.BusABC, wanted: set[int]) -> bool:
    """Whether a frame under each identifier has come in time."""
    for _ in range(int(100 * PATIENCE_S)):
        message = bus.recv(1.0)
        if message is not None:
            wanted.discard(message.arbitration_id)
        if not wanted:
            return True
    return False


def start(command: list[str], out: Path) -> Process:
    """A process whose words go into a file."""
    with out.open("wb") as file:
        return subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)


def session(name: str, loop: Loop, out: Path) -> Process:
    """`retuner run`, or the examination."""
    command = [*RETUNER, "run", str(loop.config), *BUS, "--out", str(out / name)]
    if name == "conformance":
        command = [*RETUNER, "conformance", *BUS, "--node", "1"]
    with (out / f"{name}.json").open("wb") as told, (out / f"{name}.err").open("wb") as err:
        return subprocess.Popen([*command, "--speed", loop.speed, "--json"], stdout=told, stderr=err)


def run_together(made: dict[str, Loop], out: Path) -> dict[str, object]:
    """Devices first; sessions when all of them are heard. Exit statuses of both."""
    outcome: dict[str, object] = {"heard": False}
    with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
        devices = {name: start(loop.device, out / f"{name}.device") for name, loop in made.items()}
        if await_frames(bus, {loop.heard for loop in made.values()}):
            sessions = {name: session(name, loop, out) for name, loop in made.items()}
            outcome = {"heard": True, "run": {name: process.wait() for name, process in sessions.items()}}
    for device in devices.values():
        device.send_signal(signal.SIGINT)
    return {**outcome, "device": {name: device.wait(PATIENCE_S) for name, device in devices.items()}}


def main() -> int:
    firmware, out, groups = sys.argv[1], Path(sys.argv[2]), [group.split("+") for group in sys.argv[3:]]
    known = loops(firmware, out / "store")
    with can.Bus(interface="socketcan", channel=CHANNEL) as ear, can.CanutilsLogWriter(out / "capture.log") as capture:
        notifier = can.Notifier(ear, [capture])
        outcome = [run_together({name: known[name] for name in group}, out) for group in groups]
        notifier.stop()
    (out / "outcome.json").write_text(json.dumps(outcome))
    return 0


if __name__ == "__main__":
    sys.exit(main())
