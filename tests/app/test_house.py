"""The house keeps its order: imports run one way, pure folders stay pure, files and functions stay small."""

import ast
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest
from syntax import nodes

ROOT = Path(__file__).resolve().parents[2]
TOP = {"schedule": "schedule", "adaptive": "adaptive", "drivers": "drivers", "app": "src/retuner"}
MAY_IMPORT = {
    "schedule": {"schedule"},
    "adaptive": {"schedule", "adaptive"},
    "drivers": {"schedule", "adaptive", "drivers"},
}
# fmt: off
ORDER = (
    "schedule",
    *(f"adaptive.{name}" for name in (
        "declared_setting", "display_hook", "decision_numbers", "signals", "process", "loop", "interaction", "rules",
        "indexes", "controller_settings", "experiments",
        "fit", "identification", "valve", "explanations", "schedule_design", "schedule_choice", "region_model", "guard",
        "trial", "choice", "diagnosis", "cause_odds", "without_model",
        "supervision", "orders", "setpoint_bumps", "audit",
    )),
    *(f"drivers.{name}" for name in (
        "clock", "closing", "state_machine", "device", "protocol", "bus", "plants", "telemetry", "controller", "host",
        "recorded", "conformance",
        "profiles", "dbc", "canopen",
        "historian",
    )),
    "errors", "files", "stopping", "streams", "products", "verbosity", "templates", "conversions", "tuning", "api",
    "diagnosing", "scheduling", "config", "ledger", "decisions", "simulation", "pid_controller", "",
    "decision_page", "report", "schedule_report", "experiment", "audit", "session", "one_plant", "live_view", "replay",
    "serve", "gain_export", "commands", "cli", "__main__",
)
"""Every package in the order of the house, lowest first, below `retuner.`; a file on a floor of packages counts as one,
and "" is what `import retuner` gives. A package imports only from itself and from those before it."""
# fmt: on
# fmt: off
CORE = {
    "adaptive.supervision.retuner": (29_650, {
        "adaptive.audit", "adaptive.controller_settings", "adaptive.experiments", "adaptive.schedule_choice",
    }),
    "commands.run": (46_450, {
        "adaptive.audit", "adaptive.controller_settings", "adaptive.schedule_choice", "api", "audit", "diagnosing",
        "drivers.conformance", "drivers.canopen", "drivers.dbc", "drivers.historian",
        "drivers.plants.fmu_model", "experiment",
        "gain_export", "live_view", "report", "schedule_report", "scheduling", "serve", "session.pretuning",
        "tuning",
    }),
}
# fmt: on
"""What `from retuner import Retuner` and `retuner run` reach: at most so many lines, and none of these products."""
EMPTY = ("adaptive", "drivers")  # what holds packages and nothing else
PURE = ("schedule", "adaptive")
# fmt: off
PURE_MAY_IMPORT = {
    "abc", "array", "base64", "bisect", "cmath", "collections", "contextlib", "contextvars", "dataclasses", "enum",
    "functools", "hashlib", "heapq", "importlib", "itertools", "json", "math", "operator", "re", "string", "sys",
    "textwrap", "tomllib", "types", "typing", "zlib", "filterpy", "numpy", "scipy", "retuner",
}
IMPURE_NAMES = {"open", "print", "input", "exec", "eval", "compile", "breakpoint", "__import__", "id", "hash"}
IMPURE_ATTRIBUTES = {
    "random", "load", "loadtxt", "genfromtxt", "fromfile", "save", "savez", "savetxt", "tofile", "memmap", "rvs",
}
# fmt: on
PURE_OF_SYS = {"float_info", "maxsize"}
MOST_FILES = 16  # in a package, beside its __init__.py
LONGEST_FILE = 600  # lines: one whole story
LONGEST_FUNCTION = 60  # lines of code without docstring, comments and blank lines
# what these weigh are typed values (adaptive/decision_numbers.py)
DECIDING = ("guard", "trial", "choice", "without_model", "supervision", "orders")
EDGE = {"to_dict", "gains_dict"}  # functions that write the plain form


def files(*tops: str) -> list[Path]:
    return [path for top in tops for path in sorted((ROOT / TOP[top]).rglob("*.py"))]


