"""The whole way: records and a variable in, curves, places and the fewest sets out."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise, product

import numpy as np

from retuner.adaptive.fit.record import setpoint_changes
from retuner.adaptive.identification.first_step import FirstStep, first_step
from retuner.adaptive.identification.robust_simc import RobustTuning
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.schedule_choice.boundaries_of_one_variable import (
    Layout,
    boundaries_of_fewest_sets,
    knots_of_fewest_sets,
)
from retuner.adaptive.schedule_choice.boundaries_of_two_variables import COUNT, Cells, cells
from retuner.adaptive.schedule_choice.scheduling_variables import (
    RegionCrossing,
    SchedulingVariable,
    axis_of,
    crossings,
    curves_along,
    curves_over_both,
)
from retuner.adaptive.schedule_design.curves import Curves
from retuner.adaptive.schedule_design.places import DesignLimits, Place, place_at
from retuner.adaptive.schedule_design.record_stretches import CurveAxis, CurveShape, tells
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window, median
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values
from retuner.schedule.table import Lookup

PLACES = 25  # places along the variable that are looked at
MOST_SETS = 16
SLOWER = (1.4, 1.6, 2.0)  # Limits of J that are tried in turn where more than MOST_SETS would be needed
LOADS_A_STRETCH = 1.5
"""Load steps that a stretch may have in the mean; right fits of benchmarks/schedules need up to 0.8, wrong ones 2."""
BEYOND = 0.1  # share of what the records visit by which a place may lie outside of it and still count as known
LEAST_TRAVEL = 10.0  # A variable that moves by no more than so many standard deviations of its noise is none


@dataclass(frozen=True, slots=True)
class VariableEvidence:
    """A candidate variable and what speaks for it. ln_evidence : over a process that is the same everywhere."""

    variable: str
    ln_evidence: float
    log_likelihood: float
    changes: bool


@dataclass(frozen=True, slots=True)
class Design:
    """A schedule and what it rests on.

    variable : that it follows. places : along it. layout : the sets; None where nothing is known well enough.
    hysteresis, min_stay_s, filter_s : of the lookup. candidates : the variables that were weighed. reason : in words.
    crossings : steps over the range in motion. second : a second variable that it follows, "" for none.
    aim : sets that those of layout lead to, once the next record confirms them; None where these are final.
    """

    variable: str
    curves: Curves
    places: tuple[Place, ...]
    layout: Layout | Cells | None
    hysteresis: float
    min_stay_s: float
    candidates: tuple[VariableEvidence, ...]
    reason: str
    crossings: tuple[RegionCrossing, ...] = ()
    second: str = ""
    second_hysteresis: float = 0.0
    aim: Layout | Cells | None = None


def design(
    windows: Sequence[Window],
    candidates: Sequence[SchedulingVariable],
    limits: DesignLimits,
    lookup: str,
    span: tuple[float | None, float | None],
    progress: Callable[[str, float], None],
) -> Design:
    """A schedule along the candidate for which most speaks.

    windows : the records. candidates : variables that the gains may follow. lookup : "hard", "interpolated", "auto".
    span : ends of the first variable's places where they are given; the fit is over all that the records visit.

    Raises ValueError: nothing moves in the records, no candidate does, or not the one that span is of.
    """
    able = _able(candidates, span)
    ends = {c.name: axis_of(c, span if c is candidates[0] else (None, None)) for c in able}
    found: dict[str, Curves] = {}
    stages = len(able) + 0.3 + (len(able) > 1)
    for i, candidate in enumerate(able):

        def told(stage: str, share: float, i: int = i, name: str = candidate.name) -> None:
            progress(f"{name}: {stage}", (i + share) / stages)

        found[candidate.name] = curves_along(windows, candidate, axis_of(candidate, (None, None)), told)
    evidence = [_evidence(name, c) for name, c in found.items()]
    best = max(evidence, key=lambda e: e.log_likelihood)
    chosen = _Chosen(next(c for c in able if c.name == best.variable), None, found[best.variable])
    dt = median([w.sample_time_s for w in windows])
    settles = len(able) == 1 or (
        not _refused(chosen, _places(chosen, ends, dt, limits)) and max(chosen.curves.differences, default=0.0) < ASKS
    )
    for both in _pairs(chosen.one, able, {e.variable for e in evidence if e.changes}, settles=settles):
        progress(f"{both[0].name} and {both[1].name}", len(able) / stages)
        pair = _Chosen(*both, curves_over_both(windows, both, [found[c.name] for c in both]))
        evidence.append(_evidence(pair.name, pair.curves))
        if pair.both_matter and pair.curves.log_likelihood > chosen.curves.log_likelihood:
            chosen = pair
    progress("the fewest sets", (stages - 0.3) / stages)
    # places, sets and the numbers of the lookup. ends : of each variable's places
    curves = chosen.curves
    places = _places(chosen, ends, dt, limits)
    second = "" if chosen.two is None else chosen.two.name
    none = Design(chosen.one.name, curves, places, None, 0.0, 0.0, tuple(evidence), "", second=second)
    reason = _refused(chosen, places)
    if reason:
        return replace(none, reason=reason)
    layout, j_limit = _affordable(places, limits, lookup)
    if layout is None:
        return replace(none, reason=f"more than {MOST_SETS} sets would be needed")
    sets = len(layout.sets)
    made = replace(
        none,
        layout=layout,
        hysteresis=_hysteresis(chosen.one, layout.lookup, layout.edges),
        min_stay_s=max(p.model.theta_s for p in places if p.known) if sets > 1 else 0.0,
        reason=_counted(sets, str(layout.lookup), places, limits.j, j_limit),
        second_hysteresis=_hysteresis(chosen.two, layout.lookup, layout.edges2)
        if chosen.two is not None and isinstance(layout, Cells)
        else 0.0,
    )
    return replace(made, crossings=crossings_of(made, windows))


def _able(
    candidates: Sequence[SchedulingVariable], span: tuple[float | None, float | None]
) -> list[SchedulingVariable]:
    """The candidates that move; errors as design."""
    able = [c for c in candidates if c.span()[1] - c.span()[0] > LEAST_TRAVEL * c.noise()]
    still = ", ".join(c.name for c in candidates if c not in able)
    if not able:
        raise ValueError(f"{still}: moves no more than its noise in these records, so nothing can be scheduled over it")
    if candidates[0] not in able and span != (None, None):
        raise ValueError(
            f"{candidates[0].name}: does not move in the records beyond its noise, and low and high are its ends; "
            "name a variable that moves first"
        )
    return able


MOST_PAIRS = 3  # variables that are tried beside the one for which most speaks


@dataclass(frozen=True, slots=True)
class _Chosen:
    """One variable or two, and the curves along them."""

    one: SchedulingVariable
    two: SchedulingVariable | None
    curves: Curves

    @property
    def name(self) -> str:
        return self.one.name if self.two is None else f"{self.one.name} and {self.two.name}"

    @property
    def both_matter(self) -> bool:
        form = self.curves.form
        one, two = (any(shape > CurveShape.CONSTANT for shape in s) for s in (form.shapes, form.second_shapes))
        return one and two and self.curves.second_evidence > 0


def _pairs(
    best: SchedulingVariable, able: Sequence[SchedulingVariable], changing: Collection[str], *, settles: bool
) -> list[tuple[SchedulingVariable, SchedulingVariable]]:
    """The best beside others, signals of the loop first; two of these go together in a loop, so they are no pair.

    changing : variables along which something changes. settles : whether the best one does alone. Where it does not,
    what shows nothing alone may do so beside another, whose changes hid it.
    """
    others = [c for c in able if c is not best and (c.outside or best.outside)]
    others = [c for c in others if not settles or (c.name in changing and best.name in changing)][:MOST_PAIRS]
    return [(best, c) if not best.outside or c.outside else (c, best) for c in others]


def _evidence(name: str, found: Curves) -> VariableEvidence:
    changes = any(shape > 1 for shape in (*found.form.shapes, *found.form.second_shapes))
    return VariableEvidence(name, found.evidence, found.log_likelihood, changes)


def _counted(sets: int, lookup: str, places: Sequence[Place], wanted: float, affordable: float) -> str:
    known, count = sum(place.known for place in places), len(places)
    whom = "every place" if known == count else f"the {known} of {count} places that are known"
    how = f"one set serves {whom}" if sets == 1 else f"{sets} sets, {lookup}"
    if sets > 1 and known < count:
        how += f", serve {whom}"
    slower = f"; within J {wanted:g} it would need more than {MOST_SETS}, within {affordable:g} not"
    return how + slower * (affordable > wanted)


def crossings_of(found: Design, windows: Sequence[Window]) -> tuple[RegionCrossing, ...]:
    """The loop in motion along the first variable; in the middle of a second one. None with one set."""
    layout, variable = found.layout, found.variable
    if variable not in {"sp", "pv"} or layout is None or len(layout.sets) == 1:
        return ()
    largest = max(float(np.max(np.abs(np.diff(window.sp)))) for window in windows)
    if isinstance(layout, Layout):
        return tuple(crossings(found.curves, found.places, layout.gains_at, (variable,), largest))
    middle = found.places[COUNT // 2].x2
    assert middle is not None
    row = [place for place in found.places if place.x2 == middle]
    return tuple(crossings(found.curves, row, lambda x: layout.gains_at(x, middle), (variable,), largest, middle))


NEAR_VISITED_RANGES = 0.25
"""Distance from where the records have been, in visited ranges of each variable, within which a place may be known."""


def _places(chosen: _Chosen, ends: Mapping[str, CurveAxis], dt: float, limits: DesignLimits) -> tuple[Place, ...]:
    """Places from end to end of one variable or two, row by row; only what the records visit can be known."""
    found, two = chosen.curves, chosen.two
    if two is None:
        some = [place_at(found, x, dt, limits) for x in ends[chosen.one.name].grid(PLACES).tolist()]
    else:
        across = product(*(ends[c.name].grid(COUNT).tolist() for c in (chosen.one, two)))
        some = [place_at(found, x, dt, limits, x2) for x, x2 in across]
    visited = _visited(chosen, some)
    return tuple(replace(p, known=p.known and there) for p, there in zip(some, visited, strict=True))


def _visited(chosen: _Chosen, places: Sequence[Place]) -> list[bool]:
    """Which places are no further from what the records visit than a curve may be drawn on."""
    inside = [_inside(chosen.one, p.x) for p in places]
    if chosen.two is None:
        return inside
    # which places are near where the records have been with both variables; whatever the product says elsewhere
    one, two = chosen.curves.form.axis, chosen.curves.form.second
    assert two is not None
    low, high = np.array([[one.low, two.axis.low], [one.high, two.axis.high]])
    been = np.concatenate([np.stack([s.x, s.x2], axis=1) for s in chosen.curves.joint.stretches if s.x2 is not None])
    away = [np.linalg.norm((been - [p.x, p.x2]) / (high - low), axis=1) for p in places]
    near = [float(np.min(distance)) <= NEAR_VISITED_RANGES for distance in away]
    beside = [p.x2 is not None and _inside(chosen.two, p.x2) for p in places]
    return [all(each) for each in zip(inside, beside, near, strict=True)]


def _inside(one: SchedulingVariable, x: float) -> bool:
    """Whether a value lies within what is visited, or a little beyond."""
    low, high = one.span()
    beyond = BEYOND * (high - low)
    return low - beyond <= x <= high + beyond


def _refused(chosen: _Chosen, places: Sequence[Place]) -> str:
    """Why no sets follow; empty where they may."""
    found, visited = chosen.curves, _visited(chosen, places)
    stretches = found.joint.stretches
    if not any(map(tells, stretches)):
        noise = max(noise_sigma(s.pv) for s in stretches)
        return (
            f"these records tell nothing: pv does not move beyond its noise ({noise:.3g}); "
            "give records in which the setpoint changes"
        )
    # Load steps that move pv by more than a form leaves unexplained: no plant has so many
    loads = 0
    for stretch, rows, sizes in zip(stretches, found.joint.loads, found.now.sizes, strict=True):
        x2 = None if stretch.x2 is None else np.array([float(np.mean(stretch.x2))])
        ln = found.ln(np.array([float(np.mean(stretch.x))]), x2)[0]
        gain = math.exp(ln[0] + ln[2])
        nets = np.asarray(sizes[: len(rows)]).reshape(-1, 2).sum(axis=1)  # each enters between two rows
        loads += int(np.sum(np.abs(nets) * gain > SMALL_LOAD * float(np.ptp(stretch.pv))))
    if loads > LOADS_A_STRETCH * len(stretches):
        return (
            f"not explained: {loads} load steps would have to have happened in {len(stretches)} stretches of the "
            "records; something else moves pv"
        )
    apart = [(v, name) for v, name in zip(found.differences, TOLD_OF, strict=False) if v >= DIFFERS]
    if apart:  # the stretches are of several processes at one and the same place
        most, name = max(apart)
        return (
            f"something else changes the process: its {name} differs by a factor of {math.exp(most):.1f} from stretch "
            "to stretch at the same place; name what changes with it as the variable"
        )
    known, been = sum(place.known for place in places), sum(visited)
    if known and known >= LEAST_KNOWN * been:
        return ""
    stds = [place.gain_std for place, there in zip(places, visited, strict=True) if there and not place.known]
    least = min(stds or [place.gain_std for place in places])
    factor = f"the controller gain is uncertain by a factor of {math.exp(least):.2f} or more"
    if not known:
        return f"nowhere accurate enough: {factor}"
    return f"accurate enough at {known} of the {been} places that the records visit; at the others {factor}"


SMALL_LOAD = 0.03
"""Share of a stretch's travel by which a load must move pv at rest to count: less mends what a form leaves."""
DIFFERS = 0.5
"""Standard deviation of ln p between stretches from which no curve over the variable serves: a factor of 1.6."""
ASKS = 0.25  # share from which another variable is tried beside the first
TOLD_OF = ("slope gain", "dead time", "lag", "second lag")
LEAST_KNOWN = 0.5  # share of the visited places that must be known: fewer say nothing of a schedule over the variable


