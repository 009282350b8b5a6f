"""The standard batch: gains off, setpoint and load steps in turn, 1 % noise; in spec after every disturbance?

Each run is a process of the batch with its gains off by one of START's pairs of factors on Kc and tau_I. The load is as
large as moves pv by one under SIMC with perfect knowledge, as the setpoint step does; noise is 1 % of it. Samples are
an eighth of the effective dead time apart, disturbances 60 effective dead times (longer for sluggish starts).
"""

import math
import zlib
from dataclasses import dataclass

import numpy as np
from cases.case import share

from online.judge import Judge, Judgement
from online.loop import LostLoop, WatchedLoop, guard_settings
from online.rivals import Member, batch
from online.session import (
    LENGTH_THETA,
    LOST,
    NOISE,
    REST_SAMPLES,
    SAMPLES_PER_THETA,
    STARTS,
    Row,
    Session,
    faults,
    in_words,
    noise_of,
)
from retuner.adaptive.guard.step_size import Parameter, step_limit
from retuner.schedule.gains import PidGains

DISTURBANCES = 6


@dataclass(frozen=True, slots=True)
class Task:
    """One run. opened : limits of a change at x8 instead of the defaults. verbose : tell what was decided."""

    member: Member
    start: tuple[float, float]
    seed: int
    opened: bool
    noise: float = NOISE
    verbose: bool = False


def tasks(
    seed: int,
    *,
    opened: bool = False,
    every: int = 1,
    offset: int = 0,
    only: str = "",
    noise: float = NOISE,
    verbose: bool = False,
    starts: int = 1,
) -> list[Task]:
    """The runs of a table: `starts` of STARTS (in a drawn order) for each process; every n-th, from an offset on."""
    rng = np.random.default_rng(seed)
    found = []
    for member in batch():
        order = rng.permutation(len(STARTS))[:starts]
        found += [
            Task(member, STARTS[i], zlib.crc32(f"{seed} {member.name} {i}".encode()), opened, noise, verbose)
            for i in order
        ]
    return [task for task in found if task.member.name.startswith(only)][offset::every]


def run(task: Task) -> Row:
    """One run; keys spec, ms, j (a value a disturbance), changes, and where verbose the story."""
    dt_s = Judge.theta(task.member.process) / SAMPLES_PER_THETA
    judge = Judge(task.member.process, dt_s)
    kc, tau_i = task.start
    gains = PidGains(judge.best.kp * kc, judge.best.ki * kc / tau_i)
    session = Session(task, judge, gains)
    judged, now = disturbed(session.loop, judge, task, session.story), session.loop.gains
    return {
        "part": "batch", "process": task.member.name, "family": task.member.family, "kc": kc, "tau_i": tau_i,
        "seed": task.seed, "opened": task.opened, "changes": session.loop.changes, "ms0": session.first.ms,
        "j0": session.first.j, "ms_limit": judge.ms_limit, "reach": reaches(judge, gains, opened=task.opened),
        "spec": [found.in_spec for found in judged], "ms": [found.ms for found in judged],
        "j": [found.j for found in judged], "kc_now": now.kp / judge.best.kp, "ki_now": now.ki / judge.best.ki,
        "story": session.story if task.verbose else [],
    }  # fmt: skip


def disturbed(loop: WatchedLoop, judge: Judge, task: Task, story: list[str]) -> list[Judgement]:
    """What is in force after each disturbance; a lost loop counts as unstable from then on."""
    rng = np.random.default_rng(task.seed)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA * max(1.0, 1 / task.start[0]))
    judged: list[Judgement] = []
    load_size = judge.load_like_setpoint()
    sp = load = 0.0
    try:
        loop.run(sp, load, noise_of(rng, REST_SAMPLES, task.noise))
        for i in range(DISTURBANCES):
            sp, load = (1.0 - sp, load) if i % 2 == 0 else (sp, load_size - load)
            story.append(f"{i + 1}. {'setpoint' if i % 2 == 0 else 'load'} at {loop.t_s:.4g} s")
            loop.run(sp, load, noise_of(rng, n, task.noise))
            judged.append(judge.of(loop.table.gains_of(0)))
            story.append(f"   now {in_words(judged[-1])}")
    except LostLoop:
        story.append(f"   lost at {loop.t_s:.4g} s")
        judged += [LOST] * (DISTURBANCES - len(judged))
    return judged


