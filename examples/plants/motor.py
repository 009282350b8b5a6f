"""The armature current of a DC motor of gym-electric-motor (MIT), with its converter, one sample late:

pip install --no-deps gym-electric-motor gymnasium cloudpickle farama-notifications && pip install matplotlib
"""

from typing import Any

import gym_electric_motor as gem
import numpy as np
from gym_electric_motor.physical_system_wrappers import DeadTimeProcessor
from gym_electric_motor.physical_systems import ExternalSpeedLoad

DT_S = 1e-4
SUPPLY_V = 60.0


class Motor:
    """A PMG 132. Inputs: voltage in V; faster in rad/s over `speed`, at which something else turns the shaft."""

    def __init__(self, speed: float = 100.0) -> None:
        self.speed = speed
        shaft = ExternalSpeedLoad(lambda t, **_more: self.speed, tau=DT_S)  # noqa: ARG005  called by name
        late = DeadTimeProcessor(steps=1)
        motor: Any = gem.make(
            "Cont-CC-PermExDc-v0", load=shaft, physical_system_wrappers=(late,), tau=DT_S, calc_jacobian=False
        )
        self.system: Any = motor.get_wrapper_attr("physical_system")
        self.at, self.rest = self.system.state_names.index("i"), speed
        self.state = self.system.reset()

    @property
    def pv(self) -> dict[str, float]:
        """The current in A."""
        return {"current": float(self.state[self.at] * self.system.limits[self.at])}

    def step(self, co: dict[str, float], dt: float) -> dict[str, float]:
        """Hold the voltage for dt seconds, whole samples of 0.1 ms."""
        self.speed = self.rest + co.get("faster", 0.0)
        for _ in range(max(round(dt / DT_S), 1)):
            self.state = self.system.simulate(np.array([min(max(co["voltage"] / SUPPLY_V, -1.0), 1.0)]))
        return self.pv
