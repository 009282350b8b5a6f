"""Many loops in one session, in real time, with decisions being made: is a sample lost, and what does a loop cost?

    python benchmarks/many_loops.py [--loops 32] [--rate 100] [--seconds 90] [--seed 1] [--hogs 0]

`retuner device` is all controllers, `retuner run` watches them on udp_multicast (no frame leaves this machine), and a
bare python-can reader beside it receives the same frames and does nothing with them: what it takes is the measure of
CPU time. Every loop's setpoint steps every 20 s at a time of its own, so there is always a decision on its way.
--hogs : endless loops beside it all. CPU time is that of the process, without the workers', while the scenario goes on.

Prints one JSON document; status 1 when a sample was lost, a write was refused, or nothing was decided.
"""

import argparse
import collections
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

from retuner.drivers.protocol.frames import HIGHEST_NODE
from retuner.ledger import LedgerReader

GROUP = "239.74.163.48"
STEP_S = 20.0
START_S, END_S = 15.0, 120.0  # what imports and connecting take, and how long the end may
HOG = "import os\nwhile os.getppid() == {p}: pass"
BARE = """
import can, sys
bus = can.Bus(interface="udp_multicast", channel="{group}", hop_limit=0)
while True:
    bus.recv(timeout=1.0)
"""
HEAD = """schema = 1
schedule = {{ variable = "sp", region = [{{ name = "all", kc = {kc}, tau_i_s = 0.5 }}] }}
adaptation = {{ mode = "auto" }}
bus = {{ interface = "udp_multicast", channel = "{group}" }}
output = {{ directory = "unused" }}
"""
LOOP = """[[loop]]
name = "loop {node}"
pv_unit = "%"
pv_min = 0.0
pv_max = 100.0
sample_time_s = {dt}
bus = {{ node = {node} }}
scenario = {{ duration_s = {seconds}, steps = [{steps}] }}
device.seed = {node}
[loop.device.plant]
kind = "linear"
k = {k:.4f}
lags_s = [{lag:.4f}]
theta_s = {theta:.4f}
start_pv = 50.0
noise = 0.05
"""


def configuration(loops: int, rate: float, seconds: float, seed: int) -> str:
    """So many loops with lags of 0.4 to 0.8 s, most of them sluggish at first."""
    rng = random.Random(seed)
    text = HEAD.format(kc=0.4, group=GROUP)
    for node in range(1, loops + 1):
        lag, first = rng.uniform(0.4, 0.8), rng.uniform(2.0, STEP_S)
        times = [0.0, *(first + i * STEP_S for i in range(int((seconds - first - 1) / STEP_S) + 1))]
        steps = ", ".join(f"{{ at_s = {t:.2f}, sp = {50.0 + 10.0 * (i % 2)} }}" for i, t in enumerate(times))
        plant = {"k": rng.uniform(0.8, 1.5), "lag": lag, "theta": lag * rng.uniform(0.1, 0.25)}
        text += LOOP.format(node=node, dt=1 / rate, seconds=seconds, steps=steps, **plant)
    return text


def cpu_s(pid: int) -> float:
    """CPU time that a process has taken so far, without its children."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measured(folder: Path, text: str, seconds: float, hogs: int) -> dict[str, float]:
    """Shares of a core of the device, the session and the bare reader, while the scenario goes on."""
    (folder / "many.toml").write_text(text)
    program = [sys.executable, "-P", "-m", "retuner"]
    commands = {
        "devices": [*program, "device", str(folder / "many.toml")],
        "bare python-can": [sys.executable, "-c", BARE.format(group=GROUP)],
        "session": [*program, "run", str(folder / "many.toml"), "--speed", "1", "--out", str(folder / "run")],
    }
    with ExitStack() as stack, (folder / "said.txt").open("wb") as said:
        for _ in range(hogs):
            _started(stack, [sys.executable, "-c", HOG.format(p=os.getpid())], said)
        running = {name: _started(stack, command, said) for name, command in commands.items()}
        time.sleep(START_S)
        before, began_s = {name: cpu_s(one.pid) for name, one in running.items()}, time.monotonic()
        time.sleep(seconds - START_S - 5.0)
        took_s = time.monotonic() - began_s
        shares = {name: (cpu_s(one.pid) - before[name]) / took_s for name, one in running.items()}
        last_s = time.monotonic() + seconds + END_S
        while not ended(folder) and time.monotonic() < last_s and running["session"].poll() is None:
            time.sleep(1.0)  # the reports that come after it are not what is measured
    return shares


def ended(folder: Path) -> bool:
    """Whether the session has written its last row."""
    path = folder / "run" / "ledger.sqlite"
    if not path.exists():  # many loops on a busy machine take their time to begin
        return False
    with LedgerReader(path) as ledger:
        return any(row.kind == "end" for row in ledger.rows())


def _started(stack: ExitStack, command: list[str], said: BinaryIO) -> subprocess.Popen[bytes]:
    """A program that is ended with the measurement."""
    process = subprocess.Popen(command, stdout=said, stderr=said)
    stack.callback(process.wait)
    stack.callback(process.kill)
    return process


def told(folder: Path) -> dict[str, Any]:
    with LedgerReader(folder / "run" / "ledger.sqlite") as ledger:
        rows = list(ledger.rows())
    bodies = collections.defaultdict(list)
    for row in rows:
        bodies[row.kind].append(row.body)
    late = [body["delay"]["entered"] - body["delay"]["raised"] for body in bodies["decision"] if body.get("delay")]
    return {
        "samples": sum(body["samples"] for body in bodies["over"]),
        "lost": sum(body["count"] for body in bodies["lost"]),
        "bus faults": sum(body["times"] for body in bodies["bus"]),
        "decisions": len(bodies["decision"]),
        "decisions that did not come in time": sum(
            body["code"] in {"decision_late", "decision_lost"} for body in bodies["decision"]
        ),
        "overtaken": sum(body["code"].startswith("overtaken") for body in bodies["decision"]),
        "entered after samples, median": statistics.median(late) if late else None,
        "entered after samples, most": max(late, default=None),
        "writes": sum(body["why"] != "schedule" for body in bodies["committed"]),
        "refused": len(bodies["refused"]),
        "refused, why": dict(collections.Counter(str(body["reason"]) for body in bodies["refused"])),
        "out of reach": sum(body["state"] != "up" for body in bodies["link"]),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=32, choices=range(1, HIGHEST_NODE + 1), metavar="1..63")
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hogs", type=int, default=0)
    arguments = parser.parse_args()
    text = configuration(arguments.loops, arguments.rate, arguments.seconds, arguments.seed)
    with tempfile.TemporaryDirectory() as name:
        shares = measured(Path(name), text, arguments.seconds, arguments.hogs)
        found = told(Path(name))
    session, bare = shares["session"], shares["bare python-can"]
    document = {
        "loops": arguments.loops,
        "samples a second": arguments.rate,
        "seconds": arguments.seconds,
        **found,
        "share of a core": {name: round(share, 3) for name, share in shares.items()},
        "share of a core for a loop": round(session / arguments.loops, 5),
        "session over bare python-can": round(session / bare, 2) if bare else None,
    }
    print(json.dumps(document, indent=1))
    return int(bool(found["lost"] or found["refused"] or not found["decisions"]))


if __name__ == "__main__":
    sys.exit(main())
