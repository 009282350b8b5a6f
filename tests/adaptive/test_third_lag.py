"""A third lag is found as what it is: what lacks one was explained by a load step that never came, and k with it."""

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss

from retuner.adaptive.fit.dynamics import Clock, through_lag
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import refine
from retuner.adaptive.fit.search import with_third
from retuner.adaptive.fit.structure import LAG, SECOND, THIRD, parameters_of
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.robust_simc import swings
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.sample import FloatArray, Window

TOPDT = ProcessType.TOPDT
DT_S = 0.13


def record(seed: int, denominator: FloatArray, kc: float = 0.39, tau_i_s: float = 0.55) -> Window:
    """PI on 1/denominator: a setpoint step after 60 samples, 1 % noise."""
    rng, n = np.random.default_rng(seed), 220
    a, b, c, _, _ = cont2discrete(tf2ss([1.0], denominator), DT_S)
    x, integral = np.zeros(len(a)), 0.0
    pv, co, wanted = np.zeros(n), np.zeros(n), np.where(np.arange(n) >= 60, 1.0, 0.0)
    for i in range(n):
        pv[i] = float((c @ x).item()) + 0.01 * rng.standard_normal()
        integral += kc / tau_i_s * DT_S * (wanted[i] - pv[i])
        co[i] = kc * (wanted[i] - pv[i]) + integral
        x = a @ x + b[:, 0] * co[i]
    return Window(DT_S * np.arange(float(n)), wanted, pv, co)


SWINGS = np.polymul([1.0, 1.0], [1.0, 1.4, 1.0])
"""A lag and a damped second order: process P9 of Astrom and Hagglund's batch with T = 1."""


@pytest.mark.parametrize("seed", [1, 2])
def test_no_load_is_invented_and_the_gain_is_right(seed: int) -> None:
    found = identify_window(record(seed, SWINGS), sign=1)
    assert found.identifiable
    assert found.log.type == TOPDT
    assert found.load_times_s == ()
    assert found.log.model().k == pytest.approx(1.0, abs=2 * found.log.std()["k"])


def test_the_bigger_structure_is_never_the_worse_one_and_its_shortest_lag_is_the_third() -> None:
    of = Record.of(record(3, np.poly([-1.0, -1.0, -1 / 0.6])))
    plain = ProcessModel(ProcessType.SOPDT, 1.0, 1.2, 0.9, 0.4)
    fit = refine(Misfit(of, plain.type, 1, 0, of.noise_std, 0.3), parameters_of(plain))
    bigger = with_third(fit, TOPDT)
    total, c2, third = (math.exp(bigger.x[place[TOPDT]]) for place in (LAG, SECOND, THIRD))
    assert bigger.deviance < fit.deviance
    assert c2 > total / 4 or third <= total * (1 - math.sqrt(1 - 4 * c2 / total)) / 2 + 1e-9


@pytest.mark.parametrize("even", [True, False])
def test_a_ramp_through_a_lag_is_exact_at_any_interval(even: bool) -> None:
    t = np.arange(40) * 0.5 if even else np.cumsum(np.random.default_rng(1).uniform(0.1, 1.0, 40))
    t -= t[0]
    expected = t - 3.0 * -np.expm1(-t / 3.0)
    np.testing.assert_allclose(through_lag(Clock.of(t), t, 3.0), expected, atol=1e-9)


@pytest.mark.parametrize("model", [
    ProcessModel(TOPDT, 2.0, 9.0, 4.0, 1.0, tau3_s=2.0),
    ProcessModel(TOPDT, 2.0, 3.0, 2.0, 1.0, tau3_s=8.0),
    ProcessModel(TOPDT, 2.0, 3.0, 3.0, 1.0, 0.7, tau3_s=8.0),
])  # fmt: skip
def test_rules_take_it_by_the_half_rule(model: ProcessModel) -> None:
    linear = model.linear()
    assert isinstance(linear, LinearProcess)
    for order, found in ((1, without_second_lag(model)), (2, model.of_second_order())):
        expected = half_rule(linear, order=order)
        assert found.type == expected.type
        for name in ("k", "tau1_s", "tau2_s", "theta_s"):
            assert getattr(found, name) == pytest.approx(getattr(expected, name))


def test_it_swings_where_no_lag_is_longer_than_its_pair_of_poles() -> None:
    assert swings(ProcessModel(TOPDT, 1.0, 3.0, 3.0, 1.0, 0.7, tau3_s=2.0))
    assert not swings(ProcessModel(TOPDT, 1.0, 3.0, 3.0, 1.0, 0.7, tau3_s=8.0))


def test_only_this_structure_has_a_third_lag() -> None:
    with pytest.raises(ValueError, match="tau3_s = 2"):
        ProcessModel(ProcessType.SOPDT, 1.0, 3.0, 2.0, 1.0, tau3_s=2.0)
    with pytest.raises(ValueError, match="tau3_s = 0"):
        ProcessModel(TOPDT, 1.0, 3.0, 2.0, 1.0)


def test_equal_lags_are_known_as_far_as_the_misfit_says_and_not_its_derivative() -> None:
    found = identify_window(record(1, np.poly([-1.0, -1.0, -1.0])), sign=1)
    third = found.of(TOPDT).log
    assert max(np.linalg.eigvalsh(third.p)) < 1.0  # by the derivative alone a factor of e^3 either way
    assert third.gain_uncertainty(DT_S) < 0.25
