"""How much would be noticed: the code with one thing wrong each, and what finds it.

    python benchmarks/mutation.py firmware                every mutant of drivers/firmware: examination, simulation
    python benchmarks/mutation.py python --copy CHECKOUT  100 mutants of host, device, guard and ledger, drawn from all
                                                          places where a comparison, a sign, a number or a condition
                                                          stands; found by their tests

Exit status 1 when the score is below 95 %. `make nightly` runs the first; the second has not been run whole yet.
"""

import argparse
import ast
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent))

from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FirmwareDevice
from bus_simulation.mutants import MUTANTS, MUTANTS_OF_THE_STORE, Mutant
from bus_simulation.truth import ViolationError
from bus_simulation.world import BOX, FIRST, World

from retuner.drivers.conformance.chapters import chapters
from retuner.drivers.conformance.conversation import Conversation, NoAnswerError
from retuner.drivers.conformance.counterparts import InThread
from retuner.drivers.conformance.examination import examine
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings

ROOT = Path(__file__).resolve().parents[1]
AIM = 0.95
KEY = bytes(range(16))
TRIAL = 20
SEEDS, STEPS = 20, 700  # what CI simulates
TESTS_S = 300.0
BROKEN = (ViolationError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
TARGETS = {
    "drivers/host/write_protocol.py": ("tests/drivers/test_write_protocol.py", "tests/drivers/test_write_table.py"),
    "drivers/host/lease_client.py": ("tests/drivers/test_lease.py", "tests/drivers/test_busy_host.py"),
    "drivers/host/running_set.py": ("tests/drivers/test_running_belief.py", "tests/drivers/test_attacks.py"),
    "drivers/host/page_reader.py": ("tests/drivers/test_can_device.py",),
    "drivers/controller/gain_memory.py": ("tests/drivers/test_virtual_device.py", "tests/drivers/test_trial.py"),
    "drivers/controller/lease_server.py": ("tests/drivers/test_lease.py",),
    "drivers/protocol/gain_limits.py": ("tests/drivers/test_virtual_device.py",),
    "drivers/protocol/authentication.py": ("tests/drivers/test_commit_code.py", "tests/drivers/test_attacks.py"),
    "src/retuner/ledger/chain.py": ("tests/app/test_ledger.py",),
    "src/retuner/ledger/store.py": ("tests/app/test_ledger.py",),
    "adaptive/guard/prove.py": ("tests/adaptive/guard",),
}
"""Where mutants are made, and the tests that are asked first."""
THEN = ("tests/drivers", "tests/simulation", "tests/adaptive/guard", "tests/app/test_ledger.py")


# The firmware


def by_examination(changes: tuple[tuple[str, str], ...]) -> bool:
    """Whether the examination finds something, with a key or without."""
    for key in (KEY, None):
        settings = VirtualDeviceSettings(FIRST, box=BOX, key=key, trial_samples=TRIAL)
        device = FirmwareDevice(settings, LagPlant(), changes=changes)
        device.step()
        try:
            if examine(Conversation(InThread(device), 1, key), chapters(TRIAL)).findings:
                return True
        except NoAnswerError:
            return True
    return False


def by_simulation(changes: tuple[tuple[str, str], ...], twin: type | None) -> bool:
    """Whether a promise is broken in as many steps as CI simulates; twin : told the same, must answer the same."""
    for seed in range(SEEDS):
        try:
            World(seed, partial(FirmwareDevice, changes=changes), twin).run(STEPS)
        except BROKEN:
            return True
    return False


def apart(look: Callable[..., bool], *given: object) -> bool:
    """The same in a process of its own: a mutant that brings it down is found."""
    with ProcessPoolExecutor(1) as process:
        try:
            return process.submit(look, *given).result()
        except BrokenProcessPool:
            return True


def firmware() -> float:
    """Every mutant of the firmware; the share that is found."""
    found = {"examination": 0, "simulation": 0, "simulation beside its twin": 0, "any": 0}
    mutants: tuple[Mutant, ...] = (*MUTANTS, *MUTANTS_OF_THE_STORE)
    for mutant in mutants:
        changes = ((mutant.old, mutant.new),)
        ways = {
            "examination": apart(by_examination, changes),
            "simulation": apart(by_simulation, changes, None),
            "simulation beside its twin": apart(by_simulation, changes, VirtualDevice),
        }
        ways["any"] = any(ways.values())
        for way, seen in ways.items():
            found[way] += seen
        print(
            f"{mutant.name}: " + (", ".join(w for w, seen in ways.items() if seen and w != "any") or "NOT FOUND"),
            flush=True,
        )
    for way, count in found.items():
        print(f"{way}: {count} of {len(mutants)}")
    return found["any"] / len(mutants)


# Python


class Change(NamedTuple):
    """One mutant: the file, the line, and the whole text."""

    path: str
    line: int
    told: str
    text: str


SWAPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Add, ast.And: ast.Or, ast.Or: ast.And, ast.Mod: ast.Mult,
}  # fmt: skip


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


def killed(change: Change, copy: Path) -> bool:
    """Whether a test fails over it; a suite that does not end has failed."""
    target = copy / change.path
    before = target.read_text(encoding="utf-8")
    target.write_text(change.text, encoding="utf-8")
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "RETUNER_TESTS": "quick"}
    pytest = [str(copy / ".venv" / "bin" / "python"), "-P", "-m", "pytest", "-x", "-q", "-p", "no:randomly"]
    try:
        for tests in (TARGETS[change.path], THEN):
            done = subprocess.run(
                [*pytest, *tests], cwd=copy, env=environment, capture_output=True, timeout=TESTS_S, check=False
            )
            if done.returncode:
                return True
    except subprocess.TimeoutExpired:
        return True
    finally:
        target.write_text(before, encoding="utf-8")
    return False


def python(count: int, seed: int, copy: Path) -> float:
    """So many mutants, drawn; the share that is killed."""
    every = [change for path in TARGETS for change in changes_of(path)]
    drawn = random.Random(seed).sample(every, min(count, len(every)))
    dead = 0
    for number, change in enumerate(drawn, 1):
        began = time.monotonic()
        is_dead = killed(change, copy)
        dead += is_dead
        mark = "killed" if is_dead else "SURVIVED"
        print(
            f"{number} {mark} {time.monotonic() - began:.0f} s  {change.path}:{change.line}  {change.told}", flush=True
        )
    print(f"{dead} of {len(drawn)} killed, of {len(every)} places")
    return dead / len(drawn)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("firmware", "python"))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--copy", type=Path, default=None, help="a checkout with a .venv of its own that may be changed"
    )
    options = parser.parse_args()
    if options.what == "firmware":
        return int(firmware() < AIM)
    if options.copy is None or not (options.copy / ".venv").is_dir():
        parser.error("--copy: give a checkout of this repository with a .venv of its own (make test there once)")
    return int(python(options.count, options.seed, options.copy) < AIM)


if __name__ == "__main__":
    sys.exit(main())
