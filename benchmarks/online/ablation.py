"""What does each piece of the live path hold? It is taken away in all runs in which it decided something.

A piece is a function that answers a question of its own beside the models: its neutral answer stands for its absence.
Every run is made as it is, with what each piece said; then, for each piece, the runs in which it ever said something
else than its neutral answer are made again without it. In the other runs its absence cannot be seen.

Counted are the tables of the parts (batch, own, harm, loads, changes) as they are and without each piece, and the time
of a core over the runs that were made again.
"""

import importlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple
from unittest.mock import patch

from online import batch, changes, harm, loads, own_fault

Row = dict[str, Any]
PARTS: dict[str, ModuleType] = {"batch": batch, "own": own_fault, "harm": harm, "loads": loads, "changes": changes}
SUPERVISION = "retuner.adaptive.supervision"


class Piece(NamedTuple):
    """A function of a module by its name, and what stands for its absence."""

    name: str
    module: str
    function: str
    neutral: Any = None


PIECES = (
    Piece("growth", f"{SUPERVISION}.pipeline", "grows"),
    Piece("lasting", f"{SUPERVISION}.causes", "lasting"),
    Piece("swing", f"{SUPERVISION}.pipeline", "foreign_swing"),
    Piece("hidden", f"{SUPERVISION}.causes", "hidden_cause", (None, False)),
    Piece("held_up", f"{SUPERVISION}.causes", "_held_up", neutral=False),
    Piece("swing_known", f"{SUPERVISION}.pipeline", "known_of_swing"),
    Piece("known_to_swing", f"{SUPERVISION}.causes", "known_to_swing", neutral=False),
    Piece("at_rest", "retuner.adaptive.diagnosis.second_opinion", "was_at_rest", neutral=True),
    Piece("calm_before", "retuner.adaptive.diagnosis.second_opinion", "calm_before", neutral=True),
    Piece("not_seen", f"{SUPERVISION}.causes", "not_seen", ""),
    Piece("runs_away", f"{SUPERVISION}.causes", "runs_away", neutral=False),
    Piece("crossover", f"{SUPERVISION}.causes", "at_own_crossover", neutral=False),
    Piece("known", f"{SUPERVISION}.pipeline", "is_known", neutral=False),
    Piece("borne_out", f"{SUPERVISION}.causes", "borne_out", neutral=False),
    Piece("refuted", f"{SUPERVISION}.pipeline", "not_as_modelled"),
    Piece("confirming", f"{SUPERVISION}.causes", "unconfirmed"),
)


@dataclass(frozen=True, slots=True)
class Task:
    """A run of a part. without : name of the piece that is taken away, empty for none."""

    part: str
    task: Any
    without: str = ""


def run(task: Task) -> Row:
    """The row of the part; keys said (how often each piece decided something) and cpu_s besides."""
    said: Counter[str] = Counter()
    begun = time.process_time()
    with _changed(task.without, said):
        row: Row = PARTS[task.part].run(task.task)
    return row | {"said": dict(said), "cpu_s": time.process_time() - begun, "without": task.without}


@contextmanager
def _changed(without: str, said: Counter[str]) -> Iterator[None]:
    """All pieces counted, one of them taken away."""
    with ExitStack() as stack:
        for piece in PIECES:
            module = importlib.import_module(piece.module)
            if not hasattr(module, piece.function):  # a piece that has gone
                continue
            now = getattr(module, piece.function)
            stands = _absent(piece) if piece.name == without else _heard(piece, now, said)
            stack.enter_context(patch.object(module, piece.function, stands))
        yield


def _absent(piece: Piece) -> Callable[..., Any]:
    return lambda *_: piece.neutral


def _heard(piece: Piece, now: Callable[..., Any], said: Counter[str]) -> Callable[..., Any]:
    """The function, and count what it says."""

    def heard(*given: Any) -> Any:  # noqa: ANN401  whatever it takes and gives
        found = now(*given)
        said[piece.name] += found != piece.neutral
        return found

    return heard


def again(tasks: list[Task], rows: list[Row], pieces: list[str]) -> list[Task]:
    """The runs in which a piece decided something, without it."""
    return [
        Task(task.part, task.task, name)
        for name in pieces
        for task, row in zip(tasks, rows, strict=True)
        if row["said"].get(name)
    ]


def table(part: str, tasks: list[Task], rows: list[Row], others: list[tuple[Task, Row]]) -> list[str]:
    """The part's own table as it is, and with the runs that another piece's absence has changed."""
    own = [i for i, task in enumerate(tasks) if task.part == part]
    lines = [f"== {part}, as it is", *PARTS[part].table([rows[i] for i in own])]
    for name in dict.fromkeys(task.without for task, _ in others if task.part == part):
        made = {id(task.task): row for task, row in others if task.part == part and task.without == name}
        merged = [made.get(id(tasks[i].task), rows[i]) for i in own]
        before = sum(rows[i]["cpu_s"] for i in own if id(tasks[i].task) in made)
        after = sum(row["cpu_s"] for row in made.values())
        lines += [
            f"== {part}, without {name}: {len(made)} of {len(own)} runs again; {before:.0f} s with it, {after:.0f} s "
            "without",
            *PARTS[part].table(merged),
        ]
    return lines
