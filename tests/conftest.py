"""For all tests: one thread for linear algebra, how hard to try (support/effort.py), and the seed of the order told."""

import os

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_library] = "1"  # thousands of small matrices: threads only get in each other's way

import pytest  # noqa: E402  the threads are counted when numpy is loaded
from effort import EFFORT, VARIABLE, load_profile  # noqa: E402

load_profile()


def pytest_configure(config: pytest.Config) -> None:
    whole_suite = config.args_source is not pytest.Config.ArgsSource.ARGS
    if whole_suite and not config.option.markexpr:
        config.option.markexpr = EFFORT.marks


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """The same order again: the seed is not shown in the header of a quiet run, and a failure needs it."""
    seed = config.getoption("randomly_seed", None)
    terminalreporter.write_line(f"{VARIABLE}={EFFORT.name}; the same order again: --randomly-seed={seed}")
