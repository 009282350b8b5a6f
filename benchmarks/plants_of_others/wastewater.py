"""Oxygen in an aeration tank of the benchmark wastewater plant BSM1: bsm2-python 0.0.16 (PyPI, BSD-3-Clause).

The package brings the activated sludge model (IWA ASM1), two weeks of inflow in dry weather and in rain, and sensor and
blower as transfer functions with their published noise. Nobody moves the setpoint of 2 g/m3: the inflow is the load.
Gains: the package's (25, 0.002 d), and those of the benchmark's book (500, 0.001 d), which its comments name. Its own
controller adds up no integral; ours stands in its place.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plants_of_others.loop import Card, Control, package
from retuner import PidGains

MINUTE_S, DAY_S = 60.0, 86400.0
DAYS = 3.0
SP = 2.0
OFFSET = 144.0  # The package's output to begin with, 1/d
MOVES = {"oxygen": 0.0, "oxygen_stepped": 0.5}
"""Size of the operators' setpoint steps, every six hours: none, as the benchmark says; or some."""


def load(part: str) -> Any:  # noqa: ANN401  a module without types
    """A module of the package; SystemExit where it is not installed."""
    return package(f"bsm2_python.{part}", "the wastewater plant")


class Wastewater:
    """The oxygen loop of the fifth tank, one sample a minute."""

    name = "bsm1"
    licence = "BSD-3-Clause"

    def __init__(self) -> None:
        self._package = load("bsm1_cl")
        init = load("bsm2.init.aerationcontrolinit_bsm1")
        gains = PidGains(init.KSO5, init.KSO5 / (init.TISO5 * DAY_S), 0.0)
        self.cards = {
            name: Card(name, MINUTE_S, (0.0, 10.0), (0.0, 360.0), gains, "bsm2-python 0.0.16", 0.5) for name in MOVES
        }

    def rest(self, _loop: str) -> float:
        """Output to begin with."""
        return OFFSET

    def times(self, _loop: str, _seed: int) -> list[float]:
        """A quarter of a day is one disturbance: the load of a day has a morning and an evening."""
        return [DAY_S * 0.25 * (i + 1) for i in range(int(DAYS / 0.25) - 1)]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """Inflow of dry weather or of rain from a day that the seed gives."""
        rng = np.random.default_rng([seed, 13])
        data = self._inflow(str(rng.choice(["dryinfluent.csv", "raininfluent.csv"])))
        first = float(rng.uniform(0.0, data[-1, 0] - DAYS - 0.01))
        data = data[data[:, 0] >= first]
        data[:, 0] -= data[0, 0]
        sps = SP + MOVES[loop] * rng.choice([-1.0, 0.0, 1.0], int(DAYS / 0.25) + 1)
        self._run(controls, data, DAYS, sps.tolist(), seed)

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """The mean inflow of dry weather, exact sensor."""
        data = self._inflow("dryinfluent.csv")
        mean = np.tile(data.mean(axis=0), (2, 1))
        mean[:, 0] = 0.0, seconds / DAY_S + 1.0
        self._run(controls, mean, seconds / DAY_S, [SP], None)

    def _inflow(self, file: str) -> np.ndarray:
        folder = Path(self._package.__file__).parent / "data"
        return np.genfromtxt(folder / file, delimiter=",", encoding="utf-8-sig")

    def _run(
        self, controls: Mapping[str, Control], data: np.ndarray, days: float, sps: list[float], seed: int | None
    ) -> None:
        plant = self._package.BSM1CL(
            data_in=data, timestep=1.0 / 1440, endtime=days, use_noise=0 if seed is None else 2, noise_seed=seed or 0
        )
        blower = _Blower(next(iter(controls.values())), sps)
        plant.kla5_pid, plant.noise_timestep = blower, plant.simtime
        if seed is None:
            plant.noise_so4 = np.zeros(len(plant.simtime))
        for i in range(len(plant.simtime)):
            plant.step(i)


class _Blower:
    """In the place of the package's controller."""

    setpoint = SP

    def __init__(self, control: Control, sps: list[float]) -> None:
        self._control, self._sps, self._i = control, sps, 0

    def output(self, signal: float, dt: float, _inject: float = 0.0) -> float:
        """One sample."""
        sp = self._sps[min(int(self._i * dt / 0.25), len(self._sps) - 1)]
        self._i += 1
        return self._control(sp, float(signal))
