"""A plant of your own: a drum that a pump fills and a hole in its bottom empties."""

import math

AREA, HOLE, GRAVITY = 0.5, 0.004, 9.81  # m2, m2, m/s2
PUMP, PUMP_LAG = 0.0002, 6.0  # m3/s for 1 %, s


class Tank:
    """The level follows the pump with a gain and a lag that grow with the level: a schedule's case."""

    def __init__(self, level: float = 1.0) -> None:
        self.pv = level
        self.inflow = HOLE * math.sqrt(2 * GRAVITY * level)  # at rest

    def step(self, co: float, dt: float) -> float:
        """Hold the pump for dt seconds; the level, m."""
        self.inflow += (PUMP * co - self.inflow) * -math.expm1(-dt / PUMP_LAG)
        outflow = HOLE * math.sqrt(2 * GRAVITY * max(self.pv, 0.0))
        self.pv += (self.inflow - outflow) * dt / AREA
        return self.pv
