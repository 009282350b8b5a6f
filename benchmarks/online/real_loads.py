"""Loops under the loads of real loops, watched by `PidController` in mode auto: are wrong gains cured, good ones kept?

process    one lag, two lags or integrating; dead time 1 to 12 samples, lags 4 to 60 samples; dt 1 s
load       pieces of the co of real loops one after another (world/draw.py), at the process input all the time, sized
           so that pv moves by 2 (standard deviation) under good gains; noise 0.3
setpoint   eight steps of 8, up and down in turn, or none (--alone)
start      SIMC's gains with perfect knowledge (good), Kc x 0.25 (weak), Kc x 2.5 (tight), Kc x 0.25 with tau_I x 4
           (slow)

Cured: Ms up to 1.9 and J up to 2 at the end, on the true process (judge.py). Sluggish made more sluggish: weak or slow
at the start, and the IAE of a load step is larger at the end by more than a tenth.
"""

import functools
import math
from typing import Any

import numpy as np
from cases.case import FloatArray
from cases.loop import Controller, Upsets
from cases.loop import run as simulated
from cases.plant import HeldPlant
from cases.setting import scaled
from world.draw import piece, real_loops

from online.judge import Judge, Judgement, effect
from online.runner import Task
from retuner import LinearProcess, PidController, PidGains

Row = dict[str, Any]
STARTS = {"good": (1.0, 1.0), "weak": (0.25, 1.0), "tight": (2.5, 1.0), "slow": (0.25, 4.0)}
KINDS = tuple(STARTS)
CURED_MS, CURED_J, HIGH_MS, SLOWER = 1.9, 2.0, 2.0, 1.15
STEPS, STEP, PV_STD, NOISE_STD, SP0, CO_SPAN = 8, 8.0, 2.0, 0.3, 50.0, 1e4
LOST = 1e4
MORE_SLUGGISH = 1.1


def process_of(rng: np.random.Generator) -> LinearProcess:
    """A process, in samples of one second."""
    theta, lag = (math.exp(rng.uniform(math.log(low), math.log(high))) for low, high in ((1.0, 12.0), (4.0, 60.0)))
    k = math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
    kind = int(rng.integers(3))
    if kind == 2:
        return LinearProcess(k / math.exp(rng.uniform(math.log(10.0), math.log(100.0))), theta_s=theta, integrators=1)
    return LinearProcess(k, (lag,) if kind == 0 else (lag, lag * rng.uniform(0.2, 0.8)), theta_s=theta)


def load_of(rng: np.random.Generator, folder: str, fold: int | None, n: int) -> FloatArray:
    """n samples of loads of real loops, each as restless as the others, without a jump between them."""
    loops, found = real_loops(folder, fold), np.zeros(1)
    while len(found) < n:
        moved = piece(rng, loops[int(rng.integers(len(loops)))][2], int(rng.integers(400, 1200)))
        if np.std(moved) > 0:
            found = np.concatenate([found, found[-1] + moved / np.std(moved)])
    return np.asarray(found[:n] - np.mean(found[:n]), dtype=np.float64)


@functools.cache
def _judge(seed: int, index: int) -> Judge:
    """Of the loop of that number."""
    return Judge(process_of(np.random.default_rng([seed, index, 51])), 1.0)


