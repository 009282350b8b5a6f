"""Loops with derivative action, watched by `PidController` in mode auto: wrong gains cured, the derivative kept?

process    two lags, the second 0.3 to 1 of the first (or, one of four, an integrator and a lag), and a dead time of
           0.1 to 0.6 of the second lag; samples a sixth of the dead time apart
start      SIMC-PID's gains with perfect knowledge, tau_c = theta, off by a factor on Kc (0.25 to 3), on tau_I (0.5 to
           4) and on tau_D (0.5 to 2), stable, out of specification; the derivative's filter is a tenth of tau_D
upsets     setpoint and load steps in turn, six; noise 1 % of the step

In spec: Ms up to max(1.8, 1.03 times SIMC-PID's), and J, the mean of the ratios of IAE to SIMC-PID's after a setpoint
and a load step, up to 1.25. The derivative hurts where the gains at the end have a smaller J with it than without.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from cases.case import FloatArray, share
from cases.loop import Controller, Upsets
from cases.loop import run as simulated
from cases.plant import HeldPlant, log_uniform, robustness

from online.judge import MS_LIMIT, MS_OVER_BEST, Judgement
from online.runner import Task
from retuner import LinearProcess, PidController, PidGains
from retuner.adaptive.process.reduction import half_rule
from retuner.adaptive.rules.rule import ControllerKind
from retuner.adaptive.rules.simc import simc

Row = dict[str, Any]
KINDS = ("pid",)
STARTS = ((0.25, 0.5, 2.0, 3.0), (0.5, 1.0, 2.0, 4.0), (0.5, 1.0, 2.0))  # Factors on Kc, tau_I and tau_D
UPSETS, SAMPLES_PER_THETA, FILTER, NOISE, LENGTH = 6, 6, 0.1, 0.01, 40.0
J_LIMIT, SP0, STEP, PV_SPAN, CO_SPAN = 1.25, 50.0, 1.0, 10.0, 1e4


class PidJudge:
    """Judge of one process sampled at dt_s. best : SIMC-PID with perfect knowledge. scale_s : theta + tau2."""

    def __init__(self, process: LinearProcess, dt_s: float) -> None:
        self.process, self.dt_s = process, dt_s
        self.sampled = replace(process, theta_s=process.theta_s + dt_s / 2)
        self.best = simc(half_rule(self.sampled, order=2), kind=ControllerKind.PID).gains
        self.tau_f_s = FILTER * self.best.kd / self.best.kp
        self.scale_s = self.best.kd / self.best.kp + self.sampled.theta_s
        self.ms_limit = max(MS_LIMIT, MS_OVER_BEST * robustness(self.sampled, self.best, self.tau_f_s).ms)
        self._best = self.pv_and_iae(self.best)[1]

    def pv_and_iae(self, gains: PidGains) -> tuple[float, tuple[float, float]]:
        """The largest pv after a load step of one, and the IAE after a setpoint and after a load step."""
        n = int((LENGTH * self.scale_s + 8 * abs(gains.kp / gains.ki)) / self.dt_s)
        found = []
        for sp, load in ((np.ones(n), np.zeros(n)), (np.zeros(n), np.ones(n))):
            record = simulated(self.process, Controller(gains, self.tau_f_s), self.dt_s, Upsets(sp, load=load))
            found.append((float(np.max(np.abs(record.pv))), float(np.sum(np.abs(record.sp - record.pv)) * self.dt_s)))
        return found[1][0], (found[0][1], found[1][1])

    def of(self, gains: PidGains) -> Judgement:
        """Judge settings."""
        ms, j = robustness(self.sampled, gains, self.tau_f_s).ms, math.inf
        if math.isfinite(ms):
            j = sum(x / y for x, y in zip(self.pv_and_iae(gains)[1], self._best, strict=True)) / 2
        return Judgement(ms, j, ms <= self.ms_limit and j <= J_LIMIT)


def drawn(rng: np.random.Generator) -> tuple[PidJudge, PidGains]:
    """A process and the gains at the start."""
    lag, k = log_uniform(rng, 10.0, 100.0), log_uniform(rng, 0.3, 3.0)
    second = lag * float(rng.uniform(0.3, 1.0))
    theta = second * float(rng.uniform(0.1, 0.6))
    process = LinearProcess(k, (lag, second), theta_s=theta)
    if rng.uniform() < 0.25:
        process = LinearProcess(k / lag, (second,), theta_s=theta, integrators=1)
    judge = PidJudge(process, theta / SAMPLES_PER_THETA)
    best = judge.best
    while True:
        kc, tau_i, tau_d = (float(rng.choice(factors)) for factors in STARTS)
        gains = PidGains(kc * best.kp, kc * best.ki / tau_i, kc * tau_d * best.kd)
        found = judge.of(gains)
        if math.isfinite(found.j) and not found.in_spec:
            return judge, gains


def run(task: Task) -> Row:
    """One loop; keys ms0, j0, ms, j (values after each upset), spec, best, dropped, hurts, story."""
    rng = np.random.default_rng([task.seed, task.index, 31])
    judge, gains = drawn(rng)
    plant, dt_s = HeldPlant(judge.process, judge.dt_s), judge.dt_s
    size = STEP / judge.pv_and_iae(judge.best)[0]
    pid = PidController(
        gains,
        dt_s=dt_s,
        pv_range=(SP0 - PV_SPAN / 2, SP0 + PV_SPAN / 2),
        co_range=(-CO_SPAN, CO_SPAN),
        mode="auto",
        tau_f_s=judge.tau_f_s,
    )
    first, y, sp, load, judged, decided = judge.of(gains), 0.0, SP0, 0.0, list[Judgement](), list[str]()
    n = int(LENGTH * judge.scale_s * max(1.0, judge.best.ki / gains.ki) / dt_s)
    for i in range(-1, UPSETS):
        if i >= 0:
            sp, load = (2 * SP0 + STEP - sp, load) if i % 2 == 0 else (sp, size - load)
        noise: FloatArray = NOISE * STEP * rng.standard_normal(n if i >= 0 else n // 4)
        for more in noise:
            y = plant.move(pid.step(sp, SP0 + y + float(more)) + load)
            if task.verbose and pid.decision is not None:
                decided.append(f"{pid.decision.t_s:.5g} s {pid.decision.reason}")
        if i >= 0:
            judged.append(judge.of(pid.gains))
    now = pid.gains
    without = judge.of(PidGains(now.kp, now.ki))
    return {
        "part": "derivative", "index": task.index, "process": repr(judge.process), "ms0": first.ms, "j0": first.j,
        "start": [gains.kp / judge.best.kp, gains.ki / judge.best.ki, gains.kd / judge.best.kd],
        "end": [now.kp / judge.best.kp, now.ki / judge.best.ki, now.kd / judge.best.kd],
        "ms": [x.ms for x in judged], "j": [x.j for x in judged], "spec": [x.in_spec for x in judged],
        "dropped": not now.kd, "hurts": bool(now.kd and without.in_spec and without.j < judged[-1].j),
        "story": decided,
    }  # fmt: skip


def line(row: Row) -> str:
    """A run for people."""
    spec = "".join("+" if ok else "." for ok in row["spec"])
    of = " -> ".join("/".join(f"{x:.2f}" for x in row[key]) for key in ("start", "end"))
    first, last = (f"Ms {ms:.2f} J {j:.2f}" for ms, j in ((row["ms0"], row["j0"]), (row["ms"][-1], row["j"][-1])))
    head = f"{row['index']:3d} {spec}  {first} -> {last}"
    return "\n".join([f"{head}  kp/ki/kd over SIMC's {of}", *(f"    {text}" for text in row["story"])])


def table(rows: list[Row]) -> list[str]:
    """In spec after each upset and at the end; J alone; derivatives that went."""
    n = len(rows)
    found = [f"in spec after {i + 1} upsets  {share(sum(r['spec'][i] for r in rows), n)}" for i in range(UPSETS)]
    return [
        *found,
        f"J up to {J_LIMIT:g} at the end  {share(sum(r['j'][-1] <= J_LIMIT for r in rows), n)}",
        f"derivative dropped        {share(sum(r['dropped'] for r in rows), n)}",
        f"kept though it hurts      {share(sum(r['hurts'] for r in rows), n)}",
        f"Ms over its limit, worse than at the start: "
        f"{sum(r['ms'][-1] > max(MS_LIMIT, 1.01 * r['ms0']) for r in rows)} of {n}",
    ]
