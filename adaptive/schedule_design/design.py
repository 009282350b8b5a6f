"""The whole way: records and a variable in, curves, places and the fewest sets out."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from retuner.adaptive.controller_settings.read_off import settings_in_force
from retuner.adaptive.schedule_design.cover import Layout, knots, steps
from retuner.adaptive.schedule_design.crossing import Crossing, crossings
from retuner.adaptive.schedule_design.curves import Curves, curves
from retuner.adaptive.schedule_design.places import DesignLimits, Place, place_at
from retuner.adaptive.schedule_design.shapes import Axis
from retuner.adaptive.schedule_design.stretches import Stretch, cut, moving, signals_of, tells, without_gaps
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.table import Lookup

PLACES = 25
"""Places along the variable that are looked at."""
MOST_SETS = 16
SLOWER = (1.4, 1.6, 2.0)
"""Limits of J that are tried in turn where more than MOST_SETS would be needed."""
LOADS_A_STRETCH = 1.5
"""Load steps that a stretch may have in the mean; right fits of benchmarks/schedules need up to 0.8, wrong ones 2."""
ROWS = 400
"""Rows wanted in a typical stretch."""
BEYOND = 0.1
"""Share of what the records visit by which a place may lie outside of it and still count as known."""
OWN = ("sp", "pv", "co")
"""Signals of the loop itself; another variable may move pv on its own."""
LEAST_TRAVEL = 10.0
"""A variable that moves by no more than so many standard deviations of its noise is none."""


@dataclass(frozen=True, slots=True)
class Evidence:
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
    crossings : steps over the range in motion.
    """

    variable: str
    curves: Curves
    places: tuple[Place, ...]
    layout: Layout | None
    hysteresis: float
    min_stay_s: float
    candidates: tuple[Evidence, ...]
    reason: str
    crossings: tuple[Crossing, ...] = ()


@dataclass(frozen=True, slots=True)
class Candidate:
    """A variable at the samples of every record."""

    name: str
    values: tuple[FloatArray, ...]

    def span(self) -> tuple[float, float]:
        """Lowest and highest value visited, noise apart."""
        low = min(float(np.quantile(v, 0.001)) for v in self.values)
        high = max(float(np.quantile(v, 0.999)) for v in self.values)
        return low, high

    def noise(self) -> float:
        """Standard deviation of its noise."""
        return max(noise_sigma(v) for v in self.values)


def design(
    windows: Sequence[Window],
    candidates: Sequence[Candidate],
    limits: DesignLimits,
    lookup: str,
    span: tuple[float | None, float | None],
    progress: Callable[[str, float], None],
) -> Design:
    """A schedule along the candidate for which most speaks.

    Parameters
    ----------
    windows : the records. candidates : variables that the gains may follow. lookup : "hard", "interpolated", "auto".
    span : ends of the variable where they are given.

    Raises
    ------
    ValueError
        Nothing moves in the records, or no candidate does.
    """
    able = [c for c in candidates if c.span()[1] - c.span()[0] > LEAST_TRAVEL * c.noise()]
    if not able:
        named = ", ".join(c.name for c in candidates)
        raise ValueError(f"{named}: does not move in the records beyond its noise; nothing can be told over it")
    found = {}
    for i, candidate in enumerate(able):
        axis = _axis(candidate, span)

        def told(stage: str, share: float, i: int = i, name: str = candidate.name) -> None:
            progress(f"{name}: {stage}", (i + share) / (len(able) + 0.3))

        outside = candidate.name not in OWN
        found[candidate.name] = curves(_stretches(windows, candidate), axis, direction(windows), told, pushed=outside)
    evidence = tuple(_evidence(name, c) for name, c in found.items())
    best = max(evidence, key=lambda e: e.log_likelihood)
    chosen = next(c for c in able if c.name == best.variable)
    progress("the fewest sets", len(able) / (len(able) + 0.3))
    return _designed(chosen, found[best.variable], windows, limits, lookup, evidence)


