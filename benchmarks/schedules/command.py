"""How good are gain schedules designed from ordinary records?

Examples
--------
  python benchmarks/schedules run --seed 1 --loops 2 --part drawn --out rows.jsonl
  python benchmarks/schedules run --seed 1 --part physics --mode scheduled --verbose
  python benchmarks/schedules table rows.jsonl
"""

import argparse
import sys
from pathlib import Path

from online.runner import collect, rows_of

from schedules.measure import MODES, PLACES, WALK, Row, measure, tasks
from schedules.tables import line, table

PARTS = ("drawn", "signal", "constant", "physics")


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="benchmarks/schedules", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_subparsers(dest="what", required=True)
    one = what.add_parser("run", help="records, designs, and everybody on the true plants")
    one.add_argument("--seed", type=int, default=1, help="2028 and above are for final tables only")
    one.add_argument("--loops", type=int, default=2, help="drawn processes of each sort")
    one.add_argument("--part", choices=("all", *PARTS), default="all")
    one.add_argument("--mode", choices=("all", *MODES), default="fixed", help="gains in force in the record")
    one.add_argument("--only", default="", help="subjects whose name holds this")
    one.add_argument("--visits", type=int, default=2, help="of each place, in the record")
    one.add_argument("--places", type=int, default=PLACES, help="places judged")
    one.add_argument("--walk", type=int, default=WALK, help="visits of the fresh walk")
    one.add_argument("--alone", action="store_true", help="without the rivals and the count of the fewest sets")
    one.add_argument("--jobs", type=int, default=1)
    one.add_argument("--every", type=int, default=1, help="only every n-th case")
    one.add_argument("--offset", type=int, default=0, help="and the first of these")
    one.add_argument("--out", type=Path, metavar="FILE", help="a line of JSON a case; cases it holds are not run again")
    one.add_argument("--verbose", action="store_true", help="a line a case")
    two = what.add_parser("table", help="the table again, of rows from files")
    two.add_argument("files", type=Path, nargs="+", metavar="FILE")
    options = parser.parse_args()
    if options.what == "table":
        rows: list[Row] = [row for file in options.files for row in rows_of(file)]
        whole = True
    else:
        parts = PARTS if options.part == "all" else (options.part,)
        modes = MODES if options.mode == "all" else (options.mode,)
        some = tasks(
            options.seed,
            options.loops,
            parts,
            modes,
            visits=options.visits,
            places=options.places,
            walk=options.walk,
            rivals=not options.alone,
        )
        wanted = [task for task in some if options.only in task.subject][options.offset :: options.every]
        rows, whole = collect(measure, wanted, options.jobs, options.out, line if options.verbose else None, more=True)
    sys.stdout.write("\n".join(table(rows) if rows else ["no runs"]) + "\n")
    return 0 if rows and whole else 1