def imported(source: str) -> Iterator[str]:
    """Full dotted names; of `from a.b import c` both a.b and a.b.c, because c may be a module."""
    for node in nodes(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def modules() -> dict[str, Path]:
    """Every module of the product, by its name below `retuner.`."""
    found = {}
    for top, folder in TOP.items():
        for path in files(top):
            inside = path.relative_to(ROOT / folder).with_suffix("").parts
            parts = inside if top == "app" else (top, *inside)
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


def package(module: str) -> str:
    """The package of a module, or the module itself where it stands among packages: the longest name in ORDER."""
    fitting = [name for name in ORDER if name and (module == name or module.startswith(f"{name}."))]
    return max(fitting, key=len) if fitting else module


def ours(source: str, known: Collection[str]) -> Iterator[str]:
    """Modules of the product that a source imports, by their names below `retuner.`."""
    for node in nodes(source):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            below = (node.module or "").removeprefix("retuner").removeprefix(".")
            parts = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [part if part.removeprefix("retuner.") in known else node.module or "" for part in parts]
            assert below in known or node.module != f"retuner.{below}", f"{node.module}: no such module"
        yield from (n.removeprefix("retuner").removeprefix(".") for n in names if n.split(".")[0] == "retuner")


def out_of_order(module: str, imports: Iterable[str]) -> list[str]:
    """Imports of a module that come from packages which ORDER does not place before its own."""
    before = {*EMPTY, *ORDER[: ORDER.index(package(module)) + 1]}
    return [other for other in imports if package(other) not in before]


def cycles(graph: Mapping[str, Collection[str]]) -> set[str]:
    """Modules that import themselves, by way of others or not; nothing when the graph has no cycle."""
    left = {module: set(others) for module, others in graph.items()}
    while free := {module for module, others in left.items() if not others & left.keys()}:
        left = {module: others for module, others in left.items() if module not in free}
    return set(left)


def wrong_way(top: str, source: str) -> list[str]:
    ours = [name for name in imported(source) if name.split(".")[0] in {"retuner", *TOP}]
    allowed = MAY_IMPORT[top]
    return [name for name in ours if name.split(".")[0] != "retuner" or [*name.split("."), ""][1] not in allowed]


def impure(source: str) -> list[str]:
    found = [
        name for name in imported(source) if name.split(".")[0] not in PURE_MAY_IMPORT or "random" in name.split(".")
    ]
    for node in nodes(source):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in IMPURE_NAMES:
            found.append(node.func.id)
        if isinstance(node, ast.Attribute) and node.attr in IMPURE_ATTRIBUTES:
            found.append(node.attr)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sys":
            found += [f"sys.{node.attr}"] if node.attr not in PURE_OF_SYS else []
        if isinstance(node, ast.Global | ast.Nonlocal | ast.Await | ast.AsyncFunctionDef):
            found.append(type(node).__name__)
    return found


def numbers_by_name(source: str) -> list[str]:
    """Fields, arguments, results and variables that are dicts of numbers by name, those of the EDGE apart."""
    found = []
    for node in nodes(source):
        notes: list[tuple[str, ast.expr | None]] = []
        if isinstance(node, ast.AnnAssign | ast.arg):
            notes.append((ast.unparse(node.target) if isinstance(node, ast.AnnAssign) else node.arg, node.annotation))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name not in EDGE:
            notes.append((node.name, node.returns))
        found += [name for name, note in notes if note is not None and "dict[str, float" in ast.unparse(note)]
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


@pytest.fixture(scope="module", autouse=True)
def no_nodes_left() -> Iterator[None]:
    """A million nodes would make every later collection of garbage in this process slow."""
    yield
    nodes.cache_clear()


@pytest.mark.parametrize("top", MAY_IMPORT)
def test_imports_run_one_way(top: str) -> None:
    checked = files(top)
    assert len(checked) > 3
    assert {str(path.relative_to(ROOT)): wrong for path in checked if (wrong := wrong_way(top, path.read_text()))} == {}


@cache
def import_graph() -> dict[str, set[str]]:
    """Which modules each module imports."""
    known = modules()
    return {module: set(ours(path.read_text(), known)) for module, path in known.items()}


def for_types_only(source: str) -> str:
    """The source without what stands under `if TYPE_CHECKING`: no program imports that."""
    if "TYPE_CHECKING" not in source:
        return source
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body, node.test = [ast.Pass()], ast.Constant(False)
    return ast.unparse(tree)


def reached(start: str) -> set[str]:
    """Modules that a module imports, now or when one of its functions is called, by way of others or not."""
    known = modules()
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        module = waiting.pop()
        if module in seen or module not in known:
            continue
        seen.add(module)
        names = ours(for_types_only(known[module].read_text()), known)
        parts = [name.split(".") for name in names]
        waiting += [".".join(part[:i]) for part in parts for i in range(1, len(part) + 1)]
    return seen


@pytest.mark.parametrize("start", CORE)
def test_the_core_reaches_no_product_and_stays_small(start: str) -> None:
    most, products = CORE[start]
    found, known = reached(start), modules()
    assert len(found) > 100
    assert {module for module in found if package(module) in products or module in products} == set()
    assert sum(len(known[module].read_text().splitlines()) for module in found) <= most


def test_every_package_has_its_place_and_imports_only_what_stands_before_it() -> None:
    graph = import_graph()
    assert {module for module in graph if package(module) not in (*ORDER, *EMPTY)} == set()
    placed = {module: others for module, others in graph.items() if package(module) in ORDER}
    assert {module: wrong for module, others in placed.items() if (wrong := out_of_order(module, others))} == {}


def test_no_module_imports_itself_by_way_of_others() -> None:
    assert cycles(import_graph()) == set()


def test_packages_stay_small() -> None:
    held = Counter(path.parent for path in modules().values() if path.name != "__init__.py")
    assert {str(path.relative_to(ROOT)): n for path, n in held.items() if n > MOST_FILES} == {}


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("adaptive.signals.sample", "from retuner.adaptive.process.model import ProcessModel"),
        ("adaptive.rules.rule", "from retuner.adaptive import guard"),
        ("config.model", "def f():\n    from retuner.session.session import Session"),
        ("session.session", "import retuner.commands.run"),
        ("drivers.bus.bus", "from retuner.drivers.host.can_device import CanDevice"),
        ("errors", "from retuner import diagnose"),
    ],
)
def test_the_check_sees_imports_against_the_order(module: str, source: str) -> None:
    assert out_of_order(module, ours(source, modules()))


