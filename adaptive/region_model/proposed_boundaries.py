"""Another schedule, where a region is too wide for one set: a boundary inside it, or sets that are interpolated.

The curves through what is known of the regions (region_curves.py) say what the process is at places from end to end of
every region, and how well that is known: places as the design of a schedule has them (schedule_design/places.py), at
which a set of gains keeps the limits or not. Whether the sets in force are the best ones is not asked here: that is
seen to from response to response. A region with the set that serves it best is weighed against the same region with a
boundary in it and the best set on either side, and against means of the sets at the centres. What is not known well
counts for none of them, so doubt proposes nothing. Nothing is changed by it: a person takes it up with `retuner
approve`, or leaves it. Whether a region holds two processes, or two regions one, is asked by split_or_merge.py.

Pure: a table and region models in, a proposal out.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from retuner.adaptive.fit.structure import model_at
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.region_curves import curves, lenders
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.split_or_merge import features
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.schedule_choice.boundaries_of_one_variable import CALMER
from retuner.adaptive.schedule_design.places import LEAST_STD, OUT, DesignLimits, Place, place_on
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_value, plain_values
from retuner.schedule.regions import Regions, choose, enter
from retuner.schedule.table import GainTable, Lookup


@dataclass(frozen=True, slots=True)
class Best:
    """The set that serves some places best: at how many of them it keeps the limits."""

    gains: PidGains
    kept: float


def place_by(x: float, log: LogModel, sample_time_s: float, limits: DesignLimits) -> Place | None:
    """The place x by what is known of the process there; None where that is not known well enough."""
    ln_std = math.hypot(math.sqrt(float(features(log, sample_time_s).p[0, 0])), LEAST_STD)
    if ln_std > limits.std:
        return None
    values, vectors = np.linalg.eigh(log.p)
    ways = OUT * vectors * np.sqrt(np.maximum(values, 0.0))
    allowed = tuple(model_at(log.type, log.x + side * way, log.sign) for way in ways.T for side in (1.0, -1.0))
    found = place_on(x, log.model(), allowed, (), ln_std, sample_time_s, limits)
    return found if found.known else None


def best_of(places: Sequence[Place], limits: DesignLimits) -> Best:
    """The set that keeps the limits at most of these places, of their own sets and calmer ones."""
    tried = (place.own.times(factor) for place in places for factor in CALMER)
    return max(
        (Best(one, sum(_keeps(place, one, limits) for place in places)) for one in tried), key=lambda best: best.kept
    )


def _keeps(place: Place, gains: PidGains, limits: DesignLimits) -> bool:
    """Whether a set keeps the limits on the likeliest process; what else it may be makes a place's own set calmer."""
    found = place.judged(gains)
    return found.ms <= max(limits.ms, place.judged(place.own).ms) and found.j <= limits.j


