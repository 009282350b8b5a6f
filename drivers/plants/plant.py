"""What a plant is to the virtual device: something that a controller output moves and a sensor reads."""

import math
import random
from typing import Protocol

from retuner.adaptive.process.model import LinearProcess


class Plant(Protocol):
    """A simulated process with its actuator and sensor. It starts at rest."""

    @property
    def pv(self) -> float:
        """Sensor reading without measurement noise, in pv units."""

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s seconds and read the sensor.

        co : controller output, percent of its range.
        load : disturbance, in percent of controller output that would have the same steady effect on the heat balance.
        dt_s : duration in seconds, positive.

        Reading at the end of the interval, measurement noise included.

        Raises ValueError: an argument is not finite or dt_s is not positive; the plant has not moved.
        """

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """Controller output in percent that holds this pv. Raises ValueError: no output within the range holds it."""


class KnownPlant(Plant, Protocol):
    """A plant that knows its own true model."""

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:
        """The true model for small moves about rest at this pv: k in pv units per percent, sensor included.

        load : where the process depends on it, percent as in `step`.
        """


def check_step(co: float, load: float, dt_s: float) -> None:
    """Refuse a step with a number that is none, before any state moves.

    Raises ValueError: co or load is not finite, or dt_s is not a positive finite number.
    """
    if not (math.isfinite(co) and math.isfinite(load) and 0.0 < dt_s < math.inf):
        raise ValueError(f"co = {co}, load = {load}, dt_s = {dt_s}: give finite numbers and a positive dt_s")


class MeasurementNoise:
    """White Gaussian noise of a sensor, the same for the same seed.

    sigma : standard deviation in pv units, not negative.
    seed : of the generator.
    """

    def __init__(self, sigma: float, seed: int) -> None:
        self._sigma = sigma
        self._gauss = random.Random(seed).gauss  # noqa: S311  a plant, not a secret

    def __call__(self) -> float:
        """The next deviation in pv units."""
        return self._gauss(0.0, self._sigma) if self._sigma else 0.0
