"""For all tests: one thread for linear algebra, how hard to try (support/effort.py), and the seed of the order told."""

import os
import time
from collections import Counter
from collections.abc import Generator

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_library] = "1"  # thousands of small matrices: threads only get in each other's way

import pytest  # noqa: E402  the threads are counted when numpy is loaded
from effort import EFFORT, VARIABLE, load_profile  # noqa: E402

load_profile()

COUNTED_S = 0.5
"""CPU time that the cases of one test may take in a process while their lines are counted (--cov). The tracer makes a
test two to three times as long, and what the first cases do not run the others seldom do: the coverage that is told is
a lower bound."""
_spent_s: Counter[str] = Counter()


def pytest_configure(config: pytest.Config) -> None:
    whole_suite = config.args_source is not pytest.Config.ArgsSource.ARGS
    if whole_suite and not config.option.markexpr:
        config.option.markexpr = EFFORT.marks


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests run without the tracer."""
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.no_cover)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """And so do the further cases of a test that has taken its time under it."""
    test, begun_s = item.nodeid.partition("[")[0], time.process_time()
    if _spent_s[test] > COUNTED_S:
        item.add_marker(pytest.mark.no_cover)
    try:
        return (yield)
    finally:
        _spent_s[test] += time.process_time() - begun_s


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """The same order again: the seed is not shown in the header of a quiet run, and a failure needs it."""
    seed = config.getoption("randomly_seed", None)
    terminalreporter.write_line(f"{VARIABLE}={EFFORT.name}; the same order again: --randomly-seed={seed}")
