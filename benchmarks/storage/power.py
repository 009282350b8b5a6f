"""Power cuts: the device under an ext4 file system loses everything that was not flushed, at a random moment.

    python scripts/socketcan/run.py --uml --timeout 3600 -- PYTHON -P benchmarks/storage/power.py [--cuts N]

Runs as root inside user-mode Linux (the runner boots it) on a loop device behind dm-flakey: a job is killed at a random
moment, in the same instant the device begins to drop (every other time: to refuse) all writes, the file system is
thrown away with what it had not written, mounted anew, and must hold all that was acknowledged. --synchronous NORMAL
weakens the ledger and must show losses: that the test finds them shows its teeth.
"""

import argparse
import collections
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from job import Promised, broken, work

MODULES = ("drivers/block/loop", "drivers/md/dm-mod", "drivers/md/dm-flakey")
SIZE_BYTES = 64 << 20
SECTOR = 512
DEVICE = "retuner-flakey"
EVER = 1 << 20  # seconds
MODES = {"drop": "drop_writes", "refuse": "error_writes"}
MOST_ROWS = 60  # that a job acknowledges before the cut: counted, for on a busy machine a time says nothing
LONGEST_LIFE_S = 0.01  # after that; a row takes about 5 ms there
CUTS_PER_DISK = 20


def sh(*command: str | Path) -> None:
    subprocess.run([str(word) for word in command], check=True, capture_output=True)


class Disk:
    """An ext4 file system on a device that can be cut off."""

    def __init__(self, folder: Path) -> None:
        self.image, self.mount = folder / "image", folder / "mount"
        self.mount.mkdir()
        with self.image.open("wb") as image:
            image.truncate(SIZE_BYTES)
        self.loop = subprocess.check_output(["losetup", "--find", "--show", self.image], text=True).strip()
        self.setup("create", up=True)
        self.node = Path("/dev/mapper") / DEVICE
        sh("dmsetup", "mknodes")
        sh("mkfs.ext4", "-q", self.node)
        sh("mount", "-t", "ext4", self.node, self.mount)

    def table(self, *, up: bool, feature: str = "") -> str:
        """dm-flakey's line: for ever up, or for ever down with a feature."""
        times = f"{EVER} 0" if up else f"0 {EVER} 1 {feature}"
        return f"0 {SIZE_BYTES // SECTOR} flakey {self.loop} 0 {times}"

    def setup(self, verb: str, *, up: bool, feature: str = "") -> None:
        """Create the device or load another table."""
        sh("dmsetup", "--noudevsync", verb, DEVICE, "--table", self.table(up=up, feature=feature))

    def cut(self, feature: str) -> None:
        """From now on nothing reaches the disk; what the kernel still holds is lost; then the power comes back."""
        self.setup("load", up=False, feature=feature)
        sh("dmsetup", "--noudevsync", "suspend", "--noflush", "--nolockfs", DEVICE)
        sh("dmsetup", "--noudevsync", "resume", DEVICE)
        subprocess.run(["umount", self.mount], check=True, capture_output=True)
        sh("sh", "-c", "echo 3 >/proc/sys/vm/drop_caches")
        self.setup("load", up=True)
        sh("dmsetup", "--noudevsync", "suspend", "--noflush", "--nolockfs", DEVICE)
        sh("dmsetup", "--noudevsync", "resume", DEVICE)
        sh("mount", "-t", "ext4", self.node, self.mount)

    def remove(self) -> None:
        """Take it away."""
        sh("umount", self.mount)
        sh("dmsetup", "--noudevsync", "remove", DEVICE)
        sh("losetup", "-d", self.loop)


def interrupted(folder: Path, promised: Promised, lines: int, life_s: float, synchronous: str) -> None:
    """A job in a forked child, killed life_s after it has acknowledged so many lines; what it acknowledged."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(out)
        try:
            work(folder, 1 << 30, into, synchronous)
        finally:
            os._exit(0)
    os.close(into)
    with os.fdopen(out) as answers:
        read = "".join(line for _, line in zip(range(lines), answers, strict=False))
        time.sleep(life_s)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        promised.take(read + answers.read())


def cuts(count: int, seed: int, synchronous: str) -> dict[str, object]:
    """Cut after cut, on a new disk now and then."""
    rng = random.Random(seed)
    made: collections.Counter[str] = collections.Counter()
    wrong: list[str] = []
    rows = losing = 0
    while made.total() < count:
        with tempfile.TemporaryDirectory(dir="/run") as scratch:
            disk, promised = Disk(Path(scratch)), Promised()
            folder = disk.mount / "run"
            folder.mkdir()
            sh("sync")
            for _ in range(min(CUTS_PER_DISK, count - made.total())):
                interrupted(folder, promised, rng.randrange(MOST_ROWS), rng.uniform(0, LONGEST_LIFE_S), synchronous)
                mode = ("drop", "refuse")[made.total() % 2]
                disk.cut(MODES[mode])
                made[mode] += 1
                faults = [f"cut {made.total()} ({mode}): {fault}" for fault in broken(folder, promised)]
                losing += bool(faults)
                wrong += faults
                if faults:
                    break
            rows += len(promised.rows)
            disk.remove()
    return {
        "part": "power",
        "seed": seed,
        "synchronous": synchronous or "FULL",
        "cuts": dict(made),
        "rows": rows,
        "cuts with loss": losing,
        "wrong": wrong[:5],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cuts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--synchronous", default="", help="weaken the ledger (NORMAL, OFF)")
    chosen = parser.parse_args()
    modules = Path("/usr/lib/uml/modules") / os.uname().release / "kernel"
    for module in MODULES:
        subprocess.run(["insmod", modules / f"{module}.ko"], check=False, capture_output=True)
    started = time.monotonic()
    result = cuts(chosen.cuts, chosen.seed, chosen.synchronous)
    result["seconds"] = round(time.monotonic() - started, 1)
    sys.stdout.write(json.dumps(result) + "\n")
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
