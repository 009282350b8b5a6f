"""A schedule that the regions' own records ask for: other regions, or more of them, than the table has.

The curves through what is known of the regions (along.py) are put to the same question as those of a whole record
(schedule_design/places.py, cover.py): the fewest sets, as steps or interpolated, with which every place that is known
keeps Ms and J on all models still allowed. It is proposed where every region is known, and the table in force does not
keep them everywhere, and the other would. Nothing is changed by it: a person takes it up, or leaves it.

Pure: a table and region models in, a proposal out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.along import curves, lenders
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.schedule_design.cover import Layout, knots, steps
from retuner.adaptive.schedule_design.places import DesignLimits, Place, place_of
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions, choose, enter
from retuner.schedule.table import GainTable, Lookup

PLACES = 13
MOST_SETS = 8
LEAST_RECORDS = 3
"""Of every region that counts; two such are needed."""
LEAST_KNOWN = 0.6
"""Share of the places that must be known."""
ROOM = 0.4
"""Hysteresis at the most, as a share of the narrowest region."""


@dataclass(frozen=True, slots=True)
class Refinement:
    """A proposal with what it rests on.

    table : as proposed. places : that are known. kept, kept_then : of these, where the limits are kept by the table in
    force and by the other. ms, ms_then : largest Ms at any of them on the models still allowed. limits : of Ms and J.
    """

    table: GainTable
    places: int
    kept: int
    kept_then: int
    ms: float
    ms_then: float
    limits: DesignLimits

    @property
    def sentence(self) -> str:
        """The proposal in a sentence or two."""
        axis = self.table.regions.axes[0]
        where = ", ".join(f"{self.table.regions.centre(i):.4g}" for i in range(len(self.table.gains)))
        what = "steps" if self.table.lookup is Lookup.HARD else "interpolated sets"
        many = f"{len(self.table.gains)} {what} about {axis.label} = {where} {axis.unit}".rstrip()
        return (
            f"Another schedule serves more places: {many}. It keeps Ms {self.limits.ms:g} and J {self.limits.j:g} at "
            f"{self.kept_then} of {self.places} known places, the present one at {self.kept}. "
            f"The largest Ms is {_ms(self.ms_then)} instead of {_ms(self.ms)}."
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
    """The proposal, None where the table does as well, or too little is known.

    Parameters
    ----------
    table : in force, along one variable. region_models : what is known, by region. t_s : now. sample_time_s : of the
        controller. limits : of Ms and J, those of a schedule's design where nothing is said.
    """
    wanted = limits or DesignLimits()
    places = _places(table, region_models, t_s, sample_time_s, tracker, wanted)
    known = [place for place in places if place.known]
    if len(known) < max(LEAST_KNOWN * len(places), 1):
        return None
    now = [in_force(table, place.x) for place in known]
    kept = sum(place.keeps(gains, wanted) for place, gains in zip(known, now, strict=True))
    if kept == len(known):
        return None
    layout = _fewest(places, wanted)
    if layout is None:
        return None
    other = _table_of(table, layout)
    then = [in_force(other, place.x) for place in known]
    kept_then = sum(place.keeps(gains, wanted) for place, gains in zip(known, then, strict=True))
    if kept_then <= kept:
        return None
    ms, ms_then = (
        max(place.judged(gains).ms_worst for place, gains in zip(known, sets, strict=True)) for sets in (now, then)
    )
    return Refinement(other, len(known), kept, kept_then, ms, ms_then, wanted)


def _fewest(places: Sequence[Place], limits: DesignLimits) -> Layout | None:
    """The fewest sets; steps where both need as many, for they are the simpler to judge."""
    able = [found(places, limits, MOST_SETS) for found in (steps, knots)]
    return min((one for one in able if one is not None), key=lambda one: len(one.sets), default=None)


def in_force(table: GainTable, x: float) -> PidGains:
    """The gains at a place that the loop has come to slowly from below."""
    law = table.regions.law()
    return table.at(choose(law, enter(law, x, 0.0), x, 0.0).region, x)


def _places(
    table: GainTable,
    region_models: Mapping[int, RegionModel],
    t_s: float,
    sample_time_s: float,
    tracker: TrackerSettings,
    limits: DesignLimits,
) -> Sequence[Place]:
    """Places from the lowest to the highest region that knows its process, with the process there."""
    sign, regions = table.gains[0].direction, table.regions
    own = {i: model for i, model in lenders(region_models, sign).items() if model.records >= LEAST_RECORDS}
    if len(own) < max(len(regions), 2) or len(regions.axes) > 1:  # what is not known must keep its own set
        return ()
    curve = curves(own, regions, t_s, tracker).get(ProcessType.FOPDT)
    if curve is None:
        return ()
    grid = np.linspace(regions.span(min(own))[0], regions.span(max(own))[1], PLACES).tolist()
    return tuple(place_of(x, *curve.at((x,)), sign, sample_time_s, limits) for x in grid)


def _table_of(table: GainTable, layout: Layout) -> GainTable:
    """The layout as the next revision of a table."""
    axis, edges, n = table.regions.axes[0], layout.edges, len(layout.sets)
    narrowest = min(b - a for a, b in pairwise(edges))
    regions = Regions(
        axis.variable,
        axis.unit,
        tuple(f"part {i + 1}" for i in range(n)),
        edges[0],
        edges[1:-1],
        edges[-1],
        min(axis.hysteresis, ROOM * narrowest),
        axis.min_stay_s,
        axis.filter_s,
        axis.signal,
    )
    return GainTable(table.loop, regions, layout.sets, layout.lookup, table.revision + 1)