def _affordable(places: Sequence[Place], limits: DesignLimits, lookup: str) -> tuple[Layout | Cells | None, float]:
    """The fewest sets, at most MOST_SETS, for the smallest limit of J with which that is possible, and that limit.

    The limit of Ms is never given up.
    """
    for j in (limits.j, *(j for j in SLOWER if j > limits.j)):
        kept = replace(limits, j=j)
        if places[0].x2 is not None:
            layout = cells(places, kept, lookup, MOST_SETS)
            if layout is not None:
                return layout, j
            continue
        options = [] if lookup == Lookup.INTERPOLATED else [boundaries_of_fewest_sets(places, kept, MOST_SETS)]
        if lookup != Lookup.HARD:
            options.append(knots_of_fewest_sets(places, kept, MOST_SETS))
        able = [one for one in options if one is not None]
        if able:  # where steps and interpolation need as many sets, those with the smaller J in the mean
            known = [p for p in places if p.known]
            cost = [(len(one.sets), float(np.mean([p.judged(one.gains_at(p.x)).j for p in known]))) for one in able]
            return able[cost.index(min(cost))], j
    return None, limits.j


def _hysteresis(chosen: SchedulingVariable, lookup: Lookup, edges: Sequence[float]) -> float:
    """Three standard deviations of the variable's noise, and a hundredth of the range; within what the sets allow."""
    if lookup is not Lookup.HARD or len(edges) <= 2:
        return 0.0
    low, high = chosen.span()
    narrowest = min(b - a for a, b in pairwise(edges))
    wanted = max(3 * chosen.noise(), 0.01 * (high - low))
    return min(wanted, 0.4 * narrowest)


