"""Proof and choice: may the region have these gains, and which of the proved sets shall run.

A proposal is put to the guard with what is known of the region (guard/proof.py). Then is weighed what staying, the
proved change and steps on its way are expected to cost, and on which models (choice/expected_cost.py).
"""

import math
from collections.abc import Sequence

from retuner.adaptive.choice.expected_cost import (
    Choice,
    Choosable,
    LoopSettings,
    ModelEvidence,
    Outlook,
    choose,
    outlooks,
)
from retuner.adaptive.guard import GuardSettings, Verdict, prove
from retuner.adaptive.guard.between_knots import worst_between
from retuner.adaptive.guard.request import ChangeRequest, Evidence, Support
from retuner.adaptive.guard.step_size import along
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.kalman import gate
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Agreement, Learned
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.supervision.known_processes import KnownProcesses
from retuner.adaptive.supervision.pipeline_types import Findings, ResponseRecord
from retuner.adaptive.supervision.proposal_from_model import RobustProposal
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.prediction import decay_seen
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import replace
from retuner.schedule.table import GainTable


def change_request(
    proposal: Tuning,
    region: int,
    commissioned: GainTable,
    known: KnownProcesses,
    learned: Learned | None,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that a model supports.

    Parameters
    ----------
    region : index. known : of all regions, that of this one as it is now.
    learned : outcome of the last record; None when none is at hand.
    damping : of the response, None when it did not swing.
    """
    settings, model = known.settings, known.region_models[region]
    contradicting = learned is not None and learned.agreement == Agreement.CONTRADICTS
    return ChangeRequest(
        in_force=known.table.gains_of(region),
        commissioned=commissioned.gains_of(region),
        proposal=proposal,
        models=known.allowed[region],
        sample_time_s=settings.sample_time_s,
        evidence=Evidence(
            records=model.records,
            age_s=max(known.t_s - model.t_s, 0.0),
            innovation=learned.innovation if learned is not None and contradicting else 0.0,
            gate=gate(len(model.log.x), settings.tracker.gate),
            borrowed=model.records == 0,
            settled=model.identifiable,
        ),
        borders=known.borders(region),
        filter_s=settings.filter_s,
        urgent=_urgent(damping, settings),
        locks=settings.locks_of(region),
        units=settings.units,
    )


def unproved_request(
    proposal: Tuning,
    region: int,
    tables: tuple[GainTable, GainTable],
    settings: RetunerSettings,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that no model supports; arguments as above."""
    in_force, commissioned = tables
    evidence = Evidence(records=0, support=Support.PATTERN)
    own = (in_force.gains_of(region), commissioned.gains_of(region))
    return ChangeRequest(
        *own,
        proposal,
        (),
        settings.sample_time_s,
        evidence,
        urgent=_urgent(damping, settings),
        locks=settings.locks_of(region),
        units=settings.units,
    )


def _urgent(damping: float | None, settings: RetunerSettings) -> bool:
    """Whether a response swings on as if it would not end."""
    return damping is not None and damping >= settings.guard.urgent_damping


def choosable(record: ResponseRecord, known: KnownProcesses, gains: PidGains) -> Choosable:
    """A set of the record's region as it would run there, with its Ms on the ways to the neighbours."""
    region, settings = record.region, known.settings
    runs = known.table.with_gains(region, gains).at(region, *record.at)
    if len(known.table.regions) == 1:
        return Choosable(runs)
    process = known.likeliest(region).model()
    worst = worst_between(known.borders(region), process, gains, settings.sample_time_s, settings.filter_s)
    return Choosable(runs, worst.ms / settings.guard.ms_border if worst is not None else 0.0)


def proved(found: Findings, model: RegionModel, wanted: RobustProposal, guard: GuardSettings | None = None) -> Verdict:
    """The guard's word on what the rule gives for a model. guard : its settings, None for those of the loop."""
    return _proved(found, found.record.known_with(model, found.settings), wanted.tuning, guard or found.settings.guard)


def _proved(found: Findings, known: KnownProcesses, tuning: Tuning, guard: GuardSettings) -> Verdict:
    """The guard's word on a tuning for the response's region."""
    record = found.record
    damping = record.pattern.damping if record.pattern is not None else None
    return prove(change_request(tuning, record.region, record.commissioned, known, found.learned, damping), guard)


def lost_on_all(allowed: Sequence[Plausible], gains: PidGains, settings: RetunerSettings) -> bool:
    """Whether a loop is unstable with these gains on every model, of which there is one at least."""
    dt_s, filter_s = settings.sample_time_s, settings.filter_s
    processes = (one.model.seen_by_controller(dt_s).linear() for one in allowed)
    return bool(allowed) and all(math.isinf(sensitivity_peak(process, gains, filter_s)) for process in processes)


def chosen(found: Findings, model: RegionModel, wanted: RobustProposal, verdict: Verdict) -> tuple[Choice, Verdict]:
    """The choice between the gains in force, the proved change and steps on its way; and the proof of the best one."""
    record, settings = found.record, found.settings
    known = record.known_with(model, settings)
    ways = [verdict, *_steps(found, known, wanted, verdict)]
    whole = _proved(found, known, wanted.tuning, settings.guard.whole_step()) if verdict.step < 1.0 else None
    sets = [record.table.gains_of(record.region), *(one.gains for one in ways), whole.gains if whole else None]
    placed = [choosable(record, known, gains) for gains in sets if gains is not None]
    seen, asked = _seen(found, model), 1 + len(ways)
    looked = _looked(found, verdict.allowed, placed, seen)
    way = looked[asked] if len(looked) > asked else None
    choice = choose(looked[:asked], way, seen, settings.choice)
    return choice, ways[choice.best - 1]


def _looked(
    found: Findings, allowed: Sequence[Plausible], sets: Sequence[Choosable], seen: ModelEvidence
) -> list[Outlook]:
    """What each set is expected to do on models; these are less sure where no setpoint step is among the records."""
    settings = found.settings
    loop = LoopSettings(settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    by_setpoint = found.excitation_now.setpoints > 0 or found.joined > 0
    return outlooks(allowed, sets, seen.decay, loop, settings.choice if by_setpoint else settings.choice.by_loads())


def _steps(found: Findings, known: KnownProcesses, wanted: RobustProposal, verdict: Verdict) -> list[Verdict]:
    """Parts of a proved change that are proved as well."""
    now, accepted = found.record.table.gains_of(found.record.region), []
    assert verdict.gains is not None
    for share in PARTS:
        part = replace(wanted.tuning, gains=along(now, verdict.gains, share), tau_c_s=None)
        one = _proved(found, known, part, found.settings.guard)
        if one.accepted:
            notes = (
                *verdict.notes,
                f"{share:.0%} of the proved change, because that is expected to be better than the full change",
            )
            accepted.append(replace(one, step=verdict.step * share, tau_c_s=verdict.tau_c_s, notes=notes))
    return accepted


PARTS = (0.75, 0.5, 0.25)
"""Shares of a proved change that are weighed beside it."""


def _seen(found: Findings, model: RegionModel) -> ModelEvidence:
    """What bears on whether the models are a fiction."""
    record, learned = found.record, found.learned
    assert learned is not None  # after the stage of identification
    return ModelEvidence(
        model.records + int(found.joined > 0),
        found.excitation_before.clear + int(found.clear and not record.response.taken_over),
        len(learned.estimate.load_times_s),
        any(sample.limited for sample in record.own),
        found.unexplained > found.settings.swing.unexplained,
        decay_seen(record.pattern),
    )
