"""The one place that calls what is measured: `retuner.design_schedule` on the record of a case."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from retuner import GainTable, PidGains, design_schedule
from retuner.adaptive.signals.sample import Window
from schedules.lookups import Lookup, Table
from schedules.loop import Trace
from schedules.subject import Subject, bands


@dataclass(frozen=True)
class Designed:
    """lookup : the schedule, None where there is none. size : sets stored. reason : as told. bands : see there."""

    lookup: Lookup | None
    size: int
    reason: str
    bands: list[dict[str, Any]] = field(default_factory=list)


def design(subject: Subject, trace: Trace, in_force: GainTable | PidGains, *, lagging: bool) -> Designed:
    """From the record alone; the designer is told by what to schedule, the output's range, and the gains in force."""
    t = np.arange(len(trace.pv)) * trace.dt_s
    window = Window(t, np.array(trace.sp), np.array(trace.pv), np.array(trace.co))
    outside = lagging or subject.by != "pv"
    by = "x" if outside else "pv"
    values = {"x": [np.array(trace.x)]} if outside else {}
    found = design_schedule(
        window,
        by,
        values=values,
        low=subject.low,
        high=subject.high,
        co_min=subject.co_min,
        co_max=subject.co_max,
        gains=in_force,
    )
    told = bands(found, subject)
    if found.table is None:
        return Designed(None, 0, found.reason, told)
    return Designed(Table(found.table), len(found.table.gains), found.reason, told)
