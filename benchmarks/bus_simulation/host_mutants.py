"""Hosts with one layer of the protocol taken away each: what the invariants over hosts must find.

    python benchmarks/bus_simulation/host_mutants.py NUMBER [SEEDS STEPS]     one of them: the first promise it breaks

Each is a module, and one change of a text in it. A mutant runs in a process of its own, whose import of that module is
changed, beside the firmware in C: what host and virtual device share is then changed at the host alone.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bus_simulation.mutants import TEXTS

SEEDS, STEPS = 20, 700  # what CI simulates


class HostMutant(NamedTuple):
    """One change: old stands in the module exactly once."""

    name: str
    module: str
    old: str
    new: str


HOST_MUTANTS = tuple(HostMutant(name, *texts) for name, texts in TEXTS["host"].items())


def broken_by(number: int, seeds: int = SEEDS, steps: int = STEPS) -> str:
    """The first promise that a mutant breaks, empty for none; in a process of its own."""
    command = [sys.executable, "-P", __file__, str(number), str(seeds), str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in {0, 1}:
        raise RuntimeError(f"mutant {number}: {done.stderr.strip().splitlines()[-1:]}")
    return done.stdout.strip()


def main() -> int:
    number, seeds, steps = map(int, [*sys.argv[1:], SEEDS, STEPS][:3] if len(sys.argv) == 2 else sys.argv[1:])
    # load the module with its change, before anything else does
    mutant = HOST_MUTANTS[number]
    spec = importlib.util.find_spec(mutant.module)
    if spec is None or spec.origin is None or mutant.module in sys.modules:
        raise ValueError(f"{mutant.module} is not there, or loaded already")
    source = Path(spec.origin).read_text(encoding="utf-8")
    if source.count(mutant.old) != 1:
        raise ValueError(f"{mutant.name}: {mutant.old!r} stands {source.count(mutant.old)} times in {mutant.module}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[mutant.module] = module
    exec(compile(source.replace(mutant.old, mutant.new), spec.origin, "exec"), module.__dict__)
    from bus_simulation.campaign import World
    from bus_simulation.firmware import FirmwareDevice

    for seed in range(seeds):
        try:
            World(seed, FirmwareDevice).run(steps)
        except (AssertionError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            print(f"{type(error).__name__}: {error}" if not isinstance(error, AssertionError) else error)
            return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
