"""How far a schedule may go at once: each set no farther than what was asked of the records where it is in force.

The door of a single loop's settings (identification/first_step.py), set by set: of the setpoint and load steps that
happened in its part, and against the gains in force there. A set is held to the place of its part where it goes
farthest; one that is mixed with its neighbours, to its own knot.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.fit.coincident_loads import setpoint_changes
from retuner.adaptive.identification.first_step import FirstStep, first_step
from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.schedule_choice.cells import Cells
from retuner.adaptive.schedule_choice.design import Design, crossings_of
from retuner.adaptive.schedule_design.cover import Layout
from retuner.adaptive.schedule_design.places import Place
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup

InForce = Callable[[float, float | None], PidGains | None]
"""Gains that were in force at a value of the variable, and of a second one; None where nobody knows."""


def first_sets(found: Design, windows: Sequence[Window], visited: Sequence[FloatArray], in_force: InForce) -> Design:
    """The design with sets that its records carry at once; what they lead to is its aim, None where that is no farther.

    windows : the records. visited : the variable at their samples, and a second one, each over all records.
    """
    layout = found.layout
    if layout is None:
        return found
    events = _events(found, windows, visited)
    steps = [_step(found.places, layout, part, gains, events[part], in_force) for part, gains in enumerate(layout.sets)]
    taken = [step for step in steps if step is not None]
    if not taken:
        return found
    sets = tuple(old if new is None else new.now.tuning.gains for old, new in zip(layout.sets, steps, strict=True))
    first = replace(layout, sets=sets)
    farthest = max(taken, key=lambda step: step.factor / step.carried)
    made = replace(found, layout=first, aim=layout, reason=f"{found.reason}; {farthest.sentence}")
    return replace(made, crossings=crossings_of(made, windows))


def _events(found: Design, windows: Sequence[Window], visited: Sequence[FloatArray]) -> list[int]:
    """Setpoint and load steps in the part of each set."""
    layout = found.layout
    assert layout is not None
    counted, begun = [0] * len(layout.sets), 0
    for window in windows:
        rows = begun + np.searchsorted(window.t_s - window.t_s[0], setpoint_changes(window))
        for row in rows.tolist():
            counted[layout.part(*(float(values[row]) for values in visited))] += 1
        begun += len(window.t_s)
    for stretch, loads in zip(found.curves.joint.stretches, found.curves.joint.loads, strict=True):
        at = [float(np.mean(values)) for values in (stretch.x, stretch.x2) if values is not None]
        counted[layout.part(*at)] += len(loads) // 2  # each enters between two rows
    return counted


def _step(
    places: Sequence[Place], layout: Layout | Cells, part: int, gains: PidGains, events: int, in_force: InForce
) -> FirstStep | None:
    """The first step of a set where it goes farthest; None where it may be reached at once."""
    inside = [place for place in places if place.known and layout.part(place.x, place.x2) == part]
    if layout.lookup is Lookup.INTERPOLATED:
        inside = inside[len(inside) // 2 :][:1]
    steps = []
    for place in inside:
        now, judged = in_force(place.x, place.x2), place.judged(gains)
        if now is not None:
            aim = RobustTuning(Tuning("simc", "series", gains), judged.ms, judged.ms_worst)
            steps.append(first_step(aim, now, events, place.model, place.sample_time_s))
    return max((step for step in steps if step is not None), key=lambda step: step.factor, default=None)
