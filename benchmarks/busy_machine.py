"""The README's two processes beside programs that keep the machine busy: does every write come about, is nothing lost?

    python benchmarks/busy_machine.py [--until 50400] [--speed 50] [--hogs 2] [--before PYTHON]

`retuner device` and `retuner run` on udp_multicast (no frame leaves this machine), beside so many endless loops of the
same priority. The same scenario is run in simulated time first, for the gains that a machine with time to spare comes
to. --before : the Python of an environment with an earlier release, which is measured in the same way in the same run.
Prints a line a release: writes begun, refused, changes of gains, samples lost, decisions and how many samples they were
entered after, the largest factor between its gains and the demo's. Status 1 when this release has a refused write, a
lost sample, or changed no gains.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from retuner.ledger import LedgerReader, Row

ROOT = Path(__file__).resolve().parent.parent
SAMPLE_S = 2.0  # of the oven
GROUP = "239.74.163.47"
START_S = 60.0
"""What a run may take beside its scenario: imports, connecting, the report; on a busy machine."""
HOG = "import os, time\nend = time.monotonic() + {s}\nwhile time.monotonic() < end and os.getppid() == {p}: pass"
STEP = re.compile(r"^\s*\{ at_s = ([0-9.]+),")


def scenario_until(text: str, until_s: float) -> str:
    """A configuration whose scenario ends earlier."""
    kept = [line for line in text.splitlines() if not (step := STEP.match(line)) or float(step[1]) < until_s]
    return re.sub(r"(?m)^duration_s = .*$", f"duration_s = {until_s}", "\n".join(kept) + "\n")


@contextmanager
def running(*commands: list[str]) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Programs that run meanwhile, and are ended afterwards whatever happens."""
    started: list[subprocess.Popen[bytes]] = []
    nowhere = subprocess.DEVNULL
    try:
        started.extend(subprocess.Popen(command, stdout=nowhere, stderr=nowhere) for command in commands)
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


def retuner(python: str, *arguments: str) -> list[str]:
    """A command of the release that this Python has."""
    return [python, "-m", "retuner", *arguments]


def live(python: str, config: Path, folder: Path, speed: float, until_s: float, hogs: int) -> list[Row]:
    """The rows of one session beside the hogs."""
    bus = ["-i", "udp_multicast", "-c", GROUP, "--speed", f"{speed:g}"]
    limit_s = until_s / speed + START_S
    hog = [sys.executable, "-c", HOG.format(s=limit_s, p=os.getpid())]
    device = retuner(python, "device", str(config), *bus)
    run = retuner(python, "run", str(config), *bus, "--mode", "auto", "--out", str(folder))
    with running(device, *[hog] * hogs), folder.with_suffix(".txt").open("wb") as said:
        process = subprocess.Popen(run, stdout=said, stderr=said)
        try:
            process.wait(limit_s + START_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    with LedgerReader(folder / "ledger.sqlite") as ledger:
        return list(ledger.rows())


def of(rows: list[Row], *kinds: str) -> list[dict[str, Any]]:
    """Bodies of some kinds."""
    return [row.body for row in rows if row.kind in kinds]


def gains(rows: list[Row]) -> dict[str, np.ndarray]:
    """The last gains that a decision or a restoring put into force, by region."""
    found: dict[str, np.ndarray] = {}
    for row in rows:
        if row.kind == "restore" or (row.kind == "committed" and row.body["why"] == "retune"):
            found[row.body["region"]] = np.array([row.body["gains"][name] for name in ("kp", "ki", "kd")])
    return found


def apart(here: dict[str, np.ndarray], there: dict[str, np.ndarray]) -> float | None:
    """The largest factor between two sets of gains; None where other regions were changed."""
    if here.keys() != there.keys() or not here:
        return None
    both = [(a, b) for name in here for a, b in zip(here[name], there[name], strict=True) if a and b]
    return max(float(np.exp(abs(np.log(a / b)))) for a, b in both)


def told(folder: Path, rows: list[Row], demo: dict[str, np.ndarray]) -> dict[str, object]:
    """What a session came to."""
    later = [body["delay"] for body in of(rows, "decision") if "delay" in body]
    delays = [delay["entered"] - delay["asked"] for delay in later]
    reasons = [body["reason"] for body in of(rows, "refused", "dropped", "worker")]
    return {
        "ended": "end" in {row.kind for row in rows},
        "samples": rows[-1].body["samples"],
        "lost_samples": lost_samples(folder / "trend.csv"),
        "faults": sum(body["times"] for body in of(rows, "bus")),
        "writes": len(of(rows, "intent")),
        "refused": len(of(rows, "refused")),
        "changes": sum(body["why"] == "retune" for body in of(rows, "committed")),
        "decisions": len(of(rows, "decision")),
        "questions": len(of(rows, "question")),
        "entered_after_samples": [int(np.median(delays)), max(delays)] if delays else None,
        "without_decision": len(of(rows, "worker")),
        "aborts": [body["cause"] for body in of(rows, "abort")],
        "gains": {name: [float(f"{v:.4g}") for v in values] for name, values in gains(rows).items()},
        "largest_factor_to_demo": apart(gains(rows), demo),
        "reasons": sorted(set(reasons)),
    }


def lost_samples(trend: Path) -> int:
    """Samples that the trend of a session lacks between its first and its last one."""
    t_s = np.loadtxt(trend, delimiter=",", skiprows=1, usecols=0)
    return int(np.sum(np.rint(np.diff(t_s) / SAMPLE_S) - 1))


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--until", type=float, default=50400.0, help="end of the scenario, s of the loop")
    parser.add_argument("--speed", type=float, default=50.0)
    parser.add_argument("--hogs", type=int, default=2)
    parser.add_argument("--before", help="Python of an environment with an earlier release")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        config = folder / "oven.toml"
        config.write_text(scenario_until((ROOT / "examples/oven.toml").read_text(), arguments.until))
        simulated = retuner(sys.executable, "run", str(config), "--no-compare", "--out", str(folder / "demo"))
        subprocess.run(simulated, check=True, stdout=subprocess.DEVNULL)
        with LedgerReader(folder / "demo/ledger.sqlite") as ledger:
            demo = list(ledger.rows())
        found = {"simulated": told(folder / "demo", demo, gains(demo))}
        releases = {"this release": sys.executable, **({"before": arguments.before} if arguments.before else {})}
        for name, python in releases.items():
            place = folder / name.replace(" ", "-")
            rows = live(python, config, place, arguments.speed, arguments.until, arguments.hogs)
            found[name] = told(place, rows, gains(demo))
    print(json.dumps(found, indent=1))
    mine = found["this release"]
    return int(bool(mine["refused"] or mine["lost_samples"] or not mine["changes"]))


if __name__ == "__main__":
    sys.exit(main())