def _axis(candidate: Candidate, span: tuple[float | None, float | None]) -> Axis:
    """From end to end of a schedule, those that are given and those that the records visit."""
    own = candidate.span()
    low, high = (given if given is not None else seen for given, seen in zip(span, own, strict=True))
    if not max(low, own[0]) < min(high, own[1]):
        raise ValueError(
            f"{candidate.name}: the records visit {own[0]:.4g} to {own[1]:.4g}, and nothing of low = {low:g} to "
            f"high = {high:g}; give ends that take in some of it"
        )
    return Axis(low, high)


SEEN = 5
"""Setpoint changes that must agree on the direction in which the controller acts, on balance, weighed by their size."""


def direction(windows: Sequence[Window]) -> int | None:
    """Sign of the process gain as the controller's answers to setpoint changes show it; None where there are too few.

    In a loop that is closed and works, co goes the process' way when the setpoint moves. Where it never does, the
    controller is read off the record.
    """
    votes = []
    for window in windows:
        moved = np.diff(window.sp)
        large = np.flatnonzero(np.abs(moved) > 0.1 * max(float(np.ptp(window.sp)), 1e-300))
        for row in large[(large > SEEN) & (large < len(moved) - SEEN)].tolist():
            kick = float(np.mean(window.co[row + 1 : row + 1 + SEEN]) - np.mean(window.co[row - SEEN + 1 : row + 1]))
            votes.append(math.copysign(1.0, moved[row]) * kick)
    total = sum(votes)
    against = sum(abs(v) for v in votes if v * total < 0)
    if votes and against <= abs(total):
        return int(math.copysign(1, total))
    read_off = (settings_in_force(window).direction for window in windows)
    return next((way for way in read_off if way is not None), None)


def _evidence(name: str, found: Curves) -> Evidence:
    changes = any(shape > 1 for shape in found.form.shapes)
    return Evidence(name, found.evidence, found.log_likelihood, changes)


def _stretches(windows: Sequence[Window], candidate: Candidate) -> list[Stretch]:
    """All stretches of all records."""
    found: list[Stretch] = []
    for window, values in zip(windows, candidate.values, strict=True):
        every = _every(window)
        for piece, there in without_gaps(window, values):
            found += moving(cut(signals_of(piece, there, every)))
    return found


