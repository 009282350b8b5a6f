"""Many seeds over all cores; what is done is kept in a file, so that a campaign can be stopped and gone on with."""

import hashlib
import json
import math
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from bus_simulation.firmware import FIRMWARE, FirmwareDevice
from bus_simulation.truth import ViolationError
from bus_simulation.world import World
from retuner import drivers
from retuner.drivers.controller.virtual_device import VirtualDevice

BATCH = 10  # seeds that a process takes at a time


class Outcome(NamedTuple):
    """What one seed came to: counts, or the promise that it broke (and in which step)."""

    seed: int
    counts: dict[str, int]
    broken: str


DEVICES: dict[str, tuple[type, type | None]] = {
    "virtual": (VirtualDevice, None),
    "firmware": (FirmwareDevice, None),
    "both": (VirtualDevice, FirmwareDevice),
}
"""What is the device, and what is told the same beside it and must answer the same."""


def run_seed(job: tuple[int, int, str]) -> Outcome:
    """One run of (seed, steps, which of DEVICES)."""
    seed, steps, device = job
    world = World(seed, *DEVICES[device])
    try:
        return Outcome(seed, dict(world.run(steps)), "")
    except ViolationError as error:
        return Outcome(seed, {}, f"step {world.step_number}: {error}")
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        return Outcome(
            seed, {}, f"step {world.step_number}: no exception may come out: {type(error).__name__}: {error}"
        )


def fingerprint() -> str:
    """Of the code under test and of this harness: results of other code are not added up."""
    digest = hashlib.sha256()
    here, there = Path(__file__).parent, Path(str(drivers.__file__)).parent
    loaded = {
        name.rpartition(".")[2] for name in sys.modules if name.startswith(("retuner.drivers.", "bus_simulation."))
    }
    for path in sorted((*here.glob("*.py"), *there.rglob("*.py"), *there.glob("*.dbc"))):
        if path.stem in loaded or path.suffix == ".dbc":
            digest.update(path.name.encode() + path.read_bytes())
    for path in sorted(FIRMWARE.glob("*.[ch]")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class Campaign:
    """Seeds from first on, counted up.

    Parameters
    ----------
    first, seeds, steps : seeds first .. first + seeds - 1, each so many steps.
    state : file that keeps what is done; None for none. What other code has done is kept beside it and its seeds are
        passed over, so that every night looks at new ones. device : which of DEVICES. hours : after which no seed is
        begun.
    """

    def __init__(
        self,
        first: int,
        seeds: int,
        steps: int,
        state: Path | None,
        *,
        device: str = "virtual",
        hours: float = math.inf,
    ) -> None:
        self.first, self.seeds, self.steps, self._device = first, seeds, steps, device
        self._state = state
        self.done: set[int] = set()
        self.counts: Counter[str] = Counter()
        self.broken: dict[int, str] = {}
        self.busy_s = 0.0
        self.before: list[dict[str, object]] = []
        self._hours = hours
        self._key = f"{fingerprint()} {steps} {device}"
        if state is not None and state.exists():
            self._load(json.loads(state.read_text(encoding="utf-8")))

    def run(self, processes: int) -> Iterator[Outcome]:
        """Run what is not done yet; outcomes as they come."""
        todo = [
            (seed, self.steps, self._device)
            for seed in range(self.first, self.first + self.seeds)
            if seed not in self.done
        ]
        began = last_saved = time.monotonic()
        before_s = self.busy_s
        with multiprocessing.Pool(processes) as pool:
            for outcome in pool.imap_unordered(run_seed, todo, chunksize=min(BATCH, 1 + len(todo) // processes // 4)):
                self.done.add(outcome.seed)
                self.counts.update(outcome.counts)
                if outcome.broken:
                    self.broken[outcome.seed] = outcome.broken
                now = time.monotonic()
                self.busy_s = before_s + now - began
                if now - last_saved > 10.0 or outcome.broken:
                    last_saved = now
                    self.save()
                yield outcome
                if now - began > 3600.0 * self._hours:
                    pool.terminate()
                    break
        self.save()

    def steps_of_all(self) -> int:
        """Fault-injected steps of this code and all before it."""
        return self.counts["steps"] + sum(int(dict(one["counts"]).get("steps", 0)) for one in self.before)

    def save(self) -> None:
        """Keep what is done."""
        if self._state is None:
            return
        self._state.parent.mkdir(parents=True, exist_ok=True)
        whole = {
            "key": self._key,
            "done": sorted(self.done),
            "counts": self.counts,
            "broken": self.broken,
            "busy_s": self.busy_s,
            "before": self.before,
        }
        fresh = self._state.with_suffix(".new")
        fresh.write_text(json.dumps(whole), encoding="utf-8")
        fresh.replace(self._state)

    def _load(self, kept: dict[str, object]) -> None:
        """Go on from what was kept, if it is of this very code; else behind its seeds."""
        self.before = list(kept.get("before", ()))
        if kept.get("key") != self._key:
            told = {name: kept[name] for name in ("key", "done", "counts", "broken")}
            self.before.append({**told, "done": [min(told["done"], default=0), max(told["done"], default=-1)]})
        self.first = max([self.first, *(one["done"][1] + 1 for one in self.before)])
        if kept.get("key") != self._key:
            return
        self.done = set(kept["done"])
        self.counts = Counter(kept["counts"])
        self.broken = {int(seed): why for seed, why in kept["broken"].items()}
        self.busy_s = kept["busy_s"]
