"""The finder on a map: filtered values choose, an unknown one holds, manual keeps the hysteresis."""

import json
import math

import numpy as np
import pytest

from retuner.adaptive.signals.sample import LoopMode, LoopSample
from retuner.adaptive.supervision.decision import Mode
from retuner.adaptive.supervision.response_finder import Left, ResponseFinder
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.supervision.state_file import remember, restore
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Axis, Regions
from retuner.schedule.table import GainTable

HEAT = Axis("sp", "degC", 0.0, (50.0,), 100.0, 2.0)
FLOW = Axis("can", "%", 0.0, (50.0,), 100.0, 5.0, 0.0, 4.0, "flow")
GAINS = tuple(PidGains(1.0 + i, 0.02) for i in range(4))
TABLE = GainTable("boiler", Regions.along(tuple("abcd"), HEAT, FLOW), GAINS)
SETTINGS = RetunerSettings(sample_time_s=1.0, pv_span=100.0, mode=Mode.ADVISE)
NAN = math.nan


def sample(t_s: float, x: float = 20.0, x2: float = 20.0, mode: int = LoopMode.AUTO, pv: float = 0.0) -> LoopSample:
    return LoopSample(t_s, 0.0, pv + 0.01 * (t_s % 3), 30.0 + 0.01 * (t_s % 2), mode, 0, x, 0, x2)


def watched(samples: list[LoopSample], table: GainTable = TABLE) -> tuple[ResponseFinder, list[object]]:
    finder = ResponseFinder(table.regions, table.at, SETTINGS)
    return finder, [seen for s in samples if (seen := finder.step(s)) is not None]


def test_the_second_variable_chooses_through_its_filter() -> None:
    samples = [sample(float(t), x2=20.0 if t < 10 else 90.0) for t in range(40)]
    finder, seen = watched(samples)
    assert seen == []
    assert finder.region == 1
    early = ResponseFinder(TABLE.regions, TABLE.at, SETTINGS)
    places = []
    for s in samples:
        early.step(s)
        places.append(early.region)
    assert places.index(1) == 13  # 20 + 70 (1 - 0.8^n) passes 50 + 5 with the 4th sample of the new value
    assert finder.scheduled[0] == 20.0
    assert finder.scheduled[1] == pytest.approx(90.0, abs=0.1)


def test_an_unknown_variable_keeps_its_axis_and_cuts_responses() -> None:
    samples = [sample(float(t)) for t in range(100)]
    samples += [sample(float(t), pv=5.0) for t in range(100, 104)]  # a response has begun
    samples += [sample(float(t), x2=NAN, x=80.0) for t in range(104, 110)]
    samples += [sample(float(t), x=80.0, x2=20.0) for t in range(110, 120)]
    finder, seen = watched(samples)
    cut = [s for s in seen if isinstance(s, Left)]
    assert cut[0] == Left(0, under_way=True)
    assert all(not s.under_way for s in cut[1:])
    assert finder.region == 2, "heat goes on by itself"
    assert finder.scheduled == (80.0, 20.0)


def test_nothing_begins_before_all_variables_are_known() -> None:
    finder, seen = watched([sample(float(t), x2=NAN) for t in range(5)])
    assert (finder.region, seen) == (None, [])
    finder.step(sample(5.0, x2=80.0))
    assert finder.region == 1


@pytest.mark.parametrize("wrong", [{"x": NAN}, {"x": math.inf}, {"pv": NAN}])
def test_what_comes_with_every_sample_must_be_a_number(wrong: dict[str, float]) -> None:
    finder, _ = watched([sample(float(t)) for t in range(5)])
    for first in (finder, ResponseFinder(TABLE.regions, TABLE.at, SETTINGS)):
        with pytest.raises(ValueError, match="is not finite"):
            first.step(sample(5.0, **wrong))


def test_numbers_whose_sum_is_beyond_all_are_numbers() -> None:
    finder, seen = watched([sample(float(t), pv=1e308, x=1e308) for t in range(5)])
    assert (finder.region, seen, len(finder.samples)) == (2, [], 5)


def test_a_second_variable_counts_only_where_there_are_two() -> None:
    row = GainTable("row", Regions.along(("cold", "hot"), HEAT), GAINS[:2])
    finder, seen = watched([sample(float(t), x2=NAN) for t in range(5)], row)
    assert (finder.region, seen, len(finder.samples)) == (0, [], 5)


def test_numbers_of_numpy_are_kept_as_plain_ones() -> None:
    finder, _ = watched([sample(float(t))._replace(x2=np.float64(90.0)) for t in range(40)])
    assert finder.region == 1
    assert {type(value) for s in finder.samples for value in s} <= {float, int, LoopMode}
    assert type(finder.scheduled[1]) is float


def test_manual_keeps_the_hysteresis() -> None:
    xs = [48.0, 51.0, 49.0, 51.9, 53.0, 49.0, 47.0]
    finder = ResponseFinder(TABLE.regions, TABLE.at, SETTINGS)
    places = []
    for t, x in enumerate(xs):
        finder.step(sample(float(t), x=x, mode=LoopMode.MANUAL))
        places.append(finder.region)
    assert places == [0, 0, 0, 0, 2, 2, 0]


def test_after_a_gap_the_place_is_taken_anew_where_it_is_known() -> None:
    finder, _ = watched([sample(float(t), x2=90.0) for t in range(5)])
    finder.step(sample(500.0, x=80.0, x2=NAN))
    assert finder.region == 3
    assert finder.scheduled == (80.0, 90.0)


def test_a_memory_taken_while_a_variable_is_unknown_goes_on_alike() -> None:
    samples = [sample(float(t), x2=NAN if 20 <= t < 40 else 20.0 + t) for t in range(80)]
    whole, parts = (Retuner(TABLE, SETTINGS) for _ in range(2))
    for t, s in enumerate(samples):
        whole.observe(s)
        parts.observe(s)
        if t in {5, 25, 60}:
            parts = restore(json.loads(json.dumps(remember(parts), allow_nan=False)), SETTINGS)
    assert remember(parts) == remember(whole)
    assert parts.region == 1
