"""The armature current of a DC motor at 10 kHz: gym-electric-motor (PyPI, MIT).

The package brings motor (PMG 132, permanently excited), four-quadrant converter and solver. Its dead-time wrapper lets
an output act one sample late, as in a drive. The shaft's speed is given from outside and is the load: its voltage is
0.165 V s. Gains: the symmetrical optimum with a = 4 of gem_controllers, the package's own tuning.
"""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from plants_of_others.loop import Card, Control, Tripped, package
from retuner import PidGains

DT_S = 1e-4
L_H, A = 19e-6, 4.0  # The motor's inductance and the design parameter: kc = L / (a dt), tau_I = a^2 dt
HOLD_S, EVENTS = 0.03, 12
CURRENT_A, SPEEDS, NOISE_A = 40.0, (100.0, 120.0, 140.0), 0.3


def load() -> Any:  # noqa: ANN401  a module without types
    return package("gym_electric_motor", "the motor")


class Motor:
    """Voltage to current."""

    name = "gem"
    licence = "MIT"

    def __init__(self) -> None:
        self._package = load()
        self._systems = importlib.import_module("gym_electric_motor.physical_systems")
        self._wrappers = importlib.import_module("gym_electric_motor.physical_system_wrappers")
        kc = L_H / (A * DT_S)
        gains = PidGains(kc, kc / (A**2 * DT_S), 0.0)
        self.cards = {
            "current": Card("current", DT_S, (-210.0, 210.0), (-60.0, 60.0), gains, "gem_controllers, a = 4", 20.0)
        }

    def rest(self, _loop: str) -> float:
        """The voltage of the shaft at the first speed, and that of the first current."""
        return 0.165 * SPEEDS[0] + 0.016 * CURRENT_A

    def times(self, _loop: str, _seed: int) -> list[float]:
        """At even intervals."""
        return [HOLD_S * (i + 1) for i in range(EVENTS)]

    def session(self, controls: Mapping[str, Control], loop: str, seed: int) -> None:
        """Steps of the current's setpoint and jumps of the shaft's speed in turn; 210 A end it, as in the package."""
        rng = np.random.default_rng([seed, 15])
        sp, speed, script = CURRENT_A, SPEEDS[0], []
        for i in range(EVENTS + 1):
            script.append((sp, speed))
            if i % 2 == 0:
                sp = CURRENT_A + (0.0 if sp != CURRENT_A else float(rng.choice([-1, 1]) * rng.uniform(10.0, 25.0)))
            else:
                speed = float(rng.choice([x for x in SPEEDS if x != speed]))
        self._run(controls[loop], script, HOLD_S, rng)

    def calm(self, controls: Mapping[str, Control], seconds: float) -> None:
        """One speed, one setpoint, exact."""
        self._run(next(iter(controls.values())), [(CURRENT_A, SPEEDS[0])], seconds, None)

    def _run(
        self, control: Control, script: list[tuple[float, float]], hold_s: float, rng: np.random.Generator | None
    ) -> None:
        def speed(t: float, **_more: object) -> float:
            return script[min(int(max(t, 0.0) / hold_s + 1e-9), len(script) - 1)][1]

        shaft = self._systems.ExternalSpeedLoad(speed, tau=DT_S)
        late = self._wrappers.DeadTimeProcessor(steps=1)
        motor = self._package.make(
            "Cont-CC-PermExDc-v0", load=shaft, physical_system_wrappers=(late,), tau=DT_S, calc_jacobian=False
        )
        system = motor.get_wrapper_attr("physical_system")
        at, limits = system.state_names.index("i"), system.limits
        state = system.reset()
        for sp, _ in script:
            for _ in range(round(hold_s / DT_S)):
                seen = float(state[at] * limits[at]) + (NOISE_A * float(rng.standard_normal()) if rng else 0.0)
                state = system.simulate(np.array([control(sp, seen) / 60.0]))
                if abs(state[at]) > 1.0:
                    raise Tripped(f"{state[at] * limits[at]:.0f} A: over the limit of the package")
