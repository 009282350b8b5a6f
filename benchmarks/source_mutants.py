"""Python code with one thing wrong each: where mutants are made, a copy of the project to try them in, who dies."""

import ast
import json
import os
import random
import resource
import shutil
import site
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = (
    ".venv",
    ".git",
    "runs",
    "__pycache__",
    ".pytest_cache",
    ".hypothesis",
    ".mypy_cache",
    ".ruff_cache",
    "dist",
)
TARGETS = {
    "drivers/host/write_protocol.py": ("tests/drivers/test_write_protocol.py", "tests/drivers/test_write_table.py"),
    "drivers/host/lease_client.py": ("tests/drivers/test_lease.py", "tests/drivers/test_busy_host.py"),
    "drivers/host/running_set.py": ("tests/drivers/test_running_belief.py", "tests/drivers/test_attacks.py"),
    "drivers/host/page_reader.py": ("tests/drivers/test_can_device.py",),
    "drivers/host/connection.py": ("tests/drivers/test_can_device.py",),
    "drivers/controller/virtual_device.py": (
        "tests/drivers/test_virtual_device.py",
        "tests/drivers/test_conformance.py",
    ),
    "drivers/controller/gain_memory.py": ("tests/drivers/test_virtual_device.py", "tests/drivers/test_trial.py"),
    "drivers/controller/lease_server.py": ("tests/drivers/test_lease.py",),
    "drivers/protocol/gain_limits.py": ("tests/drivers/test_virtual_device.py",),
    "drivers/protocol/authentication.py": ("tests/drivers/test_commit_code.py", "tests/drivers/test_attacks.py"),
    "src/retuner/ledger/chain.py": ("tests/app/test_ledger.py",),
    "src/retuner/ledger/store.py": ("tests/app/test_ledger.py",),
    **dict.fromkeys(
        (f"adaptive/guard/{name}.py" for name in ("checks", "limits", "proof", "step_size", "write_order")),
        ("tests/adaptive/guard",),
    ),
}
"""Where mutants are made, and the tests that are asked first."""
THEN = (
    "tests/drivers", "tests/simulation", "tests/adaptive/guard", "tests/app/test_ledger.py",
    "--ignore=tests/drivers/test_foreign_processes.py",
)  # fmt: skip
EQUAL = {
    "@dataclass(": "slots and frozen: nothing that the product does shows whether they are set",
    "strict=True": "of zip, over sequences of the same length by their types",
    "self._belief.epoch or 0": "an epoch is known wherever this is reached",
}
"""Lines with True, False or a number that nobody can tell from the changed one, by what stands in them; and why."""
CPU_S = 400  # of one run of tests, which takes 50: a mutant that needs more never ends
WALL_S = 1200.0  # the same for one that waits
SWAPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Add, ast.And: ast.Or, ast.Or: ast.And, ast.Mod: ast.Mult,
}  # fmt: skip


class Change(NamedTuple):
    """One mutant: the file, the line, and the whole text."""

    path: str
    line: int
    told: str
    text: str

    @property
    def is_equal(self) -> bool:
        """Whether it does what the original does."""
        line = (ROOT / self.path).read_text(encoding="utf-8").splitlines()[self.line - 1]
        return self.told in {"True -> False", "0 -> 1"} and any(text in line for text in EQUAL)

    @property
    def name(self) -> str:
        """The same as long as neither place nor change moves."""
        return f"{self.path}:{self.line}  {self.told}"


