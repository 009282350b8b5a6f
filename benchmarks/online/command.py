"""How good is retuning on line? One part of the measurement per command; docs/developers/online.md has the tables.

Examples
--------
  python benchmarks/online batch --seed 1 --every 10 --jobs 2
  python benchmarks/online batch --opened --only P6 --verbose
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from online import (
    batch,
    changes,
    derivative,
    harm,
    injected,
    interrupted,
    loads,
    own_fault,
    proof,
    real_loads,
    tours,
    wrong_starts,
)  # fmt: skip
from online.runner import PLACES, Task, collect, rows_of

ALL = "all"


@dataclass(frozen=True, slots=True)
class Part:
    """One part: a module with KINDS, run, line and table. asks : names of its options. quiet : no line a run."""

    module: ModuleType
    title: str
    asks: tuple[str, ...] = ()
    loops: int = 40
    first: str = ALL
    quiet: bool = False

    def tasks(self, options: argparse.Namespace) -> Sequence[Any]:
        """What is to be run."""
        wanted = {name: getattr(options, name) for name in (*self.asks, "verbose")}
        if self.module in {batch, proof}:
            return batch.tasks(options.seed, every=options.every, offset=options.offset, **wanted)
        kinds = self.module.KINDS if options.kind == ALL else (options.kind,)
        count = {kind: options.hours if kind == "quiet" and self.module is harm else options.loops for kind in kinds}
        each = [Task(kind, options.seed, index, **wanted) for kind in kinds for index in range(count[kind])]
        return each[options.offset :: options.every]


PARTS = {
    "batch": Part(
        batch, "the standard batch of 134 processes, gains off", ("opened", "only", "noise", "starts"), quiet=True,
    ),
    "proof": Part(proof, "retuner, and what people do instead, on the standard batch", quiet=True),
    "tours": Part(
        tours, "nonlinear plants: visits until a region is good", ("start", "places", "lookup", "opened"), 8,
        tours.SMOOTH,
    ),
    "changes": Part(changes, "processes that change, coloured noise, starts in motion", quiet=True),
    "harm": Part(harm, "do no harm: quiet hours, stiction, outside oscillations, saturation"),
    "injected": Part(injected, "deliberately bad changes on trial", ("wander",)),
    "interrupted": Part(interrupted, "changes on trial that something interrupts", loops=8),
    "loads": Part(loads, "loads of every kind and no setpoint step, gains off", ("opened", "bumps"), 20),
    "own": Part(own_fault, "loops that swing by their own fault, Ms over 3", loops=20),
    "derivative": Part(derivative, "loops with derivative action, gains off", loops=16),
    "wrong": Part(wrong_starts, "gains off under an external oscillation, or over a sticking valve", loops=13),
    "real": Part(
        real_loads, "wrong and good gains under the loads of real loops", ("fold", "section", "alone", "data"), 8
    ),
}  # fmt: skip


def main() -> int:
    """Run one part and print its table."""
    options = _parser().parse_args()
    if options.part == "tables":
        # the tables of rows from files; those of the batch by the limits of a change
        rows = [row for file in options.files for row in rows_of(file)]
        for name, part in PARTS.items():
            of = [row for row in rows if row["part"] == name]
            for opened in sorted({row["opened"] for row in of}) if part.module is batch else [None]:
                some = of if opened is None else [row for row in of if row["opened"] == opened]
                limits = "" if opened is None else f", limits of a change: {'x8' if opened else 'defaults'}"
                if some:
                    seeds = sorted({row["seed"] for row in some})
                    _say([f"{part.title}{limits}; {len(some)} runs, seeds {seeds}", *part.module.table(some), ""])
        return 0 if rows else 1
    part = PARTS[options.part]
    tasks = part.tasks(options)
    shown = part.module.line if options.verbose or not part.quiet else None
    rows, whole = collect(part.module.run, tasks, options.jobs, options.out, shown)
    if part.module is batch and not options.verbose:
        _say([batch.line(row) for row in rows if not all(row["spec"][2:])])
    wanted = {key: value for key, value in vars(options).items() if key not in {"part", "jobs", "out", "verbose"}}
    _say([f"{part.title}; {wanted}", *(part.module.table(rows) if rows else ["no runs"])])
    return 0 if rows and whole else 1


def _say(lines: list[str]) -> None:
    sys.stdout.write("\n".join(lines) + "\n" if lines else "")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmarks/online", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--seed", type=int, default=1, help="2028 and above are for final tables only")
    common.add_argument("--jobs", type=int, default=1)
    common.add_argument("--every", type=int, default=1, help="only every n-th run")
    common.add_argument("--offset", type=int, default=0, help="and the first of these (--every 2 --offset 1)")
    common.add_argument("--out", type=Path, metavar="FILE", help="every run as a line of JSON")
    common.add_argument("--verbose", action="store_true", help="tell what was decided, and what is true")
    parts = parser.add_subparsers(dest="part", required=True)
    of = {name: parts.add_parser(name, parents=[common], help=part.title) for name, part in PARTS.items()}
    for name, part in PARTS.items():
        if part.module not in {batch, proof}:
            of[name].add_argument("--kind", choices=(ALL, *part.module.KINDS), default=part.first)
            of[name].add_argument("--loops", type=int, default=part.loops, help="of each kind")
    for name in ("batch", "tours", "loads"):
        of[name].add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
    of["batch"].add_argument("--only", default="", help='processes whose name begins so: "P6", "P1 T=0.02"')
    of["batch"].add_argument("--noise", type=float, default=batch.NOISE, help="share of a setpoint step")
    of["batch"].add_argument("--starts", type=int, default=1, help=f"wrong starts, of {len(batch.STARTS)}")
    of["harm"].add_argument("--hours", type=int, default=100, help="quiet hours")
    of["injected"].add_argument("--wander", choices=loads.WANDERING, default="", help="a load that goes on all along")
    of["loads"].add_argument("--bumps", type=float, default=0.0, help="percent of pv's range of a setpoint bump")
    of["real"].add_argument("--data", required=True, metavar="FOLDER", help="records, as benchmarks/world has them")
    of["real"].add_argument("--fold", type=int, choices=(0, 1), help="loads of every second tag only")
    of["real"].add_argument("--alone", action="store_true", help="no setpoint step")
    of["real"].add_argument("--section", type=int, default=1000, help="samples between two setpoint steps")
    of["tours"].add_argument("--start", choices=("middle", "quarter", "own"), default="quarter")
    of["tours"].add_argument("--places", type=int, default=PLACES, help="of each tour")
    of["tours"].add_argument("--lookup", choices=("hard", "interpolated"), default="hard")
    again = parts.add_parser("tables", help="the tables again, of rows from files")
    again.add_argument("files", type=Path, nargs="+", metavar="FILE", help="as --out writes them")
    return parser
