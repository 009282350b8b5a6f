"""Functional mock-up units of FMI 2 and 3: against analytic answers, with the standard's events, and what is told."""

import math
from dataclasses import replace
from pathlib import Path

import made_fmu
import pytest

from retuner.drivers.plants.fmu_model import FmuModel
from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError
from retuner.drivers.plants.plant_process import ModelInProcess

LAG = ModelSpec("fmu", "", ("u",), ("y",), (40.0,), {"tau": 20.0, "x": 10.0})
HEATER = ModelSpec("fmu", "", ("u",), ("y",), (40.0,), {"tau": 8.0})


@pytest.fixture(scope="module", params=[2, 3])
def lag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ModelSpec:
    version: int = request.param
    return replace(LAG, source=str(made_fmu.compiled(tmp_path_factory.mktemp("fmu"), version)))


@pytest.fixture(scope="module")
def heater(tmp_path_factory: pytest.TempPathFactory) -> ModelSpec:
    return replace(HEATER, source=str(made_fmu.heater(tmp_path_factory.mktemp("fmu"))))


def lag_at(t_s: float) -> float:
    """The lag with its events under u = 40 from x = 10: the gain doubles at 100 s, the lag above 50."""
    if t_s <= 100.0:
        return 40.0 - 30.0 * math.exp(-t_s / 20.0)
    at_100 = lag_at(100.0)
    crossing = 100.0 + 20.0 * math.log((80.0 - at_100) / 30.0)
    if t_s <= crossing:
        return 80.0 - (80.0 - at_100) * math.exp(-(t_s - 100.0) / 20.0)
    return 80.0 - 30.0 * math.exp(-(t_s - crossing) / 40.0)


@pytest.mark.parametrize("dt_s", [1.0, 7.0])
def test_model_exchange_with_time_and_state_events_is_the_analytic_response(lag: ModelSpec, dt_s: float) -> None:
    model = FmuModel(lag)
    assert model.readings == [10.0]
    for n in range(1, int(150 / dt_s)):
        assert model.step([40.0], dt_s)[0] == pytest.approx(lag_at(n * dt_s), rel=2e-4)
    model.close()


def test_model_exchange_settles_on_other_inputs(lag: ModelSpec) -> None:
    model = FmuModel(replace(lag, settle_s=90.0, start=(20.0,)))
    assert model.readings[0] == pytest.approx(20.0 - 10.0 * math.exp(-90 / 20), rel=1e-4)
    model.close()


def test_a_model_with_one_input_needs_no_names_and_shows_what_it_begins_with(lag: ModelSpec) -> None:
    model = FmuModel(replace(lag, inputs=(), outputs=(), start=(12.5,)))
    assert "u = 12.5" in model.described()[1]
    model.close()


def test_co_simulation_in_a_process_is_the_analytic_response(heater: ModelSpec) -> None:
    model = ModelInProcess(heater, 60.0)
    assert "FMI 2.0 co-simulation, Heater" in model.described[0]
    assert "tau = 8 (the FMU's own: 5)" in model.described[3]
    assert model.readings == [60.0]
    temps = [model.step([50.0], 1.0)[0] for _ in range(2000)]
    tau, sensor = 4000.0 / 20.0, 8.0
    for n in (10, 100, 500, 2000):
        lag = (tau * math.exp(-n / tau) - sensor * math.exp(-n / sensor)) / (tau - sensor)
        assert temps[n - 1] == pytest.approx(60.0 + 10.0 * (1 - lag), abs=2e-3)
    model.close()


def test_communication_steps_may_be_shorter_than_a_sample(heater: ModelSpec) -> None:
    short, long = FmuModel(replace(heater, step_s=0.3)), FmuModel(heater)
    got = [(short.step([50.0], 3.0)[0], long.step([50.0], 3.0)[0]) for _ in range(100)][-1]
    assert got[0] == pytest.approx(got[1], abs=2e-3)
    assert got[0] != got[1]
    short.close()
    long.close()


@pytest.mark.parametrize(
    ("change", "key", "text"),
    [
        ({"inputs": ("uu",)}, ("input",), "the nearest: u"),
        ({"inputs": ("y",)}, ("input",), "is not an input of the FMU but output"),
        ({"outputs": ("why",)}, ("output",), "the nearest: y"),
        ({"outputs": ("table",)}, ("output",), "is an array|there is no variable of the FMU"),  # FMI 3, 2
        ({"parameters": {"tua": 3.0}}, ("parameters", "tua"), "the nearest: tau"),
        ({"parameters": {"y": 3.0}}, ("parameters", "y"), "cannot be set"),
        ({"parameters": {"tau": "fast"}}, ("parameters", "tau"), "tau = 10.* is a number"),
        ({"interface": "co_simulation"}, ("interface",), "has no co_simulation; it has model_exchange"),
        ({"source": "nowhere.fmu"}, ("file",), "there is no such file"),
        ({"source": __file__}, ("file",), "cannot be read as an FMU"),
    ],
)
def test_what_is_wrong_is_told_by_name(lag, change, key, text):
    with pytest.raises(PlantFaultError, match=text) as told:
        FmuModel(replace(lag, **change))  # type: ignore[arg-type]
    assert told.value.key == key


def test_a_unit_with_one_input_and_one_output_needs_no_names(lag: ModelSpec) -> None:
    model = FmuModel(replace(lag, inputs=(), outputs=()))
    assert model.step([40.0], 1.0)[0] == pytest.approx(lag_at(1.0), rel=1e-4)
    model.close()


def test_the_folder_that_a_unit_is_unpacked_into_is_gone_afterwards(lag: ModelSpec) -> None:
    model = FmuModel(lag)
    folder = Path(model._folder)
    assert folder.is_dir()
    model.close()
    assert not folder.exists()
