"""Loops that see loads only, of every kind: nobody moves the setpoint, and the gains are wrong at the start.

steps      a step to and fro, the standard of the batch
pulses     one rectangular pulse of half to ten dead times, up or down
ramps      the load moves over 5 to 40 dead times to another place, and stays
walk       a random walk all the time
sinusoid   a slow sinusoid all the time, of 20 to 80 dead times
coloured   noise through a lag of 1 to 10 dead times, all the time
quiet      no load at all: measurement noise
calm walk, calm coloured   as above, a twentieth of the size

bumps : percent of pv's range (a standard step is 10 %) by which retuner may bump the setpoint, at most once a period.

A period is 60 effective dead times (longer for sluggish starts), as between two disturbances of the batch; noise is
1 %. Loads are sized by what they do under SIMC with perfect knowledge: a step moves pv by 1. Processes are those of
benchmarks/cases, gains off as in the batch, where the loop is stable with them. Counted is what is in spec after so
many periods, what was changed for the worse, and what was made unstable.
"""

import math
from collections.abc import Iterator

import numpy as np
from cases.case import FloatArray
from cases.plant import log_uniform
from cases.setting import scaled
from cases.signals import coloured, random_walk

from online.judge import Judge
from online.loop import WatchedLoop, Watching
from online.runner import Task
from online.session import (
    LENGTH_THETA,
    REST_SAMPLES,
    SAMPLES_PER_THETA,
    Row,
    Session,
    by_kind,
    in_spec_after,
    line,
    loop_with_start,
    noise_of,
)
from retuner.adaptive.setpoint_bumps.bump_settings import BumpSettings
from retuner.adaptive.setpoint_bumps.loop_bumps import LoopBumps
from retuner.adaptive.signals.sample import LoopMode, LoopSample

__all__ = ["KINDS", "line", "load_of", "run", "table"]
KINDS = ("steps", "pulses", "ramps", "walk", "sinusoid", "coloured", "quiet", "calm walk", "calm coloured")
WANDERING = ("walk", "coloured", "sinusoid", "calm walk", "calm coloured")  # Kinds that never rest
CALM = 0.05  # Size of a calm load over that of the same load otherwise
PERIODS = 6


def period(watched: WatchedLoop, bumps: LoopBumps, watching: Watching, load: list[float], noise: list[float]) -> None:
    """One period; where bumps are allowed, a sample at a time at the setpoint that was last sent."""
    if not bumps.planner.settings.allowed:
        watched.run(0.0, load, noise)
        return
    sp, told_of = watched.sp, len(watching.decisions)
    for upset, one in zip(load, noise, strict=True):
        [(pv, co)] = watched.run(sp, upset, [one])
        for decision in watching.decisions[told_of:]:
            bumps.decided(decision)
        told_of = len(watching.decisions)
        news = bumps.step(LoopSample(watched.t_s, sp, pv, co, LoopMode.AUTO, False, sp, watched.revision))
        sp = news.setpoint if news is not None and news.setpoint is not None else sp
    watched.sp = sp


def run(task: Task) -> Row:
    """One loop; keys of session.Session.row, and the bumps."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 41])
    loop, judge, (kc, tau_i) = loop_with_start(rng)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA * max(1.0, 1 / kc))
    load = load_of(task.kind, rng, n, loop.theta_s / loop.dt_s) * judge.load_like_setpoint()
    session = Session(task, judge, scaled(loop.best, kc, tau_i))
    period_s = n * loop.dt_s
    allowed = {"allowed": True, "percent": task.bumps} if task.bumps else {}
    wanted = BumpSettings(
        **allowed, after_h=period_s / 2 / 3600, most_per_day=100, most=PERIODS, announce_s=0.0, longest_s=period_s
    )
    bumps = LoopBumps(wanted, session.watching.retuner)

    def upsets() -> Iterator[Judge]:
        session.loop.run(0.0, 0.0, noise_of(rng, REST_SAMPLES))
        for i in range(PERIODS):
            period(session.loop, bumps, session.watching, load[i * n : (i + 1) * n].tolist(), noise_of(rng, n))
            yield judge

    session.run(upsets(), PERIODS)
    what = f"{loop.family} kc x{kc:g} tau_i x{tau_i:g}"
    return session.row("loads", what, bump_percent=task.bumps, bumps=len(bumps.planner.made))


def load_of(kind: str, rng: np.random.Generator, n: int, theta: float) -> FloatArray:
    """The load of all periods, 1 for a step of the standard size. n : samples of a period. theta : of a dead time."""
    whole = n * PERIODS
    time = np.arange(whole)
    if kind == "quiet":
        return np.zeros(whole)
    if kind.startswith("calm "):
        return CALM * load_of(kind.removeprefix("calm "), rng, n, theta)
    if kind == "walk":
        return 0.3 * random_walk(rng, whole) / math.sqrt(theta)
    if kind == "coloured":
        return 0.7 * coloured(rng, whole, log_uniform(rng, 1.0, 10.0) * theta)
    if kind == "sinusoid":
        period = log_uniform(rng, 20.0, 80.0) * theta
        return np.asarray(np.sin(2 * np.pi * (time / period + rng.uniform())), dtype=np.float64)
    load = np.zeros(whole)
    for i in range(PERIODS):
        first = i * n + int(rng.uniform(0.0, 0.2) * n)
        if kind == "steps":
            load[first:] += 1.0 if i % 2 == 0 else -1.0
        elif kind == "pulses":
            size = float(rng.choice([-1.5, 1.5]))
            load[first : first + int(log_uniform(rng, 0.5, 10.0) * theta)] += size
        else:
            length = log_uniform(rng, 5.0, 40.0) * theta
            size = float(rng.uniform(1.5, 3.0)) * (1.0 if i % 2 == 0 else -1.0)
            load += size * np.clip((time - first) / length, 0.0, 1.0)
    return load


def table(rows: list[Row]) -> list[str]:
    """Shares in spec after 1, 3 and 6 periods, a kind and all."""
    return [
        text
        for _, of, head in by_kind(rows, (*KINDS, "all"))
        for text in (f"{head}, bumps {sum(row['bumps'] for row in of)}", *in_spec_after(of))
    ]