def _every(window: Window) -> int:
    """Samples in an interval: a typical time between setpoint changes has ROWS."""
    n = len(window.t_s)
    changes = int(np.count_nonzero(np.abs(np.diff(window.sp)) > 0.01 * np.ptp(window.sp))) if np.ptp(window.sp) else 0
    return max(1, round(n / (changes + 1) / ROWS)) if changes < n / 20 else max(1, n // 40 // ROWS)


def _designed(
    chosen: Candidate,
    found: Curves,
    windows: Sequence[Window],
    limits: DesignLimits,
    lookup: str,
    evidence: tuple[Evidence, ...],
) -> Design:
    """Places, sets and the numbers of the lookup."""
    dt = float(np.median([w.sample_time_s for w in windows]))
    places = _visited(chosen, [place_at(found, float(x), dt, limits) for x in found.form.axis.grid(PLACES)])
    reason = _at_rest(found) or _unexplained(found) or _differs(found) or _nowhere_known(places)
    if reason:
        return Design(chosen.name, found, places, None, 0.0, 0.0, evidence, reason)
    layout, j_limit = _affordable(places, limits, lookup)
    border = _hysteresis(chosen, layout)
    stay = max(p.model.theta_s for p in places if p.known) if layout is not None and len(layout.sets) > 1 else 0.0
    if layout is None:
        return Design(
            chosen.name, found, places, None, 0.0, 0.0, evidence, f"more than {MOST_SETS} sets would be needed"
        )
    sets = len(layout.sets)
    how = "one set serves every place" if sets == 1 else f"{sets} sets, {layout.lookup}"
    how += f"; within J {limits.j:g} it would need more than {MOST_SETS}, within {j_limit:g} not" * (j_limit > limits.j)
    moving_by = (chosen.name,) if chosen.name in {"sp", "pv"} else ()
    moved = tuple(crossings(found, places, layout, moving_by, _largest_step(windows))) if sets > 1 else ()
    return Design(chosen.name, found, places, layout, border, stay, evidence, how, moved)


def _visited(chosen: Candidate, places: Sequence[Place]) -> tuple[Place, ...]:
    """The places; those further from what the records visit than a curve may be drawn on are not known."""
    low, high = chosen.span()
    beyond = BEYOND * (high - low)
    return tuple(p if low - beyond <= p.x <= high + beyond else replace(p, known=False) for p in places)


def _at_rest(found: Curves) -> str:
    """Why the records tell nothing at all; empty where pv moves in them."""
    stretches = found.joint.stretches
    if any(map(tells, stretches)):
        return ""
    noise = max(noise_sigma(s.pv) for s in stretches)
    return (
        f"these records tell nothing: pv does not move beyond its noise ({noise:.3g}); "
        "give records in which the setpoint changes"
    )


def _unexplained(found: Curves) -> str:
    """Why the curves explain the records only with the help of loads that no plant has; empty where they do."""
    loads, stretches = sum(map(len, found.joint.loads)) // 2, len(found.joint.stretches)
    if loads <= LOADS_A_STRETCH * stretches:
        return ""
    return (
        f"not explained: {loads} load steps would have to have happened in {stretches} stretches of the records; "
        "something else moves pv"
    )


DIFFERS = 0.5
"""Standard deviation of ln p between stretches from which no curve over the variable serves: a factor of 1.6."""
TOLD_OF = ("slope gain", "dead time", "lag", "second lag")


def _differs(found: Curves) -> str:
    """Why the stretches are of several processes at one and the same place; empty where they agree."""
    apart = [(v, name) for v, name in zip(found.differences, TOLD_OF, strict=False) if v >= DIFFERS]
    if not apart:
        return ""
    most, name = max(apart)
    return (
        f"something else changes the process: its {name} differs by a factor of {math.exp(most):.1f} from stretch to "
        "stretch at the same place; name what changes with it as the variable"
    )


def _nowhere_known(places: Sequence[Place]) -> str:
    """Why no place is known well enough; empty where one is."""
    if any(place.known for place in places):
        return ""
    factor = math.exp(min(place.gain_std for place in places))
    return f"nowhere accurate enough: the controller gain is uncertain by a factor of {factor:.2f} or more"


def _affordable(places: Sequence[Place], limits: DesignLimits, lookup: str) -> tuple[Layout | None, float]:
    """The fewest sets, at most MOST_SETS, for the smallest limit of J with which that is possible, and that limit.

    The limit of Ms is never given up.
    """
    for j in (limits.j, *(j for j in SLOWER if j > limits.j)):
        layout = _layout(places, replace(limits, j=j), lookup)
        if layout is not None:
            return layout, j
    return None, limits.j


def _largest_step(windows: Sequence[Window]) -> float:
    """Of the setpoint from one sample to the next."""
    return max(float(np.max(np.abs(np.diff(window.sp)))) for window in windows)


def _layout(places: Sequence[Place], limits: DesignLimits, lookup: str) -> Layout | None:
    """The fewest sets; where steps and interpolation need as many, the one with the smaller J in the mean."""
    options = [] if lookup == Lookup.INTERPOLATED else [steps(places, limits, MOST_SETS)]
    if lookup != Lookup.HARD:
        options.append(knots(places, limits, MOST_SETS))
    able = [layout for layout in options if layout is not None]
    return min(able, key=lambda one: (len(one.sets), _mean_j(places, one)), default=None)


def _mean_j(places: Sequence[Place], layout: Layout) -> float:
    return float(np.mean([p.judged(layout.gains_at(p.x)).j for p in places if p.known]))


def _hysteresis(chosen: Candidate, layout: Layout | None) -> float:
    """Three standard deviations of the variable's noise, and a hundredth of the range; within what the sets allow."""
    if layout is None or layout.lookup is not Lookup.HARD or len(layout.sets) == 1:
        return 0.0
    low, high = chosen.span()
    narrowest = min(b - a for a, b in zip(layout.edges, layout.edges[1:], strict=False))
    wanted = max(3 * chosen.noise(), 0.01 * (high - low))
    return min(wanted, 0.4 * narrowest)


__all__ = ["Candidate", "Design", "Evidence", "design"]
