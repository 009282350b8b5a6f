"""How good an audit is, on a plant of which everything is known, and what it costs.

    python benchmarks/audit/audit.py --loops 500 --days 7 --seed 41 --stretches 3 --jobs 2

Printed: causes as named against the true ones; of the first places how many deserve a visit; roots of common swings;
advice to retune a valve that sticks; core-hours for 10,000 loop-days and the largest memory of a process. A line of
JSON at the end.
"""

import argparse
import json
import resource
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from plant import FAULTS, Loop, plant

from retuner.adaptive.audit.loop_screen import screen_loop
from retuner.audit.catalogue import catalogue, files_of
from retuner.audit.loop_row import AuditSettings, Row
from retuner.audit.ranked_loops import ranked
from retuner.audit.working import on_this_machine
from retuner.drivers.historian.loop_record import read_loop_record
from retuner.drivers.historian.record_form import RecordForm

ANSWERS = {
    "ok": {"ok", "noise"},
    "cascade": {"ok", "noise", "unknown"},
    "sluggish": {"sluggish", "slow_integrating"},
    "aggressive": {"aggressive", "slow_integrating"},
    "stiction": {"stiction"},
    "external": {"external"},
    "saturation": {"saturation"},
    "interaction": {"interaction"},
}
"""Causes that are right, by the true kind; manual and dead loops are told by what is to be done."""
NO_VISIT = {"nothing", "record a setpoint step", "screened only"}
DONE = {"manual": "find out why it is in manual", "dead": "check the sensor or the tag"}


def is_right(loop: Loop, row: Row) -> bool:
    """Whether the verdict is the true one."""
    if loop.kind == "interaction":
        return bool(row.get("interaction")) and loop.against in row.get("swings_with", [])
    return row["action"] == DONE[loop.kind] if loop.kind in DONE else row["cause"] in ANSWERS[loop.kind]


def judged(loops: dict[str, Loop], rows: list[Row], groups: list) -> dict[str, object]:
    right = Counter(loops[str(row["tag"])].kind for row in rows if is_right(loops[str(row["tag"])], row))
    total = Counter(loop.kind for loop in loops.values())
    named = Counter((loops[str(row["tag"])].kind, str(row["cause"])) for row in rows)
    first = [row for row in rows if row["action"] not in NO_VISIT][:50]
    wrong = [(row["tag"], loops[str(row["tag"])].kind, row["cause"], row["action"]) for row in first]
    wrong = [w for w in wrong if w[1] not in FAULTS]
    upset = [loop for loop in loops.values() if loop.root]
    masters = {str(row["tag"]): row.get("master") or "" for row in rows}
    root_of = {tag: group.root for group in groups for tag in group.tags}
    return {
        "right": {kind: f"{right[kind]} of {total[kind]}" for kind in total},
        "named": {f"{kind} as {cause}": n for (kind, cause), n in sorted(named.items())},
        "first_places_deserve": f"{len(first) - len(wrong)} of {len(first)}",
        "first_places_wrong": wrong,
        "roots_right": f"{sum(root_of.get(loop.tag) == loop.root for loop in upset)} of {len(upset)} upset loops",
        "groups_true": f"{sum(_is_true(group.tags, loops) for group in groups)} of {len(groups)}",
        "masters_right": f"{sum(masters[tag] == loop.master for tag, loop in loops.items())} of {len(loops)}",
        "retune_of_sticking": sum(
            row["action"] == "retune" for row in rows if loops[str(row["tag"])].kind == "stiction"
        ),
        "failed": [row["failed"] for row in rows if "failed" in row],
    }


def _is_true(tags: tuple[str, ...], loops: dict[str, Loop]) -> bool:
    """Whether the loops of a group swing together in truth: one root, its own loop too, or a pair."""
    sources = {loops[tag].root or min(tag, loops[tag].against or tag) for tag in tags}
    return len(sources) == 1


def screening(path: Path, loops: list[Loop]) -> dict[str, float]:
    """What screening costs over merely reading the file into arrow, CPU time, in one run."""
    times: Counter[str] = Counter()
    for loop in loops[:10]:
        started = time.process_time()
        pq.read_table(path, columns=["time", *(f"{loop.tag}.{s}" for s in ("SP", "PV", "OP"))])
        times["arrow"] += time.process_time() - started
        started = time.process_time()
        record = read_loop_record([path], RecordForm(tag=loop.tag))
        times["read"] += time.process_time() - started
        started = time.process_time()
        screen_loop(record.recording.window())
        times["screen"] += time.process_time() - started
    return {name: round(s / times["arrow"], 2) for name, s in times.items()}


def made_plant(folder: Path, count: int, days: float, seed: int) -> list[Loop]:
    """The loops of a plant in a folder, made there unless it is the same that stands there."""
    path, asked = folder / "truth.json", [count, days, seed]
    if path.is_file() and json.loads(path.read_text())["asked"] == asked:
        return [Loop(**loop) for loop in json.loads(path.read_text())["loops"]]
    loops = [loop for some in plant(folder, count, days, seed) for loop in some]
    path.write_text(json.dumps({"asked": asked, "loops": [vars(loop) for loop in loops]}))
    return loops


def _largest_kb(who: int) -> int:
    """The largest resident memory of this process, or of those that it waited for."""
    return resource.getrusage(who).ru_maxrss


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, kind, default in (("loops", int, 100), ("days", float, 3.0), ("seed", int, 1), ("stretches", int, 3)):
        parser.add_argument(f"--{name}", type=kind, default=default)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder in which the plant stays")
    parser.add_argument("--rows", type=Path, help="file for all rows and what is true of the loops")
    parser.add_argument("--only-make", action="store_true", help="make the plant in --keep and nothing else")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = given.keep or Path(made)
        folder.mkdir(exist_ok=True)
        made_of = made_plant(folder, given.loops, given.days, given.seed)
        if given.only_make:
            return
        loops = {loop.tag: loop for loop in made_of}
        ratios = screening(folder / "unit001.parquet", made_of)
        found = catalogue(files_of([folder]), RecordForm())
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime + time.process_time()
        rows = [r for _, some in on_this_machine(found.tasks, AuditSettings(given.stretches), given.jobs) for r in some]
        spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime + time.process_time() - before
        listed, groups = ranked(rows)
        result = judged(loops, listed, groups) | {
            "over_reading_arrow": ratios,
            "core_hours_per_10000_loop_days": round(spent / 3600 / (given.loops * given.days) * 10_000, 2),
            "cpu_s_a_loop": round(spent / given.loops, 3),
            "largest_process_mb": max(map(_largest_kb, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))) // 1024,
            "seed": given.seed,
        }
    if given.rows:
        given.rows.write_text(
            json.dumps({"rows": rows, "listed": listed, "truth": {tag: vars(loop) for tag, loop in loops.items()}})
        )
    for name, value in result.items():
        print(f"{name:32} {value}")
    print(json.dumps(result))


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
