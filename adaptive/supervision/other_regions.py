"""What a response means for the regions where the loop is not.

A region that the loop never entered, or only passed, would keep its gains until a response ended in it. But its process
is known earlier, from responses that passed and from the curves through the other regions. So if a response changes
nothing in its own region, the others are asked, the nearest first, one at a time. Gains that are far from right there,
or over their limit where the region ends, are proved like any change, and go on trial when the loop comes. Gains that
are nearly right wait for responses of their own region.

Nobody has watched that region. So the new gains must be right by the curves and by the table as well
(as_right_as_others). How much a load moves pv there follows from how much it does here (trial/load_variability.py).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.fit.structure import SLOPE, model_at
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.region_model.from_neighbours import borrowed
from retuner.adaptive.region_model.region_curves import centre_of, lenders
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Agreement, TrackerSettings, predicted
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import BETWEEN, Findings, over_limit, tuning_of
from retuner.adaptive.supervision.judge_evidence import prediction_of
from retuner.adaptive.supervision.known_processes import KnownProcesses, change_request
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.load_variability import load_variability, load_variability_there
from retuner.adaptive.trial.posterior_check import costs
from retuner.adaptive.trial.prediction import decay_seen
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup

DOUBTFUL = frozenset({"unconfirmed", "one_record"})  # codes of decisions that doubt what the response has taught
LEAST_LENDERS = 2
"""Regions that must know their process before one that was never entered gets gains: one shows no trend."""


def elsewhere(found: Findings, winner: Outcome) -> Mapping[int, Outcome]:
    """What is due in the nearest of the other regions whose gains are far from right. winner : what follows here."""
    record, learned = found.record, found.learned
    if not found.settings.borrowing.far_off or winner.changes or winner.code in DOUBTFUL:
        return {}
    if record.table.lookup is not Lookup.HARD or learned is None or found.in_use is None:
        return {}
    if learned.agreement not in {Agreement.FIRST, Agreement.AGREES} or found.wanted is None or not found.wanted.ready:
        return {}
    known = {**record.region_models, **found.beside, record.region: found.in_use}
    asked = (*found.question.free, *found.question.away)
    for region in sorted(asked, key=lambda at: record.table.regions.distance(record.region, at)):
        due = _due(found, region, known)
        if due is not None:
            return {region: due}
    return {}


def _due(found: Findings, region: int, known: Mapping[int, RegionModel]) -> Outcome | None:
    """The change that is due in a region by what is known of all; None where its gains are nearly right, or nobody can
    say.
    """
    record, settings, now_s = found.record, found.settings, float(found.record.window.t_s[-1])
    table, model = record.table, _known_of(found, region, known)
    if model is None or not model.identifiable:
        return None
    # one hypothesis more: the table's set is as right there as another one is elsewhere
    more = as_right_as_others(known, region, found.record.commissioned.gains, now_s, settings.tracker)
    model = replace(model, plausible=(*model.plausible, *more))
    asked = KnownProcesses(table, {**known, region: model}, now_s, settings)
    wanted = tuning_of(asked, region, table.gains_of(region))
    if not wanted.ready or not wanted.diagnosis.retune:
        return None
    request = change_request(wanted.tuning, region, record.commissioned, asked, None)
    if request.evidence.borrowed:  # what is lent rests on the records of those that lend
        records = min(one.records for one in known.values() if one.identifiable)
        request = replace(request, evidence=replace(request.evidence, records=records))
    proof = prove(request, settings.guard)
    place = (*centre_of(table.regions, region), 0.0)
    prediction = prediction_of(proof, table, region, (place[0], place[1]), None, settings)
    if prediction is None or proof.gains is None:
        return None
    if BETWEEN not in wanted.diagnosis.evidence and (
        region in found.question.away or not _far_off(found, region, proof.allowed, proof.gains)
    ):
        return None
    by = model.reason if not model.records else "known by responses that passed through"
    return Outcome(
        proof.code,
        f"{by}; {wanted.diagnosis.reason}",
        diagnosis=wanted.diagnosis,
        proposal=wanted.tuning,
        basis=Basis.MODEL,
        proof=proof,
        prediction=replace(prediction, wander=_wander(found, proof)),
    )


def _known_of(found: Findings, region: int, known: Mapping[int, RegionModel]) -> RegionModel | None:
    """What is known of a region: by its own records where they settle it, else along the curves through all."""
    own, settings, record = known.get(region), found.settings, found.record
    if own is not None and own.identifiable:
        return own
    now_s, sign = float(record.window.t_s[-1]), record.in_force.direction
    if own is None and len(lenders(known, sign)) < LEAST_LENDERS:
        return None
    return borrowed(known, region, record.table.regions, now_s, sign, settings.borrowing, settings.tracker, own)


def _far_off(found: Findings, region: int, models: Sequence[Plausible], now: PidGains) -> bool:
    """Whether a region's gains cost far more than others and these cost less on every allowed model, or they are over
    their limit on each of them.
    """
    settings, gains = found.settings, found.record.table.gains_of(region)
    loop = (settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    cost = costs(models, gains, now, *loop)
    if 0 < cost[0] < settings.borrowing.far_off and max(cost) < 1:
        return True
    return over_limit(models, gains, settings, settings.robust.believed, settings.cause.ms_high)


def _wander(found: Findings, proof: Proof) -> float:
    """How much a load that never rests will move the error there, with the gains that are due."""
    record, settings, model = found.record, found.settings, found.in_use
    seen, _ = load_variability(record.samples)
    swung = decay_seen(record.pattern)
    if not seen or model is None or proof.gains is None or (swung or 0.0) > settings.trial.harmless_decay:
        return 0.0
    here = predicted(model, float(record.window.t_s[-1]), settings.tracker).model()
    sampled = (each.seen_by_controller(settings.sample_time_s).linear() for each in (here, proof.allowed[0].model))
    more = (settings.setpoint_weight, settings.filter_s)
    loops = [
        ClosedLoop(each, gains, *more) for each, gains in zip(sampled, (record.in_force, proof.gains), strict=True)
    ]
    return load_variability_there(seen, record.window.noise_std, loops[0], loops[1])


# What the table itself says of a region that nobody has watched: its set is as right there as others are.
#
#     process of region r = process of region i,  its gain times Kc_i / Kc_r,  its times times tau_I_r / tau_I_i
#
# On it the set of r does exactly what that of i does in i, in its own time: a hypothesis a region i that knows its
# process. Curves through the regions (region_curves.py) do not know of a jump between them. Whoever drew up the table
# may have, or may have been mistaken in one region only: where some of its sets turned out right, this one may be. So
# gains for a region that nobody has watched must be right on these processes too. Where all known sets were wrong in
# the same way, they agree with the curves.
#
# The sets are those of the table as it was at first: what has been tuned since says nothing of the others.


def as_right_as_others(
    region_models: Mapping[int, RegionModel],
    region: int,
    first: Sequence[PidGains],
    t_s: float,
    tracker: TrackerSettings,
) -> tuple[Plausible, ...]:
    """The processes of a region with which its set would be as right as the sets of the others are, one for each that
    knows its own; none where a set has no proportional gain.

    region_models : by region. region : the one that nobody has watched. first : the table's sets as they were at first.
    t_s : now.
    """
    own, found = first[region], []
    for other, model in lenders(region_models, own.direction).items():
        theirs = first[other]
        if other == region or not own.kp or not theirs.kp:
            continue
        log = predicted(model, t_s, tracker)
        slower = math.log(1.0 if not theirs.ki or not own.ki else (own.kp / own.ki) / (theirs.kp / theirs.ki))
        x = log.x + slower
        x[SLOPE] = log.x[SLOPE] + math.log(theirs.kp / own.kp) - slower
        found.append(Plausible(model_at(log.type, x, log.sign), 0.0))
    return tuple(found)
