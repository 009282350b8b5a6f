"""What a model of somebody else is to a bench: some inputs in, some readings out, time in between.

A model knows nothing of loops: shared_plant.py hangs them onto one. plant_process.py keeps one in a process of its own.
"""

import difflib
from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from retuner.schedule.late_dataclass import dataclass, field

Parameter = float | int | bool | str


class PlantFaultError(Exception):
    """A plant that cannot be begun or does not go on. key : the setting below [device.plant] that it is about."""

    def __init__(self, message: str, *key: str) -> None:
        self.key = key
        super().__init__(message)


class StillBusyError(Exception):
    """A plant that has not answered yet; it may still."""


@dataclass(frozen=True, slots=True)
class ModelSpec:
    """Which model, with what.

    kind : python or fmu. source : the file or module. inputs, outputs : names; none where it has one of each.
    start : inputs at the start, in the order of their names. parameters : by name. settle_s : how long it is run on
    these inputs before anybody reads it. step_s : longest step of an FMU, 0 for that of the caller. interface : of an
    FMU that has both, co_simulation or model_exchange; empty for the first that it has.
    """

    kind: str
    source: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    start: tuple[float, ...]
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    settle_s: float = 0.0
    step_s: float = 0.0
    interface: str = ""


class PlantModel(Protocol):
    """A model at rest or in motion."""

    @property
    def readings(self) -> Sequence[float]:
        """Outputs at the start, in the order of the spec."""

    def step(self, inputs: Sequence[float], dt_s: float) -> Sequence[float]:
        """Hold the inputs for dt_s seconds; the outputs at the end.

        Raises PlantFaultError: it does not go on: nobody asks it again.
        Raises StillBusyError: it has not answered yet: it is asked again at the next step.
        """

    def close(self) -> None:
        """Let go of everything that it holds."""


def missing_name(what: str, name: str, known: Collection[str]) -> str:
    """Words that there is no variable of this name, and which come nearest."""
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5) or sorted(known)[:8]
    return f'= "{name}": there is no {what} of this name' + (f"; the nearest: {', '.join(near)}" if near else "")
