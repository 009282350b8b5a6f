"""The process in motion against exact responses, and the shapes of curves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.schedule_design.motion import Batch, Local, response
from retuner.adaptive.schedule_design.stretches import KNOTS, Axis, Shape, cut, signals_of
from retuner.adaptive.signals.sample import Window


def stepped(n: int, at: int) -> Window:
    t = np.arange(n, dtype=np.float64)
    co = np.where(t < at, 0.0, 1.0)
    return Window(t, np.zeros(n), np.sin(t), co)


@given(st.floats(0.2, 6.0), st.floats(3.0, 200.0), st.floats(0.1, 5.0))
def test_a_constant_process_answers_as_a_first_order_lag_with_dead_time(theta: float, tau: float, b: float) -> None:
    window = stepped(200, 10)
    stretch = cut(signals_of(window, window.pv, 1))[0]
    batch = Batch.of([stretch])
    shape = (len(batch.pv), 1, 1)
    local = Local(*(np.full(shape, np.log(p)) for p in (b, theta, tau)), None)
    y = response(local, batch.arriving(np.full(shape, theta)), batch.h_s)[:, 0, 0]
    since = np.maximum(np.arange(200) - 10 - theta, 0.0)
    exact = b * tau * (1 - np.exp(-since / tau))
    assert np.max(np.abs(y - exact)) < 0.13 * b  # a step within an interval is one of its mean: second order in 1/tau
    assert y[-1] == pytest.approx(exact[-1], rel=0.02)


def test_a_second_lag_delays_by_itself() -> None:
    window = stepped(300, 10)
    batch = Batch.of([cut(signals_of(window, window.pv, 1))[0]])
    shape = (300, 1, 1)
    local = Local(*(np.full(shape, np.log(p)) for p in (0.1, 2.0, 30.0, 6.0)))
    y = response(local, batch.arriving(np.full(shape, 2.0)), batch.h_s)[:, 0, 0]
    since = np.maximum(np.arange(300) - 12.0, 0.0)
    exact = 3.0 * (1 - (30 * np.exp(-since / 30) - 6 * np.exp(-since / 6)) / 24)
    assert np.max(np.abs(y - exact)) < 0.01


@given(st.floats(-50, 50), st.floats(0.1, 100))
def test_bends_hold_no_line_and_shapes_are_nested(low: float, width: float) -> None:
    axis = Axis(low, low + width)
    x = axis.grid(KNOTS)
    bent = axis.columns(x, Shape.BENT)
    line = axis.columns(x, Shape.LINE)
    assert bent[:, :2] == pytest.approx(line)
    assert np.abs(line.T @ bent[:, 2:]).max() < 1e-9
    assert axis.columns(np.array([low - 9.0]), Shape.BENT)[0] == pytest.approx(bent[0])


def test_stretches_begin_before_setpoint_changes_and_end_with_the_record() -> None:
    t = np.arange(1000, dtype=np.float64)
    window = Window(t, np.where(t < 300, 1.0, 2.0), np.sin(t), np.cos(t))
    stretches = cut(signals_of(window, window.pv, 1))
    assert stretches[1].changed
    assert stretches[1].t_s[0] == 296.0
    assert sum(map(len, stretches)) == 1000
    assert max(map(len, stretches)) <= 400


def test_means_keep_the_integral_of_the_output() -> None:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.5, 1.5, 600))
    co = rng.normal(size=600)
    signals = signals_of(Window(t, np.zeros(600), rng.normal(size=600), co), co, 4)
    assert signals.fired[-1] == pytest.approx(float(np.sum(co * np.diff(t, append=t[-1] + np.median(np.diff(t))))))
