"""The README's two processes beside programs that keep the machine busy: does every write come about, is nothing lost?

    python benchmarks/busy_machine.py [--until 50400] [--speed 50] [--hogs 2] [--share 0.2] [--before PYTHON]

`retuner device` and `retuner run` on udp_multicast (no frame leaves this machine), beside so many endless loops of
the same priority. --share : the session with its worker is held to so much of one core, by stopping and continuing it
as cpulimit does; the time that reports and imports take grows with it. The same scenario is run in simulated time
first, for the gains that a machine with time to spare comes to. --before : the Python of an environment with an
earlier release, which is measured in the same way in the same run.
Prints a line a release: writes begun, refused, changes of gains, samples lost, decisions and how many samples they were
entered after, the largest factor between its gains and the demo's. Status 1 when this release has a refused write, a
lost sample, or changed no gains.
"""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
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


@contextmanager
def listening(device: list[str]) -> Iterator[None]:
    """A device, from the line on with which it says that it is there."""
    with subprocess.Popen(device, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        try:
            process.stderr.readline()
            yield
        finally:
            process.kill()


def retuner(python: str, *arguments: str) -> list[str]:
    """A command of the release that this Python has."""
    return [python, "-m", "retuner", *arguments]


SLICE_S = 0.02
"""For so long a held process runs at least before it is stopped."""


class Held:
    """A process group that gets no more than a share of one core, as long as the block lasts."""

    def __init__(self, group: int, share: float) -> None:
        self._group, self._share, self._over = group, share, threading.Event()
        self._thread = threading.Thread(target=self._hold, daemon=True)

    def __enter__(self) -> "Held":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _hold(self) -> None:
        """Stop it for as long as it has had too much."""
        began_s = time.monotonic()
        while not self._over.wait(SLICE_S):
            ahead_s = self._used_s() / self._share - (time.monotonic() - began_s)
            if ahead_s < -1.0:  # what it did not use a while ago is not saved up
                began_s -= ahead_s
            elif ahead_s > 0:
                self._say(signal.SIGSTOP)
                self._over.wait(ahead_s)
                self._say(signal.SIGCONT)

    def _say(self, number: int) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._group, number)

    def _used_s(self) -> float:
        """CPU time of all processes of the group so far."""
        found = 0.0
        for path in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError, IndexError):
                fields = path.read_text().rpartition(")")[2].split()
                found += sum(map(int, fields[11:13])) if int(fields[2]) == self._group else 0
        return found / os.sysconf("SC_CLK_TCK")


def live(
    python: str, config: Path, folder: Path, speed: float, until_s: float, hogs: int, share: float | None
) -> list[Row]:
    """The rows of one session beside the hogs, held to a share of a core or not."""
    bus = ["-i", "udp_multicast", "-c", GROUP, "--speed", f"{speed:g}"]
    limit_s = until_s / speed + START_S
    hog = [sys.executable, "-c", HOG.format(s=limit_s, p=os.getpid())]
    device = retuner(python, "device", str(config), *bus)
    run = retuner(python, "run", str(config), *bus, "--mode", "auto", "--out", str(folder))
    with running(*[hog] * hogs), listening(device), folder.with_suffix(".txt").open("wb") as said:
        process = subprocess.Popen(run, stdout=said, stderr=said, start_new_session=True)
        try:
            with Held(process.pid, share) if share else nullcontext():
                process.wait(limit_s + START_S / (share or 1.0))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if not (folder / "ledger.sqlite").exists():
        sys.exit(f"the session has come to nothing: {folder.with_suffix('.txt').read_text().strip()}")
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
    delays = [delay["entered"] - delay["raised"] for delay in later]
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
    parser.add_argument("--share", type=float, help="of one core, that the session with its worker gets at most")
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
            rows = live(python, config, place, arguments.speed, arguments.until, arguments.hogs, arguments.share)
            found[name] = told(place, rows, gains(demo))
    print(json.dumps(found, indent=1))
    mine = found["this release"]
    return int(bool(mine["refused"] or mine["lost_samples"] or not mine["changes"]))


if __name__ == "__main__":
    sys.exit(main())
