"""Rows as they come, appended to a file as lines of JSON; what the file already holds is not worked out again."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Protocol, TypeVar

from online.runner import finite, rows_of

Row = dict[str, Any]


class Keyed(Protocol):
    """A task that is told from others by its key."""

    def key(self) -> list[Any]:
        """See above."""


K = TypeVar("K", bound=Keyed)
Spread = Callable[[Callable[[K], Row], Iterable[K], int], Iterator[Row]]


def stream(
    work: Callable[[K], Row],
    tasks: Sequence[K],
    spread: Spread[K],
    jobs: int,
    out: Path | None,
    shown: Callable[[Row], str] | None,
) -> tuple[list[Row], bool]:
    """All rows, those of the file first, and whether every task was done (not, after Ctrl-C).

    shown : what to print of each.
    """
    rows: list[Row] = rows_of(out) if out and out.exists() else []
    known = {json.dumps(row["key"]) for row in rows}
    left = [task for task in tasks if json.dumps(task.key()) not in known]
    with out.open("a", encoding="utf-8") if out else nullcontext() as file:
        try:
            for done, row in enumerate(spread(work, left, jobs), 1):
                rows.append(row)
                if file:
                    file.write(json.dumps(finite(row)) + "\n")
                    file.flush()
                if shown:
                    sys.stdout.write(shown(row) + "\n")
                    sys.stdout.flush()
                sys.stderr.write(f"{done} of {len(left)}\n")
        except KeyboardInterrupt:
            return rows, False
    return rows, True
