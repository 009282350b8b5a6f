"""Storage under faults: no acknowledged ledger row lost, no torn gain table, one clear line for every refusal.

    python benchmarks/storage/faults.py sweep [--every N]
        kill at every durable system call once; have each refused once and from there on (EIO, ENOSPC); needs strace
    python benchmarks/storage/faults.py kills [--count N]
        kill -9 at random moments
    python benchmarks/storage/faults.py disk
        a full disk (tmpfs where root may mount, and a file size limit), read-only and missing folders, two writers

Prints one line of JSON per part with its counts and what broke; status 1 when anything did. power.py cuts the power.
"""

import argparse
import collections
import contextlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from job import Promised, broken, work

from retuner.ledger import Ledger

JOB = Path(__file__).resolve().with_name("job.py")
ROWS = 6  # per job of the sweep: enough for two replacements of the table
DURABLE = ("write", "pwrite64", "fsync", "fdatasync", "rename", "unlink", "ftruncate")
MOST_LINES = 8  # acknowledged by a job before it is killed, however fast the machine is
LONGEST_LIFE_S = 0.006  # after that; a row takes about a third of it
MEBIBYTE = 1 << 20


def job(folder: Path, *prefix: str, rows: int = ROWS) -> "subprocess.CompletedProcess[str]":
    """The job as a process, behind a prefix such as strace."""
    return subprocess.run(
        [*prefix, sys.executable, "-B", "-P", str(JOB), str(folder), str(rows)],
        capture_output=True,
        text=True,
        check=False,
    )


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """A folder of its own on the disk that is tested."""
    with tempfile.TemporaryDirectory(prefix="retuner-storage-") as folder:
        yield Path(folder)


def calls() -> collections.Counter[str]:
    """How often the job makes each durable call."""
    with scratch() as folder:
        trace = folder / "trace"
        (folder / "run").mkdir()
        done = job(folder / "run", "strace", "-f", "-qq", "-o", str(trace), "-e", f"trace={','.join(DURABLE)}")
        assert done.returncode == 0, done.stderr
        names = re.findall(r"^\d+\s+(\w+)\(", trace.read_text(errors="replace"), re.MULTILINE)
    return collections.Counter(name for name in names if name in DURABLE)


def sweep(every: int) -> dict[str, object]:
    """Each call once per way to fail, and a second job after it."""
    found = calls()
    ways = {"killed": "signal=SIGKILL:when={}"}
    for error in ("EIO", "ENOSPC"):
        ways |= {f"{error} once": f"error={error}:when={{}}", f"{error} from then on": f"error={error}:when={{}}+"}
    points = [(way, name, n) for way in ways for name, count in found.items() for n in range(1, count + 1)]
    tried: collections.Counter[str] = collections.Counter()
    wrong = []
    for way, name, n in points[::every]:
        with scratch() as folder:
            inject = [
                "strace",
                "-f",
                "-qq",
                "-o",
                "/dev/null",
                "-e",
                f"trace={name}",
                "-e",
                f"inject={name}:{ways[way]}",
            ]
            inject[-1] = inject[-1].format(n)
            done = job(folder, *inject)
            promised = Promised()
            promised.take(done.stdout)
            faults = [*told_badly(done, way, name), *broken(folder, promised)]
            again = job(folder)
            promised.take(again.stdout)
            faults += [again.stderr] if again.returncode else []
            faults += broken(folder, promised)
            tried[way] += 1
            wrong += [f"{way}, {name} {n}: {fault}" for fault in faults]
    return {"part": "sweep", "durable calls": dict(found), "points": dict(tried), "wrong": wrong}


def told_badly(done: "subprocess.CompletedProcess[str]", way: str, name: str) -> Iterator[str]:
    """A refusal by the disk is one line; a kill says nothing, nor does a job whose stderr cannot be written either."""
    if way == "killed" or (name == "write" and way.endswith("from then on")):
        return
    if "Traceback" in done.stderr:
        yield f"a traceback: {done.stderr.splitlines()[-1]}"
    if done.returncode not in (0, 3, 120):  # 120: Python could not flush stdout or stderr
        yield f"status {done.returncode}"
    if len(done.stderr.splitlines()) > 1:
        yield f"{len(done.stderr.splitlines())} lines"


