"""Plants written by others, from the package index: the equations of pc-gym (MIT licence; Bloor et al. 2024).

    pip install --no-deps pcgym; pip install jax      (all that its equations import; its other parts want more)

A dead time of the analyser or the pipe is added here to each: the equations have none. Places are those where one input
holds one output at rest, stable, with the other inputs as given.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from schedules.ode import Equations, State
from schedules.physics import from_equations
from schedules.subject import Subject


def models() -> ModuleType:
    """The file of equations, without the environments round it.

    Raises
    ------
    SystemExit
        It is not installed.
    """
    package = importlib.util.find_spec("pcgym")
    if package is None or not package.submodule_search_locations:
        raise SystemExit("plants by others need: pip install --no-deps pcgym; pip install jax")
    file = Path(next(iter(package.submodule_search_locations))) / "model_classes.py"
    spec = importlib.util.spec_from_file_location("pcgym_model_classes", file)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{file}: cannot be loaded")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _seconds(slope: Callable[[State, float], object], unit_s: float) -> Callable[[State, float, float], list[float]]:
    """dx/dt a second of equations whose time runs in another unit."""
    return lambda x, u, _w: [float(v) / unit_s for v in np.asarray(slope(x, u), dtype=float).ravel()]


def _held(x: list[float], u: float) -> Callable[[float, float], tuple[list[float], float]]:
    return lambda _y, _w: (list(x), u)


def _dead(seconds: float) -> Callable[[float, float], float]:
    return lambda _y, _w: seconds


def _cstr() -> Subject:
    plant = models().cstr(int_method="numpy")

    def slope(x: State, u: float) -> object:
        return plant(np.array(x), np.array([u, plant.Ti, plant.Caf]))

    guess = _held([0.9, 320.0], 300.0)
    equations = Equations(_seconds(slope, 60.0), lambda x: x[1], guess, _dead(4.0))
    return from_equations("pc-gym cstr", equations, 312.0, 330.0, 0.02, kind="others", co=(240.0, 340.0))


def _four_tank() -> Subject:
    plant = models().four_tank(int_method="numpy")

    def slope(x: State, u: float) -> object:
        return plant([max(v, 1e-6) for v in x], [u, 3.0])

    def guess(y: float, _w: float) -> tuple[list[float], float]:
        through = plant.a2 * (2 * plant.g * y) ** 0.5 - plant.gamma_2 * plant.k2 * 3.0
        u = through / ((1 - plant.gamma_1) * plant.k1)
        third = ((1 - plant.gamma_2) * plant.k2 * 3.0 / plant.a3) ** 2 / (2 * plant.g)
        first = (((1 - plant.gamma_2) * plant.k2 * 3.0 + plant.gamma_1 * plant.k1 * u) / plant.a1) ** 2 / (2 * plant.g)
        return [first, y, third, (through / plant.a4) ** 2 / (2 * plant.g)], u

    equations = Equations(_seconds(slope, 1.0), lambda x: x[1], guess, _dead(10.0))
    return from_equations("pc-gym four tank", equations, 0.1, 0.9, 0.001, kind="others", co=(0.0, 20.0))


def _recycle() -> Subject:
    plant = models().cstr_series_recycle()

    def slope(x: State, u: float) -> object:
        return plant(x, [2e-5, 1e-5, u, u])

    # its gain and lags change by 1 % over the range: one region
    equations = Equations(_seconds(slope, 1.0), lambda x: x[3], _held([60.0, 350.0, 40.0, 350.0], 360.0), _dead(5.0))
    made = from_equations("pc-gym recycle", equations, 310.0, 360.0, 0.05, kind="others", co=(200.0, 500.0))
    return replace(made, constant=True)


MAKERS: dict[str, Callable[[], Subject]] = {
    "pc-gym cstr": _cstr,
    "pc-gym four tank": _four_tank,
    "pc-gym recycle": _recycle,
}
