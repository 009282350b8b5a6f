"""A variable that goes after the loop is told from one that comes from outside."""

import numpy as np
import pytest
from schedule_cases import record, slow_sine

from retuner.adaptive.schedule_choice.schedule_from_records import _pairs
from retuner.adaptive.schedule_choice.scheduling_variables import SchedulingVariable, follows_loop
from retuner.adaptive.signals.sample import FloatArray


def lagged(x: FloatArray, lag_s: float) -> FloatArray:
    found = np.empty_like(x)
    found[0] = x[0]
    for i in range(1, len(x)):
        found[i] = found[i - 1] + (x[i] - found[i - 1]) / lag_s
    return found


@pytest.mark.parametrize("lag_s", [1.0, 20.0, 60.0])
def test_a_filtered_signal_of_the_loop_follows_it(lag_s: float) -> None:
    window = record()
    for signal in (window.pv, window.co):
        assert follows_loop([window], [3.0 * lagged(signal, lag_s) - 7.0])
    assert not SchedulingVariable("T2", (window.pv,), follows=True).outside


def test_a_signal_from_outside_does_not() -> None:
    window = record()
    n = len(window.t_s)
    walk = np.cumsum(np.random.default_rng(2).normal(size=n))
    for other in (slow_sine(n), walk, np.repeat([10.0, 30.0, 20.0, 40.0], n // 4)):
        assert not follows_loop([window], [other])
    assert SchedulingVariable("flow", (walk,)).outside


def test_what_shows_nothing_alone_is_tried_beside_the_best_where_that_does_not_settle() -> None:
    sp, pv, flow, load = (SchedulingVariable(name, (np.arange(9.0),)) for name in ("sp", "pv", "flow", "load"))
    able = [sp, pv, flow, load]

    assert _pairs(flow, able, {"flow"}, settles=False) == [(sp, flow), (pv, flow), (flow, load)]
    assert _pairs(pv, able, set(), settles=False) == [(pv, flow), (pv, load)]
    assert _pairs(pv, able, {"pv", "load"}, settles=True) == [(pv, load)]
    assert _pairs(pv, able, set(), settles=True) == []
