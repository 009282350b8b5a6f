"""Runs spread over processes, every result a line of JSON as soon as it is there, a table at the end or at Ctrl-C."""

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from cases.case import spread

Row = dict[str, Any]
T = TypeVar("T")
PLACES = 42  # of a tour
REPORTS = 10  # Lines of progress where standard error is no terminal


@dataclass(frozen=True, slots=True)
class Task:
    """One loop of a part of the measurement: of a kind, drawn by seed and index.

    verbose : tell what was decided. opened : limits of a change at x8 instead of the defaults. The others are what some
    parts ask besides, as the command line says it: bumps of the setpoint, a load that wanders, where a tour starts and
    how long it is, records of real loads.
    """

    kind: str
    seed: int
    index: int
    verbose: bool = False
    opened: bool = False
    bumps: float = 0.0
    wander: str = ""
    start: str = "quarter"
    places: int = PLACES
    lookup: str = "hard"
    data: str = ""
    fold: int | None = None
    alone: bool = False
    section: int = 1000


def collect(
    work: Callable[[T], Row],
    tasks: Sequence[T],
    jobs: int,
    out: Path | None,
    shown: Callable[[Row], str] | None,
    *,
    more: bool = False,
) -> tuple[list[Row], bool]:
    """All rows, and whether every task was done (not, after Ctrl-C).

    shown : what to print of a row at once. more : tasks are told by their key(); those whose rows the file holds are
    not done again, and the others' rows are added to it.
    """
    rows: list[Row] = rows_of(out) if more and out and out.exists() else []
    known, begun = {json.dumps(row["key"]) for row in rows}, time.monotonic()
    left = [task for task in tasks if not more or json.dumps(task.key()) not in known]
    with out.open("a" if more else "w", encoding="utf-8") if out else nullcontext() as file:
        try:
            for done, row in enumerate(spread(work, left, jobs), 1):
                rows.append(row)
                if file:
                    file.write(json.dumps(finite(row)) + "\n")
                    file.flush()
                if shown and (text := shown(row)):
                    sys.stdout.write(text + "\n")
                    sys.stdout.flush()
                of = len(left)
                seconds = time.monotonic() - begun
                if sys.stderr.isatty():
                    sys.stderr.write(f"\r{done} of {of}, {seconds:.0f} s" + ("\n" if done == of else ""))
                    sys.stderr.flush()
                elif done * REPORTS // of > (done - 1) * REPORTS // of:
                    sys.stderr.write(f"{done} of {of}, {seconds:.0f} s\n")
        except KeyboardInterrupt:
            sys.stderr.write(f"\nstopped after {len(rows)} of {len(tasks)}\n")
            return rows, False
    return rows, True


def finite(value: Any) -> Any:  # noqa: ANN401  whatever a row may hold
    """The same with null for what JSON has no number for."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(x) for key, x in value.items()}
    return [finite(x) for x in value] if isinstance(value, (list, tuple)) else value


def rows_of(path: Path) -> list[Row]:
    """The rows of a file again: null was a number too large, or none."""
    return [_infinite(json.loads(text)) for text in path.read_text(encoding="utf-8").splitlines()]


def _infinite(value: Any) -> Any:  # noqa: ANN401  whatever a row may hold
    """The same with infinity for null."""
    if value is None:
        return math.inf
    if isinstance(value, dict):
        return {key: _infinite(x) for key, x in value.items()}
    return [_infinite(x) for x in value] if isinstance(value, list) else value
