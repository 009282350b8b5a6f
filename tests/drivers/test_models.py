"""Models of somebody else behind a bench: against analytic answers, on shared plants, and with faults injected."""

import json
import math
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError
from retuner.drivers.plants.identified import alike, load_of, model_of
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.plants.plant_process import ModelInProcess
from retuner.drivers.plants.python_model import PythonModel, find_object
from retuner.drivers.plants.recorded_load import LoadedPlant, RecordedLoad, RecordedLoads
from retuner.drivers.plants.shared_plant import MOST_TOLD, PlantPort, PortSettings, SharedPlant
from retuner.drivers.plants.state_space import StateSpaceModel, matrices_of
from retuner.drivers.recorded.recording import Recording

LAG = ([[-1 / 30]], [[2.5 / 30]], [[1.0]], [])  # 2.5/(30 s + 1)
# R. K. Wood and M. W. Berry, Chem. Eng. Sci. 28 (1973) 1707: a distillation column, time in minutes
WOOD_BERRY = {
    (0, 0): (12.8, 16.7, 1.0), (0, 1): (-18.9, 21.0, 3.0), (1, 0): (6.6, 10.9, 7.0), (1, 1): (-19.4, 14.4, 3.0),
}  # fmt: skip


def wood_berry() -> StateSpaceModel:
    elements = list(WOOD_BERRY.items())
    a = np.diag([-1 / tau for _, (_, tau, _) in elements])
    b, c, theta = np.zeros((4, 2)), np.zeros((2, 4)), np.zeros((2, 2))
    for n, ((i, j), (k, tau, theta_s)) in enumerate(elements):
        b[n, j], c[i, n], theta[i, j] = k / tau, 1.0, theta_s
    return StateSpaceModel(a.tolist(), b.tolist(), c.tolist(), [], theta.tolist())


@pytest.mark.parametrize("theta_s", [0.0, 0.3, 2.0, 7.77])
def test_a_state_space_with_any_dead_time_is_the_analytic_response(theta_s: float) -> None:
    model = StateSpaceModel(*LAG, [[theta_s]])
    got = [model.step([4.0], 2.0)[0] for _ in range(60)]
    t = 2.0 * np.arange(1, 61)
    np.testing.assert_allclose(got, 10.0 * (1 - np.exp(-np.maximum(t - theta_s, 0) / 30.0)), atol=1e-9)


@given(st.lists(st.sampled_from([0.1, 0.4, 0.7, 1.3]), min_size=5, max_size=40))
def test_a_state_space_does_not_depend_on_how_time_is_cut(steps: list[float]) -> None:
    whole, cut = StateSpaceModel(*LAG, [[0.55]]), StateSpaceModel(*LAG, [[0.55]])
    at_the_end = [cut.step([3.0], dt_s)[0] for dt_s in steps][-1]
    assert whole.step([3.0], sum(steps))[0] == pytest.approx(at_the_end, abs=1e-8)


def test_wood_berry_has_each_element_with_its_own_dead_time() -> None:
    for moved in (0, 1):
        model = wood_berry()
        inputs = [0.0, 0.0]
        inputs[moved] = 1.0
        got = np.array([model.step(inputs, 0.7) for _ in range(100)])
        t = 0.7 * np.arange(1, 101)
        for i in (0, 1):
            k, tau, theta = WOOD_BERRY[i, moved]
            np.testing.assert_allclose(got[:, i], k * (1 - np.exp(-np.maximum(t - theta, 0) / tau)), atol=1e-7)


def test_systems_of_python_control_and_scipy_are_taken() -> None:
    ours = [StateSpaceModel(*LAG, [[0.0]]).step([1.0], 9.0)[0]]
    for system in (
        control.tf([2.5], [30, 1]),
        control.ss(*LAG[:3], [[0.0]]),
        scipy.signal.lti([2.5], [30, 1]),
        scipy.signal.StateSpace(*LAG[:3], [[0.0]]),
    ):
        model = StateSpaceModel(*matrices_of(system), [[0.0]])
        assert model.step([1.0], 9.0)[0] == pytest.approx(ours[0], rel=1e-9)
    with pytest.raises(PlantFaultError, match="is sampled"):
        matrices_of(control.ss(*LAG[:3], [[0.0]], 0.5))
    with pytest.raises(PlantFaultError, match="is a TransferFunction that has no state space"):
        matrices_of(control.tf([1, 0, 0], [1, 1]))
    with pytest.raises(PlantFaultError, match="is a dict"):
        matrices_of({})


