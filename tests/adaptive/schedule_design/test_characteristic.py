"""How co acts, apart from the place: phi itself, and an oven whose gain falls with its output, in a loop."""

import numpy as np
import pytest

from retuner.adaptive.schedule_design.curves import curves as curves_of
from retuner.adaptive.schedule_design.record_stretches import (
    Characteristic,
    CurveAxis,
    CurveShape,
    cut,
    signals_of,
    summed,
)
from retuner.adaptive.signals.sample import Window
from retuner.scheduling import silent

LAG_S, DEAD = 60.0, 6


def oven(co: float) -> float:
    """Rest at co: 3.2 per percent when cold, 0.8 when hot."""
    return 20 + 3.2 * co - 0.012 * co * co


def gain(pv: float) -> float:
    """d oven / d co at rest there."""
    co = (3.2 - np.sqrt(3.2**2 - 4 * 0.012 * (pv - 20))) / 0.024
    return 3.2 - 0.024 * co


def record() -> Window:
    """Large setpoint steps under PI control, with a kick of the output at each."""
    rng = np.random.default_rng(4)
    sp = np.repeat([50.0, 80.0, 110.0, 150.0, 180.0, 140.0, 100.0, 60.0], 240)
    co = integral = 9.738
    y, past, rows = oven(co), [co] * DEAD, []
    for target in sp:
        pv = y + rng.normal(0.0, 0.1)
        integral += 0.02 * (target - pv)
        co = min(max(1.0 * (target - pv) + integral, 0.0), 100.0)
        rows.append((pv, co))
        past.append(co)
        y += (oven(past.pop(0)) - y) * -np.expm1(-1 / LAG_S)
    pv, out = np.array(rows).T
    return Window(np.arange(len(sp), dtype=np.float64), sp, pv, out)


def test_without_coefficients_co_acts_as_it_is_and_a_slope_bends_it() -> None:
    co = np.linspace(-20, 120, 15)
    flat = Characteristic(CurveAxis(0.0, 100.0), CurveShape.BENT).felt(co, np.zeros((CurveShape.BENT - 1, 1)))[:, 0]
    assert flat - flat[2] == pytest.approx(co, abs=1e-9)
    line = Characteristic(CurveAxis(0.0, 100.0), CurveShape.LINE)
    felt = line.felt(co, np.array([[1.0, -1.0]]))
    rates = np.diff(felt, axis=0) / 10
    assert np.all(np.diff(rates[2:12, 0]) > 0)
    assert rates[:, 0][::-1] == pytest.approx(rates[:, 1])
    assert rates[0, 0] == pytest.approx(rates[1, 0]), "beyond the records its slope stays"


def test_records_are_summed_once_and_by_their_own_time() -> None:
    window = record()
    stretches = cut(signals_of(window, window.pv, 1))
    straight = Characteristic(CurveAxis(0.0, 100.0), CurveShape.LINE)
    sums = summed(straight, stretches, np.zeros((1, 1)))
    assert all(one is sums[0] for one in sums)
    assert sums[0][:, 0] == pytest.approx(stretches[0].signals.fired)


@pytest.mark.slow
def test_a_gain_that_follows_the_output_is_told_within_its_band_at_every_place() -> None:
    window = record()
    stretches = cut(signals_of(window, window.pv, 2))
    curves = curves_of(stretches, CurveAxis(50.0, 180.0), 1, silent)
    assert curves.form.felt is not None
    assert curves.form.shapes[2] is CurveShape.CONSTANT, "the lag waves where the characteristic is left out"
    for x in (60.0, 90.0, 120.0, 150.0, 175.0):
        ln, covariance = curves.ln(np.array([x]))[0], curves.ln_covariance(x)
        wanted = np.log(gain(x) / LAG_S)
        assert abs(ln[0] - wanted) < max(3 * np.sqrt(covariance[0, 0]), 0.03), x
        assert np.exp(ln[2]) == pytest.approx(LAG_S, rel=0.05)
