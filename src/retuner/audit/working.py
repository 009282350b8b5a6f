"""The work of an audit spread over processes: of this machine, or of a dask cluster; results are kept as they come.

A task whose process dies is tried once more, each of its loops by itself; one that dies as well is a row that says so.
Ctrl-C keeps what is done.
"""

import os
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from typing import Any

from retuner.audit.catalogue import Task
from retuner.audit.loop_row import AuditSettings, Row, audit_task, failed
from retuner.audit.result_store import signature
from retuner.errors import UserError
from retuner.schedule.late_dataclass import dataclass, replace

AHEAD = 3  # tasks that are given out beyond those at work, a process
MOST_GIVEN_OUT = 2_000  # tasks that a cluster has at once
Work = Callable[[Task], list[Row]]


def processes() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_this_machine(
    tasks: Sequence[Task], settings: AuditSettings, jobs: int, work: Work | None = None
) -> Iterator[tuple[Task, list[Row]]]:
    """Tasks with their rows as they are done.

    jobs : processes; 1 does all in this one. work : what is done with a task, audit_task by itself.
    """
    do = work or partial(audit_task, settings=settings)
    if jobs == 1:
        for task in tasks:
            yield task, do(task)
        return
    left, again = list(reversed(tasks)), list[Task]()
    while left:
        broken = yield from _until_broken(left, do, jobs)
        again += broken
    for task in again:
        rows = list[Row]()
        for tag in task.tags:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_quiet) as pool:
                try:
                    rows += pool.submit(do, replace(task, tags=(tag,))).result()
                except BrokenProcessPool:
                    rows.append(failed(tag, "its process died twice, perhaps out of memory"))
        yield task, rows


def _until_broken(left: list[Task], do: Work, jobs: int) -> Generator[tuple[Task, list[Row]], None, list[Task]]:
    """Work with one pool until all is done or one of its processes dies; what was at work then is given back."""
    running: dict[Future[list[Row]], Task] = {}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_quiet) as pool:
        try:
            while left or running:
                while left and len(running) < jobs * AHEAD:
                    task = left.pop()
                    running[pool.submit(do, task)] = task
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    rows = future.result()  # before its task goes: where its process died, the task is done again
                    yield running.pop(future), rows
        except BrokenProcessPool:
            return list(running.values())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return []


def _quiet() -> None:
    """A process of the pool leaves Ctrl-C to the one that waits for it, and takes one core."""
    import signal  # noqa: PLC0415  only here

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def on_a_cluster(tasks: Sequence[Task], settings: AuditSettings, address: str) -> Iterator[tuple[Task, list[Row]]]:
    """The work on a dask cluster, which tries tasks of dead workers again.

    Raises UserError: dask.distributed is not installed, or nobody answers at the address.
    """
    try:
        cluster: Any = import_module("distributed")  # an extra, loaded when wanted
    except ImportError:
        raise UserError('--scheduler needs dask.distributed; pip install "retuner[cluster]"') from None
    try:
        client = cluster.Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise UserError(f"--scheduler {address}: no answer there: {error}") from error
    left = list(reversed(tasks))
    with client:
        futures = {}
        going = cluster.as_completed([], with_results=False)
        for task in (left.pop() for _ in range(min(len(left), MOST_GIVEN_OUT))):
            futures[future := client.submit(audit_task, task, settings, pure=False, retries=2)] = task
            going.add(future)
        for future in going:
            task = futures.pop(future)
            broken = future.exception()
            rows = [failed(tag, f"its worker: {broken}") for tag in task.tags] if broken else future.result()
            if left:
                futures[further := client.submit(audit_task, left[-1], settings, pure=False, retries=2)] = left.pop()
                going.add(further)
            yield task, rows


# ---- What is still to be done of an audit: all loops screened, then those diagnosed that are asked for; how long
# it takes.
#
# Where only a share of the loops is diagnosed, these are the worst by the screening. Its numbers alone say which they
# are, so an audit that goes on takes the same.

STRETCH_S, SCREEN_S = 0.3, 0.05
"""Seconds of a core for a stretch, and for reading and screening a loop for a month, on a machine of 2025."""
LONG_S = 300.0  # work that is told beforehand


@dataclass(frozen=True, slots=True)
class Pass:
    """Tasks that are done with the same settings; signed : what their rows hang on, by task."""

    settings: AuditSettings
    tasks: tuple[Task, ...]
    signed: Mapping[Task, str]


def screening(tasks: Sequence[Task], settings: AuditSettings, done: Mapping[str, str], share: float) -> Pass:
    """What comes first: the screening of all loops, with their diagnosis where all are diagnosed.

    tasks : of all loops. settings : of the audit. done : signatures of the rows that are there, by tag. share : of the
    loops that are diagnosed, 0 to 1.
    """
    own = settings if share >= 1 or settings.stretches == 0 else replace(settings, stretches=0)
    signed = {task: signature(task, own) for task in tasks}
    known = {task: {signed[task], signature(task, settings)} for task in tasks}
    left = tuple(task for task in tasks if any(done.get(tag) not in known[task] for tag in task.tags))
    return Pass(own, left, signed)


def diagnosing(
    tasks: Sequence[Task], settings: AuditSettings, rows: Iterable[Row], done: Mapping[str, str], share: float
) -> Pass:
    """What comes then: the diagnosis of the share of the loops that the screening shows worst; parameters as above."""
    asked = sorted(
        ((float(row.get("asks") or 0.0), str(row["tag"])) for row in rows), key=lambda one: (-one[0], one[1])
    )
    chosen = {tag for worth, tag in asked[: round(share * len(asked))] if worth > 0}
    some = [replace(task, tags=tuple(tag for tag in task.tags if tag in chosen)) for task in tasks]
    signed = {task: signature(task, settings) for task in some if task.tags}
    left = tuple(task for task in signed if any(done.get(tag) != signed[task] for tag in task.tags))
    return Pass(settings, left, signed)


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