@pytest.mark.parametrize(
    ("change", "key", "text"),
    [
        ({0: [[1.0, 2.0]]}, "a", "must be 1 x 1"),
        ({1: [[1.0], [2.0]]}, "b", "must be 1 x 1"),
        ({2: [[1.0, 1.0]]}, "c", "must be 1 x 1"),
        ({0: [[math.nan]]}, "a", "not finite"),
        ({4: [[-1.0]]}, "theta_s", "negative"),
    ],
)
def test_matrices_that_do_not_fit_are_told(change: dict[int, object], key: str, text: str) -> None:
    given_ones: list[object] = [*LAG, [[0.0]]]
    for place, value in change.items():
        given_ones[place] = value
    with pytest.raises(PlantFaultError, match=text) as told:
        StateSpaceModel(*given_ones)  # type: ignore[arg-type]
    assert told.value.key == (key,)


# Loops on one model.


class Held:
    """A device that holds an output."""

    def __init__(self, co: float) -> None:
        self.co, self.load = co, 0.0


def ports(model: StateSpaceModel, said: list[str] | None = None) -> list[PlantPort]:
    plant = SharedPlant(model, [0.0, 0.0], (said if said is not None else []).append)
    return [plant.port(PortSettings("column", i, i, input_offset=-50.0, output_offset=10.0)) for i in (0, 1)]


def test_loops_of_one_plant_act_on_each_other_without_a_sample_of_delay() -> None:
    alone = wood_berry()
    one, other = ports(wood_berry())
    first, second = Held(50.0), Held(50.0)
    one.held_by, other.held_by = first, second
    for n in range(60):
        first.co, second.co = 50.0 + (n > 3), 50.0 - (n > 20)  # decided in the last sample of each
        got = (one.step(first.co, 0.0, 1.0) - 10.0, other.step(second.co, 0.0, 1.0) - 10.0)
        assert got == pytest.approx(alone.step([first.co - 50.0, second.co - 50.0], 1.0), abs=1e-12)


def test_loops_with_other_sample_times_share_the_plant_s_time() -> None:
    fast, slow = ports(wood_berry())
    fast.held_by, slow.held_by = Held(51.0), Held(50.0)
    for n in range(1, 41):
        pv = fast.step(51.0, 0.0, 0.5)
        if n % 6 == 0:
            slow.step(50.0, 0.0, 3.0)
    k, tau, theta = WOOD_BERRY[0, 0]
    assert pv - 10.0 == pytest.approx(k * (1 - math.exp(-(20.0 - theta) / tau)), abs=1e-7)
    assert fast.plant.t_s == pytest.approx(20.0)


def test_a_port_keeps_the_plants_contract() -> None:
    port, _ = ports(wood_berry())
    assert port.pv == 10.0
    assert port.steady_co(port.pv) == 50.0
    for wrong in ((math.nan, 0.0, 1.0), (50.0, math.inf, 1.0), (50.0, 0.0, 0.0)):
        with pytest.raises(ValueError, match="finite"):
            port.step(*wrong)
    assert port.plant.t_s == 0.0
    assert port.step(50.0, 0.0, 1.0) == 10.0
    with pytest.raises(ValueError, match="is not known"):
        port.steady_co(11.0)


def test_noise_of_a_port_is_the_same_for_the_same_seed() -> None:
    def noisy(seed: int) -> list[float]:
        plant = SharedPlant(StateSpaceModel(*LAG, [[0.0]]), [0.0], [].append)
        port = plant.port(PortSettings("lag", input_offset=-50.0, noise=0.3, seed=seed))
        return [port.step(50.0, 0.0, 1.0) for _ in range(400)]

    assert noisy(1) == noisy(1) != noisy(2)
    assert np.std(noisy(1)) == pytest.approx(0.3, rel=0.15)


# A recorded load.


