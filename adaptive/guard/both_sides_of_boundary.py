"""Both sides of a region's boundary: new gains meet a process that is no longer their own.

At a weight w of the neighbour (0 at the own centre, 1 at its centre) the process is taken between the two, in the
parameters of the fits (structure.py):

    k', theta, c2, 1/T  each  a^(1-w) b^w     (a (1-w) + b w where one of them is 0: no second lag, no lag)

- hard lookup: the new gains run alone up to the boundary plus its hysteresis, the reach.
- interpolated lookup: the gains are (1-w) new + w neighbour's, between the two centres.

On a map of two axes the cells that meet in a corner are asked as well, along the diagonal between their centres: inside
a square of four cells Ms may be larger than on all of its sides (the excess of two ways multiplies). There the weights
are (1-w)^2 for the own cell, w (1-w) for both beside it and w^2 for the one across, in the gains and, in logarithms, in
the process.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

from retuner.adaptive.guard.request import DiagonalNeighbour, NeighbourBoundary
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GAIN_NAMES, GainTable, Lookup

SHARES_HARD = (1.0, 0.5)
"""Weights at which a hard boundary is proved, in shares of the reach: the farthest first, then half way."""
SHARES_MIXED = (0.5, 0.25, 0.75, 0.9)
"""Weights at which an interpolation is proved: Ms along a mean of two sets has no narrow peaks; it rises to an end."""
SHARES_UNKNOWN = (0.5, 0.25)
"""Shares where nothing is known of the neighbour: the own process stands for it up to half way."""


def boundaries_of(
    table: GainTable, region: int, models: Mapping[int, Sequence[Plausible]]
) -> tuple[NeighbourBoundary, ...]:
    """What the table says of a region's boundaries. models : what is known of the regions, by index; may lack some."""
    regions, interpolated = table.regions, table.lookup is Lookup.INTERPOLATED
    best = {i: known[0].model for i, known in models.items() if known}
    found = []
    for other in range(len(regions)):
        own, far = regions.cell(region), regions.cell(other)
        steps = [abs(i - j) for i, j in zip(own, far, strict=True)]
        if max(steps) == 1:
            # of a cell that is met in a corner only, the two between
            cells = [regions.region_at((own[0], far[1])), regions.region_at((far[0], own[1]))] if sum(steps) > 1 else ()
            between = tuple(DiagonalNeighbour(table.gains_of(cell), best.get(cell)) for cell in cells)
            reaches = [1.0 if interpolated else _reach(table, region, other, k) for k, step in enumerate(steps) if step]
            known = table.gains_of(other), tuple(models.get(other, ()))
            found.append(NeighbourBoundary(regions.names[other], *known, max(reaches), interpolated, between))
    return tuple(sorted(found, key=lambda boundary: len(boundary.cells_between)))


def _reach(table: GainTable, region: int, other: int, axis: int) -> float:
    """Weight of the other region up to which this region's gains run alone, along an axis."""
    regions = table.regions
    own, far = regions.centre(region, axis), regions.centre(other, axis)
    low, high = regions.span(region, axis)
    boundary = high if far > own else low
    return min((abs(boundary - own) + regions.axes[axis].hysteresis) / abs(far - own), 1.0)


def at_boundary(
    boundary: NeighbourBoundary,
    own: Sequence[Plausible],
    new: PidGains,
    old: PidGains,
    limit: float,
    sample_time_s: float,
    filter_s: float = 0.0,
) -> tuple[float, bool]:
    """Largest Ms on the way to the neighbour, and whether it is everywhere within the limit or no worse than before.

    All models are asked at the first weight; at the others the best of both and the pair that was worst. own : models
    of the region. filter_s : filter time of the derivative. NaN where there is nothing to ask.
    """

    def ms_of(pair: tuple[ProcessModel, ProcessModel], gains: PidGains, share: float) -> float:
        process = (_between(pair, boundary, share) or pair[0]).seen_by_controller(sample_time_s).linear()
        return sensitivity_peak(process, mixed(gains, boundary, share), filter_s)

    worst, proper = -math.inf, True
    pairs, mixed_at = _pairs(boundary, own), SHARES_MIXED if boundary.models else SHARES_UNKNOWN
    shares = mixed_at if boundary.interpolated else tuple(boundary.reach * share for share in SHARES_HARD)
    for place, share in enumerate(shares):
        asked = [(ms_of(pair, new, share), pair) for pair in pairs]
        for ms, pair in asked:
            worst = max(worst, ms)
            proper = proper and (ms <= limit or no_worse(ms, ms_of(pair, old, share), old, new))
        if not proper:
            break
        if place == 0 and pairs:
            pairs = [pairs[0], max(asked, key=lambda one: one[0])[1]]
    return (worst if pairs else math.nan), proper


