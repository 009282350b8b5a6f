"""What the record of a response teaches of its region's process, with what is known of it, or of its neighbours.

A response by itself, one that crossed a border, or setpoint steps to and fro. The fit is region_model/update.py's.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from retuner.adaptive.explanations.unstable_pole import FEWEST_ROWS, MOST_LEAD, RUNAWAYS, UnstablePole, unstable_pole
from retuner.adaptive.explanations.wandering_load import MOST_SAMPLES
from retuner.adaptive.identification.estimate import Alternative, LogModel, ModelEstimate
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.boundary_crossing import (
    Crossing,
    fitted_crossing,
    taught_beside,
    update_across,
    ways_of,
)
from retuner.adaptive.region_model.from_neighbours import as_wide_as_known, borrowed, spread
from retuner.adaptive.region_model.kalman import gate, update
from retuner.adaptive.region_model.region_model import RegionModel, StructureModel
from retuner.adaptive.region_model.sequences import update_by_sequences
from retuner.adaptive.region_model.update import Agreement, Learned, on_the_way, predicted, update_region_model
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.adaptive.supervision.question import ResponseRecord
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.table import Lookup

SAMPLES_BEFORE_STEP = 5  # samples before a setpoint step that are looked at with it
MOST_DEAD = 0.8  # dead time and lag over the time in which it grows by e; none is held from 1 (De Paor & O'Malley 1989)
KNOWN_TO_RUN_AWAY = 0.97  # probability of that before a record, where records have shown it


def learned_of_runaway(record: ResponseRecord, settings: RetunerSettings) -> Learned | None:
    """What the last samples show of a process that runs away by itself; None where they show none, and none is known.
    Without a region model where that is no more than likely.

    Such a process takes the place of all others: their integrator in place of its pole calls less gain safer. Further
    samples are one more record of it, or show that it has changed.
    """
    known, tracker, asked = record.region_models.get(record.region), settings.tracker, settings.book
    before = known if known is not None and known.runs_away else None
    window = _last_samples(record, record.entered_s if before is None else max(record.entered_s, before.t_s))
    if window is None:
        return None if before is None else _silent(before)
    shown = unstable_pole(window, record.in_force.direction, 0.0 if before is None else -MOST_LEAD)
    likely = 0.0 if shown is None else shown.probability(RUNAWAYS)
    if shown is None or likely < (asked.bad_share if before is None else asked.sure_odds):
        gone = shown is not None and shown.probability(KNOWN_TO_RUN_AWAY) <= 1.0 - asked.more_odds
        return None if before is None or gone else _silent(before)
    now_s, estimate = float(record.window.t_s[-1]), _estimate(shown, record, settings)
    if likely < asked.sure_odds or not estimate.plausible:
        return Learned(None, estimate, Agreement.SILENT, 0.0) if before is None else _silent(before)
    log, records, told, innovation = estimate.log, 1, Agreement.FIRST, 0.0
    if before is not None:
        innovation, posterior = update(predicted(before, now_s, tracker), estimate)
        told = Agreement.AGREES if innovation <= gate(len(log.x), tracker.gate) else Agreement.CHANGED
        log, records = (posterior, before.records + 1) if told is Agreement.AGREES else (log, 1)
    model = RegionModel((StructureModel(log, 0.0),), records, now_s, plausible=_held(log, record, settings))
    return Learned(model, estimate, told, innovation)


def _estimate(shown: UnstablePole, record: ResponseRecord, settings: RetunerSettings) -> ModelEstimate:
    """It as the estimate of a record."""
    log, noise, rows = shown.log, math.sqrt(shown.at.variance), len(shown.record.rows.pv)
    root = np.linalg.cholesky(np.linalg.inv(log.p)).T
    same = Alternative(log, rows * math.log(noise**2), root, root @ log.x, rows)
    return ModelEstimate(True, "", (), noise, noise, (same,), plausible=_held(log, record, settings))


def _held(log: LogModel, record: ResponseRecord, settings: RetunerSettings) -> tuple[Plausible, ...]:
    """The models at both ends of every axis of the covariance, the one in the middle first: those that the gains in
    force hold. None where these do not hold it, or its dead time leaves nothing to better.
    """
    every = spread(log)
    seen = [one.model.seen_by_controller(settings.sample_time_s) for one in every]
    held = [
        one.theta_s + one.tau2_s < MOST_DEAD * one.tau1_s
        and math.isfinite(sensitivity_peak(one.linear(), record.in_force, settings.filter_s))
        for one in seen
    ]
    return tuple(one for one, stays in zip(every, held, strict=True) if stays) if held[0] else ()


def _silent(known: RegionModel) -> Learned:
    """What is known, of a record that says nothing of it."""
    log, size = known.log, len(known.log.x)
    same = Alternative(log, 0.0, np.zeros((size, size)), np.zeros(size), 1)
    return Learned(known, ModelEstimate(True, "", (), 0.0, 1.0, (same,)), Agreement.SILENT, 0.0)


def _last_samples(record: ResponseRecord, since_s: float) -> Window | None:
    """The last samples in the region, as many as are compared one by one, and back to the last setpoint step at least;
    None where they are few. since_s : up to which samples have told before; those before co stood at a limit are none.
    """
    since_s = max([since_s, *(s.t_s for s in record.samples if s.limited)])
    kept = [s for s in record.samples if s.t_s > since_s]
    steps = [i for i in range(1, len(kept) - FEWEST_ROWS) if kept[i].sp != kept[i - 1].sp]
    first = min(len(kept) - MOST_SAMPLES, steps[-1] - SAMPLES_BEFORE_STEP if steps else len(kept))
    own = kept[max(first, 0) :]
    return Window.of(own) if record.table.lookup is Lookup.HARD and len(own) >= FEWEST_ROWS else None


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
    known = record.region_models.get(record.region) or _from_neighbours(record, settings)
    if record.crossed or record.moved:
        learned, beside = _across(record, settings, known)
        settled = learned.region_model is not None and learned.region_model.identifiable
        if record.crossed or (settled and learned.agreement in {Agreement.FIRST, Agreement.AGREES}):
            return learned, beside
    tracker = on_the_way(settings.tracker, record.share)
    learned = update_region_model(known, record.window, record.in_force, tracker, settings.fit, record.at)
    return as_wide_as_known(learned) if record.share else learned, beside


def _across(
    record: ResponseRecord, settings: RetunerSettings, known: RegionModel | None
) -> tuple[Learned, Mapping[int, RegionModel]]:
    """What a response teaches the region in which it ended, and those that it came through."""
    crossing = Crossing(
        record.window,
        ways_of(record.table.regions, list(record.samples)[-len(record.window.t_s) :]),
        record.response.t_start_s,
        record.in_force,
        record.table.regions,
        record.region_models,
        settings.tracker,
        settings.fit,
    )
    shown = fitted_crossing(crossing)
    beside = taught_beside(crossing, shown, record.region)
    return update_across(crossing, shown, record.region, known), beside


def _from_neighbours(record: ResponseRecord, settings: RetunerSettings) -> RegionModel | None:
    """What the neighbours' models say of a region without a record."""
    now, sign = float(record.window.t_s[-1]), record.in_force.direction
    regions = record.table.regions
    return borrowed(record.region_models, record.region, regions, now, sign, settings.borrowing, settings.tracker)


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