def test_a_recorded_load_acts_at_input_or_output_from_its_first_value_on() -> None:
    t_s, column = np.array([0.0, 10.0, 20.0]), np.array([7.0, 9.0, 6.0])
    load = RecordedLoad(t_s, column, scale=2.0)
    assert [load.at(t) for t in (0.0, 5.0, 10.0, 99.0)] == [0.0, 2.0, 4.0, -2.0]
    assert RecordedLoad(t_s, column, repeat=True).at(25.0) == 1.0
    at_input = LoadedPlant(LinearPlant(LinearProcess(1.5)), RecordedLoads([load]))
    at_output = LoadedPlant(LinearPlant(LinearProcess(1.5)), RecordedLoads([RecordedLoad(t_s, column, at_output=True)]))
    assert at_input.pv == at_output.pv == 0.0
    assert at_input.step(50.0, 0.0, 5.0) == pytest.approx(1.5 * 1.0)  # the mean over the step
    assert at_output.step(50.0, 0.0, 5.0) == pytest.approx(1.0)
    assert at_output.pv == pytest.approx(1.0)
    for wrong in (([0.0], [1.0]), ([0.0, 0.0], [1.0, 2.0]), ([0.0, 1.0], [1.0, math.nan])):
        with pytest.raises(ValueError, match="two rows"):
            RecordedLoad(np.array(wrong[0]), np.array(wrong[1]))


def test_every_loop_of_a_shared_plant_has_its_own_loads() -> None:
    plant = SharedPlant(wood_berry(), [0.0, 0.0], [].append)
    load = RecordedLoads([RecordedLoad(np.array([0.0, 1e-9, 1e9]), np.array([0.0, 1.0, 1.0]))])
    one = plant.port(PortSettings("column", 0, 0, input_offset=-50.0))
    plant.port(PortSettings("column", 1, 1, input_offset=-50.0), load)
    pv = [one.step(50.0, 0.0, 1.0) for _ in range(30)][-1]
    k, tau, theta = WOOD_BERRY[0, 1]
    assert pv == pytest.approx(k * (1 - math.exp(-(30.0 - theta) / tau)), rel=1e-6)


# Python classes, in this process.


class Tank:
    """A user's class as small as it may be."""

    def __init__(self, tau: float = 10.0) -> None:
        self.tau, self.level = tau, 0.0

    def step(self, co: float, dt: float) -> float:
        self.level = co + (self.level - co) * math.exp(-dt / self.tau)
        return self.level


class Pair:
    """Of two loops."""

    pv = {"low": 3.0, "high": 4.0}  # noqa: RUF012  as a user may write it

    def step(self, co: dict[str, float], dt: float) -> dict[str, float]:
        return {"low": co["a"] + dt, "high": co["b"], "more": 5.0}


def spec(name: str, inputs: Sequence[str] = (), outputs: Sequence[str] = (), **parameters: float) -> ModelSpec:
    start = (0.0,) * (len(inputs) or 1)
    return ModelSpec("python", f"{__file__}:{name}", tuple(inputs), tuple(outputs), start, parameters)


def test_a_class_with_a_step_is_a_plant() -> None:
    model = PythonModel(spec("Tank", tau=5.0))
    assert model.readings == [0.0]
    assert model.step([3.0], 5.0) == pytest.approx([3.0 * (1 - math.exp(-1))])
    assert "tau: float = 10.0" in model.described()[0]


def test_a_class_of_several_loops_takes_and_gives_dicts_by_name() -> None:
    model = PythonModel(spec("Pair", ("b", "a"), ("high", "low", "more")[:2]))
    assert model.readings == [4.0, 3.0]
    assert model.step([7.0, 8.0], 1.0) == [7.0, 9.0]


