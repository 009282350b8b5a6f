"""Records of processes that no structure of the family fits: are the standard deviations still true?

    third order and zero    three lags, and a lead of 0.2 to 0.8 of the largest
    inverse response        two lags and a zero in the right half plane, 0.2 to 1 of the smaller lag
    time-varying            a gain that drifts by 5 to 25 % along the record
    nonlinear valve         more gain the farther open: a slope that changes by 10 to 60 % over co's travel

One setpoint step or two, a load step in half of the records, under PI. What is true of such a process at its operating
point is its response at a frequency, whatever the structure: there the model is asked.
"""

import math
from dataclasses import dataclass

import numpy as np

from cases.case import Record
from cases.plant import HeldPlant, best_pi, half_rule, log_uniform, robustness
from cases.setting import scaled
from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains

KINDS = ("third order and zero", "inverse response", "time-varying", "nonlinear valve")
SAMPLES_PER_THETA = (6.0, 25.0)
LENGTH = 60.0
"""Length of a record, in effective dead times and largest lags."""
MOST_SAMPLES = 1500
MOST_MS = 3.0


@dataclass(frozen=True, slots=True)
class BeyondCase:
    """A record with what made it. process : at the operating point. theta_eff_s : its effective dead time for PI."""

    kind: str
    record: Record
    gains: PidGains
    process: LinearProcess
    theta_eff_s: float


def case(seed: int, index: int) -> BeyondCase:
    """The case of that number; kinds take turns."""
    rng = np.random.default_rng([seed, index, 3])
    kind = KINDS[index % len(KINDS)]
    while True:
        process = _process(rng, kind)
        theta = half_rule(_without_lead(process)).theta_s
        dt = theta / log_uniform(rng, *SAMPLES_PER_THETA)
        gains = scaled(best_pi(_without_lead(process), dt), log_uniform(rng, 0.4, 1.2), log_uniform(rng, 0.6, 2.0))
        if robustness(process, gains).ms < MOST_MS:
            break
    n = int(min(LENGTH * (theta + max(process.lags_s)) / 4 / dt, MOST_SAMPLES))
    # the loop from rest: a setpoint step after a tenth, another after half in half of the records, and a load
    plant, integral, pv = HeldPlant(process, dt), 0.0, 0.0
    drift = float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.05, 0.25)) if kind == "time-varying" else 0.0
    bend = float(rng.uniform(0.05, 0.3)) if kind == "nonlinear valve" else 0.0
    back = int(n * 0.55) if rng.uniform() < 0.5 else n
    load_at = int(n * rng.uniform(0.3, 0.9)) if rng.uniform() < 0.5 else n
    load = float(rng.uniform(-0.6, 0.6)) / process.k
    sigma = log_uniform(rng, 0.003, 0.02)
    rows = []
    for i in range(n):
        sp = 1.0 if n // 10 <= i < back else 0.0
        seen = pv + sigma * float(rng.standard_normal())
        integral += gains.ki * dt * (sp - seen)
        co = gains.kp * (sp - seen) + integral
        rows.append((i * dt, sp, seen, co))
        through = co * (1 + drift * (i / n - 0.5)) + bend / process.k * _bent(process.k * co - 0.5)
        pv = float(plant.move(through + load * (i >= load_at)))
    return BeyondCase(kind, Record(*np.array(rows).T), gains, process, theta)


def _without_lead(process: LinearProcess) -> LinearProcess:
    """The half rule of the generators knows no leads; a smaller largest lag stands for one."""
    leads = [x for x in process.leads_s if x > 0]
    if not leads:
        return process
    lags = sorted(process.lags_s, reverse=True)
    return LinearProcess(process.k, (max(lags[0] - leads[0], lags[1]), *lags[1:]), (), process.theta_s)


def _process(rng: np.random.Generator, kind: str) -> LinearProcess:
    """A process of a kind, with a gain of either sign."""
    k = float(rng.choice([-1.0, 1.0])) * log_uniform(rng, 0.1, 10.0)
    t1 = log_uniform(rng, 2.0, 20.0)
    if kind == "third order and zero":
        return LinearProcess(k, (t1, t1 * rng.uniform(0.3, 0.9), 1.0), (t1 * float(rng.uniform(0.2, 0.8)),), 1.0)
    if kind == "inverse response":
        t2 = t1 * float(rng.uniform(0.2, 0.8))
        return LinearProcess(k, (t1, t2), (-t2 * float(rng.uniform(0.2, 1.0)),), 0.5)
    return LinearProcess(k, (t1, float(rng.uniform(0.1, 1.0))), (), 1.0)


def _bent(x: float) -> float:
    """A curve whose slope goes from -1 to 1, steepest round zero: ln cosh(2 x) / 2."""
    return (abs(2 * x) + math.log1p(math.exp(-abs(4 * x)))) / 2


def log_size(process: LinearProcess, at_s: float) -> float:
    """ln |G(j / at_s)|."""
    return math.log(abs(complex(process.response(np.array([1 / at_s]))[0])))
