"""retuner against what people do instead, on the same loops, in one table: docs/results.md has it.

Processes are the batch of Astrom & Hagglund, with gains that are off by up to 4 in Kc and in tau_I; every rival is
given the sign of the process. What comes out is judged on the true process: Ms, and J against SIMC with perfect
knowledge (judge.py). Those who use simple-pid use it here: its numbers as its own README has them, and the recipe that
guides give for turning the knobs by hand, with simple-pid as the controller.
"""

import math
import zlib
from dataclasses import dataclass
from statistics import median

import numpy as np
from cases.case import interval
from cases.plant import HeldPlant

from online import batch
from online.judge import Judge, Judgement
from online.loop import WatchedLoop, one_region, settings
from online.rivals import PatternAlone, relay_then_ziegler_nichols, step_then_simc
from online.session import LOST, PV_SPAN, Row
from retuner.schedule.gains import PidGains

PRINTED = PidGains(1.0, 0.1, 0.05)  # The gains in the example of simple-pid's README
FIRST, FACTOR, MOST_TURNS = 0.01, 1.5, 24
"""Turning a knob by hand: from this on, up by a factor each time, so often at most."""
TRIAL_THETA, SWING, OVERSHOOT = 60.0, 0.3, 0.1
"""A trial lasts so many effective dead times; it swings from this much up and down in its second half."""
WHO = {
    "fixed": "gains left as they were",
    "printed": "simple-pid, its README's numbers",
    "by hand": "simple-pid, knobs turned by hand",
    "pattern": "pattern rule (EXACT-like), six disturbances",
    "relay": "relay test + Ziegler-Nichols PI",
    "step": "step test + SIMC",
    "retuner": "retuner, six disturbances",
}
PLANT = {
    "fixed": "nothing",
    "printed": "nothing",
    "by hand": "{turns:.0f} trials",
    "pattern": "nothing",
    "relay": "a relay test",
    "step": "a step test in manual",
    "retuner": "nothing",
}
"""What each asks of the plant beside its ordinary running."""


@dataclass
class ByHand:
    """A setpoint step under simple-pid, again and again, on a plant at rest: how often, and what was seen."""

    task: batch.Task
    dt_s: float
    sign: float
    turns: int = 0

    def settings(self) -> PidGains:
        """The recipe: Kp up until it swings, and half of it; then Ki up until it overshoots, and the one before."""
        kp = FIRST
        while self.turns < MOST_TURNS and not self.swings(self.trial(kp, 0.0)):
            kp *= FACTOR
        kp /= 2.0
        ki = kp / (TRIAL_THETA / 2 * batch.SAMPLES_PER_THETA * self.dt_s)
        for _ in range(MOST_TURNS):
            pvs = self.trial(kp, ki * FACTOR)
            if max(pvs) > 1.0 + OVERSHOOT or self.swings(pvs):
                break
            ki *= FACTOR
        return PidGains(self.sign * kp, self.sign * ki)

    def trial(self, kp: float, ki: float) -> list[float]:
        """pv after a setpoint step of 1."""
        from simple_pid import PID  # an extra: no other part needs it

        self.turns += 1
        rng = np.random.default_rng(self.task.seed + self.turns)
        plant, pv, pvs = HeldPlant(self.task.member.process, self.dt_s), 0.0, []
        pid = PID(self.sign * kp, self.sign * ki, 0.0, setpoint=1.0, sample_time=None)
        for more in (self.task.noise * rng.standard_normal(int(TRIAL_THETA * batch.SAMPLES_PER_THETA))).tolist():
            pvs.append(pv + more)
            pv = plant.move(float(pid(pvs[-1], dt=self.dt_s) or 0.0))
            if abs(pv) > 100.0:
                return [*pvs, pv, -pv, pv]
        return pvs

    @staticmethod
    def swings(pvs: list[float]) -> bool:
        """Whether pv still goes up and down in the second half of the trial."""
        late = np.array(pvs[len(pvs) // 2 :])
        up = float(np.max(late - np.minimum.accumulate(late)))
        down = float(np.max(np.maximum.accumulate(late) - late))
        return min(up, down) > SWING


def run(task: batch.Task) -> Row:
    """Every set on one process: Ms, J and in spec of each."""
    process = task.member.process
    dt_s = Judge.theta(process) / batch.SAMPLES_PER_THETA
    judge = Judge(process, dt_s)
    kc, tau_i = task.start
    gains = PidGains(judge.best.kp * kc, judge.best.ki * kc / tau_i)
    rng = np.random.default_rng(zlib.crc32(f"{task.seed} tests".encode()))
    hand = ByHand(task, dt_s, math.copysign(1.0, process.k))
    found = {
        "fixed": gains,
        "printed": PidGains(*(hand.sign * x for x in (PRINTED.kp, PRINTED.ki, PRINTED.kd))),
        "by hand": hand.settings(),
        "relay": relay_then_ziegler_nichols(HeldPlant(process, dt_s), process, dt_s, task.noise, rng),
        "step": step_then_simc(HeldPlant(process, dt_s), process, judge.theta_s, dt_s, task.noise, rng),
    }
    judged = {who: LOST if x is None else judge.of(x) for who, x in found.items()}
    pattern = PatternAlone(one_region(gains), settings(dt_s, PV_SPAN))
    loop = WatchedLoop(HeldPlant(process, dt_s), pattern.table, dt_s, pattern)
    judged["pattern"] = batch.disturbed(loop, judge, task, [])[-1]
    ours = batch.run(task)
    judged["retuner"] = Judgement(ours["ms"][-1], ours["j"][-1], ours["spec"][-1])
    told = {who: {"ms": x.ms, "j": x.j, "in_spec": x.in_spec} for who, x in judged.items() if found.get(who, gains)}
    return {"part": "proof", "process": task.member.name, "seed": task.seed, "turns": hand.turns, "of": told}


def line(row: Row) -> str:
    """Ms of everybody on one process."""
    return f"{row['process']:<14} Ms " + ", ".join(f"{who} {x['ms']:.2f}" for who, x in row["of"].items())


def table(rows: list[Row]) -> list[str]:
    """One line for each, as Markdown; a rival that gave no settings for a process is out of spec there."""
    turns = median(row["turns"] for row in rows)
    heads = ("", "asks of the plant", "in spec", "Ms, median", "J, median", "unstable", "gave no settings")
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for who, name in WHO.items():
        of = [row["of"][who] for row in rows if who in row["of"]]
        good = sum(x["in_spec"] for x in of)
        low, high = (f"{100 * end:.0f}" for end in interval(good, len(rows)))
        spec = f"{good} of {len(rows)}, {good / len(rows):.0%} [{low}, {high}]"
        ms, j = (_middle([x[key] for x in of]) for key in ("ms", "j"))
        lost = sum(not math.isfinite(x["ms"]) for x in of)
        cells = (name, PLANT[who].format(turns=turns), spec, ms, j, str(lost), str(len(rows) - len(of)))
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _middle(values: list[float]) -> str:
    found = median(values)
    return f"{found:.2f}" if math.isfinite(found) else "-"
