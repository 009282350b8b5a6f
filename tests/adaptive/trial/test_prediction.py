"""Promises against the exact performance, and their plain form."""

import json
import math

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import LinearProcess, PidGains, ProcessModel, ProcessType
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.performance import performance
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.trial.batch_responses import ClosedLoop, Upset, traces
from retuner.adaptive.trial.prediction import Prediction, Spread, predict, predict_without_model
from retuner.adaptive.trial.response_numbers import peaks_of, shape_of, swing

FOPDT = ProcessModel(ProcessType.FOPDT, 2.0, 50.0, 0.0, 5.0)
MODELS = (
    FOPDT,
    ProcessModel(ProcessType.FOPDT, 1.0, 3.0, 0.0, 30.0),
    ProcessModel(ProcessType.SOPDT, -0.5, 20.0, 8.0, 4.0),
    ProcessModel(ProcessType.SOPDT, 1.0, 10.0, 10.0, 3.0, 0.5),
    ProcessModel(ProcessType.INTEGRATING, 0.02, 0.0, 0.0, 5.0),
    ProcessModel(ProcessType.INTEGRATING_LAG, 0.02, 0.0, 6.0, 5.0),
    ProcessModel(ProcessType.DELAY, 0.8, 0.0, 0.0, 4.0),
)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: str(m.type))
@pytest.mark.parametrize("slower", [1.0, 3.0])
def test_iae_and_travel_are_those_of_the_exact_calculation(model: ProcessModel, slower: float) -> None:
    gains = simc(model, slower * model.theta_s).gains
    exact = performance(model.linear(), gains, derivative_on_setpoint=False)
    found = predict([Plausible(model, 0.0)], gains, gains)
    rough = 0.12 if model.type is ProcessType.DELAY else 0.06
    if not gains.kd:
        assert found.setpoint.iae.best == pytest.approx(exact.iae_setpoint, rel=rough)
        assert found.setpoint.travel.best == pytest.approx(exact.tv_setpoint, rel=rough)
    assert found.load_step.iae.best == pytest.approx(exact.iae_load, rel=rough)


def test_peaks_of_a_second_order_decay_have_the_ratio_of_theory() -> None:
    """PI on an integrator without dead time: 1 + (tau_i s) + tau_i/(k' kc) s^2, ratio exp(-pi zeta/sqrt(1-zeta^2))."""
    kc, tau_i, slope = 1.0, 1.0, 1.0
    zeta = 0.5 * math.sqrt(slope * kc * tau_i)
    ratio = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    [[load]] = traces([ClosedLoop(LinearProcess(slope, integrators=1), PidGains(kc, kc / tau_i))], [Upset(pulse=1.0)])
    first, second, third = peaks_of(load.e)
    assert abs(third / second) == pytest.approx(ratio, rel=0.05)
    assert first * second < 0 < first * third


def test_a_loop_that_runs_away_promises_nothing() -> None:
    unstable = PidGains(40.0, 2.0)
    good = simc(FOPDT, 5.0).gains
    found = predict([Plausible(FOPDT, 0.0)], good, unstable)
    assert math.isinf(found.setpoint.iae.best)
    assert found.load_step.decay.best >= 1.0
    assert math.isinf(found.patience_s)


def test_the_spread_holds_every_allowed_model_and_the_best_one_is_first() -> None:
    stiff = ProcessModel(ProcessType.FOPDT, 2.0, 40.0, 0.0, 8.0)
    gains = simc(FOPDT, 1.0).gains
    alone = [predict([Plausible(m, 0.0)], gains, gains).load_step.decay.best for m in (FOPDT, stiff)]
    both = predict([Plausible(FOPDT, 0.0), Plausible(stiff, 3.0)], gains, gains)
    assert both.load_step.decay.best == alone[0]
    assert both.load_step.decay.high >= alone[1] > alone[0]
    assert both.models == 2


def test_more_models_than_needed_are_cut_to_the_likeliest() -> None:
    models = [Plausible(ProcessModel(ProcessType.FOPDT, 2.0, 50.0 + i, 0.0, 5.0), float(i)) for i in range(40)]
    gains = simc(FOPDT, 5.0).gains
    assert predict(models, gains, gains).models == 16
    with pytest.raises(ValueError, match="at least one model"):
        predict([], gains, gains)


@settings(max_examples=examples(15))
@given(st.floats(0.01, 100), st.floats(0.02, 5), st.floats(0.2, 5))
def test_a_promise_scales_with_time_and_gain(scale_s: float, theta: float, k: float) -> None:
    def at(s: float, gain: float) -> Prediction:
        model = ProcessModel(ProcessType.FOPDT, gain, s, 0.0, s * theta)
        return predict([Plausible(model, 0.0)], simc(model, s * theta).gains, simc(model, 2 * s * theta).gains)

    one, other = at(1.0, 1.0), at(scale_s, k)
    assert other.setpoint.iae.best == pytest.approx(one.setpoint.iae.best * scale_s, rel=0.06)
    assert other.load_step.iae.best == pytest.approx(one.load_step.iae.best * scale_s * k, rel=0.06)
    assert other.load_step.decay.best == pytest.approx(one.load_step.decay.best, abs=0.03)


def test_plain_values_and_back() -> None:
    good = simc(FOPDT, 5.0).gains
    for found in (
        predict([Plausible(FOPDT, 0.0)], good, PidGains(40.0, 2.0)),
        predict([Plausible(FOPDT, 0.0)], good, good),
    ):
        assert Prediction.from_dict(json.loads(json.dumps(found.to_dict(), allow_nan=False))) == found


@pytest.mark.parametrize("values", [(1.0, 2.0, 3.0), (1.0, 0.0, 0.5), (math.nan, 0.0, 1.0)])
def test_a_spread_has_its_best_between_its_ends(values: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="low <= best <= high"):
        Spread(*values)


def test_without_a_model_a_promise_is_no_worse_than_what_was_seen() -> None:
    peaks = (Peak(1.0, 4.0), Peak(2.0, -2.0), Peak(3.0, 1.2))
    seen = Response(0.0, 4.0, peaks, Ending.COMPLETE, sp_changed=False, band=0.1)
    found = predict_without_model(seen, PidGains(2.0, 0.2), PidGains(1.8, 0.16))
    assert found.load_step.decay.high == pytest.approx(3.2 / 6.0)
    assert found.load_step.iae.best == pytest.approx(1 / 0.16)
    assert found.load_before.iae.best == pytest.approx(1 / 0.2)
    assert math.isinf(found.setpoint.iae.high)
    assert Prediction.from_dict(json.loads(json.dumps(found.to_dict(), allow_nan=False))) == found


@pytest.mark.parametrize(
    ("peaks", "expected"),
    [
        ([], (0.0, 0.0, 0.0)),
        ([2.0], (0.0, 0.0, 0.0)),
        ([2.0, -1.0], (0.5, 0.0, 0.1)),
        ([2.0, -0.05], (0.025, 0.0, 0.1 / 2.05)),
        ([2.0, -1.0, 0.5], (0.5, 0.5, 0.5)),
        ([2.0, -2.0, 0.2], (1.0, 0.55, 0.1)),
    ],
)
def test_swing(peaks: list[float], expected: tuple[float, float, float]) -> None:
    assert swing(peaks, unseen=0.1) == pytest.approx(expected)


def test_a_loop_without_integral_action_never_comes_to_rest() -> None:
    [[step]] = traces([ClosedLoop(LinearProcess(1.0, (10.0,), (), 1.0), PidGains(2.0, 0.0))], [Upset(setpoint=1.0)])
    assert math.isinf(shape_of(step, 0.0).iae)
