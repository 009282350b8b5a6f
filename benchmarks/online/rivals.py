"""What retuner is compared with, in the same runs: a relay experiment or a step, once, and pattern rules alone.

Both experiments are given what an engineer would have to find out: the sign of the process, and an amplitude that moves
pv by about one, a hundred times the noise.
"""

import math
from typing import NamedTuple

import numpy as np
from cases.plant import later

from online.loop import Moved
from retuner import GainTable, LinearProcess, PidGains, RetunerSettings
from retuner.adaptive.experiments.relay import relay_cycle
from retuner.adaptive.identification.identify import OPEN_LOOP, identify_window
from retuner.adaptive.loop.margins import ultimate
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.response_finder import Completed, ResponseFinder
from retuner.adaptive.without_model.pattern_rule import PatternSettings, pattern_rule

WAVES = 12  # Periods of the relay experiment
HYSTERESIS_STD = 3.0
KU_PART, PU_PART = 0.45, 1.2  # Ziegler & Nichols (1942), PI: Kc = 0.45 Ku, tau_I = Pu / 1.2
STEP_LAGS, STEP_THETA, MOST_THETA = 5.0, 10.0, 60.0
"""Length of the step experiment: so many lags and dead times, and at most so many dead times."""


def relay_then_ziegler_nichols(
    plant: Moved, process: LinearProcess, dt_s: float, noise: float, rng: np.random.Generator
) -> PidGains | None:
    """PI settings from a relay experiment on the plant, whose linearisation here is `process`; None when it fails.

    noise : standard deviation, of a swing of pv by one.
    """
    ku, pu = ultimate(process)
    d = math.pi / 4 * abs(ku)
    n = int((WAVES * pu + 2 * process.theta_s) / dt_s)
    hysteresis = HYSTERESIS_STD * noise
    y, on, pvs, cos = 0.0, 1.0, [], []
    for more in (noise * rng.standard_normal(n)).tolist():
        pv = y + more
        if pv * math.copysign(1.0, ku) > hysteresis:
            on = -1.0
        elif pv * math.copysign(1.0, ku) < -hysteresis:
            on = 1.0
        pvs.append(pv)
        cos.append(on * d)
        y = plant.move(on * d)
    times = np.arange(n) * dt_s
    try:
        cycle = relay_cycle(Window(times, np.zeros(n), np.array(pvs), np.array(cos)), hysteresis)
    except ValueError:
        return None
    kp = math.copysign(KU_PART * cycle.ku, ku)
    return PidGains(kp, kp * PU_PART / cycle.pu_s)


def step_then_simc(
    plant: Moved,
    process: LinearProcess,
    theta_s: float,
    dt_s: float,
    noise: float,
    rng: np.random.Generator,
    size: float = 1.0,
) -> PidGains | None:
    """SIMC PI (tau_c = theta) on the model identified from one open-loop step; None when it is not identifiable."""
    lag = max((*process.lags_s, *(math.sqrt(c2) for _, c2 in process.quadratics), 0.0))
    length_s = min(STEP_LAGS * lag + STEP_THETA * theta_s, MOST_THETA * theta_s)
    lead, n = 20, int(length_s / dt_s)
    slow = length_s if process.integrators else lag * (1 - math.exp(-length_s / lag)) if lag else 1.0
    u = size / (process.k * (slow if process.integrators else slow / (lag or 1.0)))
    pvs, y = [], 0.0
    co = np.concatenate([np.zeros(lead), np.full(n, u)])
    for held, more in zip(co.tolist(), (noise * rng.standard_normal(lead + n)).tolist(), strict=True):
        pvs.append(y + more)
        y = plant.move(held)
    window = Window(np.arange(lead + n) * dt_s, np.zeros(lead + n), np.array(pvs), co)
    estimate = identify_window(window, None, settings=OPEN_LOOP)
    if not estimate.identifiable:
        return None
    return simc(later(estimate.log.model(), dt_s / 2)).gains


