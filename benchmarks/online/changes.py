"""Processes that are not constant, noise that is not white, records that begin in motion.

Setpoint and load steps in turn, 1 % noise, default limits of a change; in spec on the true process as it is then?

coloured   gains off as in the batch; noise through a lag of half a sample to one effective dead time, 1 to 2 %
motion     gains off as in the batch, but stable; retuner is switched on in the middle of the response to a load step
gain       k times 2 or 1/2, at once, while the loop is at rest, after SETTLED disturbances with settings in spec
delay      dead time times 2 or 1/2, the same
drift      k, lags or dead time grow or shrink steadily by a factor of 2 over DRIFTING disturbances (fouling)

coloured and motion: the families of benchmarks/cases. The others: first and second order and integrating with lag, with
time constants of 0.3 to 30 dead times.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from cases.case import share
from cases.plant import log_uniform
from cases.setting import scaled
from cases.signals import coloured

from online.judge import Judge
from online.runner import Task
from online.session import (
    LENGTH_THETA,
    NOISE,
    REST_SAMPLES,
    SAMPLES_PER_THETA,
    Row,
    Session,
    by_kind,
    faults,
    in_spec_after,
    line,
    loop_with_start,
)
from online.varying import Changing, Local, VaryingPlant
from retuner.schedule.gains import PidGains

__all__ = ["KINDS", "line", "run", "table"]
KINDS = ("coloured", "motion", "gain", "delay", "drift")
UPSETS = 6  # Disturbances that are judged, after the start or the change
SETTLED = 3  # Disturbances before a sudden change
DRIFTING = 18
FACTOR = 2.0


def run(task: Task) -> Row:
    """One loop; keys of session.Session.row, and said."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 29])
    session, what = (_constant if task.kind in {"coloured", "motion"} else _changing)(task, rng)
    return session.row("changes", what, said=[f"{d.action}: {d.reason}" for d in session.watching.decisions])


class Turns:
    """Setpoint and load steps in turn on one loop. corner : of coloured noise, in samples; 0 for white noise."""

    def __init__(self, session: Session, rng: np.random.Generator, corner: float = 0.0, noise: float = NOISE) -> None:
        self.session, self.rng, self.corner, self.noise = session, rng, corner, noise
        self.load_size = session.judge.load_like_setpoint()
        self.sp = self.load = 0.0
        self.count = 0

    def rest(self, n: int) -> None:
        """Nothing happens."""
        shape = coloured(self.rng, n, self.corner) if self.corner else self.rng.standard_normal(n)
        self.session.loop.run(self.sp, self.load, (self.noise * shape).tolist())

    def disturb(self, n: int) -> None:
        """The next step, and n samples."""
        self.count += 1
        if self.count % 2:
            self.sp = 1.0 - self.sp
        else:
            self.load = self.load_size - self.load
        self.rest(n)


def _constant(task: Task, rng: np.random.Generator) -> tuple[Session, str]:
    loop, judge, (kc, tau_i) = loop_with_start(rng, stable=task.kind == "motion")
    is_coloured = task.kind == "coloured"
    corner = log_uniform(rng, 0.5, SAMPLES_PER_THETA) if is_coloured else 0.0
    noise = log_uniform(rng, NOISE, 2 * NOISE) if is_coloured else NOISE
    session = Session(task, judge, scaled(loop.best, kc, tau_i))
    turns = Turns(session, rng, corner, noise)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA * max(1.0, 1 / kc))

    def upsets() -> Iterator[Judge]:
        if task.kind == "motion":
            session.loop.hidden, turns.load = True, turns.load_size
            turns.rest(int(float(rng.uniform(2.0, 15.0)) * SAMPLES_PER_THETA))
            session.loop.hidden = False
            turns.rest(n)
        else:
            turns.rest(REST_SAMPLES)
        for _ in range(UPSETS):
            turns.disturb(n)
            yield judge

    session.run(upsets(), UPSETS)
    return session, f"{loop.family} kc x{kc} tau_i x{tau_i}" + (f" corner {corner:.1f}" if corner else "")