@pytest.mark.parametrize(
    ("which", "key", "text"),
    [
        (spec("Tonk"), ("model",), "the nearest: Tank"),
        (spec("Tank", tua=1.0), ("parameters", "tua"), "the nearest: tau"),
        (spec("wood_berry"), ("model",), "no method step"),
        (spec("Pair", ("a", "b"), ("low", "hihg")), ("output",), "the nearest: high"),
        (ModelSpec("python", "nowhere.py:Tank", (), (), (0.0,)), ("model",), "there is no file nowhere.py"),
        (ModelSpec("python", "nowhere:Tank", (), (), (0.0,)), ("model",), "there is no module nowhere"),
        (ModelSpec("python", "nothing", (), (), (0.0,)), ("model",), "names no object"),
    ],
)
def test_what_is_wrong_with_a_class_is_told_with_the_nearest_name(which, key, text):
    with pytest.raises(PlantFaultError, match=text) as told:
        PythonModel(which)
    assert told.value.key == key


def test_a_user_s_file_may_import_what_lies_beside_it(tmp_path: Path) -> None:
    (tmp_path / "beside_it.py").write_text("GAIN = 3.0\n")
    (tmp_path / "uses_it.py").write_text("from beside_it import GAIN\n")
    assert find_object(f"{tmp_path / 'uses_it.py'}:GAIN") == 3.0
    sys.path.remove(str(tmp_path))


# Faults: in a process of its own, as a bench has them.

FAULTY = """
import math, os, threading, time

class Unprintable(Exception):
    def __str__(self):
        raise RuntimeError

class Faulty:
    pv = 1.0

    def __init__(self, fault, at=3):
        self.fault, self.at, self.n = fault, at, 0
        self.lock = threading.Lock()  # cannot be copied, so that no step is tried on a copy
        if fault == "beginning":
            raise RuntimeError("no licence")

    def step(self, co, dt):
        self.n += 1
        if self.n != self.at:
            return co + dt
        if self.fault == "error":
            return 1 / 0
        if self.fault == "nan":
            return math.nan
        if self.fault == "none":
            return None
        if self.fault == "key":
            raise KeyboardInterrupt
        if self.fault == "ask":
            return input()
        if self.fault == "unprintable":
            raise Unprintable
        if self.fault == "long":
            return 10**400
        if self.fault == "huge":
            return 1e300
        if self.fault == "exit":
            os._exit(7)
        if self.fault == "abort":
            os.abort()
        if self.fault == "print":
            print("a line of the model's")
            return co + dt
        while self.fault == "hang" or (self.fault == "slow" and not os.path.exists(SLOW)):
            time.sleep(0.001)
        return co + dt
"""


class StoppedClock:
    """The machine's clock in the test's hands."""

    def __init__(self) -> None:
        self.t_s = 0.0

    def now_s(self) -> float:
        return self.t_s

    def wait_until(self, t_s: float) -> None:
        self.t_s = t_s


class Bench:
    """A faulty model in its process, and a port on it."""

    def __init__(self, folder: Path, fault: str, at: int = 3, wait_s: float | None = None) -> None:
        self.flag = folder / "go"
        source = folder / "faulty.py"
        source.write_text(textwrap.dedent(FAULTY).replace("SLOW", repr(str(self.flag))))
        self.clock, self.said = StoppedClock(), list[str]()
        made = ModelSpec("python", f"{source}:Faulty", (), (), (2.0,), {"fault": fault, "at": at})
        self.model = ModelInProcess(made, 60.0, wait_s, self.clock)
        plant = SharedPlant(self.model, [2.0], self.said.append)
        self.port = plant.port(PortSettings("faulty.py:Faulty", start_co=2.0))

    def steps(self, count: int) -> list[float]:
        return [self.port.step(2.0, 0.0, 1.0) for _ in range(count)]


@pytest.fixture
def bench() -> Iterator[list[Bench]]:
    made: list[Bench] = []
    yield made
    for one in made:
        one.model.close()


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("error", r"ZeroDivisionError: division by zero \(line 22 of .*faulty.py\)"),
        ("key", r"KeyboardInterrupt \(line 28 of .*faulty.py\)"),
        ("ask", r"EOFError: EOF when reading a line \(line 30 of .*faulty.py\)"),
        ("unprintable", r"Unprintable: it cannot be printed \(line 32 of .*faulty.py\)"),
        ("long", r"step returned 10{57,59} \.\.\. as pv"),
        ("none", "step returned None as pv"),
        ("exit", "its process ended with status 7"),
        ("abort", "its process was killed by SIGABRT"),
    ],
)
def test_a_plant_that_dies_is_one_line_and_no_reading(tmp_path, bench, fault, text):
    bench.append(Bench(tmp_path, fault))
    got = bench[0].steps(5)
    assert got[:2] == [3.0, 3.0]
    assert all(map(math.isnan, got[2:]))
    (line,) = bench[0].said
    assert re.search(text, line)
    assert line.startswith("plant faulty.py:Faulty stopped at 3 s of its time: ")
    assert "a fault of the bench, not of the device" in line