class PatternAlone:
    """Recogniser and pattern rule, nothing else: no model, no cause, no proof, no trial."""

    def __init__(self, table: GainTable, wanted: RetunerSettings) -> None:
        self.table = table
        self.finder = ResponseFinder(table.regions, self.gains_at, wanted)
        self.rule = PatternSettings(alone=True)

    def gains_at(self, region: int, x: float, x2: float) -> PidGains:
        """The gains in force."""
        return self.table.at(region, x, x2)

    def observe(self, sample: LoopSample) -> tuple[int, PidGains] | None:
        """What the pattern of a completed response asks for."""
        seen = self.finder.step(sample)
        if not isinstance(seen, Completed):
            return None
        gains = self.table.gains_of(seen.region)
        advice = pattern_rule(seen.response, self.finder.window(seen.response), gains, None, self.rule)
        return None if advice.tuning is None else (seen.region, advice.tuning.gains)

    def written(self, region: int, gains: PidGains) -> None:
        """The controller runs them now."""
        self.table = self.table.with_gains(region, gains)
        self.finder.gains_changed()


# ---- The standard batch of processes that PID rules are tried on.
#
# Nine families, from Astrom & Hagglund (2004), "Revisiting the Ziegler-Nichols step response method for PID control",
# J. Process Control 14, section 3 (the test batch), and Astrom & Hagglund (2006), "Advanced PID Control", section 7.2:
#
#     P1  e^-s / (1 + sT)              P6  e^-sL / (s (1 + s(1 - L)))
#     P2  e^-s / (1 + sT)^2            P7  T e^-sL / ((1 + sT)(1 + s(1 - L)))
#     P3  1 / ((s + 1)(1 + sT)^2)      P8  (1 - as) / (s + 1)^3
#     P4  1 / (s + 1)^n                P9  1 / ((s + 1)((sT)^2 + 1.4 sT + 1))
#     P5  1 / ((1 + s)(1 + as)(1 + a^2 s)(1 + a^3 s))

P1_T = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.3, 1.5, 2, 4, 6, 8, 10, 20, 50, 100, 200, 500, 1000)
P2_T = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.3, 1.5, 2, 4, 6, 8, 10, 20, 50, 100, 200, 500)
P3_T = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 2, 5, 10)
P4_N = (3, 4, 5, 6, 7, 8)
P5_A = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
P6_L = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1)
P7_T, P7_L = (1, 2, 5, 10), (0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 1)
P8_A = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.1)
P9_T = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)


class Member(NamedTuple):
    """One process of the batch. family : P1 to P9. parameter : as in the head of this file, for people."""

    family: str
    parameter: str
    process: LinearProcess

    @property
    def name(self) -> str:
        """For example "P7 T=2 L=0.1"."""
        return f"{self.family} {self.parameter}"


def batch() -> list[Member]:
    """All processes of the batch, 134, in the order of the families."""
    return [
        *(Member("P1", f"T={t:g}", LinearProcess(1.0, (t,), (), 1.0)) for t in P1_T),
        *(Member("P2", f"T={t:g}", LinearProcess(1.0, (t, t), (), 1.0)) for t in P2_T),
        *(Member("P3", f"T={t:g}", LinearProcess(1.0, (1.0, t, t))) for t in P3_T),
        *(Member("P4", f"n={n}", LinearProcess(1.0, (1.0,) * n)) for n in P4_N),
        *(Member("P5", f"a={a:g}", LinearProcess(1.0, tuple(a**i for i in range(4)))) for a in P5_A),
        *(Member("P6", f"L={x:g}", LinearProcess(1.0, _lags(1 - x), (), x, 1)) for x in P6_L),
        *(Member("P7", f"T={t} L={x:g}", LinearProcess(t, (t, *_lags(1 - x)), (), x)) for t in P7_T for x in P7_L),
        *(Member("P8", f"a={a:g}", LinearProcess(1.0, (1.0, 1.0, 1.0), (-a,))) for a in P8_A),
        *(Member("P9", f"T={t:g}", LinearProcess(1.0, (1.0,), (), 0.0, 0, ((1.4 * t, t * t),))) for t in P9_T),
    ]


def _lags(lag: float) -> tuple[float, ...]:
    """None where it is nothing."""
    return (lag,) if lag > 0 else ()
