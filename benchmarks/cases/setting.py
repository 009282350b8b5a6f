"""A loop drawn at random: process, sampling, units, settings in force, how long it takes to settle; and its record."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cases.case import Record
from cases.loop import Controller, Upsets, run
from cases.plant import Robustness, best_pi, best_pid, draw, half_rule, log_uniform, robustness, sampled
from retuner.adaptive.process.model import LinearProcess
from retuner.schedule.gains import PidGains, from_form, to_series

RANGES = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0), (4.0, 20.0), (0.0, 1.0), (0.0, 255.0), (-100.0, 100.0))
"""Ranges of controller outputs that are met with, percent three times as often as any other."""
SAMPLES_PER_THETA = (5.0, 40.0)
COARSEST_PER_THETA = 5.0
PROBE_PER_THETA = 5.0
PROBE_STEPS = 2400
FINER_MOST = 8.0


@dataclass(frozen=True, slots=True)
class Loop:
    """A process with what can be known about controlling it.

    theta_s : effective dead time for PI. low, high : range of the output. co0 : its resting value.
    """

    family: str
    process: LinearProcess
    theta_s: float
    dt_s: float
    low: float
    high: float
    co0: float
    best: PidGains
    best_pid: PidGains | None

    @property
    def room(self) -> float:
        """How far the output may go from rest to either side."""
        return min(self.co0 - self.low, self.high - self.co0)

    def margins(self, gains: PidGains, tau_f_s: float = 0.0) -> Robustness:
        """Robustness of the true loop, sampling included."""
        return robustness(sampled(self.process, self.dt_s), gains, tau_f_s)

    def run(self, gains: PidGains, upsets: Upsets, **more: Any) -> Record:
        """A record in automatic, from rest. more : pv0, valve and sensor, as cases.loop.run takes them."""
        controller = Controller(gains, 0.0, self.low, self.high)
        return run(self.process, controller, self.dt_s, upsets, co0=self.co0, **more)


@dataclass(frozen=True, slots=True)
class IdentificationCase:
    """A record to identify from.

    group : how it came about. loop : with the limits of the record's output; its process is without the sampling's own
    delay. gains : in force, None for an experiment in manual. noise : standard deviation of the measurement noise.
    """

    group: str
    loop: Loop
    record: Record
    gains: PidGains | None
    noise: float
    note: dict[str, float]
    seed: int = 0
    index: int = 0


@dataclass(frozen=True, slots=True)
class DiagnosisCase:
    """A record with the cause that made it.

    group : a cause, or the name of a trap. right : the answers that count as right. hidden : the cause by construction,
    where it is one of the eight; else what was built.
    """

    group: str
    loop: Loop
    record: Record
    gains: PidGains
    right: frozenset[str]
    hidden: str
    note: dict[str, float] = field(default_factory=dict)
    seed: int = 0
    index: int = 0

    @property
    def retune_right(self) -> bool:
        """Whether a change of gains is."""
        return bool(self.right & {"aggressive", "sluggish", "slow_integrating"})


def draw_loop(rng: np.random.Generator, family: str, per_theta: tuple[float, float] = SAMPLES_PER_THETA) -> Loop:
    """A process of the family with its sampling and its output's range."""
    process = draw(rng, family)
    theta = half_rule(process).theta_s
    dt = theta / log_uniform(rng, *per_theta)
    low, high = RANGES[int(rng.integers(len(RANGES)))]
    co0 = low + float(rng.uniform(0.3, 0.7)) * (high - low)
    return Loop(family, process, theta, dt, low, high, co0, best_pi(process, dt), best_pid(process, dt))


def resampled(loop: Loop, dt_s: float) -> Loop:
    """The same loop under another sampling."""
    process = loop.process
    return replace(loop, dt_s=dt_s, best=best_pi(process, dt_s), best_pid=best_pid(process, dt_s))


def slowed(loop: Loop, by: float) -> Loop:
    """The same loop with everything so many times slower, and its best PI settings."""
    p, best = loop.process, loop.best
    lags, leads = (tuple(x * by for x in times) for times in (p.lags_s, p.leads_s))
    pairs = tuple((c1 * by, c2 * by * by) for c1, c2 in p.quadratics)
    process = LinearProcess(p.k / by**p.integrators, lags, leads, p.theta_s * by, p.integrators, pairs)
    best = PidGains(best.kp, best.ki / by, best.kd * by)
    return replace(loop, process=process, theta_s=loop.theta_s * by, dt_s=loop.dt_s * by, best=best, best_pid=None)


def fitted(loop: Loop, length_s: float, fewest: int, most: int) -> tuple[Loop, int]:
    """A sampling no finer than a record of that length allows, and the number of samples: too long a record is cut."""
    dt = min(max(loop.dt_s, length_s / most), loop.theta_s / COARSEST_PER_THETA, length_s / fewest)
    return (loop if dt == loop.dt_s else resampled(loop, dt)), int(min(length_s / dt, most))


def scaled(gains: PidGains, kc: float, tau_i: float) -> PidGains:
    return PidGains(gains.kp * kc, gains.ki * kc / tau_i)


def scaled_pid(rng: np.random.Generator, gains: PidGains, kc: float, tau_i: float) -> tuple[PidGains, float, str]:
    """The same of PID settings, in series or ideal form, with the filter time of the derivative."""
    series = to_series(gains)
    form = str(rng.choice(["series", "ideal"]))
    tau_d = series.tau_d_s * log_uniform(rng, 0.5, 1.2)
    tau_i_s = (series.tau_i_s or 0.0) * tau_i
    made = from_form(form, series.kc * kc, tau_i_s, tau_d)
    return made, tau_d / float(rng.uniform(4, 12)), form


def settling_s(loop: Loop, gains: PidGains, tau_f_s: float = 0.0) -> float:
    """Time after a setpoint and a load step until pv stays within 5 % of its largest excursion."""
    h_s = max(loop.theta_s / PROBE_PER_THETA, loop.dt_s)
    try:
        return _settled_s(loop.process, Controller(gains, tau_f_s), h_s, PROBE_STEPS)
    except OverflowError:  # stable at the loop's own sampling only
        finer = int(min(h_s / loop.dt_s, FINER_MOST))
        return _settled_s(loop.process, Controller(gains, tau_f_s), loop.dt_s, PROBE_STEPS * finer)


def _settled_s(process: LinearProcess, controller: Controller, h_s: float, n: int) -> float:
    worst = 0.0
    for upsets in (Upsets(np.ones(n)), Upsets(np.zeros(n), load=np.ones(n))):
        record = run(process, controller, h_s, upsets)
        error = np.abs(record.pv - record.pv[-1])
        out = np.flatnonzero(error > 0.05 * np.max(error))
        worst = max(worst, float(out[-1] + 1) * h_s)
    return worst
