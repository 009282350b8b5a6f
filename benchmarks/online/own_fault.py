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
from collections.abc import Iterator

import numpy as np
from cases.case import share
from cases.making import own_period_s
from cases.plant import FAMILIES, log_uniform
from cases.setting import Loop, draw_loop, scaled

from online.judge import Judge
from online.runner import Task
from online.session import Row, Session, by_kind, noise_of
from online.session import line as session_line
from retuner import Decision, PidGains
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES

KINDS = ("damped", "growing", "limits")
DANGER = 3.0
UPSETS = 8
APART_PERIODS = 12.0
MOST_SAMPLES = 24000
ROOM = {"damped": 1e6, "growing": 300.0, "limits": 4.0}
"""How far the output may go from rest, in setpoint steps of the process's gain."""
TRIES = 200


def run(task: Task) -> Row:
    """One loop, judged at the end; besides in_danger (decisions), named, causes, relief (periods, inf for never)."""
    rng = np.random.default_rng([task.seed, task.index, KINDS.index(task.kind), 42])
    loop, gains = _drawn(task.kind, rng)
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    period_s = own_period_s(loop, gains)
    # pv per unit of co that a bounded output is measured by
    p = loop.process
    room = ROOM[task.kind] / abs(p.k * (loop.theta_s if p.integrators else 1.0))
    session = Session(task, judge, gains, low=-room, high=room, lost=1e5)
    load_size = min(judge.load_like_setpoint(), 0.3 * room)
    n = min(int(APART_PERIODS * period_s / loop.dt_s), MOST_SAMPLES // UPSETS)
    by_loads = task.index % 2 == 0

    def upsets() -> Iterator[None]:
        sp = load = 0.0
        for i in range(UPSETS):
            session.loop.run(sp, load, noise_of(rng, n))
            sp, load = (sp, load_size - load) if by_loads or i % 2 else (1.0 - sp, load)
            yield None

    session.run(upsets())
    session.judged.append(judge.of(session.loop.gains))
    relief_s = math.inf
    for at_s, after in ((d.t_s, d.gains_after) for d in session.watching.writes if d.gains_after is not None):
        relief_s = min(relief_s, at_s) if judge.of(after).ms < DANGER else math.inf
    in_danger = [d for d in session.watching.decisions if judge.of(d.gains_before).ms > DANGER]
    return session.row(
        "own",
        f"{loop.family} {'loads' if by_loads else 'steps'}",
        in_danger=len(in_danger),
        named=sum(_names_tuning(d) for d in in_danger),
        causes=dict(Counter(str(d.diagnosis.cause) if d.diagnosis else d.code for d in in_danger)),
        codes=dict(Counter(d.code for d in in_danger)),
        relief=relief_s / period_s,
    )


def _names_tuning(decision: Decision) -> bool:
    """Whether a decision says that the tuning is at fault, or changes it."""
    named = decision.diagnosis is not None and decision.diagnosis.cause in TUNING_CAUSES
    return named or decision.gains_after is not None


def _drawn(kind: str, rng: np.random.Generator) -> tuple[Loop, PidGains]:
    """A loop with gains of that kind: Kc from its own limit of stability, tau_I drawn."""
    for _ in range(TRIES):
        loop = draw_loop(rng, str(rng.choice(FAMILIES)), (5.0, 15.0))
        start = scaled(loop.best, 1.0, log_uniform(rng, 0.5, 2.0))
        low, high = 0.0, 0.0
        for factor in np.geomspace(0.5, 32.0, 25):
            if loop.margins(PidGains(start.kp * factor, start.ki * factor)).stable:
                low = float(factor)
            elif low:
                high = float(factor)
                break
        critical = math.sqrt(low * high)
        over = {"damped": (0.5, 0.95), "growing": (1.05, 1.6), "limits": (1.2, 3.0)}[kind]
        factor = critical * log_uniform(rng, *over)
        gains = PidGains(start.kp * factor, start.ki * factor)
        ms = loop.margins(gains).ms
        if critical and (3.0 < ms < 10.0 if kind == "damped" else math.isinf(ms)):
            return loop, gains
    raise RuntimeError(f"no loop fits {kind} in {TRIES} draws")


def line(row: Row) -> str:
    """A loop for people."""
    relief = f"relief {row['relief']:.1f} periods; in danger {row['named']} of {row['in_danger']} name the tuning"
    return session_line(row | {"what": f"{row['what']}: {relief}; {row['codes']}"})


def table(rows: list[Row]) -> list[str]:
    """A few lines a kind."""
    lines = []
    for _, of, head in by_kind(rows, (*KINDS, "all")):
        causes: Counter[str] = Counter()
        for row in of:
            causes.update(row["causes"])
        relieved = [row for row in of if row["relief"] < math.inf]
        middle = f", in the median {np.median([r['relief'] for r in relieved]):.0f} periods" if relieved else ""
        lines += [
            head,
            f"  decisions at Ms over 3 that name the tuning  "
            f"{share(sum(r['named'] for r in of), sum(r['in_danger'] for r in of))}",
            "  named: " + ", ".join(f"{name} {number}" for name, number in causes.most_common()),
            f"  Ms under 3 at the end{middle}  {share(len(relieved), len(of))}",
            f"  in spec at the end  {share(sum(r['spec'][-1] for r in of), len(of))}",
        ]
    return lines
