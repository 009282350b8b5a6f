"""How much would be noticed: the code with one thing wrong each, and what finds it.

    python benchmarks/mutation.py firmware      every mutant of drivers/firmware: examination, simulation
    python benchmarks/mutation.py python        200 mutants of host, device, guard and ledger, drawn from all places
                                                where a comparison, a sign, a number or a condition stands; by the tests

The second works in a copy of the project and keeps what it found beside it: a second run goes on there, and asks again
only about mutants that survived. Exit status 1 when the score is below 95 %.
"""

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FirmwareDevice
from bus_simulation.mutants import MUTANTS, MUTANTS_OF_THE_STORE, Mutant
from bus_simulation.truth import ViolationError
from bus_simulation.world import BOX, FIRST, World
from cases.counting import share
from source_mutants import ROOT, Kept, draw, make_copy

from retuner.drivers.conformance.chapters import chapters
from retuner.drivers.conformance.conversation import Conversation, NoAnswerError
from retuner.drivers.conformance.counterparts import InThread
from retuner.drivers.conformance.examination import examine
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings

AIM = 0.95
KEY = bytes(range(16))
TRIAL = 20
SEEDS, STEPS = 20, 700  # what CI simulates
BROKEN = (ViolationError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


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


def python(count: int, seed: int, copy: Path) -> float:
    """So many mutants, drawn; the share that is killed of those that are not equal to the original."""
    make_copy(copy)
    drawn, places = draw(count, seed)
    kept = Kept(copy.with_suffix(".jsonl"))
    dead = equal = 0
    for number, change in enumerate(drawn, 1):
        if change.is_equal:
            equal += 1
            continue
        is_dead = kept.look(change, copy)
        dead += is_dead
        print(f"{number} {'killed' if is_dead else 'SURVIVED'}  {change.name}", flush=True)
    print(f"killed {share(dead, len(drawn) - equal)}; {equal} equal to the original; seed {seed}, {places} places")
    return dead / (len(drawn) - equal)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("firmware", "python"))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--copy", type=Path, default=ROOT / "runs" / "mutants", help="folder of the copy")
    options = parser.parse_args()
    if options.what == "firmware":
        return int(firmware() < AIM)
    return int(python(options.count, options.seed, options.copy.resolve()) < AIM)


if __name__ == "__main__":
    sys.exit(main())