MS_END = 2.1  # largest Ms where a set ends, the guard's own limit at a boundary (guard/guard_settings.py)
PLACES = 5  # places of a region, from end to end; those between the ends are where a boundary is tried
LEAST_RECORDS = 3  # records that every region must have
LEAST_KNOWN = 3  # places of a region that must be known; the others demand nothing
TOO_WIDE = 0.6  # share of a region's places that its best set must serve, or the region is too wide
WORTH = 0.15  # share of a region's places by which another schedule must serve more of them, in expectation


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
        ms, then = (f"{x:.2f}" if math.isfinite(x) else "that of an unstable loop" for x in (self.ms, self.ms_then))
        return " ".join(
            [
                *(one.sentence for one in self.wide),
                f"Another schedule serves more places: {what} {axis.unit}".rstrip() + ".",
                f"Ms {self.limits.ms:g} and {self.limits.j:g} times SIMC's IAE are then expected to hold at "
                f"{self.kept_then:g} of {self.places} places. "
                f"With the best set in each region as it is they hold at {self.kept:g}. "
                f"The largest Ms is then {then} instead of {ms}.",
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
            **plain_values(self.table, "gains"),
            "places": self.places,
            "kept": [self.kept, self.kept_then],
            "ms": plain_value((self.ms, self.ms_then)),
            "too_wide": [
                {"region": w.region, "kc_factor": w.kc_factor, "share": [w.share, w.share_then]} for w in self.wide
            ],
        }


def proposed_boundaries(
    table: GainTable,
    region_models: Mapping[int, RegionModel],
    t_s: float,
    sample_time_s: float,
    tracker: TrackerSettings,
) -> Refinement | None:
    """The proposal; None where every region is served, or too little is known.

    table : in force, steps along one variable. region_models : what is known, by region. t_s : now. sample_time_s : of
        the controller.
    """
    wanted = DesignLimits()
    sign, regions = table.gains[0].direction, table.regions
    own = {i: model for i, model in lenders(region_models, sign).items() if model.records >= LEAST_RECORDS}
    through = curves(own, regions, t_s, tracker)
    places: dict[int, list[Place]] = {}  # from end to end of every region with records of its own, its middle too
    if through and len(regions.axes) == 1 and table.lookup is Lookup.HARD:
        behind = {t: sum(k.evidence for model in own.values() for k in model.known if k.log.type is t) for t in through}
        type_ = min(behind, key=lambda t: behind[t])
        for region in own:
            xs = np.linspace(*regions.span(region), PLACES).tolist()
            row = [place_by(x, through[type_].log((x,), sign, type_), sample_time_s, wanted) for x in xs]
            known = [place for place in row if place is not None]
            if len(known) >= LEAST_KNOWN and row[PLACES // 2] is not None:
                places[region] = known
    now = {region: best_of(row, wanted) for region, row in places.items()}
    wide = [region for region, row in places.items() if now[region].kept <= TOO_WIDE * len(row)]
    if not wide:
        return None
    whole = len(places) == len(table.regions)
    ways = [_interpolated(table, places, factor, wanted) for factor in CALMER] if whole else []
    most = max(MS_END, _largest_ms(table, places))
    ways = [*_with_boundaries(table, places, now, wide, wanted), *ways]
    ways = [way for way in ways if _largest_ms(way[0], places) <= most]
    if not ways:
        return None
    best, served = max(ways, key=lambda way: (sum(way[1].values()), -_largest_ms(way[0], places)))
    told = []
    for region in wide:
        n, before, after = len(places[region]), now[region].kept, served[region]
        if after - before >= WORTH * n:
            asked = [abs(place.own.kp) for place in places[region]]
            told.append(TooWide(regions.names[region], max(asked) / min(asked), before / n, after / n))
    count, kept, then = sum(map(len, places.values())), sum(one.kept for one in now.values()), sum(served.values())
    if not told or then - kept < WORTH * PLACES:
        return None
    ms = max(sensitivity_peak(p.processes[0], now[region].gains) for region, row in places.items() for p in row)
    return Refinement(best, count, kept, then, ms, _largest_ms(best, places), wanted, tuple(told))


def _largest_ms(table: GainTable, places: Mapping[int, Sequence[Place]]) -> float:
    return max(sensitivity_peak(p.processes[0], in_force(table, p.x)) for row in places.values() for p in row)


def in_force(table: GainTable, x: float) -> PidGains:
    """The gains at a place that the loop has come to slowly from below."""
    law = table.regions.law()
    return table.at(choose(law, enter(law, x, 0.0), x, 0.0).region, x)


Way = tuple[GainTable, dict[int, float]]  # a schedule, and how many places of each present region it should serve


def _with_boundaries(
    table: GainTable,
    places: Mapping[int, Sequence[Place]],
    now: Mapping[int, Best],
    wide: Sequence[int],
    limits: DesignLimits,
) -> list[Way]:
    """The table with a boundary in the regions that are too wide, their sets the best on either side; the others keep
    theirs. Nothing where no boundary is worth it.
    """
    names: list[str] = []
    bounds: list[float] = []
    sets: list[PidGains] = []
    kept = {region: best.kept for region, best in now.items()}
    for region, name in enumerate(table.regions.names):
        low, high = table.regions.span(region)
        bounds.append(low)
        if region in wide:
            # The boundary that serves most places; a place on it counts on both sides by half
            row, cuts = places[region], []
            for at in range(1, len(row) - 1):
                parts = (best_of(row[: at + 1], limits), best_of(row[at:], limits))
                below, above = (Best(part.gains, part.kept - _keeps(row[at], part.gains, limits) / 2) for part in parts)
                cuts.append((row[at].x, below, above))
            x, below, above = max(cuts, key=lambda cut: cut[1].kept + cut[2].kept)
            more = below.kept + above.kept - now[region].kept
            room = min(x - low, high - x) >= 2 * table.regions.axes[0].hysteresis  # on both sides of the boundary
            if room and more >= WORTH * len(places[region]):
                names += [f"{name} lower", f"{name} upper"]
                bounds, sets = [*bounds, x], [*sets, below.gains, above.gains]
                kept[region] += more
                continue
        names, sets = [*names, name], [*sets, table.gains_of(region)]
    if len(sets) == len(table.gains):
        return []
    return [(_table_of(table, tuple(names), tuple(bounds[1:]), tuple(sets), Lookup.HARD), kept)]


def _interpolated(table: GainTable, places: Mapping[int, Sequence[Place]], factor: float, limits: DesignLimits) -> Way:
    """The table with its regions' centres as knots, and the sets of these, a little calmer or not."""
    own = [min(places[i], key=lambda p: abs(p.x - table.regions.centre(i))).own for i in range(len(table.regions))]
    sets = tuple(one.times(factor) for one in own)
    other = _table_of(table, table.regions.names, table.regions.bounds, sets, Lookup.INTERPOLATED)
    return other, {i: sum(_keeps(p, other.at(i, p.x), limits) for p in row) for i, row in places.items()}


def _table_of(
    table: GainTable, names: tuple[str, ...], bounds: tuple[float, ...], sets: tuple[PidGains, ...], lookup: Lookup
) -> GainTable:
    axis = table.regions.axes[0]
    kept = axis.hysteresis, axis.min_stay_s, axis.filter_s, axis.signal
    regions = Regions(axis.variable, axis.unit, names, axis.low, bounds, axis.high, *kept)
    return GainTable(table.loop, regions, sets, lookup, table.revision + 1)
