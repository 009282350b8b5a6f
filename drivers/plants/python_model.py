"""A Python class as a plant. All that it needs is one method:

    class Tank:
        def step(self, co, dt): ...      # hold co for dt seconds; return pv

Where [device.plant] names input and output, co is a dict by input and what step returns a dict by output, so that
several loops may act on one object. Optional: __init__ takes [device.plant] parameters by name; an attribute `pv` is
the reading (or the dict of them) at the start, without which the first one is that of a step.
"""

import contextlib
import copy
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from retuner.drivers.plants.foreign_model import ModelSpec, PlantFaultError, missing_name

MOST_SHOWN = 60  # letters that are shown of what is no number
FIRST_STEP_S = 1e-3  # length of the step that a class without `pv` makes for its first reading, s


def find_object(name: str) -> Any:  # noqa: ANN401  whatever the user has under that name
    """What "module:Name" or "folder/file.py:Name" stands for. Raises PlantFaultError: there is none."""
    source, _, inside = name.rpartition(":")
    if not source or not inside:
        raise PlantFaultError(f'= "{name}" names no object; give "module:Class" or "folder/file.py:Class"', "model")
    try:
        module = _module_of_file(Path(source)) if source.endswith(".py") else importlib.import_module(source)
    except FileNotFoundError:
        raise PlantFaultError(f'= "{name}": there is no file {source}', "model") from None
    except ModuleNotFoundError as missing:
        what = f"there is no module {source}" if missing.name == source else f"{source} needs {missing.name}"
        raise PlantFaultError(f'= "{name}": {what}', "model") from None
    found: Any = module
    for part in inside.split("."):
        if not hasattr(found, part):
            known = [one for one in vars(module) if not one.startswith("_")]
            raise PlantFaultError(missing_name(f"object in {source}", inside, known), "model")
        found = getattr(found, part)
    return found


def _module_of_file(path: Path) -> Any:  # noqa: ANN401  a module
    """A file as a module; what lies beside it can be imported by it."""
    if not path.is_file():
        raise FileNotFoundError
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.append(str(path.resolve().parent))
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


class PythonModel:
    """An object of the user's class: see model.PlantModel."""

    def __init__(self, spec: ModelSpec) -> None:
        self._spec = spec
        made = find_object(spec.source)
        if not callable(getattr(made, "step", None)):
            raise PlantFaultError(f'= "{spec.source}" has no method step(co, dt)', "model")
        self._plant = made(**spec.parameters) if _takes(made, spec.parameters) else made
        if spec.settle_s:
            self.step(spec.start, spec.settle_s)
        first = getattr(self._plant, "pv", None)
        self.readings = self._told(first) if first is not None else self.step(spec.start, FIRST_STEP_S)
        if first is not None:
            try:
                other = copy.deepcopy(self._plant)
            except Exception:  # noqa: BLE001  a user's class may raise anything there
                return
            self._stepped(other, spec.start, FIRST_STEP_S)  # a name that the class does not know is told before the run

    def step(self, inputs: Sequence[float], dt_s: float) -> Sequence[float]:
        """See model.PlantModel."""
        return self._stepped(self._plant, inputs, dt_s)

    def _stepped(self, plant: Any, inputs: Sequence[float], dt_s: float) -> Sequence[float]:  # noqa: ANN401  the user's
        names = self._spec.inputs
        co: object = dict(zip(names, inputs, strict=True)) if names else inputs[0]
        return self._told(plant.step(co, dt_s))

    def close(self) -> None:
        """The object goes with its process."""

    def described(self) -> list[str]:
        """What the class takes."""
        with contextlib.suppress(TypeError, ValueError):
            taken = ", ".join(map(str, inspect.signature(type(self._plant)).parameters.values()))
            return [f"{self._spec.source}({taken})"]
        return [self._spec.source]

    def _told(self, given: object) -> list[float]:
        """What step returned or pv is, in the order of the outputs."""
        names = self._spec.outputs
        if not names:
            return [_number("pv", given)]
        if not isinstance(given, Mapping):
            raise PlantFaultError(
                f"step returned {given!r}; with outputs named it returns a dict of {', '.join(names)}"
            )
        for name in names:
            if name not in given:
                raise PlantFaultError(missing_name("output", name, [*map(str, given)]), "output")
        return [_number(name, given[name]) for name in names]


def _number(name: str, value: Any) -> float:  # noqa: ANN401  whatever a user's class returns
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        told = repr(value)
        told = told if len(told) <= MOST_SHOWN else f"{told[:MOST_SHOWN]} ..."
        raise PlantFaultError(f"step returned {told} as {name}; a plant returns numbers") from None


def _takes(made: object, parameters: Mapping[str, object]) -> bool:
    """Whether this is a class (or a function that makes the plant), once its parameters have been found in it."""
    if not (inspect.isclass(made) or inspect.isfunction(made)):
        return False
    known = inspect.signature(made).parameters
    if not any(one.kind is one.VAR_KEYWORD for one in known.values()):
        for name in parameters:
            if name not in known:
                raise PlantFaultError(missing_name("parameter", name, known), "parameters", name)
        for name, one in known.items():
            if name not in parameters and one.default is one.empty and one.kind is not one.VAR_POSITIONAL:
                raise PlantFaultError(f"{name} is missing, and the class needs it", "parameters")
    return True
