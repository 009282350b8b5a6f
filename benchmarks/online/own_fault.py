"""Loops that swing by their own fault: is the tuning named, and is the loop made safer?

damped     gains with a true Ms of 3 to 10: it swings long after each upset
growing    unstable by a gain 1.05 to 1.6 times too high; the output has room for 300 setpoint steps
limits     unstable by 1.2 to 3 times, and the output swings between its limits

Each is upset by load steps alone (every second loop), or by setpoint and load steps in turn, 12 periods of its own
swing apart; noise 1 % of a setpoint step, default limits of a change. An unstable loop without an upset starts from its
noise. Counted are the decisions taken while the true Ms of the gains in force is over 3: how many name the tuning, what
the others name; and when, in periods of the swing, Ms first came under 3, and stayed.
"""

import math
from collections import Counter
from typing import Any

import numpy as np
from cases.making import own_period_s
from cases.plant import FAMILIES, HeldPlant, log_uniform
from cases.setting import Loop, draw_loop, scaled

from online.batch import PV_SPAN, told
from online.harm import effects
from online.judge import Judge, counted
from online.loop import LostLoop, WatchedLoop, Watching, one_region, settings
from online.runner import Task
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES
from retuner.adaptive.supervision.decision import Decision
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
KINDS = ("damped", "growing", "limits")
DANGER = 3.0
UPSETS = 8
APART_PERIODS = 12.0
MOST_SAMPLES = 24000
ROOM = {"damped": 1e6, "growing": 300.0, "limits": 4.0}
"""How far the output may go from rest, in setpoint steps of the process's gain."""
NOISE = 0.01
TRIES = 200


