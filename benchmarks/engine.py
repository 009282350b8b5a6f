"""What identify and diagnose cost: CPU seconds a call on 20 kinds of records of about 1,000 samples, with the answers.

    python benchmarks/engine.py [--out FILE] [--rounds 3] [--only "setpoint"]
    python benchmarks/engine.py --against FILE

The kinds: the eight causes, eleven ways in which records in automatic come about, and a random load. Of each the first
drawn record with 900 to 1,100 samples. CPU time of this process, one thread, the median of the rounds; imports and a
first call are made before. A fixed piece of work is timed beside each call (the yardstick), so that numbers of another
day can be held against these: `ratio` is a call's time over the yardstick's. --against prints, for each record, the
ratio stored in FILE over the ratio now, and whether the answer is the same.
"""

import argparse
import json
import math
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

SEED = 61
"""Seed of the first kind; each has its own, or all would be of the same process."""
SAMPLES = (900, 1100)
DRAWS = 2000
"""Cases looked at for one that long."""
AUTOMATIC = (
    "setpoint",
    "load",
    "setpoint and load",
    "several",
    "ramp drift",
    "random-walk drift",
    "quantised",
    "saturated",
    "irregular time",
    "starts in motion",
    "pid",
)
CAUSES = ("ok", "aggressive", "sluggish", "slow_integrating", "stiction", "external", "saturation", "noise")
TRAPS = ("random walk",)

Row = dict[str, Any]


class Kind(NamedTuple):
    """A kind of record: which generator draws it, and the name it has there."""

    source: str
    name: str


KINDS = (
    *(Kind("diagnosis", name) for name in CAUSES),
    *(Kind("identification", name) for name in AUTOMATIC),
    *(Kind("traps", name) for name in TRAPS),
)


def drawn(kind: Kind) -> Any:  # noqa: ANN401  a case of either kind
    """The first case of a kind that is about as long as wanted.

    Raises RuntimeError: there is none among the first DRAWS.
    """
    from cases import diagnosis, identification, traps

    source = {"diagnosis": diagnosis, "identification": identification, "traps": traps}[kind.source]
    low, high = SAMPLES
    for index in range(DRAWS):
        case = source.case(SEED + KINDS.index(kind), index, kind.name)
        if low <= len(case.record.t) <= high:
            return case
    raise RuntimeError(f"{kind.name}: no record of {low} to {high} samples in {DRAWS} draws")


def calls(case: Any) -> dict[str, Callable[[], Any]]:  # noqa: ANN401  a case of either kind
    """What is timed of a case."""
    from retuner import identify
    from retuner.diagnosing import diagnose

    record = case.record
    signals = (record.t, record.sp, record.pv, record.co)
    known = {"gains": case.gains, "co_min": case.co_min, "co_max": case.co_max}
    return {"identify": lambda: identify(*signals, **known), "diagnose": lambda: diagnose(*signals, **known)}


def yardstick() -> float:
    """CPU seconds of a fixed piece of work of the kind that fits are made of: short recursions and small matrices."""
    import numpy as np

    begun = time.process_time()
    matrix = np.vander(np.linspace(0.1, 1.0, 1000), 6)
    x = 0.0
    for i in range(100):
        np.linalg.qr(matrix)
        for _ in range(1000):
            x = 0.99 * x + math.sqrt(i)
    return time.process_time() - begun


def timed(work: Callable[[], Any], rounds: int) -> tuple[list[float], list[float], Any]:
    """CPU seconds of each round, the yardstick's beside it, and the answer (or what was refused)."""
    took, measure, answer = [], [], None
    for _ in range(rounds):
        measure.append(yardstick())
        begun = time.process_time()
        try:
            found = work()
        except ValueError as error:
            answer = {"refused": str(error)}
        else:
            answer = found.to_dict()
        took.append(time.process_time() - begun)
    return took, measure, answer


def measured(kind: Kind, rounds: int) -> Row:
    """Times and answers of one kind."""
    case = drawn(kind)
    row: Row = {
        "kind": kind.name,
        "source": kind.source,
        "index": case.index,
        "family": case.family,
        "samples": len(case.record.t),
    }
    for name, work in calls(case).items():
        took, measure, answer = timed(work, rounds)
        ratio = statistics.median(one / other for one, other in zip(took, measure, strict=True))
        row[name] = {
            "seconds": took,
            "median_s": statistics.median(took),
            "yardstick_s": measure,
            "ratio": ratio,
            "answer": json.loads(json.dumps(answer, default=str)),
        }
    return row


CALLS = ("identify", "diagnose")


def line(row: Row, stored: Row | None) -> str:
    """A record in one line."""
    text = f"{row['kind']:<20}{row['family']:<16}{row['samples']:>5}"
    for name in CALLS:
        text += f"{row[name]['median_s']:>10.3f}{row[name]['ratio']:>9.1f}"
        if stored:
            same = "same" if row[name]["answer"] == stored[name]["answer"] else "OTHER"
            text += f"{stored[name]['ratio'] / row[name]['ratio']:>8.2f}x {same:<6}"
    return text


def summary(rows: list[Row], stored: dict[str, Row]) -> list[str]:
    """Median, largest and sum of each call."""
    lines = []
    for name in CALLS:
        took = [row[name]["median_s"] for row in rows]
        text = f"{name}: median {statistics.median(took):.3f} s, largest {max(took):.3f} s, all {sum(took):.1f} s"
        known = [(stored[row["kind"]][name], row[name]) for row in rows if row["kind"] in stored]
        if known:
            faster = [before["ratio"] / now["ratio"] for before, now in known]
            same = sum(before["answer"] == now["answer"] for before, now in known)
            text += (
                f"; stored over now: median {statistics.median(faster):.2f}, {same} of {len(known)} answers the same"
            )
        lines.append(text)
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="calls of each, the median counts")
    parser.add_argument("--only", choices=[kind.name for kind in KINDS])
    parser.add_argument("--out", type=Path, metavar="FILE", help="times and answers as JSON")
    parser.add_argument("--against", type=Path, metavar="FILE", help="as --out wrote it")
    options = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported
    stored = {row["kind"]: row for row in json.loads(options.against.read_text())} if options.against else {}
    kinds = [kind for kind in KINDS if options.only in {None, kind.name}]
    for work in calls(drawn(kinds[0])).values():
        timed(work, 1)
    rows = []
    for kind in kinds:
        rows.append(measured(kind, options.rounds))
        sys.stdout.write(line(rows[-1], stored.get(kind.name)) + "\n")
        sys.stdout.flush()
    sys.stdout.write("\n".join(summary(rows, stored)) + "\n")
    if options.out:
        options.out.write_text(json.dumps(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
