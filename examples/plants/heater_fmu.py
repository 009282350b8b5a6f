"""A stirred heater as a functional mock-up unit (FMI 2, co-simulation), made with PythonFMU:

pip install pythonfmu && pythonfmu build -f examples/plants/heater_fmu.py -d runs

C dT/dt = P u/100 - k (T - T_a),   tau dy/dt = T - y
"""

import math

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Heater(Fmi2Slave):
    """Input u in percent, output y in degC; parameters by name."""

    author = "retuner"
    description = "Stirred heater"

    def __init__(self, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.power, self.loss, self.capacity = 2000.0, 20.0, 4000.0  # W, W/K, J/K
        self.ambient, self.tau = 20.0, 5.0  # degC, s
        self.u, self.temp, self.y = 0.0, 60.0, 60.0
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output))
        for name in ("power", "loss", "capacity", "ambient", "tau"):
            tunable = Fmi2Variability.tunable
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=tunable))

    def do_step(self, current_time: float, step_size: float) -> bool:  # noqa: ARG002  the standard has it
        """Exact for held u, but the sensor, which takes the tank as it is in the middle of the step."""
        goal = self.ambient + self.power * self.u / 100.0 / self.loss
        before = self.temp
        self.temp = goal + (before - goal) * math.exp(-step_size * self.loss / self.capacity)
        middle = (before + self.temp) / 2.0
        self.y = middle + (self.y - middle) * math.exp(-step_size / self.tau)
        return True
