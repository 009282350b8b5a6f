"""Any linear process as a plant, exact for a held output: the virtual device's test plant.

Exact for every delay (adaptive/loop/simulate.py), unlike a Pade approximation or a delay rounded to samples.
"""

import math

from retuner.adaptive.loop.simulate import HeldInput
from retuner.adaptive.process.model import LinearProcess, state_space
from retuner.drivers.plants.plant import MeasurementNoise, check_step


class LinearPlant:
    """A linear process about an operating point: pv = pv0 + G (co - co0 + load), clipped co.

    process : the process; its gain is in pv units per percent.
    start_pv, start_co : operating point at the start, at rest.
    noise : standard deviation of the measurement noise, pv units.
    seed : of that noise.
    co_min, co_max : limits of the actuator, percent.

    Raises ValueError: more leads than lags and integrators (no causal plant), or co limits without room between them.
    """

    def __init__(
        self,
        process: LinearProcess,
        *,
        start_pv: float = 0.0,
        start_co: float = 50.0,
        noise: float = 0.0,
        seed: int = 0,
        co_min: float = 0.0,
        co_max: float = 100.0,
    ) -> None:
        if not (math.isfinite(start_pv) and math.isfinite(start_co) and co_min < co_max):
            raise ValueError(f"start_pv {start_pv}, start_co {start_co}, co {co_min}..{co_max}: give finite numbers")
        self.process = process
        self._pv0, self._co0, self._limits = start_pv, start_co, (co_min, co_max)
        self._noise = MeasurementNoise(noise, seed)
        state_space(process, 1.0)  # refuses what no plant can be
        self._dt_s = 0.0
        self._moved: HeldInput | None = None
        self.pv = start_pv  # without noise

    def step(self, co: float, load: float, dt_s: float) -> float:
        """Hold co and load for dt_s and read the sensor: see plant.Plant. dt_s must stay that of the first step.

        Raises ValueError: as plant.Plant says, or dt_s differs from the first step's.
        """
        check_step(co, load, dt_s)
        if self._moved is None:
            self._dt_s, self._moved = dt_s, HeldInput(self.process, dt_s)
        elif dt_s != self._dt_s:
            raise ValueError(f"dt_s = {dt_s}, but this plant was started with {self._dt_s}; keep one sampling interval")
        low, high = self._limits
        self.pv = self._pv0 + self._moved.step(min(max(co, low), high) - self._co0 + load)
        return self.pv + self._noise()

    def steady_co(self, pv: float, load: float = 0.0) -> float:
        """Output in percent that holds pv: see plant.Plant."""
        co = self._co0 + (0.0 if self.process.integrators else (pv - self._pv0) / self.process.k) - load
        low, high = self._limits
        if not low <= co <= high:
            raise ValueError(f"pv = {pv} needs co = {co:.3g} %; the actuator gives {low} to {high} %")
        return co

    def linearise(self, pv: float, load: float = 0.0) -> LinearProcess:  # noqa: ARG002  linear: everywhere the same
        """The process itself: see plant.Plant."""
        return self.process
