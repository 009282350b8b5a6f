"""The linear model of somebody else's plant, from steps on a copy of it."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import LinearProcess, ProcessModel, ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.drivers.plants.foreign_model import PlantFaultError
from retuner.drivers.plants.shared_plant import PlantPort, PortSettings, SharedPlant
from retuner.drivers.plants.state_space import StateSpaceModel
from retuner.drivers.plants.stepped import STEPS_PCT, SteppedPlant, rests_of
from retuner.schedule.gains import PidGains

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
