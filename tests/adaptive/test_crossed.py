"""When a response counts as one that crossed a border: by its gains, or along the setpoint by the way of pv."""

import math
from dataclasses import replace

import numpy as np
import pytest

from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.question import ResponseRecord
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

GAINS = PidGains(1.0, 0.05)


def record(variable: str, pv: tuple[float, float], entered_s: float, *, sp_changed: bool = True) -> ResponseRecord:
    table = GainTable("loop", Regions(variable, "-", ("low", "high"), 0.0, (50.0,), 100.0), (GAINS, GAINS))
    values = np.linspace(*pv, 60).tolist()
    samples = [LoopSample(float(t), 60.0, y, 0.0, 0, 0, 60.0 if variable == "sp" else y) for t, y in enumerate(values)]
    response = Response(10.0, 59.0, (Peak(12.0, 5.0),), Ending.QUIET, sp_changed, 0.1)
    return ResponseRecord(1, response, Window.of(samples), samples, table, table, {}, entered_s=entered_s)


@pytest.mark.parametrize(("entered_s", "expected"), [(-math.inf, False), (5.0, False), (10.0, False), (30.0, True)])
def test_by_when_the_region_was_entered(entered_s: float, expected: bool) -> None:
    found = record("pv", (55.0, 70.0), entered_s)
    assert found.crossed is expected
    assert (found.pattern is None) is expected


def test_along_the_setpoint_by_where_pv_was() -> None:
    assert record("sp", (20.0, 60.0), 10.0).crossed
    assert not record("sp", (55.0, 65.0), 10.0).crossed
    assert not record("sp", (45.0, 52.0), 10.0, sp_changed=False).crossed  # a load: it came from nowhere else


def test_one_that_went_far_inside_its_region_is_fitted_in_motion() -> None:
    assert record("pv", (55.0, 70.0), -math.inf).moved
    assert not record("pv", (55.0, 62.0), -math.inf).moved
    alone = GainTable("loop", Regions("pv", "-", ("all",), 0.0, (), 100.0), (GAINS,))
    assert not replace(record("pv", (55.0, 95.0), -math.inf), region=0, table=alone).moved


def test_how_far_it_went_is_a_share_of_the_axis_and_nothing_where_there_is_one_region() -> None:
    found = record("pv", (55.0, 62.0), -math.inf)
    assert found.share == pytest.approx(0.07 * 49 / 59)  # of the response itself, which begins at 10 s
    alone = GainTable("loop", Regions("pv", "-", ("all",), 0.0, (), 100.0), (GAINS,))
    assert replace(found, region=0, table=alone).share == 0.0
