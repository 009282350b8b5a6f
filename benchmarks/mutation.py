"""How much would be noticed: the code with one thing wrong each, and what finds it.

    python benchmarks/mutation.py firmware      every mutant of drivers/firmware: examination, simulation
    python benchmarks/mutation.py host          every host with one layer taken away: simulation
    python benchmarks/mutation.py python        200 mutants of write protocol, device, guard and ledger, 50 of each,
                                                drawn from all places where a comparison, a sign, a number, a condition
                                                or a call stands; by the tests that run the statement

The last works in a copy of the project and keeps what it found beside it: a second run goes on there; --again asks
once more about those that survived. What equals the original stands in equal_mutants.toml, each with its reason, and is
printed. Exit status 1 when the score is below 95 %.
"""

import argparse
import math
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from itertools import chain
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FirmwareDevice
from bus_simulation.host_mutants import HOST_MUTANTS, broken_by
from bus_simulation.mutants import MUTANTS, MUTANTS_OF_THE_STORE, Mutant
from bus_simulation.truth import ViolationError
from bus_simulation.world import BOX, FIRST, World
from cases.counting import share
from mutant_runs import Copy, Kept
from source_mutants import ROOT, Change, draw, why_equal

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


# The host


def host() -> float:
    """Every mutant of the host; the share that the simulation's invariants find."""
    found = 0
    for number, mutant in enumerate(HOST_MUTANTS):
        broken = broken_by(number)
        found += bool(broken)
        print(f"{mutant.name}: {broken.partition(':')[0] or 'NOT FOUND'}", flush=True)
    print(f"simulation: {found} of {len(HOST_MUTANTS)}")
    return found / len(HOST_MUTANTS)


# Python


def python(count: int, seed: int, kept: Kept, copy: Copy) -> float:
    """So many mutants, drawn; the share that is killed of those that are not equal to the original."""
    drawn, places = draw(count, seed)
    if not copy.make(kept):
        print("which tests run which lines is not yet known of all; go on with the same command")
        return 0.0
    for change in chain.from_iterable(zip(*drawn.values(), strict=True)):  # a count that is broken off is of all groups
        if not why_equal(change):
            kept.look(change, copy)
    total = dead = 0
    for group, changes in drawn.items():
        counted = [change for change in changes if not why_equal(change)]
        looked = [(change, kept.look(change, copy)) for change in counted]
        died = sum(_told(change, is_dead) for change, is_dead in looked if is_dead is not None)
        open_ = sum(is_dead is None for _, is_dead in looked)
        print(
            f"{group}: killed {share(died, len(counted) - open_)}; {len(changes) - len(counted)} equal to the "
            f"original, {open_} not tried yet"
        )
        total, dead = total + len(counted) - open_, dead + died
    copy.close()
    for change in (change for changes in drawn.values() for change in changes if why_equal(change)):
        print(f"equal  {change.name}\n       {why_equal(change)}")
    print(f"killed {share(dead, total)} of {places} places, seed {seed}")
    return dead / total if total else 0.0


def _told(change: Change, is_dead: bool) -> bool:
    """The same, printed."""
    print(f"{'killed  ' if is_dead else 'SURVIVED'}  {change.name}", flush=True)
    return is_dead


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("firmware", "host", "python"))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--copy", type=Path, default=ROOT / "runs" / "mutants", help="folder of the copy")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="begin no mutant after so many; go on next time"
    )
    parser.add_argument("--again", action="store_true", help="ask once more about those that survived")
    options = parser.parse_args()
    if options.what == "firmware":
        return int(firmware() < AIM)
    if options.what == "host":
        return int(host() < AIM)
    folder = options.copy.resolve()
    kept = Kept(folder.with_name(f"{folder.name}-{options.seed}.jsonl"), again=options.again, seconds=options.seconds)
    return int(python(options.count, options.seed, kept, Copy(folder)) < AIM)


if __name__ == "__main__":
    sys.exit(main())
