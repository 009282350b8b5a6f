"""What is known of the processes of all regions where their sets run, what settings follow from it, and the question on
these that is put to the guard.

The proposal is the robust one (robust_simc.py) on the models that the records still allow, on line as off line. A
region whose process is not known well enough gets none, with one exception: a loop that is over its Ms limit on every
model that is still allowed is given less of everything without waiting for a better record. Less is asked for where
all models ask for it that fit as well as the best: a dead time may be too short to be seen (identification/bound.py).
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis, over_words, tuning_cause, with_second_lag
from retuner.adaptive.diagnosis.second_opinion import SWINGING
from retuner.adaptive.guard.both_sides_of_border import borders_of, eased, likeliest_between, mixed, worst_between
from retuner.adaptive.guard.model_set import allowed
from retuner.adaptive.guard.request import ChangeRequest, Evidence, NeighbourBorder, Support
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import believed, robust_simc_on
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.region_model.at_knots import at_knots
from retuner.adaptive.region_model.from_neighbours import borrowed
from retuner.adaptive.region_model.kalman import gate
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import SECONDS_PER_DAY, Agreement, Learned, predicted
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.table import GainTable, Lookup

HALF = 0.5  # weight of a neighbour half way to it


@dataclass(frozen=True)
class KnownProcesses:
    """What is known of the processes where the regions' own sets run, worked out once a question.

    table : in force. region_models : by region, from records. t_s : now, s.
    """

    table: GainTable
    region_models: Mapping[int, RegionModel]
    t_s: float
    settings: RetunerSettings

    @cached_property
    def where_gains_run(self) -> Mapping[int, RegionModel]:
        """The models there: in an interpolated table at the knots. Of every region, by what the others lend where
        nothing is known of it itself.
        """
        regions, sign, settings = self.table.regions, self.table.gains[0].direction, self.settings
        hard, models = self.table.lookup is Lookup.HARD, self.region_models
        own = dict(models) if hard else at_knots(models, regions, self.t_s, settings.tracker)
        found = dict(own)
        for region in range(len(regions)):
            if region not in found:
                lent = borrowed(own, region, regions, self.t_s, sign, settings.borrowing, settings.tracker)
                found.update({} if lent is None else {region: lent})
        return found

    @cached_property
    def allowed(self) -> Mapping[int, tuple[Plausible, ...]]:
        """The models that are still allowed there, by region.

        A step ends at its border: of what is only lent beyond it, the likeliest model is asked. A mean of two sets runs
        all the way, and is asked of all.
        """
        found = {}
        for region, model in self.where_gains_run.items():
            only_lent = self.table.lookup is Lookup.HARD and region not in self.region_models
            found[region] = still_allowed(model, self.t_s, self.settings)[: 1 if only_lent else None]
        return found

    def borders(self, region: int) -> tuple[NeighbourBorder, ...]:
        """The ways from a region to its neighbours."""
        return borders_of(self.table, region, {i: models for i, models in self.allowed.items() if i != region})

    def likeliest(self, region: int) -> LogModel:
        """The likeliest process of a region where its gains run, as it may be met now."""
        return predicted(self.where_gains_run[region], self.t_s, self.settings.tracker)


def known_of(known: KnownProcesses, region: int) -> StillAllowed:
    """What is known of a region's process now, as it is asked which of its sets is to run.

    In an interpolated table that is asked at the region's knot, and half way to its neighbours. Of a region without
    records the others tell: its gains were proved on what they lend.
    """
    own, settings = known.where_gains_run.get(region), known.settings
    if own is None:
        return NOTHING_KNOWN
    dt_s, asked = settings.sample_time_s, still_allowed(own, known.t_s, settings)
    alone = tuple(found.model.seen_by_controller(dt_s).linear() for found in asked)
    likely = tuple(math.exp(-found.excess / (2.0 * settings.choice.temper)) for found in asked)
    if known.table.lookup is Lookup.HARD:
        return StillAllowed(alone, settings.filter_s, weights=likely)
    best = known.allowed[region][0].model
    halves = [
        (
            likeliest_between(border, best, HALF).seen_by_controller(dt_s).linear(),
            partial(mixed, border=border, share=HALF),
        )
        for border in known.borders(region)
    ]
    return StillAllowed(alone, settings.filter_s, tuple(halves), likely)


def allowed_models(
    region: int, region_models: Mapping[int, RegionModel], t_s: float, settings: RetunerSettings
) -> tuple[Plausible, ...]:
    """The models of a region that its records still allow now; none where nothing is known of it."""
    known = region_models.get(region)
    return () if known is None else still_allowed(known, t_s, settings)


def still_allowed(region_model: RegionModel, t_s: float, settings: RetunerSettings) -> tuple[Plausible, ...]:
    """The models of a region that its records still allow now."""
    walk = settings.tracker.walk_per_day**2 * max(t_s - region_model.t_s, 0.0) / SECONDS_PER_DAY
    return allowed(predicted(region_model, t_s, settings.tracker), region_model.plausible, walk, settings.guard)


LAG_DOMINANT = 8.0
"""tau1 over theta from which SIMC's integral time no longer is tau1 (Skogestad 2003, at tau_c = theta)."""
OVER_NOMINAL = 1.03
"""Ms over the proposal's nominal limit from which a gain in force is too large: what a drifting process does to Ms is
known a few percent late, so waiting for the design limit itself is waiting until it has been passed."""


