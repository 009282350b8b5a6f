"""How much would be noticed: the code with one thing wrong each, and what finds it.

    python benchmarks/mutation.py firmware      every mutant of drivers/firmware: examination, simulation
    python benchmarks/mutation.py host          every host with one layer taken away: simulation

Exit status 1 when the score is below 95 %. Mutants of the Python code are made by mutmut or cosmic-ray.
"""

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bus_simulation.campaign import BOX, FIRST, World
from bus_simulation.device_end import LagPlant
from bus_simulation.firmware import FirmwareDevice
from bus_simulation.host_mutants import HOST_MUTANTS, broken_by
from bus_simulation.in_thread import InThread
from bus_simulation.mutants import MUTANTS, MUTANTS_OF_THE_STORE, Mutant
from bus_simulation.truth import ViolationError

from retuner.drivers.conformance.chapters import chapters
from retuner.drivers.conformance.conversation import Conversation, NoAnswerError
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("firmware", "host"))
    return int((firmware() if parser.parse_args().what == "firmware" else host()) < AIM)


if __name__ == "__main__":
    sys.exit(main())