def run(task: Task) -> Row:
    """One loop; keys ms, j (at the start, and at the end of each section), iae (of a load step, at start and end)."""
    judge = _judge(task.seed, task.index)
    rng = np.random.default_rng([task.seed, task.index, 52])
    n = STEPS * task.section
    load, rest = load_of(rng, task.data, task.fold, n), np.zeros(n)
    moved = simulated(judge.process, Controller(judge.best), 1.0, Upsets(rest, load=load))
    load = load * (PV_STD / float(np.std(moved.pv)))
    noise = rng.normal(size=n) * NOISE_STD
    start = scaled(judge.best, *STARTS[task.kind])
    pid = PidController(
        start, dt_s=1.0, pv_range=(0.0, 100.0), co_range=(-CO_SPAN, CO_SPAN), mode="auto", history=0, name=task.kind
    )
    judged, story, lost = [judge.of(start)], list[str](), False
    plant, y, changes, unstable = HeldPlant(judge.process, 1.0), 0.0, 0, 0
    for i in range(n):
        section = i // task.section
        sp = SP0 + (0.0 if task.alone else STEP * (section % 2))
        before = pid.gains
        co = pid.step(sp, SP0 + y + float(noise[i]))
        if pid.decision is not None and task.verbose:
            story.append(f"   {i}: {pid.decision.code}: {pid.decision}")
        if pid.gains != before:
            done = effect(judge, float(i), before, pid.gains)
            changes += 1
            unstable += math.isfinite(done.before.ms) and math.isinf(done.after.ms)
            story.append(f"{i}: {_told(done.before)} -> {_told(done.after)}")
        y = plant.move(co + float(load[i]))
        if abs(y) > LOST:
            lost = True
            break
        if (i + 1) % task.section == 0:
            judged.append(judge.of(pid.gains))
    if lost:
        judged.append(Judgement(math.inf, math.inf, in_spec=False))
    kind = "integrating" if judge.process.integrators else f"{len(judge.process.lags_s)} lags"
    return {
        "part": "real",
        "start": task.kind,
        "seed": task.seed,
        "index": task.index,
        "alone": task.alone,
        "what": f"{kind} theta {judge.process.theta_s:.1f} lags {', '.join(f'{x:.0f}' for x in judge.process.lags_s)}",
        "ms": [x.ms for x in judged],
        "j": [x.j for x in judged],
        "spec": judged[-1].in_spec,
        "iae": [_of_load(judge, start), _of_load(judge, pid.gains)],
        "changes": changes,
        "made_unstable": unstable,
        "lost": lost,
        "story": story,
    }


def _of_load(judge: Judge, gains: PidGains) -> float:
    """IAE of a load step over that of the best settings: |1/ki| where it does not swing."""
    return abs(judge.best.ki / gains.ki) if gains.ki else math.inf


def _told(one: Judgement) -> str:
    return f"Ms {one.ms:.2f} J {one.j:.2f}"


def line(row: Row) -> str:
    """One run."""
    way = ", ".join(f"{ms:.2f}/{j:.2f}" for ms, j in zip(row["ms"], row["j"], strict=True))
    head = f"{row['start']:5} {row['index']:3} {row['what']:34} {row['changes']} changes; Ms/J {way}"
    return "\n".join([head, *(f"      {text}" for text in row["story"])])


def table(rows: list[Row]) -> list[str]:
    """The counts."""
    wrong, good = ([r for r in rows if (r["start"] == "good") is is_good] for is_good in (False, True))
    lines = []
    if wrong:
        ends = sorted(r["j"][-1] for r in wrong)
        lines.append(f"wrong starts: {len(wrong)}")
        for name in STARTS:
            some = [r for r in wrong if r["start"] == name]
            if some:
                lines.append(f"  {name:6} cured {sum(map(_cured, some))} of {len(some)}")
        lines.append(f"  cured (Ms <= {CURED_MS}, J <= {CURED_J:g})  {sum(map(_cured, wrong))} of {len(wrong)}")
        lines.append(f"  in spec at the end             {sum(r['spec'] for r in wrong)}")
        lines.append(f"  J at the end, median           {ends[len(ends) // 2]:.2f}")
        lines.append(f"  Ms > {HIGH_MS:g} at the end              {sum(r['ms'][-1] > HIGH_MS for r in wrong)}")
        slow = [r for r in wrong if r["start"] in {"weak", "slow"}]
        worse = sum(r["iae"][1] > MORE_SLUGGISH * r["iae"][0] for r in slow)
        lines.append(f"  sluggish made more sluggish    {worse} of {len(slow)}")
    if good:
        lines.append(f"good starts: {len(good)}")
        lines.append(f"  in spec at the end             {sum(r['spec'] for r in good)}")
        lines.append(f"  Ms > {HIGH_MS:g} at the end              {sum(r['ms'][-1] > HIGH_MS for r in good)}")
        slower = sum(r["j"][-1] > SLOWER * r["j"][0] for r in good)
        lines.append(f"  slower by more than 15 %       {slower}")
        lines.append(f"  changes                        {sum(r['changes'] for r in good)}")
    lines.append(
        f"made unstable by a change        {sum(r['made_unstable'] for r in rows)}; lost {sum(r['lost'] for r in rows)}"
    )
    return lines


def _cured(row: Row) -> bool:
    return bool(row["ms"][-1] <= CURED_MS and row["j"][-1] <= CURED_J)