def no_worse(after: float, before: float, old: PidGains, new: PidGains) -> bool:
    """Whether an Ms is no larger than before. Of two unstable loops only less of everything is no worse for certain."""
    return after <= before and (math.isfinite(after) or less_of_everything(old, new))


def _pairs(boundary: NeighbourBoundary, own: Sequence[Plausible]) -> list[tuple[ProcessModel, ProcessModel]]:
    """Models here and there, the best of both first; the own one twice where nothing is known of the neighbour."""
    if not own:
        return []
    if not boundary.models:
        return [(mine.model, mine.model) for mine in own] if boundary.interpolated else []
    here, there = own[0].model, boundary.models[0].model
    pairs = [(here, other.model) for other in boundary.models] + [(mine.model, there) for mine in own[1:]]
    return [pair for pair in pairs if between_models(*pair, 0.5) is not None]


def _between(pair: tuple[ProcessModel, ProcessModel], boundary: NeighbourBoundary, share: float) -> ProcessModel | None:
    if boundary.cells_between:
        # The process inside a square of four cells, on its diagonal; between the two corners where a side is unknown
        here, there = pair
        one, two = (cell.model for cell in boundary.cells_between)
        if one is not None and two is not None:
            sides = between_models(here, one, share), between_models(two, there, share)
            if sides[0] is not None and sides[1] is not None:
                return between_models(sides[0], sides[1], share)
        return between_models(here, there, share)
    return between_models(*pair, share)


def likeliest_between(boundary: NeighbourBoundary, own: ProcessModel, share: float) -> ProcessModel:
    """The process at a weight of the neighbour by the best models of both; the own one where nothing is known there."""
    there = boundary.models[0].model if boundary.models else own
    return _between((own, there), boundary, share) or own


def mixed(gains: PidGains, boundary: NeighbourBoundary, share: float) -> PidGains:
    """The gains in force at a weight of the neighbour."""
    if not boundary.interpolated:
        return gains
    shares = [(gains, 1 - share), (boundary.gains, share)]
    if boundary.cells_between:
        shares = [(gains, (1 - share) ** 2), (boundary.gains, share**2)]
        shares += [(cell.gains, share * (1 - share)) for cell in boundary.cells_between]
    return PidGains(*(sum(w * getattr(one, name) for one, w in shares) for name in GAIN_NAMES))


@lru_cache(maxsize=1024)  # each set that is tried is asked on the same ways
def between_models(one: ProcessModel, other: ProcessModel, share: float) -> ProcessModel | None:
    """The process between two: see the head of this file; None where a structure is not one that a fit can have."""
    kinds = {ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG}
    one, other = one.of_second_order(), other.of_second_order()
    if not {one.type, other.type} <= kinds or one.k * other.k < 0:
        return None
    a, b = _numbers(one), _numbers(other)
    size, theta, c2, c0 = (_mean(x, y, share) for x, y in zip(a, b, strict=True))
    slope = math.copysign(size, one.k)
    if not c0:
        type_ = ProcessType.INTEGRATING_LAG if c2 else ProcessType.INTEGRATING
        return ProcessModel(type_, slope, 0.0, c2, theta)
    total = 1 / c0
    plain = ProcessModel(ProcessType.FOPDT, slope * total, total, 0.0, theta)
    if not c2:
        return plain
    root = 1 - 4 * c2 / total
    if root < 0:
        tau = math.sqrt(c2 * total)
        return replace(plain, type=ProcessType.SOPDT, tau1_s=tau, tau2_s=tau, zeta=min(total / (2 * tau), 1.0))
    tau1 = total * (1 + math.sqrt(root)) / 2
    return replace(plain, type=ProcessType.SOPDT, tau1_s=tau1, tau2_s=min(c2 * total / tau1, tau1))


