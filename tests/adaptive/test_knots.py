"""An interpolated table that is tuned live: what is proved and proposed is of what runs, at the knots and between."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import GainTable, Lookup, PidGains, ProcessModel, ProcessType, Regions, RetunerSettings
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.guard.both_sides_of_boundary import between_models, eased
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.request import NeighbourBoundary
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.region_model.at_knots import at_knots
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.supervision.findings import tuning_of
from retuner.adaptive.supervision.known_processes import KnownProcesses, change_request, known_of

REGIONS = Regions("pv", "C", ("low", "middle", "high"), 0.0, (40.0, 60.0), 100.0)
KNOTS = (20.0, 50.0, 80.0)
STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.0)
ASKED = RetunerSettings(0.2, 100.0)
GRID = np.linspace(0.05, 0.95, 19).tolist()


def process(k: float, theta_s: float = 2.0) -> ProcessModel:
    return ProcessModel(ProcessType.FOPDT, k, 20.0, 0.0, theta_s)


def known(model: ProcessModel, x: float, std: float = 0.03) -> RegionModel:
    log = LogModel(parameters_of(model), std**2 * np.eye(3), 1)
    points = (RecordPoint(0.0, x, 0.0, log, 0.0),)
    around = (Plausible(model, 0.0), Plausible(replace(model, k=1.1 * model.k, tau1_s=22.0), 4.0))
    return RegionModel((StructureModel(log, 0.0),), 4, 0.0, points=points, plausible=around)


def table(*gains: PidGains) -> GainTable:
    return GainTable("oven", REGIONS, gains, Lookup.INTERPOLATED)


def best(model: ProcessModel) -> PidGains:
    return simc(model.seen_by_controller(ASKED.sample_time_s)).gains


def at(models: dict[int, RegionModel], tab: GainTable, low: int, share: float) -> float:
    """Ms of what runs between two knots on the process between their models."""
    one, two = models[low].log.model(), models[low + 1].log.model()
    between = between_models(one, two, share)
    x = KNOTS[low] + share * (KNOTS[low + 1] - KNOTS[low])
    return sensitivity_peak(between.seen_by_controller(ASKED.sample_time_s).linear(), tab.at(low, x))


def test_a_model_is_carried_along_the_curves_to_its_knot() -> None:
    def k(x: float) -> float:
        return 2.0 * math.exp(0.01 * x)

    where = {0: 28.0, 1: 58.0, 2: 70.0}
    carried = at_knots({i: known(process(k(x)), x, 0.002) for i, x in where.items()}, REGIONS, 0.0, STILL)
    for i, knot in enumerate(KNOTS):
        assert carried[i].log.model().k == pytest.approx(k(knot), rel=0.03)
        assert carried[i].plausible[0].model.k == pytest.approx(k(knot), rel=0.03)


def test_where_one_region_is_known_its_model_stays_and_opens() -> None:
    alone = known(process(2.0), 30.0)
    carried = at_knots({0: alone}, REGIONS, 0.0, STILL)[0]
    assert carried.log.model().k == pytest.approx(2.0)
    assert carried.log.p[0, 0] > alone.log.p[0, 0] + 0.05**2
    centred = known(process(2.0), 20.0)
    assert at_knots({0: centred}, REGIONS, 0.0, STILL)[0] is centred


@pytest.mark.slow
@pytest.mark.uncounted
@settings(max_examples=25)
@given(
    k=st.tuples(*[st.floats(0.5, 6.0)] * 3),
    theta=st.tuples(*[st.floats(1.0, 4.0)] * 3),
    start=st.tuples(*[st.floats(0.2, 1.6)] * 3),
    x=st.tuples(st.floats(5.0, 35.0), st.floats(42.0, 58.0), st.floats(65.0, 95.0)),
    region=st.integers(0, 2),
    known_there=st.tuples(*[st.booleans()] * 3),
)
def test_no_accepted_change_makes_a_place_between_knots_too_much(k, theta, start, x, region, known_there):
    models = [process(*one) for one in zip(k, theta, strict=True)]
    sets = [best(model) for model in models]
    now = table(*(PidGains(f * one.kp, f * one.ki) for f, one in zip(start, sets, strict=True)))
    told = {i: known(models[i], x[i]) for i in range(3) if known_there[i] or i == region}
    there = KnownProcesses(now, told, 0.0, ASKED).where_gains_run
    wanted = tuning_of(KnownProcesses(now, told, 0.0, ASKED), region, now.gains_of(region))
    verdict = prove(
        change_request(wanted.tuning, region, now, KnownProcesses(now, told, 0.0, ASKED), None), ASKED.guard
    )
    if verdict.gains is None:
        return
    then = now.with_gains(region, verdict.gains)
    for low in (region - 1, region):
        if 0 <= low <= 1:
            for share in GRID:
                before, after = (at(dict(there), one, low, share) for one in (now, then))
                assert after <= max(ASKED.guard.ms_border, before) * 1.02


def tuned(now: GainTable, told: dict[int, RegionModel], rounds: int) -> tuple[GainTable, list[int]]:
    """The knots in turn, as often, and how many changes each round made."""
    made = []
    for _ in range(rounds):
        made.append(0)
        for region in range(3):
            wanted = tuning_of(KnownProcesses(now, told, 0.0, ASKED), region, now.gains_of(region))
            if not wanted.diagnosis.retune:
                continue
            verdict = prove(
                change_request(wanted.tuning, region, now, KnownProcesses(now, told, 0.0, ASKED), None), ASKED.guard
            )
            if verdict.gains is not None:
                now, made[-1] = now.with_gains(region, verdict.gains), made[-1] + 1
    return now, made


def test_knots_whose_sets_are_right_are_eased_where_their_mean_is_too_much_and_then_rest() -> None:
    models = [process(k) for k in (1.0, 6.0, 1.0)]
    told = {i: known(model, x) for i, (model, x) in enumerate(zip(models, KNOTS, strict=True))}
    now = table(*map(best, models))
    worst = max(at(told, now, low, share) for low in (0, 1) for share in GRID)
    assert worst > 2.0
    then, made = tuned(now, told, 5)
    assert made[0] > 0
    assert made[-2:] == [0, 0]  # it does not go to and fro
    assert max(at(told, then, low, share) for low in (0, 1) for share in GRID) < 1.9


def test_a_place_that_is_too_much_is_told_as_what_it_is() -> None:
    models = [process(k) for k in (1.0, 6.0, 1.0)]
    told = {i: known(model, x) for i, (model, x) in enumerate(zip(models, KNOTS, strict=True))}
    now = table(*map(best, models))
    found = tuning_of(KnownProcesses(now, told, 0.0, ASKED), 0, now.gains[0])
    assert found.diagnosis.cause == Cause.AGGRESSIVE
    assert "on the way to region middle" in found.diagnosis.reason
    alike = [process(1.0)] * 3
    same = {i: known(model, x) for i, (model, x) in enumerate(zip(alike, KNOTS, strict=True))}
    level = table(*map(best, alike))
    assert tuning_of(KnownProcesses(level, same, 0.0, ASKED), 0, level.gains[0]).diagnosis.cause == Cause.OK


def test_which_set_is_to_run_is_asked_at_the_knot_and_half_way() -> None:
    models = [process(k) for k in (1.0, 6.0, 1.0)]
    told = {i: known(model, x) for i, (model, x) in enumerate(zip(models, KNOTS, strict=True))}
    now = table(*map(best, models))
    asked = known_of(KnownProcesses(now, told, 0.0, ASKED), 0)
    half = at(told, now, 0, 0.5)
    assert asked.ms(now.gains[0])[-1] == pytest.approx(half, rel=0.02)
    hard = replace(now, lookup=Lookup.HARD)
    assert len(known_of(KnownProcesses(hard, told, 0.0, ASKED), 0).ms(now.gains[0])) == len(asked.ms(now.gains[0])) - 1


def test_a_step_is_eased_where_its_boundary_bears_less() -> None:
    models = [process(k) for k in (1.0, 9.0, 9.0)]
    told = {i: known(model, x) for i, (model, x) in enumerate(zip(models, KNOTS, strict=True))}
    now = replace(table(*map(best, models)), lookup=Lookup.HARD)
    found = tuning_of(KnownProcesses(now, told, 0.0, ASKED), 0, now.gains[0])
    assert found.diagnosis.cause == Cause.AGGRESSIVE
    assert "on the way to region middle" in found.diagnosis.reason
    verdict = prove(change_request(found.tuning, 0, now, KnownProcesses(now, told, 0.0, ASKED), None), ASKED.guard)
    assert verdict.gains.kp < 0.8 * now.gains[0].kp
    middle = tuning_of(KnownProcesses(now, told, 0.0, ASKED), 1, now.gains[1])  # towards less gain its set is calmer
    assert middle.diagnosis.cause == Cause.OK


def test_beyond_the_boundary_of_a_step_stands_in_what_the_others_lend() -> None:
    told = {i: known(process(k), KNOTS[i], 0.01) for i, k in ((0, 1.0), (1, 4.0))}
    now = replace(table(*[best(process(4.0))] * 3), lookup=Lookup.HARD)
    (low, high) = change_request(
        Tuning("x", "", now.gains[1]), 1, now, KnownProcesses(now, told, 0.0, ASKED), None
    ).boundaries
    assert len(low.models) > 1
    (lent,) = high.models
    assert lent.model.k > 4.4  # the gain that rises goes on, as far as the prior of slopes believes it


@pytest.mark.parametrize(("slope", "share"), [(0.0005, 1.0), (0.16, 0.5)])
def test_where_no_share_is_within_the_limit_the_one_of_least_ms_is_taken(slope: float, share: float) -> None:
    """An integral that is too strong for its gain swings more with less of both; other loops swing less."""
    own = ProcessModel(ProcessType.INTEGRATING, 0.01, theta_s=10.0)
    there = (Plausible(replace(own, k=slope), 0.0),)
    wanted = PidGains(5.0, 5.0 / 80.0)
    boundary = NeighbourBoundary("next", wanted, there, 1.0, False)
    found = eased(wanted, [boundary], own, 1.2, 1.0)
    assert found.kp == pytest.approx(share * wanted.kp)
