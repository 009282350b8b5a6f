"""How much memory an audit takes, by the number of loops: the command itself, largest process; it screens only
unless told otherwise.

    python benchmarks/audit/memory.py --loops 100 1000 10000 --rows 2000 --keep FOLDER
    python benchmarks/audit/memory.py --loops 10000 --rows 8640 --stretches 1 --diagnose 20 --jobs 2

The loops are walks of noise in wide Parquet files of 250 loops each. A line a number of loops; the folder keeps pages.
CPU of the main process is what more workers cannot take over.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

A_FILE = 250  # Loops of a file
MEASURED = """
import json, resource, sys, time
begun = time.monotonic()
from retuner.cli import main
status = main(sys.argv[1:])
of = lambda who: resource.getrusage(who)
own, theirs = of(resource.RUSAGE_SELF), of(resource.RUSAGE_CHILDREN)
sys.stderr.write(json.dumps({"status": status, "main_mb": own.ru_maxrss // 1024, "worker_mb": theirs.ru_maxrss // 1024,
                             "main_cpu_s": round(own.ru_utime + own.ru_stime, 1),
                             "worker_cpu_s": round(theirs.ru_utime + theirs.ru_stime, 1),
                             "wall_s": round(time.monotonic() - begun, 1)}) + "\\n")
"""


def make(folder: Path, loops: int, rows: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    stamps = np.datetime64(1_700_000_000, "s") + (10 * np.arange(rows)).astype("timedelta64[s]")
    for first in range(0, loops, A_FILE):
        columns: dict[str, np.ndarray] = {"time": stamps}
        for i in range(first, min(first + A_FILE, loops)):
            walk = np.cumsum(rng.normal(size=rows)).astype(np.float32)
            columns |= {
                f"FIC{i + 10001}.{name}": value for name, value in (("SP", 0 * walk), ("PV", walk), ("OP", -walk))
            }
        pq.write_table(pa.table(columns), folder / f"{first:06d}.parquet")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--rows", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--stretches", type=int, default=0)
    parser.add_argument("--diagnose", type=float, default=100.0)
    parser.add_argument("--keep", type=Path, help="folder in which plants and pages stay")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        for loops in given.loops:
            folder = (given.keep or Path(made)) / str(loops)
            if not (folder / "plant").is_dir():
                make(folder / "plant", loops, given.rows, given.seed)
            arguments = ["audit", folder / "plant", "--out", folder / "audit", "--jobs", given.jobs]
            arguments += ["--stretches", given.stretches, "--diagnose", given.diagnose]
            run = subprocess.run(
                [sys.executable, "-c", MEASURED, *map(str, arguments)],
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                capture_output=True,
                text=True,
                check=True,
            )
            print(
                json.dumps({"loops": loops, "rows": given.rows, **json.loads(run.stderr.splitlines()[-1])}), flush=True
            )


if __name__ == "__main__":
    main()
