"""Samples that come late, irregularly, or not at all: does retuner still learn what it learns of a clean record?

clean     as the batch
jitter    each sample carries a time that is off by up to 30 % of the interval
lost      one sample in five is lost
both      both
gaps      in each disturbance once 10 to 60 samples in a row are missing

The runs are those of the batch, limits of a change at x8; the controller itself runs evenly, and hears of a write at
once.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from online.batch import DISTURBANCES, Row, Task, run, staying
from online.counting import counted
from online.supervisors import Watching
from retuner.adaptive.signals.sample import LoopSample
from retuner.schedule.gains import PidGains

KINDS = ("clean", "jitter", "lost", "both", "gaps")
JITTER, LOST = 0.3, 0.2
GAP_EVERY, GAP = 480, (10, 60)
"""Samples between two gaps, and of one."""


class Heard:
    """A supervisor that hears of the loop through a bad line."""

    def __init__(self, watching: Watching, kind: str, rng: np.random.Generator, dt_s: float) -> None:
        self._watching, self._rng = watching, rng
        self._jitter_s = JITTER * dt_s if kind in {"jitter", "both"} else 0.0
        self._lost = LOST if kind in {"lost", "both"} else 0.0
        self._gaps = kind == "gaps"
        self._count, self._silent = 0, 0
        self._wish: tuple[int, PidGains] | None = None

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        """The sample as it arrives, if it does."""
        self._count += 1
        if self._gaps and self._count % GAP_EVERY == 0:
            self._silent = int(self._rng.integers(*GAP))
        if self._silent:
            self._silent -= 1
            return None
        if self._lost and self._rng.uniform() < self._lost:
            return None
        t_s = sample.t_s + self._jitter_s * float(self._rng.uniform(-1, 1))
        return self._watching.observe(sample._replace(t_s=t_s))

    def written(self, region: int, gains: PidGains) -> None:
        """Acknowledged."""
        self._watching.written(region, gains)


def work(kind: str) -> Callable[[Task], Row]:
    """The run of a task of the batch over such a line."""

    def heard(watching: Watching, task: Task, dt_s: float) -> Heard:
        return Heard(watching, kind, np.random.default_rng([task.seed, KINDS.index(kind), 43]), dt_s)

    def one(task: Task) -> dict[str, Any]:
        return run(task, heard) | {"part": "telemetry", "kind": kind, "opened": None}

    return one


def table(rows: list[Row]) -> list[str]:
    """In spec after 1, 3 and 6 disturbances and staying, a kind."""
    lines = []
    for kind in KINDS:
        of = [row for row in rows if row["kind"] == kind]
        lines += [
            f"{kind:<7} after {n}, and staying  {counted(sum(staying(r, n) for r in of), len(of))}"
            for n in (1, 3, DISTURBANCES)
            if of
        ]
    return lines
