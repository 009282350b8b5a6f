"""The process that tries mutants, started in a copy of the project by mutant_runs.py.

    mutant_process.py map FILE TESTS...     runs the tests, writes which lines of the mutated files each of them runs
    mutant_process.py try                   asks for mutants on its input, answers on its output, a line of JSON each

Trying forks: the libraries are loaded once, the project's own modules by every child anew.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import sys
from pathlib import Path

import pytest

LOADED = ("numpy", "scipy.optimize", "scipy.signal", "scipy.linalg", "can.interfaces.virtual", "cantools", "pydantic")
LOADED_TOO = ("filterpy.kalman", "sqlite3", "typer", "rich")  # not hypothesis: pytest wants to load its plugins itself
WAITS = 10
QUIET = ("-q", "-p", "no:randomly", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=no", "-r", "f")


class Durations:
    """A plugin of pytest: seconds of every test that passed."""

    def __init__(self) -> None:
        self.s: dict[str, float] = {}
        self.failed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A part of a test is over."""
        self.s[report.nodeid] = self.s.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self.failed.append(report.nodeid)


def map_lines(target: Path, tests: list[str]) -> int:
    """Which lines of the covered files each test runs, and how long it takes."""
    from coverage import CoverageData

    durations = Durations()
    code = pytest.main(
        [*QUIET, *tests, "--cov", "--cov-config=.mutants.coveragerc", "--cov-context=test", "--cov-report="],
        plugins=[durations],
    )
    data = CoverageData(".coverage")
    data.read()
    lines: dict[str, dict[str, list[str]]] = {}
    for file in data.measured_files():
        path = str(Path(file).resolve().relative_to(Path.cwd().resolve()))
        lines[path] = {str(line): contexts for line, contexts in data.contexts_by_lineno(file).items()}
    told = {"s": durations.s, "failed": durations.failed, "lines": lines}
    target.write_text(json.dumps(told), encoding="utf-8")
    return int(code)


def tried(tests: list[str], cpu_s: int) -> tuple[int, str]:
    """What the tests say of what stands in the files now, in a child with so much time: pytest's status, who failed.

    The time is the processor's, so a busy machine kills nobody; one that only waits has ten times as much.
    """
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
        signal.alarm(WAITS * cpu_s)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os.setpgid(0, 0)
        sys.dont_write_bytecode = True
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # they take three times as long to load as a test to run
        seen = Durations()
        code = int(pytest.main(["-x", *QUIET, *tests], plugins=[seen]))
        os.write(write, "".join(seen.failed[:1]).encode())
        os._exit(code)
    os.close(write)
    _, status = os.waitpid(child, 0)
    with os.fdopen(read, "rb") as pipe:
        failed = pipe.read().decode() if os.WIFEXITED(status) else ""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # programs that its tests have begun
    return os.waitstatus_to_exitcode(status), failed


def serve() -> None:
    """Mutants, until the input ends."""
    for name in (*LOADED, *LOADED_TOO):
        importlib.import_module(name)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    for line in sys.stdin:
        asked = json.loads(line)
        status, failed = tried(asked["tests"], asked["cpu_s"])
        answers.write(json.dumps({"status": status, "failed": failed}) + "\n")
        answers.flush()


if __name__ == "__main__":
    if sys.argv[1] == "map":
        sys.exit(map_lines(Path(sys.argv[2]), sys.argv[3:]))
    serve()
