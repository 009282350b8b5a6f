"""What pv and co at rest say of the gain: a load that is invented against it loses, one that came does not."""

import math

import numpy as np
import pytest

from retuner.adaptive.fit.record import Record, RestRatio, rest_ratios
from retuner.adaptive.identification.estimate import LogModel, gain_spread
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.structure_choice import ChoiceSettings
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import Window

K = 2.0
NO_ZERO = FitSettings(ChoiceSettings(inverse=False))


def record(seed: int, *, sp: float = 1.0, load: float = 0.0, load_at: int = 90, inverse: float = 0.0) -> Window:
    """PI on a gain of 2, lags of 12 and 5 s, a dead time of 3 s and perhaps a zero; 1 % noise, the step at 60 s."""
    rng, n, delay = np.random.default_rng(seed), 400, 3
    pv, co, wanted = np.zeros(n), np.zeros(n), np.where(np.arange(n) >= 60, sp, 0.0)
    a, b, integral = 0.0, 0.0, 0.0
    for i in range(n):
        pv[i] = b - inverse * (a - b) / 5.0 + 0.01 * rng.standard_normal()
        integral += 0.25 / 17 * (wanted[i] - pv[i])
        co[i] = 0.25 * (wanted[i] - pv[i]) + integral
        entered = (co[i - delay] if i >= delay else 0.0) + (load if i >= load_at else 0.0)
        a += (K * entered - a) / 12.0
        b += (a - b) / 5.0
    return Window(np.arange(float(n)), wanted, pv, co)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_gain_at_rest_is_measured(seed: int) -> None:
    (found,) = rest_ratios(record(seed))
    assert abs(found.ratio - 1 / K) < 2 * found.std
    assert found.std < 0.1 / K


def test_a_record_without_setpoint_steps_has_no_ratio() -> None:
    assert rest_ratios(record(1, sp=0.0, load=1.0)) == ()
    assert Record.of(record(1)).rests == rest_ratios(record(1))


def test_what_a_contradiction_costs_has_an_end() -> None:
    at_rest = RestRatio(0.5, 0.025, 1.0)
    lag = np.log([1 / 12, 3.0, 24.0])  # k = 2
    assert at_rest.cost(ProcessType.FOPDT, lag, 1) == pytest.approx(0.0, abs=1e-6)
    tripled = np.log([3 / 12, 3.0, 24.0])
    assert 8 < at_rest.cost(ProcessType.FOPDT, tripled, 1) < at_rest.cost(ProcessType.FOPDT, lag, -1) < 15
    assert at_rest.cost(ProcessType.INTEGRATING, np.log([0.1, 3.0]), 1) > 8
    assert RestRatio(0.0, 0.025, 1.0).cost(ProcessType.INTEGRATING, np.log([0.1, 3.0]), 1) == pytest.approx(0.0)


def test_a_load_that_came_is_believed_against_the_rests() -> None:
    found = Fits(record(4, load=-0.4), (1,), FitSettings()).estimate(whatever_loads=True)
    (ratio,) = rest_ratios(record(4, load=-0.4))
    assert ratio.ratio > 1.5 / K  # the load is in it
    assert found.log.model().k == pytest.approx(K, rel=0.15)
    assert any(t == pytest.approx(90.0, abs=6.0) for t in found.load_times_s)


def test_two_lags_that_are_equal_are_known_as_well_as_two_that_are_not() -> None:
    """A derivative of the settings is infinite there: the gain once passed for uncertain by a factor of 2.3."""
    covariance = np.diag([0.02, 0.02, 0.03, 0.03]) ** 2
    logs = [LogModel(np.log([0.4, 1.3, 2.4, 2.4 * c2]), covariance, 1, ProcessType.SOPDT) for c2 in (0.2499, 0.2)]
    stds = [log.gain_uncertainty() for log in logs]
    assert max(stds) < 0.1
    drawn = np.random.default_rng(5).multivariate_normal(logs[0].x, covariance, 400)
    around = [Plausible(LogModel(x, covariance, 1, ProcessType.SOPDT).model(), 0.0) for x in drawn]
    assert 1.0 < stds[0] / gain_spread(around, 0.0) < 2.0
    assert math.isfinite(logs[0].std()["tau2"])
    assert logs[0].std()["tau2"] < 0.5


@pytest.mark.parametrize("seed", [2, 3, 6])
def test_a_load_invented_for_want_of_a_zero_loses_to_the_rests(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the structure that the process has, a load at the step pays; the gain that it brings is not the one."""
    window = record(seed, inverse=6.0)
    found = Fits(window, (1,), NO_ZERO).estimate()
    assert found.log.model().k == pytest.approx(K, rel=0.1)
    monkeypatch.setattr("retuner.adaptive.identification.candidate._at_rest", lambda _fit: 0.0)
    assert Fits(window, (1,), NO_ZERO).estimate().log.model().k > 1.15 * K