# ---- How far a schedule may go at once: each set no farther than what was asked of the records where it is in force.
#
# The door of a single loop's settings (identification/first_step.py), set by set: of the setpoint and load steps that
# happened in its part, and against the gains in force there. A set is held to the place of its part where it goes
# farthest; one that is mixed with its neighbours, to its own knot.

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


# ---- Where the next experiment teaches most: the place whose gain is known least, and a step that shows it there

OVER_NOISE = 20.0  # size of the answer over the noise of pv
LEAST_SHARE = 0.03  # least size of the answer as a share of what pv travels in the records
LAGS, DEAD_TIMES = 3.0, 10.0
"""How long the step is held: theta and so many lags, at most so many dead times more (a slow rise shows the slope)."""


CO_SHARE = 0.8  # share of the room that co has at a place which a step may use; the rest is left to loads

Range = tuple[float | None, float | None]  # lower and upper limit, each where it is known


@dataclass(frozen=True, slots=True)
class NextExperiment:
    """A step of the controller output in manual, or of the setpoint in automatic, at a place of the variable.

    x : where. co_step : in units of co. sp_step : in units of pv. hold_s : how long. gain_std : of ln Kc there now.
    x2 : of a second variable. held : whether the output's limits hold the step below what would be seen well.
    """

    x: float
    co_step: float
    sp_step: float
    hold_s: float
    gain_std: float
    held: bool = False
    x2: float | None = None

    def to_dict(self) -> dict[str, float | bool | None]:
        """Keys x, x2 (null for one variable), co_step, sp_step, hold_s, gain_std, held."""
        return plain_values(self, "x x2 co_step sp_step hold_s gain_std held")


