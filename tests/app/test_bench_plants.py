"""[device.plant] with a model of the user's: what check says, runs on it, loops that share one, faults in a run."""

from pathlib import Path

import numpy as np
import pytest
from command_line import run

from retuner.config.bench_plants import Plants, UnusablePlantError
from retuner.config.loading import parse_session

LOOP = """schema = 1
loop = { name = "lag", pv_unit = "degC", pv_min = 0.0, pv_max = 100.0, sample_time_s = 1.0 }
schedule = { variable = "sp", region = [{ name = "all", kc = 0.5, tau_i_s = 20.0 }] }
bus = { interface = "virtual", channel = "lag" }
[device.plant]
"""
SCENARIO = """
[scenario]
duration_s = 120.0
steps = [{ at_s = 0.0, sp = 20.0 }, { at_s = 20.0, sp = 24.0 }]
"""
LAG = """kind = "state_space"
a = [[-0.05]]
b = [[0.1]]
c = [[1.0]]
theta_s = 2.5
start_pv = 20.0
start_co_pct = 40.0
"""
CLASS = """
class Lag:
    pv = 20.0

    def __init__(self, gain=2.0):
        self.gain = gain

    def step(self, co, dt):
        self.n = getattr(self, "n", 0) + 1
        if self.n == {dies_at}:
            raise RuntimeError("valve stuck")
        self.pv += dt * (self.gain * (co - 40.0) + 20.0 - self.pv) / 20.0
        return self.pv
"""


def python_plant(folder: Path, *, dies_at: int = -1, more: str = "") -> str:
    source = folder / "lag.py"
    source.write_text(CLASS.format(dies_at=dies_at))
    return f'kind = "python"\nmodel = "{source}:Lag"\nstart_co_pct = 40.0\n{more}'


def configured(folder: Path, plant: str) -> Path:
    path = folder / "loop.toml"
    path.write_text(LOOP + plant + SCENARIO)
    return path


def check(folder: Path, plant: str) -> tuple[int, str]:
    done = run("check", configured(folder, plant))
    return done.returncode, done.stdout + done.stderr


def test_check_shows_a_class_and_its_parameters(tmp_path: Path) -> None:
    status, told = check(tmp_path, python_plant(tmp_path))
    assert status == 0
    assert "plant python" in told
    assert "lag.py:Lag(gain=2.0)" in told
    assert "start: co 40 % is 40 at its input; pv 20 degC" in told
    assert "!!" not in told


def begun(plant: str) -> str:
    session = parse_session(LOOP + plant + SCENARIO)
    with Plants(session.loops, [].append) as plants:
        (lines,) = plants.begun()
    return lines[-1]


def test_check_tells_a_start_that_is_not_at_rest_or_out_of_range(tmp_path: Path) -> None:
    away = python_plant(tmp_path).replace("start_co_pct = 40.0", "start_co_pct = 60.0")
    assert "it is not at rest: pv is 4" in begun(away)
    far = python_plant(tmp_path, more="output_offset = 5000.0\n")
    assert "pv is outside of pv_min to pv_max" in begun(far)
    with pytest.raises(UnusablePlantError, match=r"stopped at 7 s of its time: RuntimeError: valve stuck \(line 11 of"):
        begun(python_plant(tmp_path, dies_at=7))


@pytest.mark.parametrize(
    ("plant", "line"),
    [
        (LAG.replace("[[0.1]]", "[[0.1], [0.2]]"), "device.plant.b is 2 x 1; it must be 1 x 1"),
        (LAG.replace('"state_space"', '"steady_state"'), "kind = one of"),
        (LAG + 'output = "y"\n', "device.plant.input is missing; name it as well as output"),
        (LAG + 'input = "u"\noutput = "y"\n', 'device.plant.input = "u": there is no input of this name'),
        (LAG + 'shared = "tanks"\n', "device.plant.shared needs input and output by name, too"),
        (LAG + 'model = "x:y"\n', "device.plant.model or the matrices a, b, c: give one of them"),
        (LAG + 'loads = [{ file = "nowhere.csv", column = "x" }]\n', "device.plant.loads[1]: nowhere.csv"),
        ('kind = "python"\nmodel = "nowhere.py:Lag"\n', "device.plant.model = "),
        ('kind = "fmu"\nfile = "nowhere.fmu"\n', 'device.plant.file = "nowhere.fmu": there is no such file'),
    ],
)
def test_check_tells_line_and_key_of_what_is_wrong(tmp_path: Path, plant: str, line: str) -> None:
    status, told = check(tmp_path, plant)
    assert status == 2
    assert line in told
    assert "loop.toml:" in told
    assert "Traceback" not in told


