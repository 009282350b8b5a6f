"""From what is known of a loop to the guard's question: may this region have these gains?"""

from collections.abc import Mapping

from retuner.adaptive.guard.border import borders_of
from retuner.adaptive.guard.model_set import allowed
from retuner.adaptive.guard.request import ChangeRequest, Evidence, Support
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.region_model.kalman import gate
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import SECONDS_PER_DAY, Agreement, Learned, predicted
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.way_back import NOTHING_KNOWN, StillAllowed
from retuner.schedule.table import GainTable


def change_request(
    proposal: Tuning,
    region: int,
    tables: tuple[GainTable, GainTable],
    region_models: Mapping[int, RegionModel],
    learned: Learned | None,
    t_s: float,
    settings: RetunerSettings,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that a model supports.

    Parameters
    ----------
    region : index. tables : in force, and as commissioned. region_models : of all
        regions, that of this one as it is now.
    learned : outcome of the last record; None when none is at hand. t_s : now.
    damping : of the response, None when it did not swing.
    """
    in_force, commissioned = tables
    known = {index: still_allowed(region_model, t_s, settings) for index, region_model in region_models.items()}
    contradicting = learned is not None and learned.agreement == Agreement.CONTRADICTS
    return ChangeRequest(
        in_force=in_force.gains_of(region),
        commissioned=commissioned.gains_of(region),
        proposal=proposal,
        models=known[region],
        sample_time_s=settings.sample_time_s,
        evidence=Evidence(
            records=region_models[region].records,
            age_s=max(t_s - region_models[region].t_s, 0.0),
            innovation=learned.innovation if learned is not None and contradicting else 0.0,
            gate=gate(len(region_models[region].log.x), settings.tracker.gate),
            borrowed=region_models[region].records == 0,
            settled=region_models[region].identifiable,
        ),
        borders=borders_of(in_force, region, {index: known[index] for index in known if index != region}),
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


def known_of(
    region_model: RegionModel | None,
    table: GainTable,
    region: int,
    at: tuple[float, float],
    t_s: float,
    settings: RetunerSettings,
) -> StillAllowed:
    """What is known of a region's process now, as it is asked which of its sets is to run.

    at : scheduling values, where in an interpolated table a mean of several regions' sets runs.
    """
    if region_model is None:
        return NOTHING_KNOWN
    models = still_allowed(region_model, t_s, settings)
    sampled = tuple(found.model.seen_by_controller(settings.sample_time_s).linear() for found in models)
    return StillAllowed(sampled, lambda own: table.with_gains(region, own).at(region, *at), settings.filter_s)


def _urgent(damping: float | None, settings: RetunerSettings) -> bool:
    """Whether a response swings on as if it would not end."""
    return damping is not None and damping >= settings.guard.urgent_damping


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
