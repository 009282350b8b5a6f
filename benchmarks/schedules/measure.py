"""One case: a subject, its record, the schedule designed from it, and everybody on a fresh walk of the true plant."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from retuner import GainTable, PidGains
from schedules import physics, records, rivals
from schedules.designer import Designed, design
from schedules.lookups import Curve, Lookup, Table
from schedules.loop import Trace, run
from schedules.records import poor, poor_table, record, walk
from schedules.truth import Truth, counts

Row = dict[str, Any]
MODES = ("fixed", "scheduled", "lagging")
"""Gains in force in the record: one set; a table of three; one set, and the scheduling variable lags."""
LAG_THETA = 4.0  # Lag of a lagging scheduling variable, in effective dead times of the middle
PLACES, WALK = 11, 16
DRAWN = tuple((kind, factor) for kind in ("smooth", "kink") for factor in (4.0, 10.0))


@dataclass(frozen=True, slots=True)
class Task:
    """One case. subject : a name of MAKERS, or "KIND FACTOR" drawn with index. visits : of each place in the record."""

    seed: int
    index: int
    subject: str
    mode: str = "fixed"
    visits: int = 2
    places: int = PLACES
    walk: int = WALK
    rivals: bool = True

    def key(self) -> list[Any]:
        """What tells it from others."""
        return [self.seed, self.index, self.subject, self.mode, self.visits]


def tasks(seed: int, loops: int, parts: tuple[str, ...], modes: tuple[str, ...], **wanted: Any) -> list[Task]:
    """`loops` drawn processes of each sort, and each plant once; in every mode."""
    names = {
        "drawn": [f"{kind} {factor:g}" for kind, factor in DRAWN] * loops,
        "signal": ["smooth 4 by flow"] * loops,
        "constant": ["constant 1"] * loops,
        "physics": list(physics.MAKERS),
    }
    found = []
    for part in parts:
        for mode in modes:
            found += [Task(seed, i, name, mode, **wanted) for i, name in enumerate(names[part])]
    return found


def measure(task: Task) -> Row:
    """The row of one case: who is in spec where, and IAE over the perfect table's."""
    if task.subject in physics.MAKERS:
        subject = physics.MAKERS[task.subject]()
    else:
        kind, factor, *by = task.subject.split()
        rng = np.random.default_rng([task.seed, task.index, 40])
        subject = records.draw(rng, kind, float(factor), by=by[-1] if by else "pv")
    truth = Truth(subject, task.places)
    rng = np.random.default_rng([task.seed, task.index, MODES.index(task.mode), 41])
    lag_s = LAG_THETA * truth.judges[task.places // 2].theta_s if task.mode == "lagging" else 0.0
    table: GainTable | PidGains = poor_table(truth, rng) if task.mode == "scheduled" else poor(truth, rng)
    before: Lookup = Table(table) if isinstance(table, GainTable) else Curve([0.0], [table])
    trace = record(truth, before, rng, task.visits, lag_s)
    row: Row = {
        "part": "schedules",
        "key": task.key(),
        "name": subject.name,
        "kind": subject.kind,
        "mode": task.mode,
        "constant": subject.constant,
        "samples": len(trace.pv),
        "record_lost": trace.lost,
    }
    begun = time.perf_counter()
    designed = design(subject, trace, table, lagging=bool(lag_s))
    row["seconds"] = round(time.perf_counter() - begun, 2)
    row["reason"], row["size"], row["bands"] = designed.reason, designed.size, designed.bands
    row["fewest"] = truth.fewest
    who: dict[str, Lookup] = {"before": before, "perfect": truth.perfect()}
    if designed.lookup is not None:
        who["designed"] = designed.lookup
    if task.rivals:
        who |= {"fixed": rivals.fixed(truth), "four": rivals.four(truth), "points": rivals.points(truth, rng)}
    visits = walk(truth, rng, task.walk)
    noise = truth.subject.noise * rng.standard_normal(sum(visit.n for visit in visits))
    found = {}
    for name, lookup in who.items():
        trace: Trace = run(truth.subject, lookup, visits, noise, lag_s)
        found[name] = counts(truth, lookup) | {"iae": trace.iae(), "sets": lookup.size}
    perfect = found["perfect"]["iae"]
    for each in found.values():
        each["iae"] = each["iae"] / perfect if math.isfinite(each["iae"]) else math.inf
    row["who"] = found
    return row


__all__ = ["Designed", "Row", "Task", "measure", "tasks"]
