"""The quadruple tank of K. H. Johansson (IEEE Trans. Control Systems Technology 8, 2000, 456-465): two loops.

    A1 dh1/dt = -a1 sqrt(2 g h1) + a3 sqrt(2 g h3) + gamma1 k1 v1      A3 dh3/dt = -a3 sqrt(2 g h3) + (1 - gamma2) k2 v2
    A2 dh2/dt = -a2 sqrt(2 g h2) + a4 sqrt(2 g h4) + gamma2 k2 v2      A4 dh4/dt = -a4 sqrt(2 g h4) + (1 - gamma1) k1 v1

Levels in cm, pump voltages in V; the numbers are Johansson's table at his minimum-phase working point. The pumps follow
their voltage with a lag, which he leaves out.
"""

import math

AREAS = (28.0, 32.0, 28.0, 32.0)  # cm2
OUTLETS = (0.071, 0.057, 0.071, 0.057)  # cm2
GRAVITY = 981.0  # cm/s2
PUMPS = (3.33, 3.35)  # cm3/(V s)
LONGEST_STEP = 0.5  # s; the tanks' time constants are 23 to 90 s


class QuadrupleTank:
    """gamma1, gamma2 : shares of the two pumps' water that go to the lower tanks; a sum above 1 is the easy plant."""

    def __init__(self, gamma1: float = 0.70, gamma2: float = 0.60, lag: float = 6.0) -> None:
        self.gammas, self.lag = (gamma1, gamma2), lag
        self.volts = [3.0, 3.0]
        (g1, g2), (k1, k2) = self.gammas, PUMPS
        flows = (g1 * k1 + (1 - g2) * k2, g2 * k2 + (1 - g1) * k1, (1 - g2) * k2, (1 - g1) * k1)  # at rest
        self.levels = [(q * 3.0 / a) ** 2 / (2 * GRAVITY) for q, a in zip(flows, OUTLETS, strict=True)]

    @property
    def pv(self) -> dict[str, float]:
        """Levels of the two lower tanks, cm."""
        return {"level1": self.levels[0], "level2": self.levels[1]}

    def step(self, co: dict[str, float], dt: float) -> dict[str, float]:
        """Hold both pumps' voltages for dt seconds."""
        steps = math.ceil(dt / LONGEST_STEP)
        h = dt / steps
        held = math.exp(-h / self.lag)
        for _ in range(steps):
            goals = (co["pump1"], co["pump2"])
            self.volts = [goal + (v - goal) * held for goal, v in zip(goals, self.volts, strict=True)]
            middle = [x + r * h / 2 for x, r in zip(self.levels, self.rates(self.levels), strict=True)]
            self.levels = [max(x + r * h, 0.0) for x, r in zip(self.levels, self.rates(middle), strict=True)]
        return self.pv

    def rates(self, levels: list[float]) -> list[float]:
        """dh/dt of all four, cm/s."""
        out = [a * math.sqrt(2 * GRAVITY * max(h, 0.0)) for a, h in zip(OUTLETS, levels, strict=True)]
        q1, q2 = (k * v for k, v in zip(PUMPS, self.volts, strict=True))
        g1, g2 = self.gammas
        into = (out[2] + g1 * q1, out[3] + g2 * q2, (1 - g2) * q2, (1 - g1) * q1)
        return [(i - o) / area for i, o, area in zip(into, out, AREAS, strict=True)]