@dataclass(frozen=True, slots=True)
class RobustProposal:
    """tuning : what the rule gives. diagnosis : of the gains in force. ready : whether enough is known to go on."""

    tuning: Tuning
    diagnosis: Diagnosis
    ready: bool


def propose(region_model: RegionModel, log: LogModel, in_force: PidGains, settings: RetunerSettings) -> RobustProposal:
    """Settings for a region, with half a sampling interval of dead time more: what a sampled controller sees.

    region_model : what is known. log : the same as it may be met now (`predicted`). in_force : gains running now.
    """
    dt_s, best, cause = settings.sample_time_s, log.model(), settings.cause
    robust = replace(settings.robust, ms_nominal=_nominal(best, settings))
    tuning = robust_simc_on(best, region_model.plausible, dt_s, robust, in_force).tuning
    given, lagged = (in_force, tuning.gains, log.gain_uncertainty(dt_s)), with_second_lag(region_model.plausible, dt_s)
    as_well = [best, *(p.model for p in region_model.plausible[1:] if not p.excess)]

    def told(ms_high: float) -> Diagnosis:
        limits = replace(cause, ms_high=ms_high)
        each = [tuning_cause(model.seen_by_controller(dt_s), *given, limits, lagged) for model in as_well]
        return next((one for one in each if one.cause not in SWINGING), each[0])

    diagnosis = told(cause.ms_high)
    if diagnosis.cause == Cause.OK:
        closer = told(min(cause.ms_high, OVER_NOMINAL * robust.ms_nominal))
        diagnosis = closer if closer.cause == Cause.AGGRESSIVE else diagnosis
    ready = region_model.identifiable
    if not ready:
        danger = over_limit(region_model.plausible, in_force, dt_s, robust.believed, cause.ms_high)
        ready = danger and diagnosis.cause in SWINGING
        tuning = replace(tuning, gains=no_more_action(tuning.gains, in_force, diagnosis.cause))
    return RobustProposal(tuning, diagnosis, ready)


def no_more_action(wanted: PidGains, in_force: PidGains, cause: Cause) -> PidGains:
    """The wanted gains with no gain larger, and no integral time shorter, than in force.

    Where the integral is too strong for the gain, it follows a gain that was cut: the wanted integral time stays.
    """
    kp, ki, kd = (min(getattr(wanted, name), getattr(in_force, name), key=abs) for name in ("kp", "ki", "kd"))
    longest = [kp * gains.ki / gains.kp for gains in (in_force, wanted) if gains.kp]
    if cause != Cause.SLOW_INTEGRATING:
        longest = longest[:1]
    return PidGains(kp, min(ki, *longest, key=abs), kd) if longest else PidGains(kp, ki, kd)