def _changing(task: Task, rng: np.random.Generator) -> tuple[Session, str]:
    local = draw_local(rng)
    dt_s = Judge.theta(local.linear()) / SAMPLES_PER_THETA
    judge, process = Judge(local.linear(), dt_s), Changing(local)
    gains = PidGains(judge.best.kp * log_uniform(rng, 0.85, 1.1), judge.best.ki * log_uniform(rng, 0.85, 1.1))
    session = Session(task, judge, gains, VaryingPlant(process.at, process.rest, dt_s))
    turns = Turns(session, rng)
    n = int(2 * LENGTH_THETA * SAMPLES_PER_THETA)
    factor = FACTOR if bool(rng.integers(2)) else 1 / FACTOR
    target = changed(local, task.kind, factor, rng)
    count = DRIFTING if task.kind == "drift" else UPSETS

    def upsets() -> Iterator[Judge]:
        turns.rest(REST_SAMPLES)
        for _ in range(SETTLED):
            turns.disturb(n)
        for i in range(count):
            process.now = between(local, target, (i + 1) / count) if task.kind == "drift" else target
            if i == 0 and task.kind != "drift":
                turns.rest(n)  # a changed gain is itself a step for a loop away from zero; it settles, watched
            turns.disturb(n)
            yield Judge(process.now.linear(), dt_s)

    session.run(upsets(), count)
    return session, f"{'integrating' if local.integrating else 'self-regulating'} x{factor:g}"


def draw_local(rng: np.random.Generator) -> Local:
    """First or second order, or integrating with lag; dead time 1 on a time scale over four decades."""
    scale, k = 10 ** rng.uniform(-2, 2), float(rng.choice([-1, 1])) * 10 ** rng.uniform(-1, 1)
    tau1 = log_uniform(rng, 0.3, 30.0)
    tau2 = tau1 * log_uniform(rng, 0.05, 0.7) if rng.uniform() < 0.5 else 0.0
    if rng.uniform() < 0.25:
        return Local(k / scale, 0.0, log_uniform(rng, 0.1, 3.0) * scale, scale, integrating=True)
    return Local(k, tau1 * scale, tau2 * scale, scale)


def changed(local: Local, kind: str, factor: float, rng: np.random.Generator) -> Local:
    """What it becomes: gain, dead time, or for a drift one of gain, lags and dead time."""
    which = kind if kind != "drift" else str(rng.choice(["gain", "lags", "delay"]))
    if which == "gain":
        return replace(local, k=local.k * factor)
    if which == "delay":
        return replace(local, theta_s=local.theta_s * factor)
    return replace(local, tau1_s=local.tau1_s * factor, tau2_s=local.tau2_s * factor)


def between(a: Local, b: Local, share: float) -> Local:
    """On the way from one to the other, by factors."""

    def mixed(x: float, y: float) -> float:
        return x if x == y else x * math.exp(share * math.log(y / x))

    return replace(
        a,
        k=mixed(a.k, b.k),
        tau1_s=mixed(a.tau1_s, b.tau1_s),
        tau2_s=mixed(a.tau2_s, b.tau2_s),
        theta_s=mixed(a.theta_s, b.theta_s),
    )


def table(rows: list[Row]) -> list[str]:
    """Shares in spec after 1, 3 and 6 disturbances; for a drift, of all disturbances from the third on."""
    lines = []
    for kind, of, head in by_kind(rows, KINDS):
        later = [ok for row in of for ok in row["spec"][2:]]
        drift = [f"  in spec, of all disturbances from the third on  {share(sum(later), len(later))}"]
        lines += [head, *(drift if kind == "drift" else in_spec_after(of)), f"  {faults(of)}"]
    return lines
