"""Wrong gains where something else moves the loop as well: are they cured for all that?

tone    an oscillation from outside all along, at 0.35 to 8 times the loop's own period, in the load or on pv
valve   a valve that sticks (Kano 2004, He 2007); limit cycles come and go

Loops, tones and valves are those of harm.py, the starts those of batch.py, if stable. Six disturbances, setpoint and
load steps in turn, 60 dead times apart; a setpoint step is 1 to 5 times the tone, 1 to 4 times the limit cycle that the
valve makes under good gains. Judged on the true process without tone and valve, after each disturbance.
"""

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from cases.cycling import LONGEST_PERIOD
from cases.making import own_period_s
from cases.plant import HeldPlant, log_uniform
from cases.setting import scaled
from cases.signals import oscillation

from online import harm
from online.batch import STARTS, told
from online.judge import Judge, Judgement, counted
from online.loop import LostLoop, WatchedLoop, Watching, one_region, settings
from online.runner import Task
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
KINDS = ("tone", "valve")
UPSETS, LENGTH_THETA, REST_SAMPLES = 6, 60.0, 200
SHAPES = ("triangle", "saw", "filtered-square", "pulses")


def drawn(kind: str, rng: np.random.Generator) -> tuple[harm.Scene, PidGains, tuple[float, float]]:
    """A scene, the gains at the start, and their factors."""
    while True:
        scene = harm.scene_of("external" if kind == "tone" else "stiction", rng)
        factors = STARTS[int(rng.integers(len(STARTS)))]
        start = scaled(scene.loop.best, *factors)
        if scene.loop.margins(start).stable:
            return scene, start, factors


def toned(scene: harm.Scene, rng: np.random.Generator, n: int) -> tuple[list[float], list[float]]:
    """n samples of load and of what is added to pv, with a tone in one of them."""
    loop = scene.loop
    while True:
        period = log_uniform(rng, 0.35, 8.0) * own_period_s(loop, loop.best) / loop.dt_s
        if 6 < period < LONGEST_PERIOD:
            break
    shape = "sine" if rng.uniform() < 0.7 else str(rng.choice(SHAPES))
    wave = oscillation(rng, n, period, shape, float(rng.choice([0.0, 0.05])))
    out, load = log_uniform(rng, 0.01, 0.05) * rng.standard_normal(n), np.zeros(n)
    if rng.uniform() < 0.6:
        load = wave * abs(loop.best.kp) * 2
    else:
        out = out + wave
    return load.tolist(), out.tolist()


def run(task: Task) -> Row:
    """One loop; keys first, judged (after each disturbance), changes, worse, lost, what, story."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 63])
    scene, start, (kc, tau_i) = drawn(task.kind, rng)
    loop, story = scene.loop, list[str]()
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    n = int(LENGTH_THETA * loop.theta_s / loop.dt_s * max(1.0, 1 / kc))
    whole = UPSETS * n + REST_SAMPLES
    if task.kind == "tone":
        size, (load, out) = float(rng.uniform(1.0, 5.0)), toned(scene, rng, whole)
    else:
        size = scene.pv_span / harm.SPAN_OVER_SWING * float(rng.uniform(1.0, 4.0))
        load, out = [0.0] * whole, (float(np.std(scene.out)) * rng.standard_normal(whole)).tolist()
    watching = Watching(one_region(start), settings(loop.dt_s, scene.pv_span), lambda d: story.append(told(d, judge)))
    low, high = (loop.low, loop.high) if task.kind == "valve" else (-1e15, 1e15)
    watched = WatchedLoop(
        HeldPlant(loop.process, loop.dt_s), watching.retuner.table, loop.dt_s, watching,
        co0=loop.co0, low=low, high=high, valve=scene.valve, lost=1e4 * scene.pv_span,
    )  # fmt: skip
    judged, sp, upset, at, lost = list[Judgement](), 0.0, 0.0, REST_SAMPLES, False
    step = judge.load_like_setpoint() * size
    try:
        watched.run(sp, load[:at], out[:at])
        for i in range(UPSETS):
            sp, upset = (size - sp, upset) if i % 2 == 0 else (sp, step - upset)
            watched.run(sp, [more + upset for more in load[at : at + n]], out[at : at + n])
            judged, at = [*judged, judge.of(watched.gains)], at + n
    except LostLoop:
        lost = True
    judged += [Judgement(math.inf, math.inf, in_spec=False)] * (UPSETS - len(judged))
    found = harm.effects(judge, watching)
    return {
        "part": "wrong", "kind": task.kind, "seed": task.seed, "index": task.index, "lost": lost,
        "what": f"{loop.family} kc x{kc:g} tau_i x{tau_i:g}", "first": asdict(judge.of(start)),
        "judged": [asdict(x) for x in judged], "changes": len(found),
        "worse": sum(x.worse and not x.restored for x in found), "story": story if task.verbose else [],
    }  # fmt: skip


def line(row: Row) -> str:
    """A loop for people."""
    first, last = (f"Ms {x['ms']:.2f} J {x['j']:.2f}" for x in (row["first"], row["judged"][-1]))
    spec = "".join("+" if x["in_spec"] else "." for x in row["judged"])
    head = f"{row['kind']:<6}{row['index']:>3} {spec} {first} -> {last} changes {row['changes']} worse {row['worse']}"
    return "\n".join([f"{head}{' LOST' if row['lost'] else ''} {row['what']}", *(f"    {x}" for x in row["story"])])


def table(rows: list[Row]) -> list[str]:
    """In spec after the last disturbance, and harm, a kind."""
    lines = []
    for kind in KINDS:
        if of := [row for row in rows if row["kind"] == kind]:
            spec = counted(sum(row["judged"][-1]["in_spec"] for row in of), len(of))
            harmed = sum(row["worse"] > 0 for row in of)
            lines.append(f"{kind}: in spec after {UPSETS}  {spec}; harmed {harmed}; lost {sum(r['lost'] for r in of)}")
    return lines
