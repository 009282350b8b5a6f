"""Days of ordinary closed-loop record: the loop goes over its range and back under poor gains.

Each of VISITED places is visited `visits` times, on the way up and on the way down in turn, each time somewhere in its
part of the range. In the middle of every second one the load
steps to another level and stays there. Where the place is an outside signal, the signal
ramps there and the setpoint steps up or down at each.
"""

from dataclasses import replace

import numpy as np
from cases.robustness import robustness
from online.judge import Judge

from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable
from schedules.lookups import Lookup, regions_along
from schedules.loop import Trace, Visit, run
from schedules.subject import Subject
from schedules.truth import Truth

VISITED = 8
HOLD_THETA, HOLD_CLOSED = 50.0, 6.0
"""A visit lasts so many dead times there, or so many times of the loop under the gains in force, up to MOST_SAMPLES."""
MOST_SAMPLES = 2500
LOAD_SHARE = 0.05
"""Of the span: how far the largest load would move pv at rest."""
STEP_SHARE = 0.08
"""Of the span: a setpoint step where the place is an outside signal."""
MS_POOR = 2.5
"""The poor gains are no worse than this anywhere."""
REGIONS_IN_FORCE = 3


def poor(truth: Truth, rng: np.random.Generator) -> PidGains:
    """One set for everywhere: stable everywhere, and right nowhere or in few places."""
    best = truth.best()
    least = min(best, key=lambda g: abs(g.kp))
    tau_i = float(np.median([g.kp / g.ki for g in best]) * rng.uniform(0.6, 2.0))
    kp = least.kp * float(rng.uniform(0.4, 1.0))
    for _ in range(20):
        if worst_ms(truth, PidGains(kp, kp / tau_i)) <= MS_POOR:
            break
        kp, tau_i = 0.8 * kp, 1.1 * tau_i
    return PidGains(kp, kp / tau_i)


def worst_ms(truth: Truth, gains: PidGains) -> float:
    """The largest true Ms over the places."""
    half = truth.subject.dt_s / 2
    seen = [replace(judge.process, theta_s=judge.process.theta_s + half) for judge in truth.judges]
    return max(robustness(process, gains).ms for process in seen)


def poor_table(truth: Truth, rng: np.random.Generator) -> GainTable:
    """Three regions with a poor set each."""
    subject = truth.subject
    low, high = subject.low, subject.high
    bounds = tuple(low + (high - low) * i / REGIONS_IN_FORCE for i in range(1, REGIONS_IN_FORCE))
    sets = []
    for i in range(REGIONS_IN_FORCE):
        mine = [j for x, j in zip(truth.places, truth.judges, strict=True) if sum(x >= b for b in bounds) == i]
        least = min((j.best for j in mine), key=lambda g: abs(g.kp))
        kp, tau_i = least.kp * float(rng.uniform(0.4, 1.0)), least.kp / least.ki * float(rng.uniform(0.8, 1.6))
        sets.append(PidGains(kp, kp / tau_i))
    return GainTable("loop", regions_along(subject.by, low, bounds, high, (high - low) / 100), tuple(sets))


def record(truth: Truth, in_force: Lookup, rng: np.random.Generator, visits: int, lag_s: float) -> Trace:
    """So many visits of each place under the gains in force."""
    subject = truth.subject
    width = (subject.high - subject.low) / VISITED
    plan: list[Visit] = []
    order = [i for turn in range(visits) for i in (range(VISITED) if turn % 2 == 0 else range(VISITED - 1, -1, -1))]
    side = 1.0
    for index, i in enumerate(order):
        place = subject.low + width * (i + float(rng.uniform(0.25, 0.75)))
        side = -side
        sp = place if subject.by == "pv" else subject.sp0 + side * STEP_SHARE * subject.span
        n = hold(subject, in_force.frozen(place), place)
        size = LOAD_SHARE * subject.span / subject.local(place).k
        load = size * float(rng.uniform(0.4, 1.0)) * (1 if rng.uniform() < 0.5 else -1) if index % 2 else None
        plan.append(Visit(place, sp, n, load, n // 2))
    noise = subject.noise * rng.standard_normal(sum(visit.n for visit in plan))
    return run(subject, in_force, plan, noise, lag_s)


def hold(subject: Subject, gains: PidGains, place: float) -> int:
    """Samples of a visit."""
    local = subject.local(place)
    closed = abs(gains.kp / gains.ki) + abs(1 / (local.k * gains.ki))
    return int(min(max(HOLD_THETA * Judge.theta(local), HOLD_CLOSED * closed) / subject.dt_s, MOST_SAMPLES))


def walk(truth: Truth, rng: np.random.Generator, count: int) -> list[Visit]:
    """A fresh walk of so many visits, up to a fifth of the range at a time, each with a load in its middle."""
    subject = truth.subject
    span = subject.high - subject.low
    low, high = subject.low + span / 20, subject.high - span / 20
    place = float(rng.uniform(low, high))
    visits: list[Visit] = []
    side = 1.0
    while len(visits) < count:
        there = place + float(rng.uniform(0.04, 0.2)) * span * float(rng.choice([-1, 1]))
        if not low <= there <= high:
            continue
        place, side = there, -side
        sp = place if subject.by == "pv" else subject.sp0 + side * STEP_SHARE * subject.span
        n = int(min(2 * HOLD_THETA * Judge.theta(subject.local(place)) / subject.dt_s, MOST_SAMPLES))
        load = LOAD_SHARE * subject.span / subject.local(place).k * float(rng.uniform(-1, 1))
        visits.append(Visit(place, sp, n, load, n // 2))
    return visits
