"""Loads out of a record on top of any plant: what a column did, at the plant's input or at its output.

A column counts from its first value, so that the plant begins at rest: load(t) = scale (x(t) - x(0)), straight between
its rows; after its last row the load stays, or begins again where it is to be repeated.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import FloatArray
from retuner.drivers.plants.plant import KnownPlant
from retuner.schedule.late_dataclass import dataclass


@dataclass(frozen=True)
class RecordedLoad:
    """One column. t_s : from 0, rising. values : of equal length. at_output : in pv units there, else percent of co."""

    t_s: FloatArray
    values: FloatArray
    scale: float = 1.0
    at_output: bool = False
    repeat: bool = False

    def __post_init__(self) -> None:
        whole = np.isfinite(self.t_s).all() and np.isfinite(self.values).all()
        if len(self.t_s) < 2 or len(self.t_s) != len(self.values) or not whole or np.any(np.diff(self.t_s) <= 0):
            raise ValueError("a recorded load needs two rows or more, with numbers and rising times")
        if not math.isfinite(self.scale):
            raise ValueError(f"scale = {self.scale}; give a finite number")

    def at(self, t_s: float) -> float:
        """The load at a time of the plant."""
        last = float(self.t_s[-1])
        inside = t_s % last if self.repeat else t_s
        return self.scale * (float(np.interp(inside, self.t_s, self.values)) - float(self.values[0]))


class RecordedLoads:
    """All recorded loads of a plant."""

    def __init__(self, loads: Sequence[RecordedLoad]) -> None:
        self._inputs = [one for one in loads if not one.at_output]
        self._outputs = [one for one in loads if one.at_output]

    def input(self, t_s: float) -> float:
        """The load at the input, percent of co."""
        return sum(one.at(t_s) for one in self._inputs)

    def output(self, t_s: float) -> float:
        """The load at the output, pv units."""
        return sum(one.at(t_s) for one in self._outputs)


class LoadedPlant:
    """A plant with recorded loads on top: see plant.Plant."""

    def __init__(self, plant: KnownPlant, loads: RecordedLoads) -> None:
        self._plant, self._loads = plant, loads
        self._t_s = 0.0

    @property
    def pv(self) -> float:
        """Reading without noise, pv units."""
        return self._plant.pv + self._loads.output(self._t_s)

    @property
    def aux(self) -> float | None:
        """The plant's second reading, where it has one."""
        aux: float | None = getattr(self._plant, "aux", None)
        return aux

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s and read the sensor: see plant.Plant."""
        pv = self._plant.step(co, load + self._loads.input(self._t_s + dt_s / 2), dt_s)
        self._t_s += dt_s
        return pv + self._loads.output(self._t_s)

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """The plant's steady co."""
        return self._plant.steady_co(pv, load)

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:
        """The plant's linear model."""
        return self._plant.linearise(pv, load)
