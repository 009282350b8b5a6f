"""Who finds a mutant: a copy of the project to try it in, the tests that run its lines, the quickest of them first.

Once for each copy all tests run as they are, and it is kept which lines each of them runs. A mutant then meets only
the tests that run its statement, until the first fails. What a fixture of a file runs counts for all tests of the file;
what runs when a module is loaded, for all tests that enter a function of it.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

from source_mutants import GROUPS, ROOT, Change

LEFT_OUT = (
    ".venv",
    ".typing",
    ".git",
    "runs",
    "__pycache__",
    ".pytest_cache",
    ".hypothesis",
    ".mypy_cache",
    ".ruff_cache",
    "dist",
    ".coverage",
)
TESTS = ("tests/drivers", "tests/simulation", "tests/adaptive", "tests/app/test_ledger.py")
TARGETS = tuple(path for paths in GROUPS.values() for path in paths)
LEFT_TO_OTHERS = (
    "tests/drivers/test_foreign_processes.py",
    "tests/drivers/test_firmware_process.py",
)  # wait for others
LONGEST_S = 20.0  # of one test that is asked
ALL_S = 60.0  # of all that are asked about one mutant; a survivor of these counts as one, whatever the rest would find
MORE = 4  # times as long as without a mutant
COVERAGE = "[run]\nbranch = false\nconcurrency = thread\ninclude =\n"


Lines = dict[str, dict[str, list[str]]]
"""Of each file: of each line: the tests that run it, as coverage names them."""


class Copy:
    """The project in another folder that may be changed, and which tests run which of its lines.

    Parameters
    ----------
    folder : of the copy.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._map = folder / "map.json"
        self._lines: Lines = {}
        self._s: dict[str, float] = {}
        self._process: subprocess.Popen[str] | None = None
        self._sound: dict[str, bool] = {}

    def make(self, kept: "Kept") -> bool:
        """Copy what has changed, and run as they are the tests that are new or run lines of what has changed.

        A file of tests at a time, and kept after each: an interrupted map goes on.

        Returns
        -------
        bool
            Whether the map is whole; not when the time of kept is over.
        """
        known = _known(self._map)
        for link in (path for path in self.folder.rglob("*") if path.is_symlink()):
            link.unlink()  # or copytree finds it in its way
        ignore = shutil.ignore_patterns(*LEFT_OUT)
        shutil.copytree(ROOT, self.folder, ignore=ignore, symlinks=True, dirs_exist_ok=True)
        now = _state(self.folder)
        for path in (path for path in now if path not in TARGETS):
            if known["state"].get(path) == _stamp(known, path, now):
                continue
            if kept.over:
                return False
            _merge(known, self._run(path), path)
            known["state"][path] = _stamp(known, path, now)
            self._map.write_text(json.dumps(known), encoding="utf-8")
        self._s, self._lines = known["s"], known["lines"]
        return True

    def _run(self, path: str) -> dict[str, Any]:
        """A file of tests as it is: how long each takes, each line of the mutated files with the tests that run it."""
        paths = [f"  */{target.removeprefix('src/retuner/')}" for target in TARGETS]
        (self.folder / ".mutants.coveragerc").write_text(COVERAGE + "\n".join(paths) + "\n", encoding="utf-8")
        found = self.folder / "mapped.json"
        found.unlink(missing_ok=True)
        subprocess.run(
            [*self._python("map"), str(found), path, "-m", "not slow"],
            cwd=self.folder, env=self._environment, check=False, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        if not found.exists():
            raise RuntimeError(f"{self.folder}: {path} does not run in the copy")
        told: dict[str, Any] = json.loads(found.read_text(encoding="utf-8"))
        if told["failed"]:
            raise RuntimeError(f"{self.folder}: fail without a mutant; mend first: {' '.join(told['failed'])}")
        return told

    def _python(self, what: str) -> list[str]:
        return [sys.executable, "-P", str(self.folder / "benchmarks" / "mutant_process.py"), what]

    @property
    def _environment(self) -> dict[str, str]:
        """The copy's packages come before the installed ones."""
        return {
            **os.environ,
            "PYTHONPATH": str(self.folder / "src"),
            "OPENBLAS_NUM_THREADS": "1",
            "RETUNER_TESTS": "quick",
        }

    def tests_of(self, change: Change) -> tuple[list[str], float]:
        """The tests that run its statement, the quickest first, and how long they take by themselves, s."""
        lines = self._lines.get(change.path, {})
        asked = {c for n in range(change.lines[0], change.lines[1] + 1) for c in lines.get(str(n), ())}
        if not asked - {""}:
            asked = {context for contexts in lines.values() for context in contexts}
        names = {context.partition("|")[0] for context in asked if "|" in context}
        shared = {context.partition("::")[0] for context in asked if context.endswith("|setup")}
        names |= {test for test in self._s if test.partition("::")[0] in shared}
        found, total = [], 0.0
        for test in sorted(names, key=lambda name: (self._s.get(name, 0.0), name)):
            s = self._s.get(test, 0.0)
            if s <= LONGEST_S and total + s <= ALL_S:
                found.append(test)
                total += s
        return found, total

    def finds(self, change: Change) -> bool:
        """Whether a test fails over a mutant, and does not without it; tests that do not end have failed.

        Raises
        ------
        RuntimeError
            The test fails without the mutant as well.
        """
        tests, total_s = self.tests_of(change)
        if not tests:
            return False
        for asked in _nearest_first(tests):
            status, failed = self._with(change, asked, 30 + int(MORE * total_s))
            if status != 0:
                break
        else:
            return False
        witnesses = [failed] if failed else asked  # nobody failed: they could not even be loaded, or did not end
        key = " ".join(witnesses)
        if key not in self._sound:
            self._sound[key] = self._ask({"tests": witnesses, "cpu_s": 30 + int(MORE * total_s)})[0] == 0
        if not self._sound[key]:
            raise RuntimeError(f"{self.folder}: {witnesses[0]} fails without a mutant, status {status}")
        return True

    def _with(self, change: Change, tests: list[str], cpu_s: int) -> tuple[int, str]:
        """What the tests say while a mutant stands in its file."""
        target = self.folder / change.path
        before, times = target.read_bytes(), target.stat()
        try:
            target.write_text(change.text, encoding="utf-8")
            return self._ask({"tests": tests, "cpu_s": cpu_s})
        finally:
            target.write_bytes(before)
            os.utime(target, ns=(times.st_atime_ns, times.st_mtime_ns))  # what was compiled of it is good again

    def _ask(self, question: dict[str, Any]) -> tuple[int, str]:
        """A run of tests in the process that forks: its status, and the first that failed."""
        if self._process is None:
            self._process = subprocess.Popen(
                self._python("try"), cwd=self.folder, env=self._environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )  # fmt: skip
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return int(answer["status"]), str(answer["failed"])

    def close(self) -> None:
        """End the process that forks."""
        if self._process is not None:
            self._process.communicate()
            self._process = None


def _state(folder: Path) -> dict[str, str]:
    """What stands in every file of tests that is asked, and in every file that is mutated."""
    roots = [folder / test for test in TESTS]
    files = [path for root in roots for path in (root.rglob("test_*.py") if root.is_dir() else [root])]
    tests = [path for path in (str(file.relative_to(folder)) for file in files) if path not in LEFT_TO_OTHERS]
    return {path: sha256((folder / path).read_bytes()).hexdigest() for path in (*tests, *TARGETS)}


def _known(path: Path) -> dict[str, Any]:
    """The map as it was left, or an empty one."""
    if not path.exists():
        return {"s": {}, "lines": {}, "state": {}}
    known: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return known


def _stamp(known: dict[str, Any], tests: str, now: dict[str, str]) -> str:
    """Of a file of tests and of what it is known to run: while that stays, so do the lines."""
    return " ".join([now[tests], *(now[path][:12] for path in sorted(_runs(known, tests)))])


def _runs(known: dict[str, Any], tests: str) -> set[str]:
    """The mutated files of which a file of tests runs lines."""
    return {
        path
        for path, by_line in known["lines"].items()
        if any(context.startswith(f"{tests}::") for contexts in by_line.values() for context in contexts)
    }


def _merge(known: dict[str, Any], told: dict[str, Any], tests: str) -> None:
    """Put what a file of tests told in place of what it told before."""
    lines: Lines = told["lines"]
    for path, by_line in known["lines"].items():
        for line, contexts in by_line.items():
            others = [context for context in contexts if context and not context.startswith(f"{tests}::")]
            if others:
                lines.setdefault(path, {}).setdefault(line, []).extend(others)
    known["lines"] = lines
    known["s"] = {test: s for test, s in known["s"].items() if not test.startswith(f"{tests}::")} | told["s"]


def _nearest_first(tests: list[str]) -> list[list[str]]:
    """The tests of the file that has the most of them, then all others: one file loads quickly, and most die there."""
    files = [test.partition("::")[0] for test in tests]
    nearest = max(files, key=files.count)
    parts = [[test for test in tests if (test.partition("::")[0] == nearest) == near] for near in (True, False)]
    return [part for part in parts if part]


class Kept:
    """What came of each mutant, a line of JSON each, so that a count goes on where it was stopped.

    Parameters
    ----------
    path : of the file. again : ask once more about those that survived: there may be a test for them by now.
    seconds : none is begun after so many.
    """

    def __init__(self, path: Path, *, again: bool, seconds: float) -> None:
        self._path, self._until_s = path, time.monotonic() + seconds
        self.killed: dict[str, bool] = {}
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                self.killed[row["name"]] = row["killed"]
        if again:
            self.killed = {name: True for name, dead in self.killed.items() if dead}

    @property
    def over(self) -> bool:
        """Whether the time to begin something is over."""
        return time.monotonic() > self._until_s

    def look(self, change: Change, copy: Copy) -> bool | None:
        """Whether it is killed, found out now unless that is known; None when there is no time left for it."""
        if change.name not in self.killed:
            if self.over:
                return None
            began = time.monotonic()
            is_dead = self.killed[change.name] = copy.finds(change)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                row = {"name": change.name, "killed": is_dead, "s": round(time.monotonic() - began, 1)}
                file.write(json.dumps(row) + "\n")
        return self.killed[change.name]