def test_the_check_sees_cycles() -> None:
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": {"e"}, "f": set()}) == {*"abcde"}


@pytest.mark.parametrize("top", PURE)
def test_pure_folders_touch_no_clock_file_bus_or_chance(top: str) -> None:
    assert {str(path.relative_to(ROOT)): found for path in files(top) if (found := impure(path.read_text()))} == {}


def test_files_stay_small() -> None:
    long = {str(p.relative_to(ROOT)): n for p in files(*TOP) if (n := len(p.read_text().splitlines())) > LONGEST_FILE}
    assert long == {}


def test_a_class_name_stands_once() -> None:
    classes = [node.name for path in files(*TOP) for node in nodes(path.read_text()) if isinstance(node, ast.ClassDef)]
    assert {name for name, n in Counter(classes).items() if n > 1} <= {"Mode"}  # of a region, and of a controller


def test_functions_stay_small() -> None:
    long = {
        f"{path.relative_to(ROOT)}:{node.name}": lines
        for path in files(*TOP)
        for node in nodes(path.read_text())
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (lines := code_lines(node)) > LONGEST_FUNCTION
    }
    assert long == {}


def test_what_a_decision_weighed_is_typed() -> None:
    deciding = [path for room in DECIDING for path in sorted((ROOT / "adaptive" / room).rglob("*.py"))]
    assert len(deciding) > 3 * len(DECIDING)
    found = {str(path.relative_to(ROOT)): names for path in deciding if (names := numbers_by_name(path.read_text()))}
    assert found == {}


@pytest.mark.parametrize(
    "source",
    [
        "class A:\n    numbers: dict[str, float]",
        "def f(numbers: dict[str, float]) -> None: ...",
        "def f() -> tuple[int, dict[str, float | None]]: ...",
        "numbers: dict[str, float] = {}",
    ],
)
def test_the_check_sees_numbers_by_name(source: str) -> None:
    assert numbers_by_name(source)


@pytest.mark.parametrize(
    ("top", "source"),
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
def test_the_check_sees_imports_that_run_the_wrong_way(top: str, source: str) -> None:
    assert wrong_way(top, source)


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


def told_paths(text: str) -> Iterator[str]:
    """Paths of ours that a page names; `a/{b,c}.py` are two."""
    folders = "adaptive|drivers|schedule|src/retuner|benchmarks|tests|scripts|examples"
    for path in re.findall(rf"`((?:{folders})/[\w/.{{}},-]*)`", text):
        before, _, rest = path.partition("{")
        names, _, after = rest.partition("}")
        yield from (f"{before}{name}{after}" for name in names.split(","))


def test_pages_name_files_that_are_there() -> None:
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    named = [(page.name, path) for page in pages for path in told_paths(page.read_text(encoding="utf-8"))]
    assert len(named) > 30
    assert [pair for pair in named if not (ROOT / pair[1]).exists()] == []


def told_sources(text: str) -> set[str]:
    """File names of Python that a source tells a reader to look at; those of a user's own stand in a path of theirs."""
    return set(re.findall(r"(?<![\w/.{-])(?:[a-z_]\w*/)*([a-z]\w*\.py)\b", text)) - {"file.py"}


def test_sources_name_files_that_are_there() -> None:
    folders = [ROOT / name for name in (*TOP.values(), "scripts", "benchmarks", "examples", "tests")]
    there = {path.name for folder in folders for path in folder.rglob("*.py")}
    told = {str(path.relative_to(ROOT)): told_sources(path.read_text()) - there for path in files(*TOP)}
    assert {path: names for path, names in told.items() if names} == {}
    assert told_sources("see fit/no_such.py, folder/file.py") - there == {"no_such.py"}


def test_paths_of_a_page_are_seen() -> None:
    assert list(told_paths("see `drivers/{a,b}.py` and `tests/x/`, not `a/b`")) == [
        "drivers/a.py",
        "drivers/b.py",
        "tests/x/",
    ]
