"""Loops on one model: each device moves an input and reads an output, and the model goes on once for all of them.

    device i: port.step(co_i, load_i, dt) -> the model is taken to the device's own time, on the inputs that all devices
    hold since their last samples -> pv_i = output_scale y + output_offset + noise

What another device holds is read from the device itself at that moment: it was decided in its last sample, so no loop
acts a sample late for sharing its plant. A model that stops, hangs or gives no number is a fault of the bench: it is
told in one line, the readings are no numbers from then on, and the controllers go on without them, as real ones do when
a sensor fails. NaN and a late answer may pass; a model that has raised an error is not asked again.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

from retuner.drivers.plants.foreign_model import PlantFaultError, PlantModel, StillBusyError
from retuner.drivers.plants.plant import MeasurementNoise, check_step
from retuner.drivers.plants.recorded_load import RecordedLoads
from retuner.schedule.late_dataclass import dataclass

MOST_TOLD = 6  # how often it is told that readings are lost or are there again
LARGEST = 3e38  # what a reading may be: a bus carries 32-bit floating point
SAME_TIME = 1e-6  # share of a step by which times of two devices may differ by rounding
GOES_ON = "the controller goes on without a reading; this is a fault of the bench, not of the device"


class Holder(Protocol):
    """A device that holds its output, percent, and a load that a bench put on it."""

    co: float
    load: float


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How a loop hangs on a model.

    source : where the model is from, for messages. input, output, aux, load_input : places among its inputs and its
    outputs; aux, load_input None for none, then a load is added to co. input_scale, input_offset : the model's input is
    input_scale (co + load) + input_offset; output_scale, output_offset likewise for pv. start_co : percent, held at the
    start. noise : standard deviation, pv units. seed : of that noise.
    """

    source: str
    input: int = 0
    output: int = 0
    aux: int | None = None
    load_input: int | None = None
    input_scale: float = 1.0
    input_offset: float = 0.0
    output_scale: float = 1.0
    output_offset: float = 0.0
    start_co: float = 50.0
    noise: float = 0.0
    seed: int = 0


class SharedPlant:
    """A model with the loops on it. model : at rest. start : its inputs. say : takes a line on what it does wrong."""

    def __init__(self, model: PlantModel, start: Sequence[float], say: Callable[[str], None]) -> None:
        self._model, self._say = model, say
        self.readings: Sequence[float] = model.readings
        self.inputs = list(start)
        self.ports: list[PlantPort] = []
        self.t_s = 0.0
        self.stopped = ""
        self._trouble, self._told = "", 0

    def port(self, settings: PortSettings, loads: RecordedLoads | None = None) -> "PlantPort":
        """A place for another loop."""
        made = PlantPort(self, settings, loads)
        self.ports.append(made)
        return made

    def advance(self, until_s: float) -> None:
        """Take the model to this time on what all loops hold."""
        dt_s, self.t_s = until_s - self.t_s, until_s
        if self.stopped:
            return
        for port in self.ports:
            port.act(self.inputs, until_s - dt_s / 2)
        count, source = len(self.readings), self.ports[0].settings.source
        try:
            self.readings = self._model.step(self.inputs, dt_s)
        except StillBusyError as busy:
            self.readings = [math.nan] * count
            self._tell(f"plant {source} {busy}")
            return
        except PlantFaultError as fault:
            self.readings = [math.nan] * count
            self.stopped = f"plant {source} stopped at {self.t_s:.6g} s of its time: {fault}; {GOES_ON}"
            self._model.close()
            self._say(self.stopped)
            return
        lost = [(i, value) for i, value in enumerate(self.readings) if not abs(value) <= LARGEST]
        if lost:
            self.readings = [value if abs(value) <= LARGEST else math.nan for value in self.readings]
        self._tell(f"plant {source} gives {lost[0][1]} as output {lost[0][0] + 1}" if lost else "")

    def _tell(self, trouble: str) -> None:
        """Say once that something begins to be wrong, and once that it is over; no more where that goes on and on."""
        if bool(trouble) != bool(self._trouble):
            place = f"from {self.t_s:.6g} s of its time on"
            source = self.ports[0].settings.source
            self._trouble = f"{trouble} {place}; {GOES_ON}" if trouble else ""
            self._told += 1
            if self._told <= MOST_TOLD:
                last = "; this is not told again" * (self._told == MOST_TOLD)
                self._say((self._trouble or f"plant {source} gives readings again, {place}") + last)

    @property
    def fault(self) -> str:
        """What is wrong with it now: it has stopped, or gives no reading; empty for nothing."""
        return self.stopped or self._trouble

    def close(self) -> None:
        """Let go of the model."""
        self._model.close()


class PlantPort:
    """A loop's place at a model: see plant.Plant, which it is but for the load's and the start's meaning here.

    plant : the model with its loops. settings : of this one. loads : recorded ones on top.
    """

    def __init__(self, plant: SharedPlant, settings: PortSettings, loads: RecordedLoads | None = None) -> None:
        self.plant, self.settings = plant, settings
        self.held_by: Holder | None = None
        self._loads = loads
        self._held = (settings.start_co, 0.0)
        self._t_s = 0.0
        self._noise = MeasurementNoise(settings.noise, settings.seed)

    @property
    def pv(self) -> float:
        """Reading without measurement noise, pv units; no number while the model gives none."""
        settings = self.settings
        pv = settings.output_scale * self.plant.readings[settings.output] + settings.output_offset
        return pv + (self._loads.output(self.plant.t_s) if self._loads else 0.0)

    @property
    def aux(self) -> float | None:
        """A second reading of the model, in its own unit; None for none, or while it is no number."""
        place = self.settings.aux
        value = None if place is None else self.plant.readings[place]
        return value if value is not None and math.isfinite(value) else None

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s and read the sensor: see plant.Plant. Loops of one model keep their own times."""
        check_step(co, load, dt_s)
        self._held = (co, load)
        self._t_s += dt_s
        ahead_s = self._t_s - self.plant.t_s
        if ahead_s > SAME_TIME * dt_s:
            self.plant.advance(self._t_s)
        elif ahead_s < -dt_s * (1 + SAME_TIME):  # a device that has missed samples does not make up for them
            self._t_s = self.plant.t_s
        return self.pv + self._noise()

    def act(self, inputs: list[float], t_s: float) -> None:
        """Put what this loop's device holds onto the model's inputs."""
        settings, (co, load) = self.settings, self._held
        if self.held_by is not None:
            co, load = self.held_by.co, self.held_by.load
        load += self._loads.input(t_s) if self._loads else 0.0
        if settings.load_input is not None:
            inputs[settings.load_input] = load
            load = 0.0
        inputs[settings.input] = settings.input_scale * (co + load) + settings.input_offset

    def steady_co(self, pv: float, load: float = 0.0) -> float:  # noqa: ARG002  only the start is known
        """Output in percent that holds the start; what holds any other pv, nobody knows.

        Raises ValueError: the plant has moved.
        """
        if self.plant.t_s > 0:
            raise ValueError(f"the output that holds pv = {pv} is not known for the model {self.settings.source}")
        return self.settings.start_co
