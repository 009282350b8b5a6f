"""Loops that cycle: a valve that sticks, and tones that come from outside."""

from collections.abc import Callable

import numpy as np

from cases.case import FloatArray, Record
from cases.loop import Controller, Upsets, run
from cases.making import MOST_SAMPLES, Plan, event_steps, own_period_s, scaled_record, valve_record
from cases.plant import log_uniform
from cases.setting import Loop, resampled
from cases.signals import Valve, backlash, he, irregular, kano, oscillation
from retuner.schedule.gains import PidGains

PROBE = 5000
CYCLES = (4.0, 25.0)
COARSEST_PER_THETA = 4.0
FEWEST_ROUNDS = 3
LONGEST_PERIOD = 500.0  # Samples in a cycle; slower limit cycles are drawn anew

MakeValve = Callable[[float], Valve]


def sticking(rng: np.random.Generator, kind: str, size: float) -> tuple[MakeValve, float]:
    """A valve of a model family with stick band `size` in co units, and its jump."""
    jump = size * float(rng.uniform(0.2, 1.0))
    if kind == "kano":
        jump = jump if rng.uniform() < 0.8 else size * float(rng.uniform(1.0, 1.4))
        return (lambda start: kano(size, jump, start)), jump
    if kind == "he":
        return (lambda start: he(size, jump, start)), jump
    if kind == "irregular":
        spread, seed = float(rng.uniform(0.25, 0.6)), int(rng.integers(2**31))
        return (lambda start: irregular(np.random.default_rng(seed), size, jump, spread, start)), jump
    return (lambda start: backlash(size, start)), size


def limit_cycle(loop: Loop, gains: PidGains, valve: MakeValve, kick: float) -> tuple[float, float] | None:
    """Period in seconds and pv range of the cycle that a kick leaves without noise; None when it dies or saturates."""
    h_s = loop.theta_s / COARSEST_PER_THETA
    load = np.concatenate([np.full(40, kick), np.zeros(PROBE - 40)])
    controller = Controller(gains, 0.0, loop.low, loop.high)
    try:
        record = run(loop.process, controller, h_s, Upsets(np.zeros(PROBE), load), co0=loop.co0, valve=valve(loop.co0))
    except OverflowError:
        return None
    pv, co = record.pv[PROBE // 2 :], record.co[PROBE // 2 :]
    if min(co.min() - loop.low, loop.high - co.max()) < 0.02 * (loop.high - loop.low):
        return None
    centred = pv - 0.5 * (pv.max() + pv.min())
    ups = np.flatnonzero((centred[:-1] < 0) & (centred[1:] >= 0))
    swing, late = float(np.ptp(pv)), float(np.ptp(pv[-len(pv) // 3 :]))
    if len(ups) < 4 or late < 0.5 * swing:
        return None
    period = float(np.median(np.diff(ups))) * h_s
    return (period, swing) if period > 6 * h_s else None


def stiction_record(
    rng: np.random.Generator, loop: Loop, gains: PidGains, kind: str, quantum: float = 0.0
) -> tuple[Loop, Record, dict[str, float]] | None:
    """A record of the limit cycle that a sticking valve makes; None when there is none that fits a record."""
    size = loop.room * log_uniform(rng, 0.03, 0.25)
    valve, jump = sticking(rng, kind, size)
    found = limit_cycle(loop, gains, valve, 2 * size)
    if found is None:
        return None
    period, swing = found
    if swing < 0.02 * abs(loop.process.k) * jump * (loop.theta_s if loop.process.integrators else 1.0):
        return None
    loop, n = cycles_of(rng, loop, period)
    if n < 3.5 * period / loop.dt_s:
        return None
    noise = log_uniform(rng, 0.003, 0.04)
    if 3 * abs(gains.kp) * noise * swing > 0.3 * size:  # the noise would work the valve loose
        noise = 0.1 * size / (abs(gains.kp) * swing)
    lead_in = int(rng.uniform(1.5, 4) * period / loop.dt_s)
    load = np.concatenate(
        [np.full(lead_in // 3, 2 * size * float(rng.choice([-1, 1]))), np.zeros(n + lead_in - lead_in // 3)]
    )
    sp = np.zeros(n + lead_in)
    if rng.uniform() < 0.35:
        sp = sp + event_steps(rng, n + lead_in, lead_in + rng.uniform(0.1, 0.4) * n, int(rng.integers(1, 3)))
        sp *= swing * float(rng.uniform(0.5, 3.0))
        if abs(sp).max() / abs(loop.process.k) > 0.4 * loop.room and not loop.process.integrators:
            return None
    zero = np.zeros(n + lead_in)
    plan = Plan(sp, load, zero, noise, lead_in, quantum=quantum)
    record = valve_record(rng, loop, gains, plan, valve, swing)
    if any(float(np.ptp(part)) < 0.5 * swing for part in np.array_split(record.pv, 3)):
        still_cycling = False
    else:
        error = record.pv - record.sp
        centred = error - np.median(error)
        ends = np.sign(centred) * (np.abs(centred) > 0.15 * swing)
        still_cycling = int(np.count_nonzero(np.diff(ends[ends != 0]) > 0)) >= FEWEST_ROUNDS
    if not still_cycling:
        return None
    return loop, record, {"s": size, "j": jump, "period": period, "cycles": n * loop.dt_s / period}


def cycles_of(rng: np.random.Generator, loop: Loop, period_s: float) -> tuple[Loop, int]:
    """Sampling and samples for a few to many cycles."""
    coarsest = loop.theta_s / COARSEST_PER_THETA
    dt = min(max(loop.dt_s, period_s / LONGEST_PERIOD * 2), coarsest, period_s / 15)
    loop = resampled(loop, dt)
    n = int(min(log_uniform(rng, *CYCLES) * period_s / dt, MOST_SAMPLES))
    return loop, max(n, 150)


def tone_record(
    rng: np.random.Generator,
    loop: Loop,
    gains: PidGains,
    shape: str,
    ratio: float,
    *,
    jitter: float = 0.0,
    quantum: float = 0.0,
) -> tuple[Loop, Record, dict[str, float]]:
    """An outside oscillation with a period of `ratio` times the loop's own, in the load or on pv."""
    period = ratio * own_period_s(loop, gains)
    loop, n = cycles_of(rng, loop, period)
    lead_in = int(2 * period / loop.dt_s)
    wave = oscillation(rng, n + lead_in, period / loop.dt_s, shape, jitter)
    zero = np.zeros(n + lead_in)
    inside = rng.uniform() < 0.6
    load, out = (wave, zero) if inside else (zero, wave)
    swing = float(np.ptp(run(loop.process, Controller(gains), loop.dt_s, Upsets(zero, load, out)).pv[lead_in:]))
    sp = zero
    if rng.uniform() < 0.4:
        sp = event_steps(rng, n + lead_in, lead_in + float(rng.uniform(0.1, 0.4)) * n, int(rng.integers(1, 4)))
        sp = sp * swing * log_uniform(rng, 0.5, 3.0)
    plan = Plan(sp, load, out, log_uniform(rng, 0.005, 0.05), lead_in, quantum=quantum)
    record = scaled_record(rng, loop, gains, plan)
    return loop, record, {"period": period, "cycles": n * loop.dt_s / period}


def far_from_own(rng: np.random.Generator) -> float:
    """Ratio of an outside period to the loop's own, a factor of 1.6 away or more."""
    return log_uniform(rng, 1.6, 8.0) if rng.uniform() < 0.75 else log_uniform(rng, 0.35, 0.62)


def silence(n: int) -> FloatArray:
    return np.zeros(n)
