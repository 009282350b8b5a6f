"""What the record of a response teaches of its region's process, with what is known of it, or of its neighbours.

A response by itself, one that crossed a boundary, or setpoint steps to and fro. The fit is region_model/update.py's.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from retuner.adaptive.region_model.boundary_crossing import (
    Crossing,
    fitted_crossing,
    taught_beside,
    update_across,
    ways_of,
)
from retuner.adaptive.region_model.from_neighbours import as_wide_as_known, borrowed
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.sequences import update_by_sequences
from retuner.adaptive.region_model.update import Agreement, Learned, on_the_way, update_region_model
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.adaptive.supervision.question import ResponseRecord
from retuner.adaptive.supervision.retuner_settings import RetunerSettings

SMALL_STEP = 0.05  # share of pv's span up to which one whole step is enough: as large as bumps are made
WHOLE = 2.01  # A whole step of a bump to and fro over the bump, rounding included


def learned_by_itself(
    record: ResponseRecord, settings: RetunerSettings, beside: Mapping[int, RegionModel]
) -> tuple[Learned, Mapping[int, RegionModel]]:
    """What one response as it came teaches its region, and the other regions on its way. beside : these, as before.

    The farther it went, the less one linear model of it says of the region. One that went far is fitted in motion
    first. Where that does not agree with what is known, or does not settle it, it is judged as any other: the process
    may have changed in time.
    """
    regions, sign, tracker = record.table.regions, record.in_force.direction, settings.tracker
    lent = regions, float(record.window.t_s[-1]), sign, settings.borrowing, tracker
    known = record.region_models.get(record.region) or borrowed(record.region_models, record.region, *lent)
    if record.crossed or record.moved:
        ways = ways_of(regions, list(record.samples)[-len(record.window.t_s) :])
        ran = record.response.t_start_s, record.in_force, regions, record.region_models
        crossing = Crossing(record.window, ways, *ran, tracker, settings.fit)
        shown = fitted_crossing(crossing)
        beside = taught_beside(crossing, shown, record.region)
        learned = update_across(crossing, shown, record.region, known)
        settled = learned.region_model is not None and learned.region_model.identifiable
        if record.crossed or (settled and learned.agreement in {Agreement.FIRST, Agreement.AGREES}):
            return learned, beside
    tracker = on_the_way(tracker, record.share)
    learned = update_region_model(known, record.window, record.in_force, tracker, settings.fit, record.at)
    return as_wide_as_known(learned) if record.share else learned, beside


def learned_by_sequences(record: ResponseRecord, settings: RetunerSettings, steps: SetpointSteps) -> Learned | None:
    """What setpoint steps to and fro teach by what is known of the setpoint alone."""
    known = record.region_models.get(record.region)
    sequences = (*(known.sequences if known is not None else ()), steps)
    law, sign = (settings.setpoint_weight, settings.filter_s), record.in_force.direction
    return update_by_sequences(known, sequences, sign, settings.tracker, settings.fit, law, record.at)


def beside_sequences(record: ResponseRecord, settings: RetunerSettings, learned: Learned) -> Learned:
    """What is learned, where what is known rests on steps to and fro: no load may add to these, and no small step by
    itself.

    They are made where loads never rest, and one response shows such a load as much as its process.
    """
    before = record.region_models.get(record.region)
    if before is None or not before.sequences:
        return learned
    moved = float(np.ptp(record.window.sp))
    if not record.response.sp_changed or moved <= WHOLE * SMALL_STEP * settings.pv_span:
        return replace(learned, region_model=before, agreement=Agreement.SILENT)
    now = learned.region_model
    return learned if now is None else replace(learned, region_model=replace(now, sequences=before.sequences))
