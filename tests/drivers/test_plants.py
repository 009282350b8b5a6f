"""The plants against analytic answers, and the oven's own linearisation against its nonlinear simulation."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import scipy.signal
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner import LinearProcess, PidGains, ProcessModel, ProcessType
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.rules.simc import simc
from retuner.drivers.plants.foreign_model import PlantFaultError
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.plants.oven_plant import OvenPlant, OvenSettings
from retuner.drivers.plants.plant import Plant
from retuner.drivers.plants.shared_plant import PlantPort, PortSettings, SharedPlant
from retuner.drivers.plants.state_space import StateSpaceModel
from retuner.drivers.plants.stepped import STEPS_PCT, SteppedPlant, rests_of

DT_S = 2.0
QUIET = OvenSettings(noise_c=0.0)


def step_response(plant: Plant, co: float, n: int, dt_s: float = DT_S, load: float = 0.0) -> np.ndarray:
    return np.array([plant.step(co, load, dt_s) for _ in range(n)])


@pytest.mark.parametrize("theta_s", [0.0, 0.3, 2.0, 7.77, 40.0])
def test_first_order_with_any_delay_is_the_analytic_response(theta_s: float) -> None:
    process = LinearProcess(2.5, (30.0,), (), theta_s)
    got = step_response(LinearPlant(process, start_pv=10.0, start_co=40.0), 44.0, 100)

    t = DT_S * np.arange(1, 101)
    expected = 10.0 + 2.5 * 4.0 * (1 - np.exp(-np.maximum(t - theta_s, 0) / 30.0))
    np.testing.assert_allclose(got, expected, atol=1e-11)


@pytest.mark.parametrize(
    "process",
    [
        LinearProcess(1.5, (20.0, 8.0, 3.0), (-4.0,), 4.0),
        LinearProcess(-0.7, (20.0, 8.0), (12.0, 5.0), 2.0),
        LinearProcess(0.02, (5.0,), (), 6.0, integrators=1),
        LinearProcess(1e-3, (), (), 2.0, integrators=2),
        LinearProcess(3.0, (), (), 6.0),
        ProcessModel(ProcessType.SOPDT, 1.0, 5.0, 5.0, zeta=0.5).linear(),
    ],
)
def test_any_process_is_the_response_of_its_transfer_function(process: LinearProcess) -> None:
    numerator, denominator = np.array([process.k]), np.array([1.0])
    for lead in process.leads_s:
        numerator = np.polymul(numerator, [lead, 1.0])
    for lag in process.lags_s:
        denominator = np.polymul(denominator, [lag, 1.0])
    for c1, c2 in process.quadratics:
        denominator = np.polymul(denominator, [c2, c1, 1.0])
    for _ in range(process.integrators):
        denominator = np.polymul(denominator, [1.0, 0.0])
    t = DT_S * np.arange(60)
    if len(denominator) > 1:
        _, reference = scipy.signal.step((numerator, denominator), T=t)
    else:
        reference = np.full(60, process.k)
    whole = round(process.theta_s / DT_S)
    got = step_response(LinearPlant(process, start_co=50.0), 51.0, 60)[whole - 1 : 59]

    np.testing.assert_allclose(got, reference[: len(got)], rtol=1e-7, atol=1e-9)


def test_linear_plant_clips_its_actuator_and_takes_load_at_its_input() -> None:
    process = LinearProcess(1.0, (4.0,))
    assert step_response(LinearPlant(process), 500.0, 50)[-1] == pytest.approx(50.0, abs=1e-9)
    assert step_response(LinearPlant(process), 50.0, 50, load=-3.0)[-1] == pytest.approx(-3.0, abs=1e-9)


def test_linear_plant_refuses_what_it_cannot_be() -> None:
    with pytest.raises(ValueError, match="more zeros than poles"):
        LinearPlant(LinearProcess(1.0, (1.0,), (2.0, 3.0)))
    plant = LinearPlant(LinearProcess(1.0, (4.0,), (), 3.0))
    plant.step(50.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="keep one sampling interval"):
        plant.step(50.0, 0.0, 0.5)
    with pytest.raises(ValueError, match="needs co"):
        plant.steady_co(1000.0)


@pytest.mark.parametrize("temp_c", [25.0, 55.0, 90.0, 120.0, 150.0, 185.0, 215.0])
def test_oven_linearisation_is_its_own_small_step_response(temp_c: float) -> None:
    oven = OvenPlant(QUIET, start_c=temp_c)
    co = oven.steady_co(temp_c)
    truth = oven.linearise(temp_c)
    move = 0.02
    nonlinear = step_response(oven, co + move, 800) - temp_c
    linear = step_response(LinearPlant(truth, start_co=co), co + move, 800)

    np.testing.assert_allclose(nonlinear, linear, atol=2e-3 * truth.k * move)


def test_oven_range_is_held_within_5_to_85_percent() -> None:
    oven = OvenPlant()
    assert 5.0 <= oven.steady_co(20.0) < oven.steady_co(220.0) <= 85.0
    with pytest.raises(ValueError, match="needs"):
        oven.steady_co(400.0)


def simc_gain(model: LinearProcess) -> float:
    """Kc of Skogestad (2003) with tau_c = theta after the half rule: an oracle of its own."""
    tau, sensor = model.lags_s
    theta = model.theta_s + sensor / 2
    return (tau + sensor / 2) / (model.k * 2 * theta)


def test_oven_regions_need_clearly_different_gains() -> None:
    oven = OvenPlant()
    cold, warm, hot = (simc_gain(oven.linearise(c)) for c in (55.0, 120.0, 185.0))
    assert cold * 1.3 < warm < hot / 1.3
    assert 2.0 < hot / cold < 4.0


def test_oven_load_acts_like_heater_power_without_delay() -> None:
    oven = OvenPlant(QUIET, start_c=100.0)
    co = oven.steady_co(100.0)
    assert oven.step(co, -5.0, DT_S) < 100.0 - 1e-4
    settled = step_response(oven, co, 3000, load=-5.0)[-1]
    assert oven.steady_co(settled, load=-5.0) == pytest.approx(co, abs=1e-6)


def test_oven_answer_does_not_depend_on_the_sampling() -> None:
    """A fourth of the integration step changes a move over half the range by less than 0.1 % of it."""
    coarse, fine = OvenPlant(QUIET, start_c=40.0), OvenPlant(QUIET, start_c=40.0)
    a = step_response(coarse, 80.0, 300, 2.0)
    b = step_response(fine, 80.0, 1200, 0.5)[3::4]
    assert np.max(np.abs(a - b)) < 1e-3 * (a[-1] - 40.0)
    assert a[-1] > 150.0


def test_oven_buffer_stays_small_and_trimming_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> tuple[list[float], int]:
        oven = OvenPlant(OvenSettings(), start_c=40.0, seed=3)
        values = [oven.step(30.0 + 20.0 * (i // 100 % 2), 0.0, DT_S) for i in range(5000)]
        return values, len(oven._times)

    untrimmed, _ = run()
    monkeypatch.setattr("retuner.drivers.plants.oven_plant.HISTORY_TRIM", 40)
    trimmed, size = run()
    np.testing.assert_allclose(trimmed, untrimmed, atol=1e-7)
    assert size < 100


def test_noise_is_seeded_and_has_its_sigma() -> None:
    def record(seed: int) -> np.ndarray:
        oven = OvenPlant(OvenSettings(noise_c=0.1), start_c=60.0, seed=seed)
        return step_response(oven, oven.steady_co(60.0), 4000) - 60.0

    assert np.array_equal(record(5), record(5))
    assert not np.array_equal(record(5), record(6))
    assert np.std(record(5)) == pytest.approx(0.1, rel=0.05)


BAD = st.sampled_from([math.nan, math.inf, -math.inf])


@given(bad=BAD, where=st.integers(0, 2))
@settings(max_examples=examples(20))
def test_non_finite_arguments_are_refused_and_nothing_moves(bad: float, where: int) -> None:
    arguments = [50.0, 0.0, 1.0]
    arguments[where] = bad
    for plant in (OvenPlant(start_c=50.0), LinearPlant(LinearProcess(1.0, (4.0,)), start_pv=50.0)):
        with pytest.raises(ValueError, match="finite"):
            plant.step(*arguments)
        assert plant.pv == 50.0


# The linear model of somebody else's plant, from steps on a copy of it.


Matrix = list[list[float]]


def stepped(
    a: Matrix, b: Matrix, c: Matrix, theta_s: float, rests: dict[float, float]
) -> tuple[SteppedPlant, list[str]]:
    """A plant about co 40 %, pv 50; and what was closed."""
    closed: list[str] = []

    def begin() -> tuple[PlantPort, Callable[[], None]]:
        plant = SharedPlant(StateSpaceModel(a, b, c, [], [[theta_s]]), [0.0], lambda _: None)
        settings = PortSettings("test", input_offset=-40.0, output_offset=50.0, start_co=40.0)
        return plant.port(settings), lambda: closed.append("one")

    return SteppedPlant(begin, rests, 1.0), closed


@pytest.mark.parametrize(
    ("a", "b", "c", "truth"),
    [
        ([[-0.02]], [[0.02]], [[1.5]], LinearProcess(1.5, (50.0,), (), 5.0)),
        ([[-0.02, 0.0], [0.1, -0.1]], [[0.02], [0.0]], [[0.0, -2.0]], LinearProcess(-2.0, (50.0, 10.0), (), 5.0)),
        ([[0.0]], [[0.001]], [[1.0]], LinearProcess(0.001, (), (), 5.0, 1)),
    ],
)
def test_a_step_on_a_copy_finds_the_process(a: Matrix, b: Matrix, c: Matrix, truth: LinearProcess) -> None:
    plant, closed = stepped(a, b, c, 5.0, {50.0: 40.0, 53.0: 42.0})
    found = plant.linearise(52.0)
    assert plant.linearise(90.0) is found
    assert len(closed) == 1 + truth.integrators, "each copy is ended, and asked once a rest"
    gains = simc_of(truth)
    assert sensitivity_peak(found, gains) == pytest.approx(sensitivity_peak(truth, gains), rel=0.01)


def test_a_rise_that_is_slow_against_the_sampling_is_no_tail_of_an_earlier_one() -> None:
    """A pH of a fermenter: 2500 s, sampled every 2 s, its sensor 15 s; it had been found with a gain of nothing."""
    plant, _ = stepped([[-0.0008, 0.0], [0.133, -0.133]], [[0.0008], [0.0]], [[0.0, 0.9]], 0.0, {50.0: 40.0})
    found = plant.linearise(50.0)
    assert found.k == pytest.approx(0.9, rel=0.02)
    assert found.lags_s[0] == pytest.approx(1250.0, rel=0.02)


def simc_of(truth: LinearProcess) -> PidGains:
    """Gains that the process bears."""
    if truth.integrators:
        return simc(ProcessModel(ProcessType.INTEGRATING, truth.k, 0.0, 0.0, truth.theta_s)).gains
    return simc(ProcessModel(ProcessType.FOPDT, truth.k, sum(truth.lags_s), 0.0, truth.theta_s)).gains


def test_a_copy_that_does_not_answer_is_no_process() -> None:
    plant, closed = stepped([[-0.02]], [[0.0]], [[1.0]], 0.0, {50.0: 40.0})
    with pytest.raises(PlantFaultError, match="a step of its copy tells no process"):
        plant.linearise(50.0)
    assert closed == ["one"] * len(STEPS_PCT)


def test_a_coarse_sensor_is_stepped_by_more() -> None:
    class Coarse(StateSpaceModel):
        def step(self, inputs: Sequence[float], dt_s: float) -> list[float]:
            return [0.32 * round(one / 0.32) for one in super().step(inputs, dt_s)]

    def begin() -> tuple[PlantPort, Callable[[], None]]:
        plant = SharedPlant(Coarse([[-0.02]], [[0.02]], [[1.5]], [], [[5.0]]), [0.0], lambda _: None)
        return plant.port(PortSettings("test", input_offset=-40.0, output_offset=50.0, start_co=40.0)), lambda: None

    found = SteppedPlant(begin, {50.0: 40.0}, 1.0).linearise(50.0)
    assert found.k == pytest.approx(1.5, rel=0.03)
    assert found.lags_s[0] == pytest.approx(50.0, rel=0.1)


def test_a_copy_that_dies_is_a_fault_and_no_traceback() -> None:
    class Dies:
        readings = (50.0,)

        def step(self, inputs: object, dt_s: float) -> tuple[float]:  # noqa: ARG002  the protocol has them
            raise PlantFaultError("its process was killed by SIGKILL")

        def close(self) -> None: ...

    def begin() -> tuple[PlantPort, Callable[[], None]]:
        return SharedPlant(Dies(), [0.0], lambda _: None).port(PortSettings("test")), lambda: None

    with pytest.raises(PlantFaultError, match="its process was killed by SIGKILL"):
        SteppedPlant(begin, {50.0: 40.0}, 1.0).linearise(50.0)


def test_the_co_that_holds_each_setpoint_is_that_of_its_end() -> None:
    sp = np.repeat([10.0, 20.0, 10.0, 30.0], [100, 100, 40, 5])
    co = np.repeat([1.0, 5.0, 2.0, 7.0], [100, 100, 40, 5]) + np.linspace(0.0, 0.1, 245)
    assert rests_of(sp, co) == pytest.approx({10.0: 2.1, 20.0: 5.07}, abs=0.02)
    many = np.repeat(np.arange(20.0), 20)
    assert len(rests_of(many, many)) == 5
    assert rests_of(sp[-5:], co[-5:]) == {}