def run(task: Task) -> Row:
    """One loop; keys in_danger (decisions), named, causes, relief (periods, infinite for never), spec, ms, story."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 42])
    loop, gains = _drawn(task.kind, rng)
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    seen: list[tuple[float, Decision]] = []
    story: list[str] = []

    def tell(decision: Decision) -> None:
        seen.append((judge.of(decision.gains_before).ms, decision))
        if task.verbose:
            story.append(f"   Ms {seen[-1][0]:.2f} {told(decision, judge)}")

    watching = Watching(one_region(gains), settings(loop.dt_s, PV_SPAN), tell)
    period_s = own_period_s(loop, gains)
    # pv per unit of co that a bounded output is measured by
    p = loop.process
    room = ROOM[task.kind] / abs(p.k * (loop.theta_s if p.integrators else 1.0))
    table = watching.retuner.table
    plant = HeldPlant(loop.process, loop.dt_s)
    watched = WatchedLoop(plant, table, loop.dt_s, watching, low=-room, high=room, lost=1e5)
    lost, relief_s = False, math.inf
    load_size = min(judge.load_like_setpoint(), 0.3 * room)
    sp = load = 0.0
    n = min(int(APART_PERIODS * period_s / loop.dt_s), MOST_SAMPLES // UPSETS)
    by_loads = task.index % 2 == 0
    try:
        for i in range(UPSETS):
            watched.run(sp, load, [float(x) for x in NOISE * rng.standard_normal(n)])
            if by_loads or i % 2:
                load = load_size - load
            else:
                sp = 1.0 - sp
    except LostLoop:
        lost = True
    for at_s, after in ((d.t_s, d.gains_after) for d in watching.writes if d.gains_after is not None):
        safe = judge.of(after).ms < DANGER
        relief_s = min(relief_s, at_s) if safe else math.inf
    in_danger = [d for ms, d in seen if ms > DANGER]
    found, last = effects(judge, watching), judge.of(watched.gains)
    return {
        "part": "own",
        "kind": task.kind,
        "seed": task.seed,
        "index": task.index,
        "what": f"{loop.family} {'loads' if by_loads else 'steps'}",
        "in_danger": len(in_danger),
        "named": sum(_names_tuning(d) for d in in_danger),
        "causes": dict(Counter(str(d.diagnosis.cause) if d.diagnosis else d.code for d in in_danger)),
        "codes": dict(Counter(d.code for d in in_danger)),
        "relief": relief_s / period_s,
        "ms": [judge.of(gains).ms, last.ms],
        "spec": last.in_spec,
        "lost": lost,
        "worse": sum(x.worse and not x.restored for x in found),
        "made_unstable": sum(math.isfinite(x.before.ms) and math.isinf(x.after.ms) for x in found),
        "story": story,
    }


def _names_tuning(decision: Decision) -> bool:
    """Whether a decision says that the tuning is at fault, or changes it."""
    named = decision.diagnosis is not None and decision.diagnosis.cause in TUNING_CAUSES
    return named or decision.gains_after is not None


def _drawn(kind: str, rng: np.random.Generator) -> tuple[Loop, PidGains]:
    """A loop with gains of that kind: Kc from its own limit of stability, tau_I drawn."""
    for _ in range(TRIES):
        loop = draw_loop(rng, str(rng.choice(FAMILIES)), (5.0, 15.0))
        start = scaled(loop.best, 1.0, log_uniform(rng, 0.5, 2.0))
        critical = _critical(loop, start)
        over = {"damped": (0.5, 0.95), "growing": (1.05, 1.6), "limits": (1.2, 3.0)}[kind]
        factor = critical * log_uniform(rng, *over)
        gains = PidGains(start.kp * factor, start.ki * factor)
        ms = loop.margins(gains).ms
        if critical and (3.0 < ms < 10.0 if kind == "damped" else math.isinf(ms)):
            return loop, gains
    raise RuntimeError(f"no loop fits {kind} in {TRIES} draws")


def _critical(loop: Loop, gains: PidGains) -> float:
    """The factor on both gains at which the loop begins to swing by itself; 0 where none was found."""
    low, high = 0.0, 0.0
    for factor in np.geomspace(0.5, 32.0, 25):
        if loop.margins(PidGains(gains.kp * factor, gains.ki * factor)).stable:
            low = float(factor)
        elif low:
            high = float(factor)
            break
    return math.sqrt(low * high)


def line(row: Row) -> str:
    """A loop for people."""
    head = (
        f"{row['kind']:<8}{row['index']:>3} Ms {row['ms'][0]:6.2f} -> {row['ms'][1]:6.2f} "
        f"{'in spec' if row['spec'] else 'OUT':<8}"
        f"relief {row['relief']:6.1f} periods; in danger {row['named']} of {row['in_danger']} name the tuning; "
        f"{row['codes']} worse {row['worse']}{' LOST' if row['lost'] else ''} {row['what']}"
    )
    return "\n".join([head, *(f"    {text}" for text in row["story"])])


def table(rows: list[Row]) -> list[str]:
    """A few lines a kind."""
    lines = []
    for kind in (*KINDS, "all"):
        of = [row for row in rows if kind in {"all", row["kind"]}]
        if not of:
            continue
        causes: Counter[str] = Counter()
        for row in of:
            causes.update(row["causes"])
        relieved = [row for row in of if row["relief"] < math.inf]
        middle = f", in the median {np.median([r['relief'] for r in relieved]):.0f} periods" if relieved else ""
        lines += [
            f"{kind}: {len(of)} loops, worse {sum(r['worse'] for r in of)}, lost {sum(r['lost'] for r in of)}, made "
            f"unstable {sum(r['made_unstable'] for r in of)}",
            f"  decisions at Ms over 3 that name the tuning  "
            f"{counted(sum(r['named'] for r in of), sum(r['in_danger'] for r in of))}",
            "  named: " + ", ".join(f"{name} {number}" for name, number in causes.most_common()),
            f"  Ms under 3 at the end{middle}  {counted(len(relieved), len(of))}",
            f"  in spec at the end  {counted(sum(r['spec'] for r in of), len(of))}",
        ]
    return lines