def trend(folder: Path) -> np.ndarray:
    table = np.genfromtxt(folder / "trend.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    return np.asarray(table["pv"], dtype=float)


@pytest.mark.slow
def test_one_plant_as_matrices_and_as_a_class_runs_alike(tmp_path: Path) -> None:
    """A class that integrates in steps of a sample is the exact one within a few percent of the move."""
    for name, plant in (("matrices", LAG.replace("theta_s = 2.5\n", "")), ("class", python_plant(tmp_path))):
        done = run("run", configured(tmp_path, plant), "--out", tmp_path / name, "--no-compare")
        assert done.returncode == 0, done.stderr
    one, other = trend(tmp_path / "matrices"), trend(tmp_path / "class")
    assert np.abs(one - other).max() < 0.1
    assert one[-1] == pytest.approx(24.0, abs=0.05)


def test_a_run_whose_plant_dies_goes_on_and_says_so_in_a_line(tmp_path: Path) -> None:
    path = configured(tmp_path, python_plant(tmp_path, dies_at=60))
    done = run("run", path, "--out", tmp_path / "out", "--no-compare")
    assert done.returncode == 2
    assert "stopped at 60 s of its time: RuntimeError: valve stuck (line 11 of" in done.stderr
    assert "a fault of the bench, not of the device" in done.stderr
    assert "Traceback" not in done.stderr
    assert "a fault of the bench" in done.stdout  # at the time, beside the decisions
    assert len(trend(tmp_path / "out")) >= 120  # and the controller went on to the end


def test_recorded_loads_move_any_plant(tmp_path: Path) -> None:
    record = tmp_path / "load.csv"
    record.write_text("t,draught,other\n" + "".join(f"{t},{5.0 + 3.0 * (t >= 30)},0\n" for t in range(121)))
    load = f'loads = [{{ file = "{record}", column = "draught", at = "output" }}]\n'
    for plant in (LAG, python_plant(tmp_path), 'kind = "linear"\nk = 2.0\nlags_s = [20.0]\nstart_pv = 20.0\n'):
        session = parse_session(LOOP + plant + load + SCENARIO)
        with Plants(session.loops, [].append) as plants:
            plant_, co = plants.plants[0], 40.0 if "linear" not in plant else 50.0
            got = [plant_.step(co, 0.0, 1.0) for _ in range(60)]
        assert got[:29] == pytest.approx([20.0] * 29)
        assert got[30:] == pytest.approx([23.0] * 30)


PAIR = """schema = 1
schedule = { variable = "sp" }
bus = { interface = "virtual", channel = "pair" }
[device.plant]
kind = "state_space"
shared = "pair"
a = [[-0.1, 0.0], [0.0, -0.1]]
b = [[0.1, 0.05], [0.0, 0.1]]
c = [[1.0, 0.0], [0.0, 1.0]]
inputs = ["u1", "u2"]
outputs = ["y1", "y2"]
start_pv = 20.0
[[loop]]
name = "one"
pv_unit = "cm"
pv_min = 0.0
pv_max = 100.0
sample_time_s = 1.0
bus = { node = 1 }
device = { plant = { input = "u1", output = "y1" } }
schedule = { region = [{ name = "all", kc = 0.5, tau_i_s = 10.0 }] }
[[loop]]
name = "two"
pv_unit = "cm"
pv_min = 0.0
pv_max = 100.0
sample_time_s = 1.0
bus = { node = 2 }
device = { plant = { input = "u2", output = "y2" } }
schedule = { region = [{ name = "all", kc = 0.5, tau_i_s = 10.0 }] }
"""


def test_loops_that_name_one_plant_share_it() -> None:
    session = parse_session(PAIR)
    with Plants(session.loops, [].append) as plants:
        one, two = plants.plants
        for _ in range(100):
            pv = one.step(50.0, 0.0, 1.0)
            two.step(52.0, 0.0, 1.0)
    assert pv == pytest.approx(20.0 + 0.5 * 2.0, abs=0.02)


def test_one_shared_plant_cannot_be_two_models(tmp_path: Path) -> None:
    path = tmp_path / "pair.toml"
    path.write_text(PAIR.replace('input = "u2"', 'theta_s = 3.0, input = "u2"'))
    done = run("check", path)
    assert done.returncode == 2
    assert 'device.plant.shared = "pair" is another model for "one"' in done.stderr
