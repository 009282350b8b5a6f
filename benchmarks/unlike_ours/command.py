"""Retuner streamed on loops unlike those of the other benchmarks, through the public interface alone.

The simulator (process.py), the truth (truth.py), the controllers (controllers.py) and the stories (stories.py) share
nothing with the rest of benchmarks/. Each story is a loop with eight disturbances at irregular times, in mode auto,
with the default limits. Truth is Ms and J of the exact process. In spec: Ms at most 1.8 (or 1.03 of the reference's),
J at most 1.25 of the reference's, the PI controller of least J at Ms 1.55.

Examples
--------
  OPENBLAS_NUM_THREADS=1 python benchmarks/unlike_ours --seed 1 --loops 2 --jobs 1
  python benchmarks/unlike_ours --seed 1 --loops 1 --only ringing derivative --verbose
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from online.runner import collect

from unlike_ours.run import Row, run, tasks
from unlike_ours.stories import NAMES

AFTER = (1, 3, 6)
HARM = ("unstable", "ms_worse", "j_worse", "right_changed", "right_lost", "right_back")
HEADS = f"{'story':<15}{'loops':>6}{'in spec after 1, 3, 6, at the end':>36}  changes; {', '.join(HARM)}; errors, odd"


def main() -> int:
    """Run them and print the table."""
    options = _parser().parse_args()
    names = tuple(options.only)
    todo = tasks(options.seed, options.loops, names, verbose=options.verbose)[options.offset :: options.every]
    rows, whole = collect(run, todo, options.jobs, options.out, line)
    print(f"unlike ours, seed {options.seed}", *table(rows), sep="\n")
    return 0 if rows and whole else 1


def line(row: Row) -> str:
    """A loop for people."""
    (ms, j), (ms_end, j_end) = row["start"], row["end"]
    spec = "".join("#" if good else "." for good in row["spec"])
    told = [f"{name} {n}" for name in HARM if (n := count([row], name))]
    said = [*told, *([row["error"]] if row["error"] else []), *row["odd"], *row["log"]]
    ends = f"Ms {ms:.2f} J {j:.2f} -> Ms {ms_end:.2f} J {j_end:.2f}"
    head = f"{row['name']:<15}{row['index']:>3}  {ends}  {spec:<8}  changes {len(row['told'])}  {row['cpu']:.0f} s"
    return "\n    ".join([head, *said])


def count(rows: Sequence[Row], name: str) -> int:
    """Changes of which this is true."""
    return sum(change[name] for row in rows for change in row["told"])


def table(rows: Sequence[Row]) -> list[str]:
    """A line a story, and all together."""
    groups = [(name, [row for row in rows if row["name"] == name]) for name in NAMES]
    return [HEADS, *(_line(name, group) for name, group in [*groups, ("all", rows)] if group), *_promises(rows)]


def staying(row: Row, n: int) -> bool:
    """In spec after so many disturbances and after every later one."""
    return bool(row["spec"]) and all(row["spec"][n - 1 :])


def _line(name: str, rows: Sequence[Row]) -> str:
    spec = " ".join(f"{sum(staying(row, n) for row in rows):>7}" for n in AFTER)
    spec += f" {sum(bool(row['spec']) and row['spec'][-1] for row in rows):>7}"
    harm = ", ".join(str(count(rows, what)) for what in HARM)
    changes, errors = sum(len(row["told"]) for row in rows), sum(bool(row["error"]) for row in rows)
    return f"{name:<15}{len(rows):>6}{spec:>36}  {changes:>7}; {harm}; {errors}, {sum(len(row['odd']) for row in rows)}"


def _promises(rows: Sequence[Row]) -> list[str]:
    """True Ms over the promised one, and what decisions take."""
    told = [change for row in rows for change in row["told"] if change["promised"] and not change["unstable"]]
    ratios = sorted(change["after"][0] / change["promised"] for change in told)
    seconds = sorted(second for row in rows for second in row["seconds"])
    if not ratios or not seconds:
        return []
    return [
        f"true Ms over promised: median {median(ratios):.2f}, largest {ratios[-1]:.2f}, of {len(ratios)} changes",
        f"a decision: median {median(seconds):.2f} s, largest {seconds[-1]:.1f} s, of {len(seconds)}",
    ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmarks/unlike_ours", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, default=2, help="of each story (2)")
    parser.add_argument("--only", nargs="+", default=NAMES, choices=NAMES, metavar="STORY", help=", ".join(NAMES))
    parser.add_argument("--every", type=int, default=1, help="only every n-th run")
    parser.add_argument("--offset", type=int, default=0, help="and the first of these")
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--out", type=Path, metavar="FILE", help="every run as a line of JSON")
    parser.add_argument("--verbose", action="store_true", help="tell every decision")
    return parser


if __name__ == "__main__":
    sys.exit(main())
