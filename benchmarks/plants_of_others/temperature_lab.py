"""The temperature control lab of Brigham Young University as its own package simulates it: tclab (PyPI, Apache 2.0).

Two transistors heat two sensors; a heater takes 0 to 100 %, a sensor tells 0.32 K steps with 0.04 K of noise. One
sample a second, simulated time (the package's `synced=False`). Loops T1 and T2. Gains: the makers' course gives the
process as 0.9 K/%, 175 s, dead time 15 s, and IMC with tau_c = max(0.1 tau, 0.8 theta).
"""

import contextlib
import io
import random
from collections.abc import Mapping
from typing import Any

import numpy as np

from plants_of_others.loop import Card, Control, package
from retuner import PidGains

DT_S = 1.0
K, TAU_S, THETA_S = 0.9, 175.0, 15.0  # The makers' published process
HOLD_S, EVENTS = 900.0, 12
LOW, LEAST = 32.0, 3.0
HIGH = {"T1": 58.0, "T2": 44.0}  # Setpoints that the heaters reach, and the smallest step, Celsius
WARM = 40.0
OTHER_HEATER = (0.0, 30.0, 60.0)  # Percent: the load


def imc() -> PidGains:
    """PI by IMC on the published process."""
    kc = TAU_S / (K * (THETA_S + max(0.1 * TAU_S, 0.8 * THETA_S)))
    return PidGains(kc, kc / TAU_S, 0.0)


def load() -> Any:  # noqa: ANN401  a module without types
    return package("tclab.tclab", "the temperature lab")


class TemperatureLab:
    """Loop T1 under control, heater 2 the load; or the other way round."""

    name = "tclab"
    licence = "Apache-2.0"

    def __init__(self) -> None:
        self._package = load()
        source = "APMonitor course: IMC on 0.9 K/%, 175 s, 15 s"
        self.cards = {name: Card(name, DT_S, (0.0, 100.0), (0.0, 100.0), imc(), source, 5.0) for name in ("T1", "T2")}

    def rest(self, _loop: str) -> float:
        """Output to begin with."""
        return 30.0

    def times(self, _loop: str, _seed: int) -> list[float]:
        """Twice a warm-up's length first, then an event each HOLD_S."""
        return [HOLD_S * (i + 1) for i in range(EVENTS)]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """Setpoint steps and steps of the other heater in turn."""
        rng = np.random.default_rng([seed, 11])
        sp, load, script = WARM, OTHER_HEATER[1], []
        for i in range(EVENTS + 1):
            script.append((sp, load))
            if i % 2 == 0:
                sp = float(
                    rng.choice([s for s in np.arange(LOW, HIGH[loop], 0.5) if LEAST <= abs(s - sp) <= 4 * LEAST])
                )
            else:
                load = float(rng.choice([x for x in OTHER_HEATER if x != load]))
        random.seed(seed)
        self._run(controls, loop, script, HOLD_S, noisy=True)

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """Exact temperatures, nothing moves."""
        self._run(controls, next(iter(controls)), [(WARM, OTHER_HEATER[1])], seconds, noisy=False)

    def _run(
        self, controls: Mapping[str, Control], loop: str, script: list[tuple[float, float]], hold: float, *, noisy: bool
    ) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            lab = self._package.TCLabModel(synced=False)
        mine, other = (lab.Q1, lab.Q2) if loop == "T1" else (lab.Q2, lab.Q1)
        control, i = controls[loop], 0
        for sp, load in script:
            other(load)
            for _ in range(int(hold / DT_S)):
                exact = lab._T1 if loop == "T1" else lab._T2  # noqa: SLF001  the sensor only tells it rounded
                mine(control(sp, lab.measurement(exact) if noisy else exact))
                i += 1
                lab.update(i * DT_S)
