"""The boiler: at rest where it was started, its true model is what it does, lag and delay follow the flow."""

import math

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.drivers.plants.boiler_plant import BoilerPlant, BoilerSettings, flow_of

QUIET = BoilerSettings(noise_c=0.0, flow_noise_pct=0.0)


@pytest.mark.parametrize("start_c", [10.0, 30.0, 110.0])
def test_it_rests_where_it_starts(start_c: float) -> None:
    boiler = BoilerPlant(QUIET, start_c)
    co = boiler.steady_co(start_c)
    assert [boiler.step(co, 0.0, 2.0) for _ in range(50)] == pytest.approx([start_c] * 50, abs=1e-9)
    assert boiler.aux == 100.0


@settings(max_examples=examples(25))
@given(st.floats(20.0, 110.0), st.floats(-70.0, 30.0))
def test_valve_and_balance_belong_together(pv: float, load: float) -> None:
    boiler = BoilerPlant(QUIET)
    co = boiler.steady_co(pv, load)
    assert QUIET.power(co) == pytest.approx(flow_of(load) * (pv - QUIET.inlet_c), rel=1e-9)
    slope = (QUIET.power(co + 1e-4) - QUIET.power(co - 1e-4)) / 2e-4 / flow_of(load)
    assert boiler.linearise(pv, load).k == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize(("pv", "load"), [(40.0, 0.0), (95.0, 0.0), (40.0, -60.0), (95.0, 30.0)])
def test_a_small_step_is_that_of_the_true_model(pv: float, load: float) -> None:
    """Against the two lags and the delay in closed form; dt 0.5 s, so that the delay is met within a step."""
    boiler, dt_s = BoilerPlant(QUIET, pv), 0.5
    co = boiler.steady_co(pv, load)
    for _ in range(2000):
        boiler.step(co, load, dt_s)
    rest = boiler.pv
    assert rest == pytest.approx(pv, abs=1e-6)
    truth = boiler.linearise(pv, load)
    tau1, tau2 = truth.lags_s
    for i in range(1, 600):
        boiler.step(co + 0.01, load, dt_s)
        t = max(i * dt_s - truth.theta_s, 0.0)
        shape = 1.0 - (tau1 * math.exp(-t / tau1) - tau2 * math.exp(-t / tau2)) / (tau1 - tau2)
        assert (boiler.pv - rest) / (0.01 * truth.k) == pytest.approx(shape, abs=5e-3)


def test_the_pipe_is_plug_flow() -> None:
    """A jump of the tank's temperature arrives once the pipe's volume has passed, also while the flow changes."""
    settings = BoilerSettings(noise_c=0.0, flow_noise_pct=0.0, tank_s=1e-3, tau_sensor_s=1e-3)
    boiler = BoilerPlant(settings, 40.0)
    passed, arrived = 0.0, None
    for i in range(60):
        load = -50.0 if i % 2 else 20.0
        boiler.step(boiler.steady_co(60.0, load), load, 0.5)
        passed += 0.5 * flow_of(load)
        if arrived is None and boiler.pv > 50.0:
            arrived = passed
    assert arrived == pytest.approx(settings.pipe_s, abs=0.7)


def test_no_one_setting_suits_all_cells() -> None:
    """Why a table along two variables: SIMC's gain varies by 2 along either axis, its integral time by flow alone."""

    def tuned(pv: float, load: float) -> tuple[float, float]:
        truth = BoilerPlant(QUIET).linearise(pv, load)
        model = ProcessModel(ProcessType.SOPDT, truth.k, truth.lags_s[0], truth.lags_s[1], truth.theta_s)
        tuning = simc(model, truth.theta_s)
        return tuning.gains.kp, tuning.gains.kp / tuning.gains.ki

    warm, hot, low = tuned(40.0, 0.0), tuned(95.0, 0.0), tuned(40.0, -60.0)
    assert warm[0] / hot[0] > 2.0
    assert low[1] / warm[1] > 2.0


def test_a_long_run_forgets_the_water_that_has_passed() -> None:
    boiler = BoilerPlant(QUIET, 40.0)
    for _ in range(20_000):
        boiler.step(30.0, 0.0, 2.0)
    assert len(boiler._marks) < 10_000


def test_equal_seeds_give_equal_readings() -> None:
    one, two, other = (BoilerPlant(seed=seed) for seed in (3, 3, 4))
    readings = [[(plant.step(20.0, 0.0, 1.0), plant.aux) for _ in range(20)] for plant in (one, two, other)]
    assert readings[0] == readings[1] != readings[2]


def test_a_start_that_nothing_holds_and_steps_that_are_none() -> None:
    with pytest.raises(ValueError, match="the burner gives 0 to 160 K"):
        BoilerPlant(start_c=300.0)
    boiler = BoilerPlant(QUIET, 40.0)
    for step in ((math.nan, 0.0, 1.0), (1.0, math.inf, 1.0), (1.0, 0.0, 0.0)):
        with pytest.raises(ValueError, match="finite numbers and a positive dt_s"):
            boiler.step(*step)
