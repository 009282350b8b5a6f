"""Another schedule, where a region is too wide for one set: a boundary inside it, or sets that are interpolated.

The curves through what is known of the regions (along.py) say what the process is at places from end to end of every
region, and how well that is known. The chances that a set is in spec at
them (spots.py) add up to how many of them it is expected to serve. Asked is never whether the sets in force are the
best ones, for that is seen to from response to response. A region with the set that serves it best is weighed against
the same region with a boundary in it and the best set on either side, and against means of the sets at the centres.
What is not known well lowers all of them alike, so doubt proposes nothing. Nothing is changed by it: a person takes it
up, or leaves it.

Pure: a table and region models in, a proposal out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from retuner.adaptive.identification.estimate import LogModel, proper_covariance
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.along import Curves, curves, lenders
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.spots import MS_END, Best, Spot, best_of, spot_of
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.schedule_design.places import DesignLimits
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions, choose, enter
from retuner.schedule.table import GainTable, Lookup

PLACES = 5
"""Of a region, from end to end; those between the ends are where a boundary is tried."""
LEAST_RECORDS = 3
"""Of every region."""
LEAST_KNOWN = 3
"""Places of a region that must be known; the others demand nothing."""
TOO_WIDE = 0.6
"""Share of a region's places that its best set must serve, or the region is too wide."""
WORTH = 0.15
"""Share of a region's places by which another schedule must serve more of them, in expectation."""
CALMER = (1.0, 0.92, 0.85)
"""Factors on the sets of an interpolation: a mean of two sets may be too much between them."""


@dataclass(frozen=True, slots=True)
class TooWide:
    """A region that no one set serves.

    region : its name. kc_factor : the larger over the smaller of the Kc that
    its places ask for. share, share_then : of its places that the best set serves, and that the other schedule does.
    """

    region: str
    kc_factor: float
    share: float
    share_then: float

    @property
    def sentence(self) -> str:
        """What is known of it."""
        return (
            f"Region {self.region} is too wide for one set: the Kc asked for differs inside it by a factor of "
            f"{self.kc_factor:.2g}. At its best a set serves {self.share:.0%} of it, with the proposal "
            f"{self.share_then:.0%}."
        )


@dataclass(frozen=True, slots=True)
class Refinement:
    """A proposal with what it rests on.

    table : as proposed. places : that are known. kept, kept_then : of these, where the limits are expected to be kept
    by the table as it is with the best set in each region, and by the other. ms, ms_then : largest Ms at any of them by
    the likeliest models. limits : of Ms and J. wide : the regions for the sake of which it is proposed.
    """

    table: GainTable
    places: int
    kept: float
    kept_then: float
    ms: float
    ms_then: float
    limits: DesignLimits
    wide: tuple[TooWide, ...] = ()

    @property
    def sentence(self) -> str:
        """The proposal in a few sentences."""
        axis = self.table.regions.axes[0]
        hard = self.table.lookup is Lookup.HARD
        bounds = ", ".join(f"{bound:.4g}" for bound in self.table.regions.bounds)
        knots = ", ".join(f"{self.table.regions.centre(i):.4g}" for i in range(len(self.table.gains)))
        what = f"steps at {axis.label} = {bounds}" if hard else f"interpolation about {axis.label} = {knots}"
        return " ".join(
            [
                *(one.sentence for one in self.wide),
                f"Another schedule serves more places: {what} {axis.unit}".rstrip() + ".",
                f"Ms {self.limits.ms:g} and {self.limits.j:g} times SIMC's IAE are then expected to hold at "
                f"{self.kept_then:.1f} of {self.places} places. "
                f"With the best set in each region as it is they hold at {self.kept:.1f}. "
                f"The largest Ms is then {_ms(self.ms_then)} instead of {_ms(self.ms)}.",
            ]
        )

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return {
            "kind": "refine",
            "sentence": self.sentence,
            "lookup": str(self.table.lookup),
            "bounds": list(self.table.regions.bounds),
            "knots": [self.table.regions.centre(i) for i in range(len(self.table.gains))],
            "gains": [{"kp": one.kp, "ki": one.ki, "kd": one.kd} for one in self.table.gains],
            "places": self.places,
            "kept": [self.kept, self.kept_then],
            "ms": [one if math.isfinite(one) else None for one in (self.ms, self.ms_then)],
            "too_wide": [
                {"region": w.region, "kc_factor": w.kc_factor, "share": [w.share, w.share_then]} for w in self.wide
            ],
        }


