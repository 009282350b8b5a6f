"""For all tests: one thread for linear algebra, how hard to try (support/effort.py), and the seed of the order told."""

import os
from collections import Counter

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_library] = "1"  # thousands of small matrices: threads only get in each other's way

import pytest  # noqa: E402  the threads are counted when numpy is loaded
from effort import EFFORT, VARIABLE, load_profile  # noqa: E402

load_profile()

COUNTED_CASES = 4
"""Cases of a test whose lines are counted with --cov: a tracer makes a test two to three times as long, and what the
first cases do not run the others seldom do. The coverage that is told is so a lower bound."""


def pytest_configure(config: pytest.Config) -> None:
    whole_suite = config.args_source is not pytest.Config.ArgsSource.ARGS
    if whole_suite and not config.option.markexpr:
        config.option.markexpr = EFFORT.marks


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests, and the further cases of one test, are run without the tracer; the same ones in whatever order."""
    seen: Counter[str] = Counter()
    for item in sorted(items, key=lambda item: item.nodeid):
        test = item.nodeid.partition("[")[0]
        seen[test] += 1
        if seen[test] > COUNTED_CASES or item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.no_cover)


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """The same order again: the seed is not shown in the header of a quiet run, and a failure needs it."""
    seed = config.getoption("randomly_seed", None)
    terminalreporter.write_line(f"{VARIABLE}={EFFORT.name}; the same order again: --randomly-seed={seed}")
