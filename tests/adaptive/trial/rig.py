"""A sampled PI loop on first order with dead time whose gains may change at any sample, as a stream of samples."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from retuner import GainTable, LoopSample, PidGains, ProcessModel, ProcessType, Regions, RetunerSettings
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.trial.judge import JudgedResponse
from retuner.adaptive.trial.prediction import predict

THETA_SAMPLES = 5


@dataclass
class Rig:
    """k/(tau s + 1) with a dead time of 5 samples of 1 s; output between -limit and limit."""

    gains: PidGains
    k: float = 1.0
    tau_s: float = 50.0
    noise: float = 0.0
    limit: float = 1e6
    sp: float = 0.0
    load: float = 0.0
    seed: int = 0
    t_s: float = 0.0
    x: float = 0.0
    integral: float = 0.0
    waiting: deque[float] = field(default_factory=lambda: deque([0.0] * THETA_SAMPLES))

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def change(self, gains: PidGains) -> None:
        """Bumpless at the present error."""
        e = self.sp - self.x
        self.integral += (self.gains.kp - gains.kp) * e
        self.gains = gains

    def run(self, samples: int) -> Iterator[LoopSample]:
        """The next samples."""
        keep = math.exp(-1.0 / self.tau_s)
        for _ in range(samples):
            self.t_s += 1.0
            pv = self.x + self.noise * float(self._rng.standard_normal())
            e = self.sp - pv
            raw = self.gains.kp * e + self.integral + self.gains.ki * e
            co = min(max(raw, -self.limit), self.limit)
            limited = 0 if co == raw else (1 if raw > co else -1)
            self.integral += 0.0 if limited else self.gains.ki * e
            self.waiting.append(co)
            self.x = keep * self.x + (1 - keep) * self.k * (self.waiting.popleft() + self.load)
            yield LoopSample(self.t_s, self.sp, pv, co, limited=limited)


MODEL = ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, float(THETA_SAMPLES))
GOOD = simc(ProcessModel(ProcessType.FOPDT, 1.0, 50.0, 0.0, THETA_SAMPLES + 0.5), THETA_SAMPLES + 0.5).gains
PROMISE = predict([Plausible(MODEL, 0.0)], GOOD, GOOD, 1.0)
BAD = {
    "kc x4": PidGains(4 * GOOD.kp, 4 * GOOD.ki),
    "kc /4": PidGains(GOOD.kp / 4, GOOD.ki / 4),
    "tau_i /4": PidGains(GOOD.kp, 4 * GOOD.ki),
    "tau_i x4": PidGains(GOOD.kp, GOOD.ki / 4),
}
"""Deliberately bad changes of GOOD."""


def responses(rig: Rig, samples: int, band: float = 0.1, rest: int = 200, **upset: float) -> list[JudgedResponse]:
    """The responses that a finder recognises in the rig's next samples; after `rest` samples comes the upset."""
    table = GainTable("loop", Regions("sp", "-", ("all",), -1e3, (), 1e3), (rig.gains,))
    finder = ResponseFinder(table.regions, table.at, RetunerSettings(1.0, 100.0, band=band))
    found = []
    for part, changes in ((rest, {}), (samples, upset)):
        for name, value in changes.items():
            setattr(rig, name, value)
        for sample in rig.run(part):
            seen = finder.step(sample)
            if isinstance(seen, Completed):
                found.append(JudgedResponse(seen.response, finder.window(seen.response)))
    return found