def _ms(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "that of an unstable loop"


def refinement(
    table: GainTable,
    region_models: Mapping[int, RegionModel],
    t_s: float,
    sample_time_s: float,
    tracker: TrackerSettings,
    limits: DesignLimits | None = None,
) -> Refinement | None:
    """The proposal; None where every region is served, or too little is known.

    Parameters
    ----------
    table : in force, steps along one variable. region_models : what is known, by region. t_s : now. sample_time_s : of
        the controller. limits : of Ms and J, those of a schedule's design where nothing is said.
    """
    wanted = limits or DesignLimits()
    spots = _spots(table, region_models, t_s, sample_time_s, tracker, wanted)
    now = {region: best_of(row) for region, row in spots.items()}
    wide = [region for region, row in spots.items() if now[region].kept < TOO_WIDE * len(row)]
    if not wide:
        return None
    ways = [_interpolated(table, spots, factor) for factor in CALMER] if len(spots) == len(table.regions) else []
    most = max(MS_END, _largest_ms(table, spots))
    ways = [way for way in (*_split(table, spots, now, wide), *ways) if _largest_ms(way.table, spots) <= most]
    if not ways:
        return None
    best = max(ways, key=lambda way: sum(way.kept.values()))
    told = tuple(
        _told(table, region, spots[region], now[region].kept, best.kept[region])
        for region in wide
        if best.kept[region] - now[region].kept >= WORTH * len(spots[region])
    )
    places, kept, then = sum(map(len, spots.values())), sum(one.kept for one in now.values()), sum(best.kept.values())
    if not told or then - kept < WORTH * PLACES:
        return None
    ms = max(spot.ms(now[region].gains) for region, row in spots.items() for spot in row)
    return Refinement(best.table, places, kept, then, ms, _largest_ms(best.table, spots), wanted, told)


def _largest_ms(table: GainTable, spots: Mapping[int, Sequence[Spot]]) -> float:
    """At any known place, by the likeliest process."""
    return max(spot.ms(in_force(table, spot.x)) for row in spots.values() for spot in row)


def in_force(table: GainTable, x: float) -> PidGains:
    """The gains at a place that the loop has come to slowly from below."""
    law = table.regions.law()
    return table.at(choose(law, enter(law, x, 0.0), x, 0.0).region, x)


def _spots(
    table: GainTable,
    region_models: Mapping[int, RegionModel],
    t_s: float,
    sample_time_s: float,
    tracker: TrackerSettings,
    limits: DesignLimits,
) -> dict[int, list[Spot]]:
    """Known places from end to end of every region that has records of its own, and its middle among them."""
    sign, regions = table.gains[0].direction, table.regions
    own = {i: model for i, model in lenders(region_models, sign).items() if model.records >= LEAST_RECORDS}
    through = curves(own, regions, t_s, tracker)
    if not through or len(regions.axes) > 1 or table.lookup is not Lookup.HARD:
        return {}
    behind = {t: sum(k.evidence for model in own.values() for k in model.known if k.log.type is t) for t in through}
    type_ = min(behind, key=lambda t: behind[t])
    found = {}
    for region in own:
        xs = np.linspace(*regions.span(region), PLACES).tolist()
        row = [spot_of(x, _log(through[type_], x, sign, type_), sample_time_s, limits) for x in xs]
        known = [spot for spot in row if spot is not None]
        found.update({region: known} if len(known) >= LEAST_KNOWN and row[PLACES // 2] is not None else {})
    return found


def _log(curve: Curves, x: float, sign: int, type_: ProcessType) -> LogModel:
    mean, p = curve.at((x,))
    return LogModel(mean, proper_covariance(p), sign, type_)


@dataclass(frozen=True, slots=True)
class _Cut:
    """A boundary inside a region, and the sets below and above; a place on it counts on both sides by half."""

    x: float
    below: Best
    above: Best


def _best_cut(row: Sequence[Spot]) -> _Cut:
    """The boundary that serves most places of a region."""
    cuts = []
    for at in range(1, len(row) - 1):
        parts = (best_of(row[: at + 1]), best_of(row[at:]))
        below, above = (Best(part.gains, part.kept - _chance(row[at], part.gains) / 2) for part in parts)
        cuts.append(_Cut(row[at].x, below, above))
    return max(cuts, key=lambda cut: cut.below.kept + cut.above.kept)


def _chance(spot: Spot, gains: PidGains) -> float:
    return spot.chance(math.log(abs(gains.kp)), gains.kp / gains.ki)


@dataclass(frozen=True, slots=True)
class _Way:
    """A schedule, and how many places of each present region it is expected to serve."""

    table: GainTable
    kept: dict[int, float]


def _split(
    table: GainTable, spots: Mapping[int, Sequence[Spot]], now: Mapping[int, Best], wide: Sequence[int]
) -> list[_Way]:
    """The table with a boundary in the regions that are too wide, their sets the best on either side; the others keep
    theirs. Nothing where no boundary is worth it.
    """
    names: list[str] = []
    bounds: list[float] = []
    sets: list[PidGains] = []
    kept = {region: best.kept for region, best in now.items()}
    for region, name in enumerate(table.regions.names):
        bounds.append(table.regions.span(region)[0])
        cut = _best_cut(spots[region]) if region in wide else None
        more = cut.below.kept + cut.above.kept - now[region].kept if cut is not None else 0.0
        low, high = table.regions.span(region)  # the boundary leaves the hysteresis its room on both sides
        room = cut is not None and min(cut.x - low, high - cut.x) >= 2 * table.regions.axes[0].hysteresis
        if cut is None or more < WORTH * len(spots[region]) or not room:
            names, sets = [*names, name], [*sets, table.gains_of(region)]
            continue
        names += [f"{name} lower", f"{name} upper"]
        bounds, sets = [*bounds, cut.x], [*sets, cut.below.gains, cut.above.gains]
        kept[region] += more
    if len(sets) == len(table.gains):
        return []
    return [_Way(_table_of(table, tuple(names), tuple(bounds[1:]), tuple(sets), Lookup.HARD), kept)]


def _interpolated(table: GainTable, spots: Mapping[int, Sequence[Spot]], factor: float) -> _Way:
    """The table with its regions' centres as knots, and the sets of these, a little calmer or not."""
    own = [min(spots[i], key=lambda s: abs(s.x - table.regions.centre(i))).own for i in range(len(table.regions))]
    sets = tuple(PidGains(*(factor * gain for gain in (one.kp, one.ki, one.kd))) for one in own)
    other = _table_of(table, table.regions.names, table.regions.bounds, sets, Lookup.INTERPOLATED)
    return _Way(other, {i: sum(_chance(spot, other.at(i, spot.x)) for spot in row) for i, row in spots.items()})


def _table_of(
    table: GainTable, names: tuple[str, ...], bounds: tuple[float, ...], sets: tuple[PidGains, ...], lookup: Lookup
) -> GainTable:
    """The next revision of a table, with other regions."""
    axis = table.regions.axes[0]
    regions = Regions(
        axis.variable,
        axis.unit,
        names,
        axis.low,
        bounds,
        axis.high,
        axis.hysteresis,
        axis.min_stay_s,
        axis.filter_s,
        axis.signal,
    )
    return GainTable(table.loop, regions, sets, lookup, table.revision + 1)


def _told(table: GainTable, region: int, row: Sequence[Spot], served: float, kept: float) -> TooWide:
    """What speaks for another schedule in one region."""
    asked = [abs(spot.own.kp) for spot in row]
    return TooWide(table.regions.names[region], max(asked) / min(asked), served / len(row), kept / len(row))
