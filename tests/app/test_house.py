"""The house keeps its order: imports run one way, pure rooms stay pure, files and functions stay small."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = {"schedule": "schedule", "adaptive": "adaptive", "drivers": "drivers", "app": "src/retuner"}
MAY_IMPORT = {
    "schedule": {"schedule"},
    "adaptive": {"schedule", "adaptive"},
    "drivers": {"schedule", "adaptive", "drivers"},
}
PURE = ("schedule", "adaptive")
# fmt: off
PURE_MAY_IMPORT = {
    "abc", "bisect", "cmath", "collections", "contextlib", "dataclasses", "enum", "functools", "hashlib", "heapq",
    "itertools", "json", "math", "operator", "re", "string", "sys", "textwrap", "tomllib", "types", "typing",
    "filterpy", "numpy", "scipy", "retuner",
}
IMPURE_NAMES = {"open", "print", "input", "exec", "eval", "compile", "breakpoint", "__import__", "id", "hash"}
IMPURE_ATTRIBUTES = {
    "random", "load", "loadtxt", "genfromtxt", "fromfile", "save", "savez", "savetxt", "tofile", "memmap", "rvs",
}
# fmt: on
PURE_OF_SYS = {"float_info", "maxsize"}
LONGEST_FILE = 500  # lines: one whole story
LONGEST_FUNCTION = 30  # lines of code without docstring, comments and blank lines


def files(*rooms: str) -> list[Path]:
    return [path for room in rooms for path in sorted((ROOT / ROOMS[room]).rglob("*.py"))]


def imported(tree: ast.AST) -> Iterator[str]:
    """Full dotted names; of `from a.b import c` both a.b and a.b.c, because c may be a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def wrong_way(room: str, source: str) -> list[str]:
    ours = [name for name in imported(ast.parse(source)) if name.split(".")[0] in {"retuner", *ROOMS}]
    allowed = MAY_IMPORT[room]
    return [name for name in ours if name.split(".")[0] != "retuner" or [*name.split("."), ""][1] not in allowed]


def impure(source: str) -> list[str]:
    tree = ast.parse(source)
    found = [
        name for name in imported(tree) if name.split(".")[0] not in PURE_MAY_IMPORT or "random" in name.split(".")
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in IMPURE_NAMES:
            found.append(node.func.id)
        if isinstance(node, ast.Attribute) and node.attr in IMPURE_ATTRIBUTES:
            found.append(node.attr)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sys":
            found += [f"sys.{node.attr}"] if node.attr not in PURE_OF_SYS else []
        if isinstance(node, ast.Global | ast.Nonlocal | ast.Await | ast.AsyncFunctionDef):
            found.append(type(node).__name__)
    return found


def code_lines(function: ast.AST) -> int:
    """Lines that hold code: those on which a node starts or ends, without the docstring's."""
    assert isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    lines: set[int] = set()
    for statement in body:
        for node in ast.walk(statement):
            if isinstance(node, ast.stmt | ast.expr):
                lines |= {node.lineno, node.end_lineno or node.lineno}
    return len(lines)


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_imports_run_one_way(room: str) -> None:
    checked = files(room)
    assert len(checked) > 3
    assert {
        str(path.relative_to(ROOT)): wrong for path in checked if (wrong := wrong_way(room, path.read_text()))
    } == {}


@pytest.mark.parametrize("room", PURE)
def test_pure_rooms_touch_no_clock_file_bus_or_chance(room: str) -> None:
    assert {str(path.relative_to(ROOT)): found for path in files(room) if (found := impure(path.read_text()))} == {}


def test_files_stay_small() -> None:
    long = {str(p.relative_to(ROOT)): n for p in files(*ROOMS) if (n := len(p.read_text().splitlines())) > LONGEST_FILE}
    assert long == {}


def test_functions_stay_small() -> None:
    long = {
        f"{path.relative_to(ROOT)}:{node.name}": lines
        for path in files(*ROOMS)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (lines := code_lines(node)) > LONGEST_FUNCTION
    }
    assert long == {}


@pytest.mark.parametrize(
    ("room", "source"),
    [
        ("schedule", "from retuner.adaptive.signals.sample import LoopSample"),
        ("schedule", "from retuner import adaptive"),
        ("schedule", "def f():\n    import retuner.drivers.clock"),
        ("schedule", "import schedule"),
        ("adaptive", "from retuner.drivers import clock"),
        ("drivers", "from retuner import config"),
        ("drivers", "import retuner"),
    ],
)
def test_the_check_sees_imports_that_run_the_wrong_way(room: str, source: str) -> None:
    assert wrong_way(room, source)


@pytest.mark.parametrize(
    "source",
    [
        "import time",
        "from datetime import datetime",
        "import os.path",
        "from numpy.random import default_rng",
        "from numpy import random",
        "import numpy as np\nx = np.random.default_rng()",
        "def f():\n    open('x')",
        "import numpy as np\nnp.load('x')",
        "import logging",
        "import sys\nsys.stdout",
        "import can",
        "counter = 0\ndef f():\n    global counter",
    ],
)
def test_the_check_sees_what_is_not_pure(source: str) -> None:
    assert impure(source)