def changed(node: ast.AST) -> bool:
    """Make this node wrong in place; whether there was a way."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPPED:
        node.ops[0] = SWAPPED[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPPED:
        node.op = SWAPPED[type(node.op)]()
    elif isinstance(node, ast.Constant) and type(node.value) in {int, float, bool}:
        node.value = not node.value if isinstance(node.value, bool) else node.value + 1
    elif isinstance(node, ast.If):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        node.value = ast.Constant(value=None)
    else:
        return False
    return True


def changes_of(path: str) -> Iterator[Change]:
    """Every mutant of a file."""
    source = (ROOT / path).read_text(encoding="utf-8")
    for place in range(sum(1 for _ in ast.walk(ast.parse(source)))):
        tree = ast.parse(source)
        node = next(n for i, n in enumerate(ast.walk(tree)) if i == place)
        before = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else ""
        if isinstance(node, ast.expr | ast.stmt) and changed(node):
            told = before.splitlines()[0][:60] + " -> " + ast.unparse(node).splitlines()[0][:60]
            yield Change(path, node.lineno, told, ast.unparse(ast.fix_missing_locations(tree)))


def draw(count: int, seed: int) -> tuple[list[Change], int]:
    """So many mutants, each place as likely as any other; and of how many."""
    every = [change for path in TARGETS for change in changes_of(path)]
    return random.Random(seed).sample(every, min(count, len(every))), len(every)


def make_copy(copy: Path) -> None:
    """The project in another folder that may be changed, with an interpreter that finds its packages there."""
    ignore = shutil.ignore_patterns(*LEFT_OUT)
    shutil.copytree(ROOT, copy, ignore=ignore, symlinks=True, dirs_exist_ok=True)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", "--clear", str(copy / ".venv")], check=True)
    theirs = next(Path(place) for place in site.getsitepackages() if (Path(place) / "can").is_dir())
    ours = next((copy / ".venv").glob("lib/python*/site-packages"))
    finder = next(theirs.glob("__editable___retuner*_finder.py"))
    text = finder.read_text(encoding="utf-8").replace(f"'{ROOT}/", f"'{copy}/")
    (ours / "copied_finder.py").write_text(text, encoding="utf-8")
    (ours / "a_copy.pth").write_text("import copied_finder; copied_finder.install()\n", encoding="utf-8")
    (ours / "b_others.pth").write_text(f"import site; site.addsitedir({str(theirs)!r})\n", encoding="utf-8")


def tested(copy: Path, tests: tuple[str, ...]) -> bool:
    """Whether these tests pass in the copy. Time is the processor's, so a busy machine kills nobody."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "RETUNER_TESTS": "quick", "PYTHONDONTWRITEBYTECODE": "1"}
    pytest = [str(copy / ".venv" / "bin" / "python"), "-P", "-m", "pytest", "-x", "-q", "-p", "no:randomly"]
    bound = partial(resource.setrlimit, resource.RLIMIT_CPU, (CPU_S, CPU_S))
    try:
        done = subprocess.run(
            [*pytest, "-p", "no:cacheprovider", *tests],
            cwd=copy, env=environment, capture_output=True, timeout=WALL_S, check=False, preexec_fn=bound,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


@cache
def passes_unchanged(copy: Path, tests: tuple[str, ...]) -> bool:
    """Whether the tests pass without a mutant, or else nobody's death tells anything."""
    return tested(copy, tests)


def killed(change: Change, copy: Path) -> bool:
    """Whether a test fails over it; a suite that does not end has failed.

    Raises
    ------
    RuntimeError
        The tests fail without a mutant as well.
    """
    target = copy / change.path
    before = target.read_text(encoding="utf-8")
    for tests in (TARGETS[change.path], THEN):
        if not passes_unchanged(copy, tests):
            raise RuntimeError(f"{copy}: the tests {' '.join(tests)} fail without a mutant; mend them first")
        try:
            target.write_text(change.text, encoding="utf-8")
            if not tested(copy, tests):
                return True
        finally:
            target.write_text(before, encoding="utf-8")
    return False


class Kept:
    """What came of each mutant, a line of JSON each, so that a count goes on where it was stopped.

    Parameters
    ----------
    path : of the file. A mutant that survived is asked about again: there may be a test for it by now.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.killed: dict[str, bool] = {}
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                if row["killed"]:
                    self.killed[row["name"]] = True

    def look(self, change: Change, copy: Path) -> bool:
        """Whether it is killed, found out now unless that is known."""
        if change.name not in self.killed:
            began = time.monotonic()
            is_dead = self.killed[change.name] = killed(change, copy)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                row = {"name": change.name, "killed": is_dead, "s": round(time.monotonic() - began, 1)}
                file.write(json.dumps(row) + "\n")
        return self.killed[change.name]
