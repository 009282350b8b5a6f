"""Splits and merges: found where there are two processes, or one; not where there is noise, drift or ignorance."""

import json
import math
import random
from dataclasses import replace

import numpy as np
import pytest
from effort import sized

from retuner import Axis, GainTable, Lookup, PidGains, ProcessType, Regions
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.region_model.proposed_boundaries import (
    MS_END,
    Refinement,
    best_of,
    in_force,
    place_by,
    proposed_boundaries,
)
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel
from retuner.adaptive.region_model.split_or_merge import (
    AdviceKind,
    AdviceSettings,
    RegionAdvice,
    features,
    region_advice,
)
from retuner.adaptive.region_model.update import TrackerSettings
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.schedule_design.places import DesignLimits, Place

HEAT = Axis("sp", "degC", 0.0, (100.0,), 200.0, 2.0)
FLOW = Axis("can", "%", 0.0, (50.0,), 100.0, 1.0, signal="flow")
ROW = Regions.along(("cold", "hot"), HEAT)
MAP = Regions.along(("a", "b", "c", "d"), HEAT, FLOW)
SETTINGS = AdviceSettings()
STD = 0.05
DT_S = 1.0


def log(gain: float = 1.0, lag: float = 1.0, theta: float = 1.0, std: float = STD) -> LogModel:
    """k' = 0.02 gain, theta = 10 theta s, T = 60 lag s, known to std in each logarithm."""
    x = np.log([0.02 * gain, 10.0 * theta, 60.0 * lag])
    return LogModel(x, std**2 * np.eye(3), 1)


def point(rng: random.Random, x: float, t_s: float, gain: float, x2: float = 0.0, std: float = STD) -> RecordPoint:
    """A record of a process with this gain, off by its own error and a scatter of 8 %."""
    off = math.hypot(std, 0.08)
    model = log(gain * math.exp(rng.gauss(0, off)), math.exp(rng.gauss(0, off)), math.exp(rng.gauss(0, off)), std)
    return RecordPoint(t_s, x, x2, model, 1.0)


def region_model(points: list[RecordPoint], gain: float = 1.0, std: float = 0.02) -> RegionModel:
    return RegionModel((StructureModel(log(gain, std=std), 0.0),), len(points), 1e4, points=tuple(points))


def advice(
    points: list[RecordPoint], regions: Regions = ROW, settings: AdviceSettings = SETTINGS
) -> tuple[RegionAdvice, ...]:
    return region_advice(regions, {0: region_model(points)}, DT_S, settings)


