"""Another schedule at the end of a tour: is it proposed where a region is too wide, and what would it bring?

The truth is asked as the proposal was worked out (adaptive/region_model/spots.py), but of the linearised process: of
PLACES places of a region, how many the best single set keeps in spec. A region is too wide where these are fewer than
TOO_WIDE of them. What a proposal is worth is how many the best sets in its regions, or at its knots, keep in spec; what
its own sets keep, worked out on what was known, is counted as well.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from schedules.subject import Subject

from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.region_model.refinement import PLACES, TOO_WIDE, Refinement, in_force
from retuner.adaptive.region_model.spots import Spot, best_of, spot_of
from retuner.adaptive.schedule_design.places import DesignLimits
from retuner.adaptive.supervision.retuner import Retuner
from retuner.decisions.proposed_schedule import refined
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable, Lookup

Row = dict[str, Any]
SURE = 1e-4
"""Variance of the logarithms of what is true."""
MOST_LAGS = 2


def proposed(subject: Subject, regions: Regions, retuner: Retuner) -> Row:
    """What is proposed in the end, and what is true of it; by region. Empty for plants of more lags than two."""
    truth = [_row(subject, regions, region) for region in range(len(regions))]
    if not all(len(row) == PLACES for row in truth):
        return {}
    found = refined(retuner)
    named = {one.region for one in found.wide} if found is not None else set()
    return {
        "too_wide": [best_of(row).kept < TOO_WIDE * PLACES for row in truth],
        "proposed": [name in named for name in regions.names],
        "sentence": found.sentence if found is not None else "",
        "served": _served(truth, retuner.table, found),
    }


def _served(truth: Sequence[Sequence[Spot]], table: GainTable, found: Refinement | None) -> Row:
    """Places in spec with what runs, with the best set in each region, and with the proposal; by region."""
    tables = {"now": table} if found is None else {"now": table, "then": found.table}
    counted = {name: [sum(_is_good(spot, one) for spot in row) for row in truth] for name, one in tables.items()}
    best = [best_of(row).kept for row in truth]
    return {**counted, "best": best, "best_then": best if found is None else _at_its_best(truth, found.table)}


def _at_its_best(truth: Sequence[Sequence[Spot]], table: GainTable) -> list[float]:
    """Places in spec by present regions, with the best sets that the proposed regions can have."""
    regions = table.regions
    if table.lookup is Lookup.INTERPOLATED:
        ideal = replace(table, gains=tuple(row[PLACES // 2].own for row in truth))
        return [float(sum(_is_good(spot, ideal) for spot in row)) for row in truth]
    found = []
    for row in truth:
        parts: dict[int, list[Spot]] = {}
        for spot in row:  # a boundary belongs to the region above it, the end of a region to this one
            parts.setdefault(sum(spot.x >= bound for bound in regions.bounds if bound < row[-1].x), []).append(spot)
        found.append(sum(best_of(part).kept for part in parts.values()))
    return found


def _is_good(spot: Spot, table: GainTable) -> bool:
    gains = in_force(table, spot.x)
    return spot.chance(float(np.log(abs(gains.kp))), gains.kp / gains.ki) > 1 / 2


def _row(subject: Subject, regions: Regions, region: int) -> list[Spot]:
    """The true places of a region; fewer where they are of more lags than a model has."""
    found = [_spot(subject, float(x)) for x in np.linspace(*regions.span(region), PLACES)]
    return [spot for spot in found if spot is not None]


def _spot(subject: Subject, x: float) -> Spot | None:
    place = min(max(x, subject.low), subject.high)
    process = subject.local(place)
    lags = sorted(process.lags_s, reverse=True)
    if not 1 <= len(lags) <= MOST_LAGS or process.integrators or process.quadratics or process.leads_s:
        return None
    kind = ProcessType.SOPDT if len(lags) > 1 else ProcessType.FOPDT
    ln = parameters_of(ProcessModel(kind, process.k, lags[0], sum(lags[1:]), process.theta_s))
    log = LogModel(ln, SURE * np.eye(len(ln)), 1 if process.k > 0 else -1, kind)
    return spot_of(place, log, subject.dt_s, DesignLimits())


def told(rows: Sequence[Row]) -> str:
    """How often it was proposed, rightly and wrongly, and what it would bring, in words."""
    asked = [row["proposal"] for row in rows if row.get("proposal")]
    if not asked:
        return "no proposals asked"
    pairs = [pair for one in asked for pair in zip(one["too_wide"], one["proposed"], strict=True)]
    wide, others = ([named for true, named in pairs if true is is_wide] for is_wide in (True, False))
    made = [one["served"] for one in asked if one["sentence"]]
    names = ("now", "then", "best", "best_then")
    now, then, best, ideal = (sum(sum(served[name]) for served in made) for name in names)
    places = sum(PLACES * len(served["now"]) for served in made)
    return (
        f"too wide for one set {sum(wide)} of {len(wide)} regions told, {sum(others)} of {len(others)} others; where "
        f"another schedule is proposed: of {places} places in spec {now}, with its sets {then}; "
        f"with the best sets in the regions {best:.0f}, in the proposed ones {ideal:.0f}"
    )
