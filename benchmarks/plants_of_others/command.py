"""Retuner on plants and loads made by others. docs/developers/plants-of-others.md has the tables and licences.

The plants come with packages of their own, which a part that misses one names:

  pip install tclab tep-studio bsm2-python gym-electric-motor jsbsim jax && pip install --no-deps pcgym

Examples
--------
  python benchmarks/plants_of_others lab --seed 1
  python benchmarks/plants_of_others eastman --loop reactor_pressure --start low --verbose
"""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from online.runner import collect, rows_of

from plants_of_others import aircraft, eastman, pairs, session
from plants_of_others.columns import COLUMNS, Distillation
from plants_of_others.loop import Card, Plant
from plants_of_others.motor import Motor
from plants_of_others.pc_gym import PcGym
from plants_of_others.picture import draw
from plants_of_others.temperature_lab import TemperatureLab
from plants_of_others.truth import StepTest, Truth, truth
from plants_of_others.wastewater import Wastewater

HOUR = 3600.0
PLANTS: dict[str, Callable[[], Plant]] = {
    "lab": TemperatureLab,
    "eastman": eastman.Eastman,
    "wastewater": Wastewater,
    "motor": Motor,
    "pc-gym": PcGym,
    **{name: partial(Distillation, name) for name in COLUMNS},
}
TESTS: dict[str, Callable[[str], StepTest]] = {
    "lab": lambda _loop: StepTest(2400.0, 1500.0),
    "wastewater": lambda _loop: StepTest(0.5 * 24 * HOUR, HOUR, 0.02),
    "motor": lambda _loop: StepTest(0.05, 0.015, 0.01),
    "pc-gym": lambda _loop: StepTest(1800.0, 900.0, 0.01, "published"),
    **{name: lambda _loop: StepTest(HOUR, 5 * HOUR, 0.01, "search") for name in COLUMNS},
    "eastman": lambda loop: StepTest(
        6 * HOUR, eastman.LOOPS[loop].answer_h * HOUR, 0.005, "published" if loop == "reactor_temperature" else "search"
    ),
}


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="benchmarks/plants_of_others", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = parser.add_subparsers(dest="part", required=True)
    for name in PLANTS:
        part = parts.add_parser(name, help=f"loops of {name}")
        part.add_argument(
            "--seed", type=int, default=1, help="of the first session; 100 and above are for final tables"
        )
        part.add_argument("--sessions", type=int, default=1, help="of each loop and start, each with the next seed")
        part.add_argument("--loop", default="all")
        part.add_argument("--start", choices=("all", *session.STARTS), default="all")
        part.add_argument("--opened", action="store_true", help="limits of a change at x8 instead of the defaults")
        part.add_argument("--together", action="store_true", help="all loops start off and are retuned at once")
        part.add_argument("--live", action="store_true", help="no replays under gains that stay")
        part.add_argument("--every", type=int, default=1, help="only every n-th session")
        part.add_argument("--offset", type=int, default=0, help="and the first of these")
        part.add_argument("--out", type=Path, metavar="FILE", help="every session as a line of JSON")
        part.add_argument("--verbose", action="store_true", help="tell what was decided, and what is true")
    pitch = parts.add_parser("aircraft", help="pitch hold, gains over dynamic pressure")
    pitch.add_argument("--seed", type=int, default=1)
    pitch.add_argument("--sessions", type=int, default=1)
    pitch.add_argument("--start", choices=("all", *aircraft.STARTS), default="all")
    both = parts.add_parser("pairs", help="two loops of one plant retuned at once, apart and with regard to both")
    both.add_argument("--seed", type=int, default=1)
    both.add_argument("--sessions", type=int, default=1)
    both.add_argument("--plants", nargs="+", choices=tuple(pairs.PAIRS), default=tuple(pairs.PAIRS))
    both.add_argument("--starts", nargs="+", choices=tuple(pairs.STARTS), default=tuple(pairs.STARTS))
    both.add_argument("--out", type=Path, metavar="FILE", help="every session as a line of JSON")
    picture = parts.add_parser("picture", help="the picture of docs/developers/plants-of-others.md")
    picture.add_argument("folder", type=Path)
    picture.add_argument("--seed", type=int, default=1)
    picture.add_argument("--start", choices=tuple(session.STARTS), default="slow")
    tables = parts.add_parser("tables", help="the tables again, of rows from files")
    tables.add_argument("files", type=Path, nargs="+", metavar="FILE", help="as --out writes them")
    options = parser.parse_args()
    if options.part == "tables":
        rows = [row for file in options.files for row in rows_of(file)]
        _say(session.table(rows))
        return 0
    if options.part == "picture":
        _say([str(draw(options.folder, options.seed, options.start))])
        return 0
    alone = {"aircraft": aircraft.measure, "pairs": _pairs}
    return alone.get(options.part, _measure)(options)


def _pairs(options: argparse.Namespace) -> int:
    seeds = range(options.seed, options.seed + options.sessions)
    tasks = [pairs.Task(pair, start, seed) for pair in options.plants for start in options.starts for seed in seeds]
    rows, whole = collect(pairs.run, tasks, 1, options.out, pairs.line)
    _say(pairs.table(rows) if rows else ["no runs"])
    return 0 if rows and whole else 1


def _measure(options: argparse.Namespace) -> int:
    plant = PLANTS[options.part]()
    loops = [name for name in plant.cards if options.loop in {"all", name}]
    if not loops:
        raise SystemExit(f"there is no loop {options.loop!r}; {options.part} has {', '.join(plant.cards)}")
    truths = {loop: _truth(options.part, plant, plant.cards[loop]) for loop in loops}
    starts = [start for start in session.STARTS if options.start in {"all", start}]
    tasks = [
        session.Task(
            loop, start, options.seed + more, options.opened, not options.live, options.verbose, options.together
        )
        for loop in loops
        for start in starts
        for more in range(options.sessions)
    ]
    work = partial(session.run, plant, truths)
    rows, whole = collect(work, tasks[options.offset :: options.every], 1, options.out, session.line)
    _say(session.table(rows) if rows else ["no runs"])
    return 0 if rows and whole else 1


def _truth(part: str, plant: Plant, card: Card) -> Truth:
    found = truth(plant, card, TESTS[part](card.name))
    p, published = found.process, found.judge.of(card.published)
    best = found.judge.best
    _say(
        [
            f"{card.name}: k {p.k:.4g}, lags {_short(p.lags_s)}, leads {_short(p.leads_s)}, "
            f"dead time {p.theta_s:.3g} s, misfit {found.misfit:.1%}; best kc {best.kp:.4g} ki {best.ki:.4g} "
            f"(Ms {found.judge.ms_best:.2f}), published kc {card.published.kp:.4g} ki {card.published.ki:.4g} "
            f"(Ms {published.ms:.2f}, J {published.j:.2f})"
        ]
    )
    return found


def _short(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in values) + ") s"


def _say(lines: list[str]) -> None:
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()
