"""Loops on one plant: what their records show of it, and what closing them together comes to."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wood_berry import BLT, DT_S, MINUTE, WOOD_BERRY, column, records

from retuner import LinearProcess, PidGains
from retuner.adaptive.interaction.common_windows import seen_in
from retuner.adaptive.interaction.multivariable_fit import Element, Moved, StepAnswers, answers
from retuner.adaptive.interaction.together import Closed, together
from retuner.adaptive.loop.margins import margins


def alone(k: float, tau: float, theta: float, gains: PidGains) -> float:
    """Ms of a loop by itself, with half a sample of hold."""
    return margins(LinearProcess(k, (tau,), (), theta + DT_S / 2), gains).ms


@settings(max_examples=20)
@given(k=st.floats(0.5, 2.0), tau=st.floats(100.0, 1000.0), theta=st.floats(20.0, 100.0), share=st.floats(0.1, 1.0))
def test_loops_that_do_not_act_on_each_other_have_the_ms_that_they_have_alone(k, tau, theta, share):
    gains = PidGains.from_ideal(share * tau / (k * 2 * (theta + DT_S)), tau)
    nothing = Element(0.0, tau, 0.0, 0.0)
    first = StepAnswers((Element(k, tau, 0.0, theta), nothing), 0.0)
    second = StepAnswers((nothing, Element(-k, 2 * tau, 0.0, theta)), 0.0)
    found = together([first, second], [Closed(gains, DT_S), Closed(PidGains(-gains.kp, -gains.ki / 2), DT_S)])
    assert found[0] == pytest.approx(alone(k, tau, theta, gains), rel=0.01)
    assert found[1] == pytest.approx(alone(-k, 2 * tau, theta, PidGains(-gains.kp, -gains.ki / 2)), rel=0.01)


@settings(max_examples=20)
@given(own=st.floats(0.5, 1.0), cross=st.floats(1.5, 3.0), share=st.floats(0.3, 3.0))
def test_the_edge_of_stability_is_where_algebra_has_it(own: float, cross: float, share: float) -> None:
    """G = [[a, b], [b, a]] / (s + 1) under kp alone has its poles at -1 - kp (a + b) and -1 - kp (a - b)."""
    edge = 1.0 / (cross - own)
    gains = Closed(PidGains(share * edge, 0.0), 1e-6)
    rows = [
        StepAnswers((Element(x, 1.0, 0.0, 0.0), Element(y, 1.0, 0.0, 0.0)), 0.0)
        for x, y in ((own, cross), (cross, own))
    ]
    assert math.isinf(together(rows, [gains, gains])[0]) == (share > 1.0) or abs(share - 1.0) < 1e-3


def test_wood_and_berrys_column_under_the_gains_published_for_it_and_under_three_times_as_much() -> None:
    found = together(column(), [Closed(one, DT_S) for one in BLT])
    assert found == pytest.approx((1.44, 1.57), abs=0.03)
    three = together(column(), [Closed(PidGains(3 * one.kp, 3 * one.ki), DT_S) for one in BLT])
    assert three == (math.inf, math.inf)
    single = [
        alone(k, a * MINUTE, b * MINUTE, PidGains(3 * one.kp, 3 * one.ki))
        for (k, a, b), one in zip((WOOD_BERRY[0][0], WOOD_BERRY[1][1]), BLT, strict=True)
    ]
    assert max(single) < 5.0  # each by itself would stand it


def test_loops_whose_pairing_has_a_negative_relative_gain_are_not_stable_together() -> None:
    """Integral action in both, and det G(0) < 0: an odd number of unstable poles (Grosdidier et al. 1985)."""
    rows = [
        StepAnswers((Element(x, 10.0, 0.0, 1.0), Element(y, 10.0, 0.0, 1.0)), 0.0) for x, y in ((1.0, 1.5), (1.5, 1.0))
    ]
    assert together(rows, [Closed(PidGains(0.1, 0.005), 1.0)] * 2) == (math.inf, math.inf)


def test_moves_of_both_setpoints_show_the_whole_column() -> None:
    found = seen_in(records(0.01), DT_S)
    assert found is not None
    for factor in (1.0, 2.0):
        closed = [Closed(PidGains(factor * one.kp, factor * one.ki), DT_S) for one in BLT]
        assert together(found, closed) == pytest.approx(together(column(), closed), rel=0.1)


def test_a_plant_of_which_one_loop_has_not_moved_is_not_known() -> None:
    assert seen_in(records(0.01, (0, 0)), DT_S) is None


def test_a_window_of_a_dozen_samples_is_enough_for_a_quick_process() -> None:
    co = np.zeros((2, 12))
    co[0, 1:], co[1, 6:] = 1.0, 1.0
    pv = np.array([2.0 * (1.0 - math.exp(-(n - 1) / 1.5)) * (n > 1) for n in range(12)])
    pv += np.array([0.5 * (1.0 - math.exp(-(n - 6) / 1.5)) * (n > 6) for n in range(12)])
    found = answers([Moved(co, pv)], 1.0)
    assert found.left < 0.01
    assert found.elements[0].k == pytest.approx(2.0, rel=0.1)
