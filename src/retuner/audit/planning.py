"""What is still to be done of an audit: all loops screened, then those diagnosed that are asked for; how long it takes.

Where only a share of the loops is diagnosed, these are the worst by the screening. Its numbers alone say which they
are, so an audit that goes on takes the same.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from retuner.audit.catalogue import Task
from retuner.audit.loop_row import AuditSettings, Row
from retuner.audit.result_store import signature

STRETCH_S, SCREEN_S = 0.3, 0.05
"""Seconds of a core for a stretch, and for reading and screening a loop for a month, on a machine of 2025."""
LONG_S = 300.0
"""Work that is told beforehand."""


@dataclass(frozen=True, slots=True)
class Pass:
    """Tasks that are done with the same settings; signed : what their rows hang on, by task."""

    settings: AuditSettings
    tasks: tuple[Task, ...]
    signed: Mapping[Task, str]


def screening(tasks: Sequence[Task], settings: AuditSettings, done: Mapping[str, str], share: float) -> Pass:
    """What comes first: the screening of all loops, with their diagnosis where all are diagnosed.

    Parameters
    ----------
    tasks : of all loops. settings : of the audit. done : signatures of the rows that are there, by tag. share : of the
    loops that are diagnosed, 0 to 1.
    """
    whole = share >= 1 or settings.stretches == 0
    own = settings if whole else replace(settings, stretches=0)
    signed = {task: signature(task, own) for task in tasks}
    known = {task: {signed[task], signature(task, settings)} for task in tasks}
    left = tuple(task for task in tasks if any(done.get(tag) not in known[task] for tag in task.tags))
    return Pass(own, left, signed)


def diagnosing(
    tasks: Sequence[Task], settings: AuditSettings, rows: Iterable[Row], done: Mapping[str, str], share: float
) -> Pass:
    """What comes then: the diagnosis of the share of the loops that the screening shows worst; parameters as above."""
    asked = sorted(((_asked(row), str(row["tag"])) for row in rows), key=lambda one: (-one[0], one[1]))
    chosen = {tag for worth, tag in asked[: round(share * len(asked))] if worth > 0}
    some = [replace(task, tags=tuple(tag for tag in task.tags if tag in chosen)) for task in tasks]
    signed = {task: signature(task, settings) for task in some if task.tags}
    left = tuple(task for task in signed if any(done.get(tag) != signed[task] for tag in task.tags))
    return Pass(settings, left, signed)


def _asked(row: Row) -> float:
    """How much the screening asks for a diagnosis: a number of the row."""
    asked = row.get("asks")
    return float(asked) if isinstance(asked, (int, float)) else 0.0


def expected(loops: int, stretches: int, share: float, jobs: int) -> str:
    """How long it is likely to take where that is long, and how to have it sooner; else nothing."""

    def seconds(of: float) -> float:
        return loops * (SCREEN_S + STRETCH_S * stretches * of) / jobs

    if (whole := seconds(share)) < LONG_S:
        return ""
    cores = "1 core" if jobs == 1 else f"{jobs} cores"
    told = f"{loops} loops, {share:.0%} of them diagnosed on up to {stretches} stretches of each record: "
    told += f"about {in_words(whole)} on {cores}"
    sooner = min(share, 0.2)
    hint = f"; --diagnose {100 * sooner:.0f} takes the worst of them only, about {in_words(seconds(sooner))}"
    return told + (hint if sooner < share and stretches else "")


def in_words(seconds: float) -> str:
    """A time as a person says it."""
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