def _numbers(model: ProcessModel) -> tuple[float, float, float, float]:
    """|k'|, theta, c2 and 1/T of k' e^(-theta s) / (c2 s^2 + s + 1/T)."""
    if not model.tau1_s:
        return abs(model.k), model.theta_s, model.tau2_s, 0.0
    total = 2 * model.zeta * model.tau1_s if model.zeta < 1 else model.tau1_s + model.tau2_s
    return abs(model.k) / total, model.theta_s, model.tau1_s * model.tau2_s / total, 1 / total


def _mean(a: float, b: float, share: float) -> float:
    """Mean of two numbers, in their logarithms where both have one."""
    return a ** (1 - share) * b**share if a and b else a * (1 - share) + b * share


# What runs at the far places of a region, where the process is no longer its own.
#
# Between the knots of an interpolated table that is the mean of two sets, on a process between two. In a table of
# steps it is the region's own set up to its boundary. The records of a region show its middle, so nobody would ask
# there.
#
# Where the process gain is r times as large at the next knot it is sqrt(r) times as large half way, and the mean of
# two gains that suit their knots is (1 + 1/r)/2 of the first. Their product exceeds that at the knots by (sqrt(r) +
# 1/sqrt(r))/2: 6 % for r = 2, 25 % for r = 4. So sets that suit both knots may be too much between them, and a region
# answers for its own half of every way to a neighbour. Up to a boundary of a table of steps it is sqrt(r) whole.

OWN_HALF = (0.25, 0.5)  # weights of the neighbour at the places that a region answers for
EASED = (1.0, 0.94, 0.88, 0.82, 0.76, 0.7, 0.65, 0.6, 0.55, 0.5)
"""Shares of the wanted gains that are tried: where less is needed, it is the neighbour's set that is too much."""


class PlaceBetween(NamedTuple):
    """The place of largest Ms on the region's part of the ways to its neighbours. to : name of that neighbour."""

    ms: float
    to: str


def worst_between(
    boundaries: Sequence[NeighbourBoundary],
    own: ProcessModel,
    gains: PidGains,
    sample_time_s: float,
    filter_s: float = 0.0,
) -> PlaceBetween | None:
    """The worst place by the best models; None where nothing is known beyond any boundary.

    boundaries : of the region. own : its process at its knot. gains : its set. filter_s : filter time of the
    derivative.
    """
    asked = []
    for boundary in boundaries:
        shares = OWN_HALF if boundary.interpolated else (boundary.reach,) if boundary.models else ()
        for share in shares:
            process = likeliest_between(boundary, own, share).seen_by_controller(sample_time_s).linear()
            asked.append(
                PlaceBetween(sensitivity_peak(process, mixed(gains, boundary, share), filter_s), boundary.name)
            )
    return max(asked, default=None)


def eased(
    wanted: PidGains,
    boundaries: Sequence[NeighbourBoundary],
    own: ProcessModel,
    limit: float,
    sample_time_s: float,
    filter_s: float = 0.0,
) -> PidGains:
    """The largest share of the wanted gains that keeps Ms within a limit on the region's part; arguments as above.

    Where no share does, the one of least Ms: of an integrating process, less gain at the same tau_I may be less robust.
    """
    least, easiest = math.inf, wanted
    for share in EASED:
        gains = PidGains(wanted.kp * share, wanted.ki * share, wanted.kd * share)
        found = worst_between(boundaries, own, gains, sample_time_s, filter_s)
        if found is None or found.ms <= limit:
            return gains
        if found.ms <= least:
            least, easiest = found.ms, gains
    return easiest
