"""How good is retuning on line? One part of the measurement per command; docs/developers/online.md has the tables.

Examples
--------
  python benchmarks/online batch --seed 1 --every 10 --jobs 2
  python benchmarks/online batch --opened --only P6 --verbose
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from online import (
    ablation,
    batch,
    changes,
    elsewhere,
    harm,
    injected,
    loads,
    oracle,
    own_fault,
    telemetry,
    tours,
    walks,
)
from online.runner import collect, rows_of


def main() -> int:
    """Run one part and print its table."""
    options = _parser().parse_args()
    rows, whole = PARTS[options.part](options)
    return 0 if rows and whole else 1


def _batch(options: argparse.Namespace) -> tuple[list[batch.Row], bool]:
    tasks = batch.tasks(
        options.seed,
        opened=options.opened,
        every=options.every,
        offset=options.offset,
        only=options.only,
        noise=options.noise,
        verbose=options.verbose,
        starts=options.starts,
        rivals=options.rivals,
    )
    rows, whole = collect(batch.run, tasks, options.jobs, options.out, batch.line if options.verbose else None)
    if not options.verbose:
        _say([batch.line(row) for row in rows if not all(row["spec"][2:])])
    limits = "x8" if options.opened else "defaults"
    _say([f"batch, seed {options.seed}, noise {options.noise:g}, limits of a change: {limits}"])
    _say(batch.table(rows) if rows else ["no runs"])
    return rows, whole


def _say(lines: list[str]) -> None:
    sys.stdout.write("\n".join(lines) + "\n" if lines else "")


def _harm(options: argparse.Namespace) -> tuple[list[harm.Row], bool]:
    kinds = harm.KINDS if options.kind == "all" else (options.kind,)
    count = {kind: options.hours if kind == "quiet" else options.loops for kind in kinds}
    tasks = [task for kind in kinds for task in harm.tasks(options.seed, kind, count[kind])][
        options.offset :: options.every
    ]
    rows, whole = collect(harm.run, tasks, options.jobs, options.out, harm.line)
    _say([f"do no harm, seed {options.seed}", *harm.table(rows)])
    return rows, whole


def _changes(options: argparse.Namespace) -> tuple[list[changes.Row], bool]:
    kinds = changes.KINDS if options.kind == "all" else (options.kind,)
    tasks = [task for kind in kinds for task in changes.tasks(options.seed, kind, options.loops)][
        options.offset :: options.every
    ]
    rows, whole = collect(changes.run, tasks, options.jobs, options.out, changes.line if options.verbose else None)
    _say([f"processes that change, seed {options.seed}", *changes.table(rows)])
    return rows, whole


def _walks(options: argparse.Namespace) -> tuple[list[walks.Row], bool]:
    tasks = walks.tasks(options.seed, options.walks, options.setpoints)[options.offset :: options.every]
    rows, whole = collect(walks.run, tasks, options.jobs, options.out, walks.line)
    _say([f"walks, seed {options.seed}", *(walks.table(rows) if rows else [])])
    return rows, whole


def _tours(options: argparse.Namespace) -> tuple[list[tours.Row], bool]:
    kinds = tours.KINDS if options.kind == "all" else (options.kind,)
    wanted = {"places": options.places, "lookup": options.lookup, "opened": options.opened, "verbose": options.verbose}
    tasks = [task for kind in kinds for task in tours.tasks(options.seed, kind, options.loops, options.start, **wanted)]
    rows, whole = collect(tours.run, tasks[options.offset :: options.every], options.jobs, options.out, tours.line)
    _say([f"tours, seed {options.seed}", *(tours.table(rows) if rows else [])])
    return rows, whole


def _elsewhere(options: argparse.Namespace) -> tuple[list[elsewhere.Row], bool]:
    kinds = elsewhere.KINDS if options.kind == "all" else (options.kind,)
    wanted = {"places": options.places, "opened": options.opened}
    tasks = [task for kind in kinds for task in elsewhere.tasks(options.seed, kind, options.loops, **wanted)]
    shown = elsewhere.line if options.verbose else None
    rows, whole = collect(elsewhere.run, tasks[options.offset :: options.every], options.jobs, options.out, shown)
    _say([f"gains for regions where the loop is not, seed {options.seed}", *(elsewhere.table(rows) if rows else [])])
    return rows, whole


def _injected(options: argparse.Namespace) -> tuple[list[injected.Row], bool]:
    kinds = injected.KINDS if options.kind == "all" else (options.kind,)
    tasks = [task for kind in kinds for task in injected.tasks(options.seed, kind, options.loops, options.wander)][
        options.offset :: options.every
    ]
    rows, whole = collect(injected.run, tasks, options.jobs, options.out, injected.line)
    under = f", under a load that wanders: {options.wander}" if options.wander else ""
    _say([f"changes injected, seed {options.seed}{under}", *injected.table(rows)])
    return rows, whole


def _loads(options: argparse.Namespace) -> tuple[list[loads.Row], bool]:
    kinds = loads.KINDS if options.kind == "all" else (options.kind,)
    wanted = {"opened": options.opened, "verbose": options.verbose, "nudge": options.nudge}
    tasks = [task for kind in kinds for task in loads.tasks(options.seed, kind, options.loops, **wanted)][
        options.offset :: options.every
    ]
    rows, whole = collect(loads.run, tasks, options.jobs, options.out, loads.line)
    bumps = f", setpoint bumps of {options.nudge:g} %" if options.nudge else ""
    _say([f"loads only, seed {options.seed}{bumps}", *loads.table(rows)])
    return rows, whole


def _oracle(options: argparse.Namespace) -> tuple[list[oracle.Row], bool]:
    tasks = oracle.tasks(options.seed, options.loops, options.nudge, options.moves)[options.offset :: options.every]
    rows, whole = collect(oracle.run, tasks, options.jobs, options.out, oracle.line if options.verbose else None)
    bumps = f", a setpoint bump of {options.nudge:g} % a period ({options.moves})" if options.nudge else ""
    _say([f"what loads alone could tell, seed {options.seed}{bumps}", *oracle.table(rows)])
    return rows, whole


def _own(options: argparse.Namespace) -> tuple[list[own_fault.Row], bool]:
    kinds = own_fault.KINDS if options.kind == "all" else (options.kind,)
    tasks = [
        task for kind in kinds for task in own_fault.tasks(options.seed, kind, options.loops, verbose=options.verbose)
    ]
    rows, whole = collect(
        own_fault.run, tasks[options.offset :: options.every], options.jobs, options.out, own_fault.line
    )
    _say([f"loops that swing by their own fault, seed {options.seed}", *own_fault.table(rows)])
    return rows, whole


def _ablation(options: argparse.Namespace) -> tuple[list[ablation.Row], bool]:
    tasks = [ablation.Task(part, task) for part, task in _ablated(options)][options.offset :: options.every]
    shown = _shown if options.verbose else None
    rows, whole = collect(ablation.run, tasks, options.jobs, options.out, shown)
    said = {name: sum(bool(row["said"].get(name)) for row in rows) for name in options.pieces}
    _say([f"without a piece, seed {options.seed}; runs in which each decided: {said}"])
    if not whole:
        return rows, False
    others = ablation.again(tasks, rows, options.pieces)
    out = options.out.with_stem(f"{options.out.stem}-without") if options.out else None
    more, whole = collect(ablation.run, others, options.jobs, out, shown)
    pairs = list(zip(others, more, strict=False))
    for part in dict.fromkeys(task.part for task in tasks):
        _say(ablation.table(part, tasks, rows, pairs))
    return rows + more, whole


def _shown(row: ablation.Row) -> str:
    return f"without {row['without'] or 'nothing'}: {ablation.PARTS[row['part']].line(row)}"


def _ablated(options: argparse.Namespace) -> list[tuple[str, Any]]:
    """The runs of a part in which pieces are taken away."""
    part, seed, loops, kind = options.of, options.seed, options.loops, options.kind
    told = options.verbose
    found: list[Any] = []
    if part == "batch":
        found = batch.tasks(seed, opened=options.opened, verbose=told)
    for each in ablation.PARTS[part].KINDS if part != "batch" and kind == "all" else (kind,) * (part != "batch"):
        match part:
            case "own":
                found += own_fault.tasks(seed, each, loops, verbose=told)
            case "loads":
                found += loads.tasks(seed, each, loops, opened=options.opened, verbose=told)
            case _:
                found += ablation.PARTS[part].tasks(seed, each, loops)
    return [(part, task) for task in found]


def _telemetry(options: argparse.Namespace) -> tuple[list[batch.Row], bool]:
    kinds = telemetry.KINDS if options.kind == "all" else (options.kind,)
    tasks = batch.tasks(options.seed, opened=True, every=options.every, offset=options.offset, verbose=options.verbose)
    rows, whole = [], True
    for kind in kinds:
        out = options.out.with_stem(f"{options.out.stem}-{kind}") if options.out else None
        shown = batch.line if options.verbose else None
        some, done = collect(telemetry.work(kind), tasks, 1, out, shown)
        rows, whole = rows + some, whole and done
    _say([f"irregular and lost samples, seed {options.seed}", *telemetry.table(rows)])
    return rows, whole


def _tables(options: argparse.Namespace) -> tuple[list[batch.Row], bool]:
    rows = [row for file in options.files for row in rows_of(file)]
    runs = [row for row in rows if row["part"] == "batch"]
    for title, of, table in (
        ("batch, limits of a change: x8", [r for r in runs if r["opened"]], batch.table),
        ("batch, limits of a change: defaults", [r for r in runs if not r["opened"]], batch.table),
        ("walks", [r for r in rows if r["part"] == "walks"], walks.table),
        ("tours", [r for r in rows if r["part"] == "tours"], tours.table),
        ("regions where the loop is not", [r for r in rows if r["part"] == "elsewhere"], elsewhere.table),
        ("processes that change", [r for r in rows if r["part"] == "changes"], changes.table),
        ("do no harm", [r for r in rows if r["part"] == "harm"], harm.table),
        ("loads only", [r for r in rows if r["part"] == "loads"], loads.table),
        ("loops that swing by their own fault", [r for r in rows if r["part"] == "own"], own_fault.table),
        ("irregular and lost samples", [r for r in rows if r["part"] == "telemetry"], telemetry.table),
        ("bad changes injected", [r for r in rows if r["part"] == "injected"], injected.table),
    ):
        if of:
            seeds = sorted({row["seed"] for row in of})
            _say(
                [f"{title}; {len(of)} runs" + (f", seeds {seeds}" if of[0]["part"] != "batch" else ""), *table(of), ""]
            )
    return rows, True


def _pictures(options: argparse.Namespace) -> tuple[list[Path], bool]:
    from online import pictures

    names = pictures.draw(options.folder, options.batch)
    _say([str(name) for name in names])
    return names, True


PARTS = {
    "ablation": _ablation,
    "batch": _batch,
    "walks": _walks,
    "tours": _tours,
    "changes": _changes,
    "elsewhere": _elsewhere,
    "harm": _harm,
    "injected": _injected,
    "loads": _loads,
    "oracle": _oracle,
    "own": _own,
    "telemetry": _telemetry,
    "tables": _tables,
    "pictures": _pictures,
}


def _tour_options(part: argparse.ArgumentParser) -> None:
    part.add_argument("--kind", choices=("all", *tours.KINDS), default=tours.SMOOTH)
    part.add_argument("--loops", type=int, default=8, help="tours of each kind")
    part.add_argument("--start", choices=("middle", "quarter", "own"), default="quarter")
    part.add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
    part.add_argument("--places", type=int, default=tours.PLACES, help="of each tour")
    part.add_argument("--lookup", choices=("hard", "interpolated"), default="hard")


def _elsewhere_options(part: argparse.ArgumentParser) -> None:
    part.add_argument("--kind", choices=("all", *elsewhere.KINDS), default="all")
    part.add_argument("--loops", type=int, default=10, help="loops of each kind")
    part.add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
    part.add_argument("--places", type=int, default=elsewhere.PLACES, help="setpoints of each loop")


def _ablation_options(part: argparse.ArgumentParser) -> None:
    part.add_argument("--of", choices=tuple(ablation.PARTS), default="batch", help="runs of this part")
    part.add_argument("--kind", default="all", help="loops of this kind only (not of batch)")
    part.add_argument("--loops", type=int, default=8, help="loops of each kind (not of batch)")
    part.add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
    names = [piece.name for piece in ablation.PIECES]
    part.add_argument("--pieces", nargs="+", choices=names, default=names)


def _loop_parts(parts: "argparse._SubParsersAction[argparse.ArgumentParser]", common: argparse.ArgumentParser) -> None:
    one = parts.add_parser("batch", parents=[common], help="the standard batch of 134 processes, gains off")
    one.add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
    one.add_argument("--only", default="", help='processes whose name begins so: "P6", "P1 T=0.02"')
    one.add_argument("--noise", type=float, default=batch.NOISE, help="share of a setpoint step")
    one.add_argument("--rivals", action="store_true", help="the same runs under fixed gains, relay, step, pattern")
    one.add_argument("--starts", type=int, default=1, help=f"wrong starts per process, of {len(batch.STARTS)}")
    two = parts.add_parser("harm", parents=[common], help="quiet hours, stiction, outside oscillations, saturation")
    two.add_argument("--kind", choices=("all", *harm.KINDS), default="all")
    two.add_argument("--hours", type=int, default=100, help="quiet hours")
    two.add_argument("--loops", type=int, default=40, help="loops of each other kind")
    three = parts.add_parser("changes", parents=[common], help="coloured noise, starts in motion, changes, drift")
    three.add_argument("--kind", choices=("all", *changes.KINDS), default="all")
    three.add_argument("--loops", type=int, default=40, help="loops of each kind")
    four = parts.add_parser("walks", parents=[common], help="setpoint walks over a process that varies by 4")
    four.add_argument("--walks", type=int, default=10)
    four.add_argument("--setpoints", type=int, default=walks.SETPOINTS, help="of each walk")


def _more_parts(parts: "argparse._SubParsersAction[argparse.ArgumentParser]", common: argparse.ArgumentParser) -> None:
    _tour_options(parts.add_parser("tours", parents=[common], help="nonlinear plants: visits until a region is good"))
    _elsewhere_options(parts.add_parser("elsewhere", parents=[common], help="gains for regions where the loop is not"))
    five = parts.add_parser("injected", parents=[common], help="deliberately bad changes on trial")
    five.add_argument("--kind", choices=("all", *injected.KINDS), default="all")
    five.add_argument("--loops", type=int, default=40, help="changes of each kind")
    five.add_argument("--wander", choices=loads.WANDERING, default="", help="a load that goes on all the time")
    eight = parts.add_parser("loads", parents=[common], help="loads of every kind and no setpoint step, gains off")
    eight.add_argument("--kind", choices=("all", *loads.KINDS), default="all")
    eight.add_argument("--loops", type=int, default=20, help="loops of each kind")
    eight.add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
    eight.add_argument("--nudge", type=float, default=0.0, help="percent of pv's range of a bump of the setpoint")
    eleven = parts.add_parser("oracle", parents=[common], help="Cramer-Rao bounds of what loads alone could tell")
    eleven.add_argument("--loops", type=int, default=60, help="loops of each kind")
    eleven.add_argument("--nudge", type=float, default=0.0, help="percent of pv's range of a bump once a period")
    eleven.add_argument("--moves", choices=tuple(oracle.MOVES), default="one", help="to one side, or to and fro")
    nine = parts.add_parser("own", parents=[common], help="loops that swing by their own fault, Ms over 3")
    nine.add_argument("--kind", choices=("all", *own_fault.KINDS), default="all")
    nine.add_argument("--loops", type=int, default=20, help="loops of each kind")
    ten = parts.add_parser("telemetry", parents=[common], help="the batch with irregular times and lost samples")
    ten.add_argument("--kind", choices=("all", *telemetry.KINDS), default="all")
    _ablation_options(parts.add_parser("ablation", parents=[common], help="what each piece of the live path holds"))


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
    _loop_parts(parts, common)
    _more_parts(parts, common)
    seven = parts.add_parser("tables", help="the tables again, of rows from files")
    seven.add_argument("files", type=Path, nargs="+", metavar="FILE", help="as --out writes them")
    six = parts.add_parser("pictures", help="the pictures of docs/developers/online.md")
    six.add_argument("folder", type=Path)
    six.add_argument("--batch", type=Path, nargs="+", required=True, metavar="FILE", help="rows of batch, as --out")
    return parser