def _nominal(best: ProcessModel, settings: RetunerSettings) -> float:
    """Largest Ms on the best model: of a lag-dominant process the guard's own limit, of the others less.

    SIMC's integral time there is that of an integrating process, and its Ms 1.70 to 1.98: less than the guard allows
    costs a quarter in J. On the others Ms is 1.59 at no cost, and room is left for what the model does not show.
    """
    plain = without_second_lag(best)
    lag_dominant = not plain.tau1_s or plain.tau1_s > LAG_DOMINANT * plain.theta_s
    return settings.guard.ms_nominal if lag_dominant else min(settings.robust.ms_nominal, settings.guard.ms_nominal)


def over_limit(
    allowed: Sequence[Plausible], in_force: PidGains, sample_time_s: float, excess: float, limit: float
) -> bool:
    """Whether the gains in force are over an Ms limit on every model that is believed to within an excess."""
    models = [p.model.seen_by_controller(sample_time_s) for p in believed(allowed, excess)]
    return bool(models) and all(sensitivity_peak(m.linear(), in_force) > limit for m in models)


def too_bold(allowed: Sequence[Plausible], in_force: PidGains, after: PidGains, settings: RetunerSettings) -> str:
    """Words for a step to more action that exceeds its Ms limit on a model that the records allow; else empty.

    What does not carry settings may still say how far not to go.
    """
    if less_of_everything(in_force, after):
        return ""
    models = [p.model.seen_by_controller(settings.sample_time_s) for p in believed(allowed, settings.robust.believed)]
    ms = max((sensitivity_peak(model.linear(), after) for model in models), default=0.0)
    return f"on a plausible model Ms would be {ms:.2f}" if ms > settings.cause.ms_high else ""


BEYOND = 1.05
"""Times the limit of a cause above which a set is one at a border: the neighbour's model moves with its records."""
BETWEEN = "ms_between"  # evidence that a set is over its limit on the way to a neighbour: the Ms there


def tuning_of(known: KnownProcesses, region: int, in_force: PidGains) -> RobustProposal:
    """What the rule gives for a region, eased to what its part of the ways to the neighbours bears, and whether its
    tuning is a cause (guard/both_sides_of_border.py).

    In an interpolated table what ran, in_force, is a mean of several sets: asked is what the region's own does.
    """
    settings, hard = known.settings, known.table.lookup is Lookup.HARD
    dt_s, guard, model = settings.sample_time_s, settings.guard, known.where_gains_run[region]
    log, own = known.likeliest(region), in_force if hard else known.table.gains_of(region)
    found, process = propose(model, log, own, settings), log.model()
    borders = known.borders(region)
    limit, high = guard.ms_nominal, settings.cause.ms_high * (BEYOND if hard else 1.0)
    easier = eased(found.tuning.gains, borders, process, limit, dt_s, settings.filter_s)
    if easier == found.tuning.gains:
        return found
    given = (process.seen_by_controller(dt_s), own, easier, log.gain_uncertainty(dt_s), settings.cause)
    told = tuning_cause(*given, with_second_lag(model.plausible, dt_s))
    found = replace(found, tuning=replace(found.tuning, gains=easier), diagnosis=told)
    worst = worst_between(borders, process, own, dt_s, settings.filter_s)
    if worst is None or worst.ms <= high or abs(easier.ki) >= abs(own.ki):
        return found
    seen = "the loop is unstable" if math.isinf(worst.ms) else over_words(worst.ms, high)
    words = f"{seen} on the way to region {worst.to}"
    evidence = {**found.diagnosis.evidence, BETWEEN: worst.ms}
    return replace(found, diagnosis=Diagnosis(Cause.AGGRESSIVE, found.diagnosis.confidence, evidence, words))


def change_request(
    proposal: Tuning,
    region: int,
    commissioned: GainTable,
    known: KnownProcesses,
    learned: Learned | None,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that a model supports.

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