def kills(count: int, seed: int) -> dict[str, object]:
    """Kill a job at a random moment, again and again, in folders that live for 50 jobs each."""
    rng = random.Random(seed)
    wrong: list[str] = []
    ended = rows = 0
    for folder_number in range(-(-count // 50)):
        with scratch() as folder:
            promised = Promised()
            for number in range(min(50, count - 50 * folder_number)):
                # one job in a forked child, killed life_s after it has acknowledged so much; whether it ended before
                lines = rng.randrange(MOST_LINES)
                out, into = os.pipe()
                child = os.fork()
                if child == 0:
                    os.close(out)
                    try:
                        work(folder, 1000, into)
                    finally:
                        os._exit(0)
                os.close(into)
                said = b""
                while said.count(b"\n") < lines and (more := os.read(out, 4096)):
                    said += more
                time.sleep(rng.uniform(0, LONGEST_LIFE_S))
                os.kill(child, signal.SIGKILL)
                _, status = os.waitpid(child, 0)
                with os.fdopen(out, "rb") as answers:
                    promised.take((said + answers.read()).decode())
                ended += os.WIFEXITED(status)
                wrong += [f"folder {folder_number}, kill {number}: {fault}" for fault in broken(folder, promised)]
            rows += len(promised.rows)
    return {"part": "kills", "seed": seed, "killed": count - ended, "ended before": ended, "rows": rows, "wrong": wrong}


def disk(rows: int = 20_000) -> dict[str, object]:
    """Places that are full, read-only, missing, or written by another."""
    wrong: list[str] = []
    tried: dict[str, object] = {}
    with scratch() as folder:
        tried["file size limit"] = _full(folder, rows, wrong, limit=MEBIBYTE)
    with mounted("size=1m") as folder:
        tried["full tmpfs"] = _full(folder, rows, wrong) if folder else "no right to mount here"
    with mounted("size=1m,nr_inodes=3") as folder:
        tried["no inodes left"] = _full(folder, rows, wrong) if folder else "no right to mount here"
    with mounted("size=1m,ro") as folder:
        tried["read-only"] = _refused(folder, "", wrong) if folder else "no right to mount here"
    with scratch() as folder:
        tried["missing folder"] = _refused(folder / "none", "does not exist", wrong)
        (folder / "file").write_text("x")
        tried["a file for a folder"] = _refused(folder / "file", "", wrong)
        with Ledger(folder / "ledger.sqlite") as ledger:
            first = ledger.append("k", {}, 0.0)
            told = _refused(folder, "another run writes this ledger", wrong)
            second = ledger.append("k", {}, 1.0)
        promised = Promised({1: first.hash, 2: second.hash})
        wrong += broken_without_table(folder, promised)
        tried["two writers"] = told
    return {"part": "disk", "tried": tried, "wrong": wrong}


@contextlib.contextmanager
def mounted(options: str) -> Iterator[Path | None]:
    """A small tmpfs, None without the right to mount one."""
    with scratch() as folder:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, check=False
        )
        if done.returncode:
            yield None
            return
        try:
            yield folder
        finally:
            subprocess.run(["umount", str(folder)], check=True)


def _full(folder: Path, rows: int, wrong: list[str], limit: int = 0) -> str:
    """Write until it is full; then what was promised must be there, and after making room a job goes on."""
    prefix = ["prlimit", f"--fsize={limit}"] if limit else []
    done = job(folder, *prefix, rows=rows)
    promised = Promised()
    promised.take(done.stdout)
    acknowledged = len(promised.rows)
    if done.returncode != 3 or len(done.stderr.splitlines()) != 1:
        wrong.append(f"status {done.returncode}: {done.stderr}")
    if acknowledged and not limit:
        roomier = subprocess.run(["mount", "-o", "remount,size=8m,nr_inodes=100", str(folder)], check=False)
        wrong += ["no room could be made"] if roomier.returncode else []
    if acknowledged:
        wrong += broken(folder, promised)
        again = job(folder)
        promised.take(again.stdout)
        wrong += [f"after making room: {again.stderr}"] if again.returncode else []
        wrong += broken(folder, promised)
    return f"{acknowledged} rows acknowledged and kept, then: {done.stderr.strip().replace(str(folder), '')}"


def _refused(folder: Path, told: str, wrong: list[str]) -> str:
    """A job that must end in one line."""
    done = job(folder)
    if done.returncode != 3 or len(done.stderr.splitlines()) != 1 or told not in done.stderr or done.stdout:
        wrong.append(f"{folder}: status {done.returncode}: {done.stdout}{done.stderr}")
    return done.stderr.strip().replace(str(folder), "")


def broken_without_table(folder: Path, promised: Promised) -> Iterator[str]:
    """The ledger's part of what broken() looks at."""
    for fault in broken(folder, promised):
        if not fault.startswith("left behind: file"):
            yield fault


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("sweep", "kills", "disk"))
    parser.add_argument("--every", type=int, default=1, help="take every n-th point of the sweep (1)")
    parser.add_argument("--count", type=int, default=10_000, help="random kills (10000)")
    parser.add_argument("--seed", type=int, default=1, help="of the random kills (1)")
    parser.add_argument("--rows", type=int, default=20_000, help="rows after which a disk counts as not full (20000)")
    chosen = parser.parse_args()
    if chosen.part == "sweep" and not shutil.which("strace"):
        sys.stderr.write("strace is not installed; apt-get install strace\n")
        return 77
    started = time.monotonic()
    parts = {
        "sweep": lambda: sweep(chosen.every),
        "kills": lambda: kills(chosen.count, chosen.seed),
        "disk": lambda: disk(chosen.rows),
    }
    result = parts[chosen.part]()
    result["seconds"] = round(time.monotonic() - started, 1)
    sys.stdout.write(json.dumps(result) + "\n")
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