def next_experiment(curves: Curves, places: Sequence[Place], co: Range = (None, None)) -> NextExperiment:
    """The experiment that teaches most. co : limits of the output; a step goes where there is room, and no farther."""
    least = max(places, key=lambda place: place.gain_std)
    model = least.model
    stretches = curves.joint.stretches
    travel = max(float(s.pv.max()) for s in stretches) - min(float(s.pv.min()) for s in stretches)
    noise = max(noise_sigma(s.pv) for s in stretches)
    answer = max(OVER_NOISE * noise, LEAST_SHARE * travel)
    hold = model.theta_s + min(LAGS * (model.tau1_s + model.tau2_s), DEAD_TIMES * (model.theta_s + model.tau2_s))
    lag = model.tau1_s or hold
    reached = model.k * min(1.0, (hold - model.theta_s) / lag)
    wanted = answer / abs(reached)
    # the sign of a step of co that moves pv away from the nearer end of the range
    inwards = math.copysign(1.0, reached) * (1.0 if least.x <= (places[0].x + places[-1].x) / 2 else -1.0)
    step = _within(wanted, float(curves.rest.co(np.array([least.x]))[0]), co, inwards)
    return NextExperiment(least.x, step, step * reached, hold, least.gain_std, abs(step) < 0.999 * wanted, least.x2)


def _within(wanted: float, rest: float, co: Range, inwards: float) -> float:
    """A step of this size away from rest, inwards where there is room; else the other way, or as far as it goes."""
    low, high = co
    up = math.inf if high is None else CO_SHARE * max(high - rest, 0.0)
    down = math.inf if low is None else CO_SHARE * max(rest - low, 0.0)
    room = {1.0: up, -1.0: down}
    way = inwards if room[inwards] >= min(wanted, room[-inwards]) else -inwards
    return way * min(wanted, room[way])