def test_a_reading_that_is_no_number_is_told_once_and_may_pass(tmp_path: Path, bench: list[Bench]) -> None:
    for fault, told in (("nan", "nan"), ("huge", "1e+300")):
        bench.append(one := Bench(tmp_path, fault))
        got = one.steps(5)
        assert [math.isnan(pv) for pv in got] == [False, False, True, False, False]
        assert len(one.said) == 2
        assert f"gives {told} as output 1 from 3 s" in one.said[0]
        assert "gives readings again, from 4 s" in one.said[1]
        assert one.port.plant.fault == ""


class Flickering:
    """A model without a reading at every other step."""

    readings = (1.0,)

    def __init__(self) -> None:
        self.n = 0

    def step(self, inputs: Sequence[float], dt_s: float) -> Sequence[float]:
        self.n += 1
        return [math.inf if self.n % 2 else inputs[0] * dt_s]

    def close(self) -> None:
        """Nothing is held."""


def test_readings_that_come_and_go_are_told_a_few_times_and_a_lost_one_at_the_end_is_a_fault() -> None:
    said: list[str] = []
    plant = SharedPlant(Flickering(), [0.0], said.append)
    port = plant.port(PortSettings("flickering"))
    got = [port.step(2.0, 0.0, 1.0) for _ in range(41)]
    assert [math.isnan(pv) for pv in got] == [True, False] * 20 + [True]
    assert len(said) == MOST_TOLD
    assert said[-1].endswith("; this is not told again")
    assert "gives inf as output 1 from 41 s of its time on" in plant.fault
    port.step(2.0, 0.0, 1.0)
    assert plant.fault == ""


def test_what_a_model_prints_does_not_get_among_its_answers(tmp_path: Path, bench: list[Bench]) -> None:
    bench.append(Bench(tmp_path, "print"))
    assert bench[0].steps(5) == [3.0] * 5
    assert bench[0].said == []


def test_a_model_that_cannot_begin_says_why(tmp_path: Path) -> None:
    with pytest.raises(PlantFaultError, match="RuntimeError: no licence"):
        Bench(tmp_path, "beginning")


def test_a_hanging_plant_is_given_up_by_the_machine_s_clock_and_the_samples_go_on(tmp_path, bench):
    bench.append(Bench(tmp_path, "hang", at=1, wait_s=0.0))
    one = bench[0]
    for later_s in (0.0, 59.0, 2.0):
        one.clock.t_s += later_s
        assert all(map(math.isnan, one.steps(3)))
    assert len(one.said) == 2
    assert "does not answer from 1 s of its time on" in one.said[0]
    assert "stopped at 7 s of its time: no answer to a step within 60 s of the machine's" in one.said[1]


def test_a_slow_plant_comes_back(tmp_path: Path, bench: list[Bench]) -> None:
    bench.append(Bench(tmp_path, "slow", at=1, wait_s=0.0))
    one = bench[0]
    assert all(map(math.isnan, one.steps(3)))
    one.flag.touch()
    while math.isnan(one.steps(1)[0]):  # until its process has seen the flag
        pass
    assert "does not answer from 1 s" in one.said[0]
    assert "gives readings again" in one.said[1]


def test_in_simulated_time_a_step_is_waited_for(tmp_path: Path, bench: list[Bench]) -> None:
    bench.append(Bench(tmp_path, "slow"))
    bench[0].flag.touch()
    assert bench[0].steps(4) == [3.0] * 4
    assert bench[0].said == []


# The plant of a record.


