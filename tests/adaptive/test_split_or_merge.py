"""Splits and merges: found where there are two processes, or one; not where there is noise, drift or ignorance."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from effort import sized

from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel
from retuner.adaptive.region_model.split_or_merge import (
    AdviceKind,
    AdviceSettings,
    RegionAdvice,
    features,
    region_advice,
)
from retuner.schedule.regions import Axis, Regions

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


def test_two_processes_are_told_apart_and_the_border_lies_between_them() -> None:
    for seed in range(20):
        (found,) = advice(mixed(random.Random(seed), 2.5))
        assert found.kind is AdviceKind.SPLIT
        assert found.regions == ("cold",)
        assert 40.0 < found.border < 60.0
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


def test_no_room_for_the_hysteresis_no_border() -> None:
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
    assert 10.0 < found.border < 30.0
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
        assert (one.regions, one.axis, one.border) == (("cold", "hot"), "sp", 100.0)
        assert 1.0 < one.statistic <= one.limit == SETTINGS.merge_factor
        assert "The boundary at sp = 100 degC may go" in one.sentence


def test_on_a_map_a_border_goes_only_where_it_parts_nothing_at_all() -> None:
    equal_rows = {0: settled(1.0), 1: settled(2.0), 2: settled(1.0), 3: settled(2.0)}
    (found,) = region_advice(MAP, equal_rows, DT_S, SETTINGS)
    assert (found.axis, found.border, found.regions) == ("sp", 100.0, ("a", "c", "b", "d"))
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
