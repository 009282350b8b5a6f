"""A variable from outside that moves pv by itself: a heater by the flow through it."""

from functools import cache

import numpy as np
import pytest

from retuner.adaptive.schedule_design.curves import Curves, curves
from retuner.adaptive.schedule_design.motion import Batch, Local, drifted, push_ways
from retuner.adaptive.schedule_design.record_stretches import CurveAxis, cut, signals_of
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.scheduling import silent

HOLD_UP, COLD, HEAT, DEAD = 600.0, 20.0, 40.0, 4
"""HOLD_UP dT/dt = flow (COLD - T) + HEAT co: slope gain 1/15 everywhere, lag HOLD_UP / flow, and the flow cools."""


def heater() -> tuple[Window, FloatArray]:
    """The flow steps through its range, the setpoint a little at each; PI control."""
    rng = np.random.default_rng(6)
    flows = np.repeat([10.0, 20.0, 30.0, 20.0, 12.0, 25.0], 200)
    sp = np.repeat([60.0, 62.0, 60.0, 63.0, 60.0, 62.0], 200)
    y, integral, rows = 60.0, 10.0, []
    past = [10.0] * DEAD
    for flow, target in zip(flows, sp, strict=True):
        pv = y + rng.normal(0.0, 0.05)
        integral += 0.04 * (target - pv)
        past.append(1.0 * (target - pv) + integral)
        rows.append((pv, past[-1]))
        y += (flow * (COLD - y) + HEAT * past.pop(0)) / HOLD_UP
    pv, co = np.array(rows).T
    return Window(np.arange(float(len(sp))), sp, pv, co), flows


@cache
def found(*, pushed: bool) -> Curves:
    window, flows = heater()
    return curves(cut(signals_of(window, flows, 1)), CurveAxis(10.0, 30.0), 1, silent, pushed=pushed)


@pytest.mark.slow
@pytest.mark.uncounted
def test_its_push_is_not_taken_for_the_process() -> None:
    told = found(pushed=True)
    for flow in (12.0, 20.0, 28.0):
        ln = told.ln(np.array([flow]))[0]
        assert np.exp(ln[0]) == pytest.approx(HEAT / HOLD_UP, rel=0.1)
        assert np.exp(ln[2]) == pytest.approx(HOLD_UP / flow, rel=0.25)
    assert np.exp(told.ln(np.array([20.0]))[0, 1]) == pytest.approx(DEAD, rel=0.25)


@pytest.mark.nightly
def test_left_out_of_the_model_it_becomes_loads_that_no_plant_has() -> None:
    with_push, without = (sum(map(len, found(pushed=pushed).joint.loads)) for pushed in (True, False))
    assert without > with_push


def test_a_ramp_of_the_flow_moves_pv_as_its_balance_says() -> None:
    """At constant co, from rest: what the flow does is a push of one size, and what pv's own way away adds to it."""
    n, fine, size = 300, 50, -(60.0 - COLD) / HEAT
    t = np.arange(float(n))
    flow = np.interp(t, [0.0, 20.0, 60.0], [10.0, 10.0, 25.0])
    co, y = 10.0 * (60.0 - COLD) / HEAT, np.full(n, 60.0)
    for i in range(n - 1):
        y[i + 1] = y[i]
        for j in range(fine):
            w = flow[i] + (flow[i + 1] - flow[i]) * (j + 0.5) / fine
            y[i + 1] += (w * (COLD - y[i + 1]) + HEAT * co) / HOLD_UP / fine
    window = Window(t, np.zeros(n), y, np.where(t < 5, co, co + 1e-9))
    batch = Batch.of(cut(signals_of(window, flow, 1)))
    shape = (len(batch.pv), 1, 1)
    lag = np.log(HOLD_UP / batch.x)[..., None]
    local = Local(np.full(shape, np.log(HEAT / HOLD_UP)), np.zeros(shape), lag, None)
    drift = drifted(batch, local, local.b + lag)
    # `away` is counted from the stretch's mean: from 60 it is, with the push, the same
    mean = float(np.mean(batch.pv))
    pushed = (size + (60.0 - mean) / HEAT) * push_ways(batch, local, [batch.x])[0]
    told = 60.0 + (pushed + drift)[:, 0, 0]
    assert np.ptp(y) > 20
    assert np.max(np.abs(told[:n] - y)) < 0.02 * np.ptp(y)
    assert np.max(np.abs(60.0 + pushed[:n, 0, 0] - y)) > 0.05 * np.ptp(y), "the drift is needed"
