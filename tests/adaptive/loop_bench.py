"""A simulated loop under a retuner: first order with dead time, under PI with the gains of the retuner's table."""

import math
from collections.abc import Iterator

import numpy as np

from retuner import Action, Decision, GainTable, LoopMode, LoopSample, Mode, Regions, Retuner, RetunerSettings
from retuner.schedule.gains import PidGains, SeriesGains

GOOD = SeriesGains(5.0, 40.0).to_parallel()  # SIMC for e^-5s / (50 s + 1)
REGIONS = Regions("pv", "-", ("a", "b"), 0.0, (50.0,), 100.0, 2.0, 0.0)


def table(gains: PidGains) -> GainTable:
    return GainTable("loop", REGIONS, (gains, gains))


class Bench:
    """A process of first order + dead time in samples, under PI with the gains of the retuner's table.

    step : of its sensor; 0 for a fine one.
    """

    def __init__(
        self, retuner: Retuner, sign: float = 1, seed: int = 0, noise: float = 0.01, step: float = 0.0
    ) -> None:
        self.retuner, self.sign, self.noise, self.step = retuner, sign, noise, step
        self.rng = np.random.default_rng(seed)
        self.t, self.x, self.integral, self.pv = 0.0, 0.0, 0.0, 0.0
        self.past = [0.0] * 5

    def run(self, seconds: int, sp: float = 0.0, load: float = 0.0, x: float = 10.0) -> list[Decision]:
        return [d for d in map(self.retuner.observe, self.samples(seconds, sp, load, x)) if d and self.obey(d)]

    def samples(self, seconds: int, sp: float, load: float, x: float) -> Iterator[LoopSample]:
        for _ in range(seconds):
            gains = self.retuner.table.gains_of(0)
            e = sp - self.pv
            co = gains.kp * e + self.integral
            self.integral += gains.ki * e
            yield LoopSample(self.t, sp, self.pv, co, LoopMode.AUTO, 0, x, 0)
            self.past.append(co)
            a = math.exp(-1 / 50.0)
            self.x = a * self.x + (1 - a) * (self.sign * self.past.pop(0) + load)
            pv = self.x + self.noise * float(self.rng.standard_normal())
            self.pv = round(pv / self.step) * self.step if self.step else pv
            self.t += 1.0

    def obey(self, decision: Decision) -> bool:
        if decision.action == Action.WRITE and decision.gains_after:
            self.retuner.committed(self.retuner.table.index(decision.region), decision.gains_after)
        return True

    def exercise(self, upsets: int = 7) -> list[Decision]:
        found = self.run(400)
        for sp, load in ((1, 0), (1, 0.5), (1, 0), (0, 0), (0, -0.5), (0, 0), (1, 0))[:upsets]:
            found += self.run(500, sp, load * self.sign)
        return found


def made(gains: PidGains, mode: Mode = Mode.AUTO, sign: int = 1, seed: int = 0) -> Bench:
    return Bench(Retuner(table(gains), RetunerSettings(1.0, 10.0, mode)), sign, seed)


def scaled(kp: float, ki: float) -> PidGains:
    return PidGains(GOOD.kp * kp, GOOD.ki * ki)