def staying(row: Row, after: int) -> bool:
    """In spec after that many disturbances and after every later one."""
    return all(row["spec"][after - 1 :])


def line(row: Row) -> str:
    """A run for people."""
    spec = "".join("+" if ok else "." for ok in row["spec"])
    head = (
        f"{row['process']:<14} kc x{row['kc']:<5g}tau_i x{row['tau_i']:<5g}{spec}  Ms {row['ms'][-1]:5.2f} "
        f"J {row['j'][-1]:5.2f} kc/best {row['kc_now']:5.2f} ki/best {row['ki_now']:5.2f} changes {row['changes']}"
    )
    return "\n".join([head, *(f"    {text}" for text in row["story"])])


def in_one_change(row: Row) -> bool:
    """Whether the right settings lie within one change of the start: the limits are of Kc, tau_I and Kc/tau_I."""
    limits = guard_settings(opened=row["opened"])
    ways = {Parameter.KC: 1 / row["kc"], Parameter.TAU_I: row["tau_i"], Parameter.INTEGRAL: row["tau_i"] / row["kc"]}
    more, less = ({p: step_limit(p, more=up, settings=limits) for p in ways} for up in (True, False))
    return all(1 / less[p] - 1e-9 <= way <= more[p] + 1e-9 for p, way in ways.items())  # above 1: more action


REACHED_STEPS = 5
"""Values of Kc that are tried for whether one change can do, each with the tau_I that is nearest to the right one."""


def reaches(judge: Judge, gains: PidGains, *, opened: bool) -> bool:
    """Whether a set that one change allows is in spec: else nobody could be after one disturbance and one change."""
    limits = guard_settings(opened=opened)
    kc, tau_i, integral = (
        [sign * math.log(step_limit(p, more=sign > 0, settings=limits)) for sign in (-1, 1)]
        for p in (Parameter.KC, Parameter.TAU_I, Parameter.INTEGRAL)
    )
    more_kc, more_ki = math.log(judge.best.kp / gains.kp), math.log(judge.best.ki / gains.ki)
    shorter = float(np.clip(more_ki - more_kc, *tau_i))
    tried = [float(np.clip(more_kc, *kc)), *(float(x) for x in np.linspace(*kc, REACHED_STEPS))]
    allowed = [(x, x + shorter) for x in tried if integral[0] <= x + shorter <= integral[1]]
    return any(judge.of(PidGains(gains.kp * math.exp(x), gains.ki * math.exp(more))).in_spec for x, more in allowed)


def table(rows: list[Row]) -> list[str]:
    """Shares in spec after each number of disturbances, by family, and what is left at the end."""
    lines = [f"{len(rows)} runs; {sum(row['changes'] for row in rows) / len(rows):.1f} changes a run"]
    lines += [
        f"in spec after {n} disturbances, and staying  {share(sum(staying(r, n) for r in rows), len(rows))}"
        f"   (at that moment {sum(r['spec'][n - 1] for r in rows)})"
        for n in range(1, DISTURBANCES + 1)
    ]
    kinds = {
        "where one change reaches": [row for row in rows if in_one_change(row)],
        "where a set of one change is in spec": [row for row in rows if row.get("reach", False)],
    }
    lines += [
        f"{kind}: after {n}, and staying  {share(sum(staying(r, n) for r in of), len(of))}"
        for kind, of in kinds.items()
        for n in (1, 3, 6)
        if of
    ]
    lines.append(faults(rows))
    for key in ("family", "kc", "tau_i"):
        lines.append(f"{key:<8} runs  staying after 1 / 3 / 6")
        for value in sorted({row[key] for row in rows}):
            of = [row for row in rows if row[key] == value]
            lines.append(
                f"  {value!s:<6} {len(of):4d}  "
                + " / ".join(f"{sum(staying(r, n) for r in of) / len(of):4.0%}" for n in (1, 3, 6))
            )
    return lines