def recorded(load: np.ndarray) -> tuple[LinearProcess, Recording]:
    """A record of a known process under a known load at its output, co moving as a controller's would."""
    process = LinearProcess(1.5, (30.0,), (), 4.0)
    plant = LinearPlant(process, start_co=40.0)
    co = 40.0 + 5.0 * np.sin(0.05 * np.arange(len(load))) + 3.0 * (np.arange(len(load)) > 100)
    pv = np.array([0.0, *(plant.step(float(one), 0.0, 2.0) for one in co[:-1])]) + 70.0 + load
    return process, Recording("record", 2.0 * np.arange(len(load)), pv, co)


def test_the_load_of_a_record_is_what_its_model_leaves() -> None:
    load = 0.3 * np.cumsum(np.random.default_rng(1).normal(size=500))
    process, record = recorded(load)
    found = load_of(process, record.t_s, record.pv, record.co)
    np.testing.assert_allclose(found.values, load - load[0], atol=1e-9)


def test_a_load_alike_has_the_same_spectrum_and_another_course() -> None:
    load = np.convolve(np.random.default_rng(2).normal(size=500), np.ones(9) / 9, mode="same")
    process, record = recorded(load)
    own = load_of(process, record.t_s, record.pv, record.co)
    one, other = alike(own, 1), alike(own, 2)
    straight = own.values - np.linspace(own.values[0], own.values[-1], len(load))
    for drawn in (one, other):
        np.testing.assert_allclose(np.abs(np.fft.rfft(drawn.values)), np.abs(np.fft.rfft(straight)), atol=1e-8)
    assert abs(np.corrcoef(one.values, other.values)[0, 1]) < 0.5
    assert alike(own, 1).values.tolist() == one.values.tolist()


def test_a_bench_repeats_the_plant_of_a_record(tmp_path: Path) -> None:
    """The record's own load and co give the record's pv again."""
    load = 0.2 * np.cumsum(np.random.default_rng(3).normal(size=300))
    process, record = recorded(load)
    (tmp_path / "found.json").write_text(
        '{"model": {"type": "fopdt", "k": 1.5, "tau1": 30.0, "tau2": 0.0, "theta": 4.0}}'
    )
    assert model_of(tmp_path / "found.json") == process
    swings = {"model": {"type": "sopdt", "k": 2.0, "tau1": 5.0, "tau2": 5.0, "theta": 1.0, "zeta": 0.4}}
    (tmp_path / "swings.json").write_text(json.dumps(swings))
    plant = LinearPlant(model_of(tmp_path / "swings.json"), start_co=0.0)
    assert max(plant.step(1.0, 0.0, 0.5) for _ in range(100)) == pytest.approx(2 * 1.254, rel=0.01)
    again = LoadedPlant(
        LinearPlant(process, start_pv=float(record.pv[0]), start_co=float(record.co[0])),
        RecordedLoads([load_of(process, record.t_s, record.pv, record.co)]),
    )
    got = [again.step(float(co), 0.0, 2.0) for co in record.co[:-1]]
    np.testing.assert_allclose(got, record.pv[1:], atol=1e-8)
    for content, told in (
        ("{}", "holds no model"),
        ("nothing", "cannot be read"),
        ('{"model": {"type": "x"}}', "found.json"),
    ):
        (tmp_path / "found.json").write_text(content)
        with pytest.raises(PlantFaultError, match=told) as wrong:
            model_of(tmp_path / "found.json")
        assert wrong.value.key == ("file",)


MIX = """
class Mix:
    pv = {"level": 50.0}
    steps = 0
    def step(self, co, dt):
        self.steps += 1
        return {"level": co["inflow"] * self.steps}
"""


def test_names_that_a_class_does_not_know_are_told_before_a_run_and_nothing_has_moved(tmp_path: Path) -> None:
    source = tmp_path / "mix.py"
    source.write_text(MIX)
    for inputs, outputs, text in (("inflw", "level", "'inflow'"), ("inflow", "lvl", "the nearest: level")):
        with pytest.raises((PlantFaultError, KeyError), match=text):
            PythonModel(ModelSpec("python", f"{source}:Mix", (inputs,), (outputs,), (2.0,), {}))
    model = PythonModel(ModelSpec("python", f"{source}:Mix", ("inflow",), ("level",), (2.0,), {}))
    assert (model.readings, model.step([2.0], 1.0)) == ([50.0], [2.0])
