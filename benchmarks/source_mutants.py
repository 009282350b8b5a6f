"""Python code with one thing wrong each: where mutants are made, which are drawn, and which equal the original."""

import ast
import random
import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
EQUAL = Path(__file__).with_name("equal_mutants.toml")
GROUPS = {
    "write protocol": tuple(
        f"drivers/host/{name}.py"
        for name in ("write_protocol", "lease_client", "running_set", "page_reader", "connection", "requests")
    ),
    "device": (
        *(f"drivers/controller/{name}.py" for name in ("virtual_device", "gain_memory", "lease_server")),
        "drivers/protocol/gain_limits.py",
        "drivers/protocol/authentication.py",
    ),
    "guard": tuple(
        f"adaptive/guard/{name}.py"
        for name in ("border", "checks", "limits", "model_set", "proof", "request", "step_size", "write_order")
    ),
    "ledger": tuple(f"src/retuner/ledger/{name}.py" for name in ("canonical", "chain", "lock", "schema", "store")),
}
"""Where mutants are made; each group gives as many as the others."""
SWAPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Add, ast.And: ast.Or, ast.Or: ast.And, ast.Mod: ast.Mult,
}  # fmt: skip


class Change(NamedTuple):
    """One mutant.

    path : of the file. lines : of the statement that it changes, first and last. said : that statement's lines in one.
    told : what was changed into what. text : of the whole file.
    """

    path: str
    lines: tuple[int, int]
    said: str
    told: str
    text: str

    @property
    def name(self) -> str:
        """The same as long as the statement and the change stay, wherever in the file it moves."""
        return f"{self.path}:  {self.said[:160]}  |  {self.told}"


class Equal(NamedTuple):
    """Mutants that nobody can tell from the original: in a path that ends so, where a statement has this text.

    told : the change, empty for any. why : in words.
    """

    path: str
    said: str
    told: str
    why: str

    def covers(self, change: Change) -> bool:
        """Whether a mutant is one of these."""
        return change.path.endswith(self.path) and self.said in change.said and self.told in {"", change.told}


@cache
def equal_mutants() -> tuple[Equal, ...]:
    """The list, each with its reason."""
    entries = tomllib.loads(EQUAL.read_text(encoding="utf-8"))["equal"]
    return tuple(Equal(e.get("path", ""), e["said"], e.get("told", ""), e["why"]) for e in entries)


def why_equal(change: Change) -> str:
    """Why a mutant does what the original does; empty when it is on no list."""
    return next((equal.why for equal in equal_mutants() if equal.covers(change)), "")


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


def head_of(statement: ast.stmt) -> tuple[int, int]:
    """First and last line of a statement, with its decorators and without the statements inside it."""
    first = min([statement.lineno, *(d.lineno for d in getattr(statement, "decorator_list", []))])
    inner = [
        inside.lineno for inside in ast.walk(statement) if isinstance(inside, ast.stmt) and inside is not statement
    ]
    last = statement.end_lineno or statement.lineno
    return first, max(statement.lineno, min([last, *(line - 1 for line in inner)]))


def statements(tree: ast.AST) -> dict[ast.AST, ast.stmt]:
    """Of every node the innermost statement around it."""
    found: dict[ast.AST, ast.stmt] = {}
    for node in ast.walk(tree):  # outer statements come first, so inner ones overwrite them
        if isinstance(node, ast.stmt):
            found.update(dict.fromkeys(ast.walk(node), node))
    return found


def places_of(path: str) -> list[int]:
    """Where in a file there is something to make wrong, counted as ast.walk does."""
    nodes = list(ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))))  # all of them before any is changed
    return [place for place, node in enumerate(nodes) if changed(node)]


def change_at(path: str, place: int) -> Change:
    """The mutant of one place."""
    source = (ROOT / path).read_text(encoding="utf-8")
    lines, tree = source.splitlines(), ast.parse(source)
    node = next(n for i, n in enumerate(ast.walk(tree)) if i == place)
    assert isinstance(node, ast.expr | ast.stmt)
    before = ast.unparse(node)
    first, last = head_of(statements(tree)[node])
    changed(node)
    told = before.splitlines()[0][:60] + " -> " + ast.unparse(node).splitlines()[0][:60]
    said = " ".join(line.strip() for line in lines[first - 1 : last])
    return Change(path, (first, last), said, told, ast.unparse(ast.fix_missing_locations(tree)))


def draw(count: int, seed: int) -> tuple[dict[str, list[Change]], int]:
    """So many mutants, as many of each group, each place of it as likely as any other; and of how many."""
    rng, drawn, places = random.Random(seed), {}, 0
    for group, paths in GROUPS.items():
        every = [(path, place) for path in paths for place in places_of(path)]
        places += len(every)
        chosen = rng.sample(every, min(count // len(GROUPS), len(every)))
        drawn[group] = [change_at(path, place) for path, place in chosen]
    return drawn, places
