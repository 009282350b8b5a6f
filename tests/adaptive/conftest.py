"""A loop to test against: PI on first order + dead time, the process solved exactly between samples."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from retuner.adaptive.signals.sample import Window


@dataclass(frozen=True)
class Loop:
    """A PI loop on first order + dead time; setpoint and load are steps at a time of their own."""

    k: float = 1.0
    tau: float = 50.0
    theta: float = 5.0
    kc: float = 5.0
    tau_i: float = 40.0
    dt: float = 0.5
    n: int = 500
    sp: float = 0.0
    load: float = 0.0
    at: float = 40.0
    noise: float = 0.0

    def run(self, seed: int = 0, t0: float = 0.0) -> Window:
        """Simulate from rest; t0 shifts the time stamps."""
        rng = np.random.default_rng(seed)
        x, integral = 0.0, 0.0
        co: list[float] = []
        rows = []
        for i in range(self.n):
            t = i * self.dt
            sp = self.sp if t >= self.at else 0.0
            pv = x + self.noise * float(rng.standard_normal())
            integral += self.kc / self.tau_i * (sp - pv) * self.dt
            co.append(self.kc * (sp - pv) + integral)
            rows.append((t + t0, sp, pv, co[-1]))
            x = self._advance(x, t, co)
        t_s, sps, pvs, cos = np.array(rows).T
        return Window(t_s, sps, pvs, cos)

    def _advance(self, x: float, t: float, co: list[float]) -> float:
        """Exact solution over one interval: split where the delayed input or the load switches."""
        first = math.floor((t - self.theta) / self.dt)
        cuts = {t, t + self.dt, *((first + j) * self.dt + self.theta for j in range(3)), self.at}
        edges = sorted(c for c in cuts if t <= c <= t + self.dt)
        for a, b in itertools.pairwise(edges):
            middle = (a + b) / 2
            j = math.floor((middle - self.theta) / self.dt)
            u = (co[j] if j >= 0 else 0.0) + (self.load if middle >= self.at else 0.0)
            x = self.k * u + (x - self.k * u) * math.exp(-(b - a) / self.tau)
        return x


@pytest.fixture
def loop() -> Callable[..., Loop]:
    """Make a loop by keyword."""
    return Loop
