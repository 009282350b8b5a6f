"""A process that changes with pv and with a flow at once: both are found, each in its own parameter."""

import numpy as np
import pytest

import retuner
from retuner.adaptive.schedule_design.record_stretches import CurveShape
from retuner.adaptive.signals.sample import FloatArray, Window

LAG_S, HOLD = 30.0, 130
SETPOINTS = (30.0, 60.0, 80.0, 50.0, 25.0, 70.0, 45.0, 75.0, 35.0, 55.0)
FLOWS = (10.0, 20.0, 10.0, 30.0, 20.0, 30.0, 10.0, 20.0, 30.0, 10.0)


def slope(y: float) -> float:
    """Slope gain: falls by three over 20..80."""
    return float(0.09 * 3.0 ** (-(y - 20.0) / 60.0))


def theta_s(flow: float) -> float:
    return 80.0 / flow


def record() -> tuple[Window, FloatArray]:
    """dy/dt = slope(y) (u(t - theta(flow)) - rest(y)), PI control; the flow is another in every stretch."""
    rng = np.random.default_rng(8)
    n = HOLD * len(SETPOINTS)
    sp, flow = np.repeat(SETPOINTS, HOLD), np.repeat(FLOWS, HOLD)
    y, integral, rows = SETPOINTS[0], 20.0, []
    grid = np.linspace(0.0, 110.0, 400)
    rest = np.cumsum([1 / (slope(v) * LAG_S) for v in grid]) * (grid[1] - grid[0])
    integral = float(np.interp(y, grid, rest))
    past = [integral] * 12
    for i in range(n):
        pv = y + rng.normal(0.0, 0.05)
        integral += 0.012 * (sp[i] - pv)
        past.append(0.4 * (sp[i] - pv) + integral)
        rows.append((pv, past[-1]))
        u = past[-1 - round(theta_s(flow[i]))]
        for _ in range(4):
            y += slope(y) * (u - float(np.interp(y, grid, rest))) / 4
    pv, co = np.array(rows).T
    return Window(np.arange(float(n)), sp, pv, co), flow


@pytest.mark.nightly
def test_both_are_found_and_the_table_has_two_axes() -> None:
    window, flow = record()
    found = retuner.design_schedule(window, ["pv", "flow"], values={"flow": [flow]})
    assert (found.variable, found.second) == ("pv", "flow")
    form = found.design.curves.form
    assert form.shapes[0] > CurveShape.CONSTANT, "the slope gain changes with pv"
    assert form.second_shapes[1] > CurveShape.CONSTANT, "the dead time changes with the flow"
    for y in (35.0, 70.0):
        for w in (10.0, 20.0, 30.0):
            model = found.model_at(y, w)
            assert model.k / (model.tau1_s + model.tau2_s) == pytest.approx(slope(y), rel=0.2)
            assert model.theta_s + model.tau2_s / 2 == pytest.approx(theta_s(w), rel=0.2, abs=0.6)
    assert found.table.regions.second is not None
    assert found.to_dict()["second"] == "flow"
    with pytest.raises(ValueError, match="a value of each"):
        found.gains_at(50.0)
