"""For all tests: one thread for linear algebra, how hard to try (support/effort.py), and the seed of the order told."""

import gc
import os
import time
from collections import Counter, deque
from collections.abc import Generator

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_library] = "1"  # thousands of small matrices: threads only get in each other's way

import pytest  # noqa: E402  the threads are counted when numpy is loaded
from effort import EFFORT, VARIABLE, load_profile  # noqa: E402

load_profile()
gc.disable()  # thousands of modules and tests are there to stay: they are not looked through while they are collected

COUNTED_S = 0.5
"""CPU time that the cases of one test may take in a process while their lines are counted (--cov). The tracer makes a
test two to three times as long, and what the first cases do not run the others seldom do: the coverage that is told is
a lower bound."""
_spent_s: Counter[str] = Counter()


def pytest_configure(config: pytest.Config) -> None:
    whole_suite = config.args_source is not pytest.Config.ArgsSource.ARGS
    if whole_suite and not config.option.markexpr:
        config.option.markexpr = EFFORT.marks


def pytest_collection_finish() -> None:
    """And not after it, either; what tests leave is looked through less often (6 % of their time at 2,000)."""
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


@pytest.hookimpl(trylast=True)  # when their order is drawn
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with long tests begin first, one on each worker in turn, so that none is left alone at the end; each
    whole, so that what its tests share is made once.

    The workers get equal pieces of the list, one after the other (--dist worksteal).
    """
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    files = list(dict.fromkeys(item.path for item in items if item.get_closest_marker("slow")))
    long = [item for item in items if item.path in files]
    others = deque(item for item in items if item.path not in files)
    ordered: list[pytest.Item] = []
    for worker in range(workers):
        piece = (len(items) - len(ordered)) // (workers - worker)
        mine = [item for item in long if files.index(item.path) % workers == worker]
        ordered += mine + [others.popleft() for _ in range(min(piece - len(mine), len(others)))]
    items[:] = [*ordered, *others]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Without the tracer run uncounted tests, and the further cases of a test that has taken its time under it."""
    test, begun_s = item.nodeid.partition("[")[0], time.process_time()
    long = item.get_closest_marker("uncounted") or _spent_s[test] > COUNTED_S
    if long and not item.config.getoption("cov_context", None):  # who runs which line?
        item.add_marker("no_cover")
    try:
        return (yield)
    finally:
        _spent_s[test] += time.process_time() - begun_s


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """The same order again: the seed is not shown in the header of a quiet run, and a failure needs it."""
    seed = config.getoption("randomly_seed", None)
    terminalreporter.write_line(f"{VARIABLE}={EFFORT.name}; the same order again: --randomly-seed={seed}")
