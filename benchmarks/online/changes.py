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
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from cases.plant import FAMILIES, HeldPlant, log_uniform
from cases.setting import draw_loop, scaled
from cases.signals import coloured

from online.batch import NOISE, PV_SPAN, SAMPLES_PER_THETA, STARTS
from online.harm import effects
from online.judge import Judge, Judgement, counted
from online.loop import LostLoop, Moved, WatchedLoop, Watching, one_region, settings
from online.runner import Task
from online.varying import Changing, Local, VaryingPlant
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
KINDS = ("coloured", "motion", "gain", "delay", "drift")
AFTER = 6
"""Disturbances that are judged, after the start or the change."""
SETTLED = 3
"""Disturbances before a sudden change."""
DRIFTING = 18
FACTOR = 2.0
LENGTH_THETA = 60.0
REST_SAMPLES = 60


def run(task: Task) -> Row:
    """One loop; keys spec, ms, j (a value a disturbance judged), changes, made_unstable, lost, what."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 29])
    return _constant(task, rng) if task.kind in {"coloured", "motion"} else _changing(task, rng)


class Run:
    """Setpoint and load steps in turn on one loop."""

    def __init__(
        self,
        judge: Judge,
        plant: Moved,
        gains: PidGains,
        rng: np.random.Generator,
        *,
        corner: float = 0.0,
        noise: float = NOISE,
    ) -> None:
        self.rng, self.corner, self.noise, self.dt_s = rng, corner, noise, judge.dt_s
        self.watching = Watching(one_region(gains), settings(judge.dt_s, PV_SPAN))
        self.loop = WatchedLoop(plant, self.watching.retuner.table, judge.dt_s, self.watching)
        self.load_size = judge.load_like_setpoint()
        self.sp = self.load = 0.0
        self.count = 0

    def shaped(self, n: int) -> list[float]:
        """Noise of n samples."""
        if not self.corner:
            return [float(x) for x in self.noise * self.rng.standard_normal(n)]
        return [float(x) for x in self.noise * coloured(self.rng, n, self.corner)]

    def rest(self, n: int) -> None:
        """Nothing happens."""
        self.loop.run(self.sp, self.load, self.shaped(n))

    def disturb(self, n: int) -> None:
        """The next step, and n samples."""
        self.count += 1
        if self.count % 2:
            self.sp = 1.0 - self.sp
        else:
            self.load = self.load_size - self.load
        self.rest(n)

    @property
    def gains(self) -> PidGains:
        """In force."""
        return self.loop.table.gains_of(0)


def _constant(task: Task, rng: np.random.Generator) -> Row:
    loop = draw_loop(rng, str(rng.choice(FAMILIES)), (SAMPLES_PER_THETA, SAMPLES_PER_THETA + 1e-9))
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    kc, tau_i = STARTS[int(rng.integers(len(STARTS)))]
    while task.kind == "motion" and not loop.margins(scaled(loop.best, kc, tau_i)).stable:
        kc, tau_i = STARTS[int(rng.integers(len(STARTS)))]
    gains = scaled(loop.best, kc, tau_i)
    is_coloured = task.kind == "coloured"
    corner = log_uniform(rng, 0.5, SAMPLES_PER_THETA) if is_coloured else 0.0
    noise = log_uniform(rng, NOISE, 2 * NOISE) if is_coloured else NOISE
    scene = Run(judge, HeldPlant(loop.process, loop.dt_s), gains, rng, corner=corner, noise=noise)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA * max(1.0, 1 / kc))
    judged: list[Judgement] = []
    try:
        if task.kind == "motion":
            scene.loop.hidden, scene.load = True, scene.load_size
            scene.rest(int(float(rng.uniform(2.0, 15.0)) * SAMPLES_PER_THETA))
            scene.loop.hidden = False
            scene.rest(n)
        else:
            scene.rest(REST_SAMPLES)
        for _ in range(AFTER):
            scene.disturb(n)
            judged.append(judge.of(scene.gains))
    except LostLoop:
        pass
    what = f"{loop.family} kc x{kc} tau_i x{tau_i}" + (f" corner {corner:.1f}" if corner else "")
    return _row(task, scene, judge, judged, AFTER, what)


def _changing(task: Task, rng: np.random.Generator) -> Row:
    local = draw_local(rng)
    per_theta = SAMPLES_PER_THETA
    dt_s = Judge.theta(local.linear()) / per_theta
    judge = Judge(local.linear(), dt_s)
    process = Changing(local)
    gains = PidGains(judge.best.kp * log_uniform(rng, 0.85, 1.1), judge.best.ki * log_uniform(rng, 0.85, 1.1))
    scene = Run(judge, VaryingPlant(process.at, process.rest, dt_s), gains, rng)
    n = int(2 * LENGTH_THETA * per_theta)
    up = bool(rng.integers(2))
    factor = FACTOR if up else 1 / FACTOR
    target = changed(local, task.kind, factor, rng)
    judged: list[Judgement] = []
    count = DRIFTING if task.kind == "drift" else AFTER
    try:
        scene.rest(REST_SAMPLES)
        for _ in range(SETTLED):
            scene.disturb(n)
        for i in range(count):
            process.now = between(local, target, (i + 1) / count) if task.kind == "drift" else target
            if i == 0 and task.kind != "drift":
                scene.rest(n)  # a changed gain is itself a step for a loop away from zero; it settles, watched
            scene.disturb(n)
            judge = Judge(process.now.linear(), dt_s)
            judged.append(judge.of(scene.gains))
    except LostLoop:
        pass
    what = f"{'integrating' if local.integrating else 'self-regulating'} x{factor:g}"
    return _row(task, scene, judge, judged, count, what)


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


def _row(task: Task, scene: Run, judge: Judge, judged: list[Judgement], count: int, what: str) -> Row:
    lost = len(judged) < count
    judged = judged + [Judgement(math.inf, math.inf, in_spec=False)] * (count - len(judged))
    found = effects(judge, scene.watching)
    return {
        "part": "changes",
        "kind": task.kind,
        "seed": task.seed,
        "index": task.index,
        "what": what,
        "spec": [x.in_spec for x in judged],
        "ms": [x.ms for x in judged],
        "j": [x.j for x in judged],
        "ms_limit": judge.ms_limit,
        "changes": len(found),
        "lost": lost,
        "records": len(scene.watching.decisions),
        "made_unstable": sum(math.isfinite(x.before.ms) and math.isinf(x.after.ms) for x in found),
        "said": [f"{d.action}: {d.reason}" for d in scene.watching.decisions],
    }


def line(row: Row) -> str:
    """A loop for people."""
    spec = "".join("+" if ok else "." for ok in row["spec"])
    return f"{row['kind']:<9}{row['index']:>4} {spec:<19} Ms {row['ms'][-1]:5.2f} J {row['j'][-1]:5.2f} {row['what']}"


def table(rows: list[Row]) -> list[str]:
    """Shares in spec after 1, 3 and 6 disturbances; for a drift, of all disturbances from the third on."""
    lines = []
    for kind in KINDS:
        of = [row for row in rows if row["kind"] == kind]
        if not of:
            continue
        lines.append(
            f"{kind}: {len(of)} loops, lost {sum(r['lost'] for r in of)}, "
            f"made unstable by a change {sum(r['made_unstable'] for r in of)}, "
            f"{sum(r['changes'] for r in of) / len(of):.1f} changes a loop"
        )
        if kind == "drift":
            later = [ok for row in of for ok in row["spec"][2:]]
            lines.append(f"  in spec, of all disturbances from the third on  {counted(sum(later), len(later))}")
        else:
            lines += [f"  in spec after {n}  {counted(sum(r['spec'][n - 1] for r in of), len(of))}" for n in (1, 3, 6)]
        faults = Counter(_fault(row) for row in of)
        lines.append("  at the end: " + ", ".join(f"{name} {number}" for name, number in faults.most_common()))
    return lines


def _fault(row: Row) -> str:
    if row["spec"][-1]:
        return "in spec"
    if math.isinf(row["ms"][-1]):
        return "unstable"
    return "Ms too large" if row["ms"][-1] > row["ms_limit"] else "J too large"
