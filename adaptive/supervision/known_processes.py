"""What is known of the processes of all regions where their sets run, and the question on new gains of one of them that
is put to the guard.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, partial

from retuner.adaptive.explanations.book import ODD, Book
from retuner.adaptive.explanations.settings_by_book import spread
from retuner.adaptive.guard.both_sides_of_boundary import boundaries_of, likeliest_between, mixed
from retuner.adaptive.guard.model_set import allowed
from retuner.adaptive.guard.request import ChangeRequest, Evidence, NeighbourBoundary, Support
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.region_model.at_knots import at_knots
from retuner.adaptive.region_model.from_neighbours import borrowed
from retuner.adaptive.region_model.kalman import gate
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import SECONDS_PER_DAY, Agreement, Learned, predicted
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.schedule.late_dataclass import dataclass, field, replace
from retuner.schedule.table import GainTable, Lookup

HALF = 0.5  # weight of a neighbour half way to it


@dataclass(frozen=True)
class KnownProcesses:
    """What is known of the processes where the regions' own sets run, worked out once a question.

    table : in force. region_models : by region, from records. t_s : now, s. met : see likeliest.
    """

    table: GainTable
    region_models: Mapping[int, RegionModel]
    t_s: float
    settings: RetunerSettings
    met: dict[int, LogModel] = field(default_factory=dict, init=False, repr=False, compare=False)

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

        A step ends at its boundary: of what is only lent beyond it, the likeliest model is asked. A mean of two sets
        runs all the way, and is asked of all.
        """
        found = {}
        for region, model in self.where_gains_run.items():
            only_lent = self.table.lookup is Lookup.HARD and region not in self.region_models
            among = still_allowed(model, self.t_s, self.settings, self.likeliest(region))
            found[region] = among[: 1 if only_lent else None]
        return found

    def boundaries(self, region: int) -> tuple[NeighbourBoundary, ...]:
        """The ways from a region to its neighbours."""
        return boundaries_of(self.table, region, {i: models for i, models in self.allowed.items() if i != region})

    def likeliest(self, region: int) -> LogModel:
        """The likeliest process of a region where its gains run, as it may be met now."""
        if region not in self.met:
            self.met[region] = predicted(self.where_gains_run[region], self.t_s, self.settings.tracker)
        return self.met[region]


def known_of(known: KnownProcesses, region: int, book: Book | None = None) -> StillAllowed:
    """What is known of a region's process now, as it is asked which of its sets is to run.

    In an interpolated table that is asked at the region's knot, and half way to its neighbours. Of a region without
    records the others tell: its gains were proved on what they lend. book : of all samples, where these may be asked.
    """
    own, settings = known.where_gains_run.get(region), known.settings
    if book is not None:
        # The processes of the book, and beside them the models of responses, as witnesses: together a model has as much
        # as the book where its Ms is in the middle of the book's odds, and the less the further out it is
        gains = known.table.gains_of(region)
        processes, ms, odds = spread(book, gains, settings.book)
        by_book, _ = _as_seen(processes, settings)
        models, likely = _as_seen(() if own is None else still_allowed(own, known.t_s, settings), settings)
        witness = []
        for model, weight in zip(models, likely, strict=True):
            there = sensitivity_peak(model, gains, settings.filter_s)
            tail = min(float(odds @ (ms >= there)), float(odds @ (ms <= there)))
            witness.append(weight / sum(likely) * max(min(2.0 * tail, 1.0), ODD))
        weights = (*processes.values(), *witness)
        return StillAllowed((*by_book, *models), settings.filter_s, weights=weights, by_loads=True)
    if own is None:
        return NOTHING_KNOWN
    alone, likely = _as_seen(still_allowed(own, known.t_s, settings), settings)
    if known.table.lookup is Lookup.HARD:
        return StillAllowed(alone, settings.filter_s, weights=likely)
    best = known.allowed[region][0].model
    halves = [
        (
            likeliest_between(boundary, best, HALF).seen_by_controller(settings.sample_time_s).linear(),
            partial(mixed, boundary=boundary, share=HALF),
        )
        for boundary in known.boundaries(region)
    ]
    return StillAllowed(alone, settings.filter_s, tuple(halves), likely)


def _as_seen(
    models: Iterable[Plausible], settings: RetunerSettings
) -> tuple[tuple[LinearProcess, ...], tuple[float, ...]]:
    """Models as a sampled controller sees them, and how likely each is beside the best."""
    models = tuple(models)
    alone = tuple(found.model.seen_by_controller(settings.sample_time_s).linear() for found in models)
    return alone, tuple(math.exp(-found.excess / (2.0 * settings.choice.temper)) for found in models)


def still_allowed(
    region_model: RegionModel, t_s: float, settings: RetunerSettings, met: LogModel | None = None
) -> tuple[Plausible, ...]:
    """The models of a region that its records still allow now. met : the likeliest, None to work it out."""
    walk = settings.tracker.walk_per_day**2 * max(t_s - region_model.t_s, 0.0) / SECONDS_PER_DAY
    met = predicted(region_model, t_s, settings.tracker) if met is None else met
    return allowed(met, region_model.plausible, walk, settings.guard)


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
    evidence = Evidence(
        records=model.records,
        age_s=max(known.t_s - model.t_s, 0.0),
        innovation=learned.innovation if learned is not None and contradicting else 0.0,
        gate=gate(len(model.log.x), settings.tracker.gate),
        borrowed=model.records == 0,
        settled=model.identifiable,
    )
    asked = unproved_request(proposal, region, (known.table, commissioned), settings, damping)
    return on_models(asked, known, region, known.allowed[region], evidence)


def on_models(
    asked: ChangeRequest, known: KnownProcesses, region: int, models: Sequence[Plausible], evidence: Evidence
) -> ChangeRequest:
    """The question with the models that it is put to, and the ways to the neighbours."""
    boundaries, filter_s = known.boundaries(region), known.settings.filter_s
    return replace(asked, models=models, evidence=evidence, boundaries=boundaries, filter_s=filter_s)


def unproved_request(
    proposal: Tuning,
    region: int,
    tables: tuple[GainTable, GainTable],
    settings: RetunerSettings,
    damping: float | None = None,
) -> ChangeRequest:
    """The question on a proposal that no model supports; arguments as above."""
    in_force, commissioned = (table.gains_of(region) for table in tables)
    return ChangeRequest(
        in_force,
        commissioned,
        proposal,
        (),
        settings.sample_time_s,
        Evidence(records=0, support=Support.PATTERN),
        urgent=damping is not None and damping >= settings.guard.urgent_damping,
        locks=settings.locks_of(region),
        units=settings.units,
    )