def mixed(rng: random.Random, factor: float, n: int = 10) -> list[RecordPoint]:
    """Records at 20..40 of one process and at 60..80 of another, in mixed order of time."""
    low = [20.0 + 20.0 * rng.random() for _ in range(n // 2)]
    high = [60.0 + 20.0 * rng.random() for _ in range(n // 2)]
    xs = [x for pair in zip(low, high, strict=True) for x in pair]
    return [point(rng, x, 1000.0 * i, factor if x > 50 else 1.0) for i, x in enumerate(xs)]


def test_two_processes_are_told_apart_and_the_boundary_lies_between_them() -> None:
    for seed in range(20):
        (found,) = advice(mixed(random.Random(seed), 2.5))
        assert found.kind is AdviceKind.SPLIT
        assert found.regions == ("cold",)
        assert 40.0 < found.boundary < 60.0
        assert found.kc_factor == pytest.approx(1 / 2.5, rel=0.35)
        assert found.records == (5, 5)
        assert found.statistic > found.limit
        assert found.against_time >= SETTINGS.against_time


def test_the_advised_settings_are_those_of_a_sampled_controller() -> None:
    """SIMC's Kc goes as 1/(k' (theta + half a sampling interval)): dead times of 1 and 4 s, samples of 2 s."""
    xs = (20.0, 70.0, 30.0, 80.0, 25.0, 75.0, 35.0, 65.0)
    records = [RecordPoint(1e3 * i, x, 0.0, log(theta=0.1 if x < 50 else 0.4), 1.0) for i, x in enumerate(xs)]
    (found,) = region_advice(ROW, {0: region_model(records)}, 2.0, SETTINGS)
    assert found.kc_factor == pytest.approx((1.0 + 1.0) / (4.0 + 1.0))


@pytest.mark.uncounted
def test_one_process_is_hardly_ever_taken_for_two() -> None:
    """One process with about the scatter that is allowed: at alpha = 0.001 fourteen of 5,000 at most."""
    count, most = sized((100, 1), (100, 1), (5000, 14))
    rng, wrong = random.Random(7), 0
    for _ in range(count):
        points = [point(rng, 100.0 * rng.random(), 1000.0 * i, 1.0) for i in range(12)]
        wrong += len(advice(points, settings=replace(SETTINGS, split_factor=1.001, against_time=0.0)))
    assert wrong <= most


def test_a_process_that_changed_in_time_is_no_second_region() -> None:
    """x rises with time: both explain it alike; x mixed: time alone explains it."""
    rng = random.Random(3)
    for xs in ([10.0 * i for i in range(10)], [15.0 if i % 2 else 75.0 for i in range(10)]):
        points = [point(rng, x, 1000.0 * i, 3.0 if i >= 5 else 1.0) for i, x in enumerate(xs)]
        assert advice(points) == ()


@pytest.mark.parametrize(
    "change", [{"split_factor": 4.0}, {"least_records": 6}, {"alpha": 1e-6, "scatter": 1.0}, {"against_time": 1e4}]
)
def test_each_condition_can_refuse(change: dict[str, float]) -> None:
    points = mixed(random.Random(1), 2.5)
    assert advice(points)
    assert advice(points, settings=replace(SETTINGS, **change)) == ()


def test_no_room_for_the_hysteresis_no_boundary() -> None:
    points = mixed(random.Random(1), 2.5)
    narrow = Regions.along(("cold", "hot"), replace(HEAT, low=45.0, hysteresis=10.0))
    assert advice(points, narrow) == ()


def test_three_processes_leave_a_contradiction_behind() -> None:
    rng = random.Random(5)
    points = [
        point(rng, x + rng.random(), 1000.0 * i, gain)
        for i, (x, gain) in enumerate([(10.0, 1.0), (50.0, 20.0), (90.0, 1.0)] * 4)
    ]
    assert advice(points) == ()


def test_unknown_places_and_too_few_records_say_nothing() -> None:
    points = mixed(random.Random(1), 2.5)
    assert advice([replace(p, x=math.nan) for p in points]) == ()
    assert advice(points[:5]) == ()
    assert advice([replace(p, x=30.0) for p in points]) == ()


def test_on_a_map_the_axis_that_explains_is_found() -> None:
    rng = random.Random(2)
    points = [
        point(rng, 90.0 * rng.random(), 1000.0 * i, 2.5 if i % 2 else 1.0, 30.0 if i % 2 else 10.0) for i in range(12)
    ]
    (found,) = advice(points, MAP)
    assert (found.axis, found.unit) == ("flow", "%")
    assert 10.0 < found.boundary < 30.0
    assert found.sentence.startswith("Region a holds two processes: a boundary at flow = 20 %")


def test_structures_may_differ_from_record_to_record() -> None:
    """An integrating record says nothing of a lag, and yet of the settings."""
    integrating = LogModel(np.log([0.02, 10.0]), STD**2 * np.eye(2), 1, ProcessType.INTEGRATING)
    rng = random.Random(4)
    points = [
        replace(p, log=integrating) if i % 3 == 0 else p
        for i, p in enumerate(point(rng, 10.0 * i, 1000.0 * i, 1.0) for i in range(9))
    ]
    assert [a for a in advice(points) if a.kind is AdviceKind.SPLIT and a.kc_factor != pytest.approx(1, rel=0.3)] == []


def settled(gain: float, std: float = STD, n: int = 8) -> RegionModel:
    rng = random.Random(int(100 * gain))
    return region_model([point(rng, 10.0 * i, 1e3 * i, gain, std=std) for i in range(n)], gain)


@pytest.mark.parametrize(
    ("gains", "std", "records", "merged"),
    [
        ((1.0, 1.02), STD, 8, True),
        ((1.0, 1.5), STD, 8, False),
        ((1.0, 1.0), 0.6, 8, False),  # equal as far as is known, but not known
        ((1.0, 1.0), STD, 2, False),
    ],
)
def test_neighbours_are_merged_when_they_are_known_to_be_equal(gains, std, records, merged):
    known = {i: settled(gain, std, records) for i, gain in enumerate(gains)}
    found = region_advice(ROW, known, DT_S, SETTINGS)
    assert [a.kind for a in found] == [AdviceKind.MERGE] * merged
    for one in found:
        assert (one.regions, one.axis, one.boundary) == (("cold", "hot"), "sp", 100.0)
        assert 1.0 < one.statistic <= one.limit == SETTINGS.merge_factor
        assert "The boundary at sp = 100 degC may go" in one.sentence


def test_on_a_map_a_boundary_goes_only_where_it_parts_nothing_at_all() -> None:
    equal_rows = {0: settled(1.0), 1: settled(2.0), 2: settled(1.0), 3: settled(2.0)}
    (found,) = region_advice(MAP, equal_rows, DT_S, SETTINGS)
    assert (found.axis, found.boundary, found.regions) == ("sp", 100.0, ("a", "c", "b", "d"))
    assert region_advice(MAP, {**equal_rows, 3: settled(3.0)}, DT_S, SETTINGS) == ()
    assert region_advice(MAP, {i: b for i, b in equal_rows.items() if i != 3}, DT_S, SETTINGS) == ()


def test_the_document_is_plain() -> None:
    (found,) = advice(mixed(random.Random(1), 2.5))
    document = found.to_dict()
    assert document["kind"] == "split"
    assert document["regions"] == ["cold"]
    assert document["sentence"] == found.sentence


def test_features_are_simcs_settings_with_their_spread() -> None:
    """Kc = 1/(k' 2 theta), tau_I = min(T, 8 theta) with half a sample more of delay; errors by hand."""
    found = features(log(), 1.0)
    assert np.exp(found.z) == pytest.approx([1 / (0.02 * 21.0), 60.0], rel=1e-9)
    delay = 10.0 / 10.5  # d ln(theta + 0.5) / d ln theta
    assert found.p[0, 0] == pytest.approx(STD**2 * (1 + delay**2), rel=1e-4)
    assert found.p[1, 1] == pytest.approx(STD**2, rel=1e-4)


# Another schedule is proposed where a region is too wide for one set, and nowhere else.


REGIONS = Regions("pv", "degC", ("low", "middle", "high"), 0.0, (33.0, 67.0), 99.0, 1.0)
STILL = TrackerSettings(walk_per_day=0.0, walk_per_record=0.0, scatter=0.02)
THETA_S, TAU_S = 8.0, 40.0
STEEP = 60.0  # Factor of the gain from the lowest region's centre to the highest: 8 in each


def log_of(k: float, variance: float = 2e-4) -> LogModel:
    return LogModel(np.log([k / TAU_S, THETA_S, TAU_S]), variance * np.eye(3), 1)


def known(k: float, variance: float = 2e-4) -> RegionModel:
    return RegionModel((StructureModel(log_of(k, variance), -500.0),), 5, 0.0)


def best(k: float) -> PidGains:
    model = known(k).log.model()
    return simc(replace(model, theta_s=THETA_S + 0.5)).gains


def rising(factor: float, variance: float = 2e-4) -> dict[int, RegionModel]:
    """A gain that rises by a factor from the lowest region's centre to the highest."""
    return {i: known(factor ** (i / 2), variance) for i in range(3)}


def table_of(*gains: PidGains, regions: Regions = REGIONS, lookup: Lookup = Lookup.HARD) -> GainTable:
    return GainTable("oven", regions, gains, lookup)


def place(k: float, x: float = 0.0, variance: float = 2e-4) -> Place:
    found = place_by(x, log_of(k, variance), 1.0, DesignLimits())
    assert found is not None
    return found


@pytest.fixture(scope="module")
def one_set() -> GainTable:
    return table_of(*[best(1.0)] * 3)


@pytest.fixture(scope="module")
def found(one_set: GainTable) -> Refinement:
    proposed = proposed_boundaries(one_set, rising(STEEP), 0.0, 1.0, STILL)
    assert proposed is not None
    return proposed


def test_regions_in_which_the_gain_grows_eightfold_are_too_wide(one_set: GainTable, found: Refinement) -> None:
    assert found.kept < found.kept_then <= found.places
    assert found.ms_then <= MS_END
    assert found.table.revision == one_set.revision + 1
    assert {one.region for one in found.wide} <= {"low", "middle", "high"}
    assert all(one.share < one.share_then and 3 < one.kc_factor < 10 for one in found.wide)
    assert "is too wide for one set" in found.sentence
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["kind"] == "refine"


def test_what_is_proposed_serves_more_places_of_the_true_process(found: Refinement) -> None:
    def served(table: GainTable) -> int:
        xs = np.linspace(2.0, 97.0, 20).tolist()
        return sum(place(STEEP ** ((x - 16.5) / 66.5), x).keeps(in_force(table, x), DesignLimits()) for x in xs)

    centres = table_of(*(best(STEEP ** (i / 2)) for i in range(3)))
    assert served(found.table) > served(centres)


def test_the_same_values_give_the_same_proposal(one_set: GainTable, found: Refinement) -> None:
    assert proposed_boundaries(one_set, rising(STEEP), 0.0, 1.0, STILL) == found


@pytest.mark.parametrize("factor", [1.0, 1.8])
def test_wrong_sets_in_regions_that_one_set_can_serve_ask_for_no_other_regions(factor: float) -> None:
    assert proposed_boundaries(table_of(*[best(0.2)] * 3), rising(factor), 0.0, 1.0, STILL) is None


@pytest.mark.parametrize(
    "models",
    [
        {0: known(1.0)},
        {0: known(1.0), 2: replace(known(3.0), records=1)},
        rising(STEEP, 0.3),
        {i: replace(one, identifiable=False) for i, one in rising(STEEP).items()},
        {},
    ],
    ids=["one region", "too few records", "vague", "not settled", "nothing"],
)
def test_what_is_not_known_proposes_nothing(models: dict[int, RegionModel], one_set: GainTable) -> None:
    assert proposed_boundaries(one_set, models, 0.0, 1.0, STILL) is None


def test_age_takes_the_proposal_away(one_set: GainTable) -> None:
    walks = replace(STILL, walk_per_day=0.3)
    assert proposed_boundaries(one_set, rising(STEEP), 86400.0 * 9, 1.0, walks) is None


def test_a_table_that_is_interpolated_is_left_alone() -> None:
    table = table_of(*[best(1.0)] * 3, lookup=Lookup.INTERPOLATED)
    assert proposed_boundaries(table, rising(STEEP), 0.0, 1.0, STILL) is None


def test_no_boundary_stands_nearer_to_another_than_its_hysteresis() -> None:
    narrow = Regions("pv", "degC", ("low", "middle", "high"), 0.0, (33.0, 67.0), 99.0, 16.0)
    found = proposed_boundaries(table_of(*[best(1.0)] * 3, regions=narrow), rising(STEEP), 0.0, 1.0, STILL)
    assert found is None or found.table.lookup is Lookup.INTERPOLATED


def test_doubt_makes_a_place_its_own_set_calmer_until_it_has_none() -> None:
    sure, unsure = place(2.0), place(2.0, variance=1.4e-2)
    assert abs(unsure.own.kp) < abs(sure.own.kp)
    assert sure.keeps(sure.own, DesignLimits())
    assert not unsure.keeps(PidGains(*(1.3 * gain for gain in (sure.own.kp, sure.own.ki, 0.0))), DesignLimits())
    assert place_by(0.0, log_of(2.0, 8e-2), 1.0, DesignLimits()) is None


def test_the_best_set_for_places_keeps_the_limits_at_most_of_them() -> None:
    row = [place(k, x) for x, k in enumerate((1.0, 1.2, 1.4, 8.0))]
    chosen = best_of(row, DesignLimits())
    assert [one.keeps(chosen.gains, DesignLimits()) for one in row] == [True, True, True, False]
    assert chosen.kept == 3
