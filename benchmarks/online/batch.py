"""The standard batch: gains off, setpoint and load steps in turn, 1 % noise; in spec after every disturbance?

Each run is a process of the batch with its gains off by one of START's pairs of factors on Kc and tau_I. The load is as
large as moves pv by one under SIMC with perfect knowledge, as the setpoint step does; noise is 1 % of it. Samples are
an eighth of the effective dead time apart, disturbances 60 effective dead times (longer for sluggish starts).
"""

import math
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from cases.plant import HeldPlant

from online.judge import Judge, Judgement, counted
from online.loop import LostLoop, Supervisor, WatchedLoop, Watching, guard_settings, one_region, settings
from online.rivals import Member, PatternAlone, batch, relay_then_ziegler_nichols, step_then_simc
from retuner.adaptive.guard.step_size import Parameter, step_limit
from retuner.adaptive.supervision.decision import Decision
from retuner.schedule.gains import PidGains

SAMPLES_PER_THETA = 8
DISTURBANCES = 6
STARTS = tuple((kc, tau_i) for kc in (4.0, 0.25, 2.0) for tau_i in (4.0, 0.25, 1.0))
"""Factors on Kc and tau_I of the right settings at the start."""
REST_SAMPLES = 60
LENGTH_THETA = 60.0
NOISE = 0.01
PV_SPAN = 10.0

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Task:
    """One run. opened : limits of a change at x8 instead of the defaults. verbose : tell what was decided."""

    member: Member
    start: tuple[float, float]
    seed: int
    opened: bool
    noise: float = NOISE
    verbose: bool = False
    rivals: bool = False


def tasks(
    seed: int,
    *,
    opened: bool,
    every: int = 1,
    offset: int = 0,
    only: str = "",
    noise: float = NOISE,
    verbose: bool = False,
    starts: int = 1,
    rivals: bool = False,
) -> list[Task]:
    """The runs of a table: `starts` of STARTS (in a drawn order) for each process; every n-th, from an offset on."""
    rng = np.random.default_rng(seed)
    found = []
    for member in batch():
        order = rng.permutation(len(STARTS))[:starts]
        found += [
            Task(member, STARTS[i], zlib.crc32(f"{seed} {member.name} {i}".encode()), opened, noise, verbose, rivals)
            for i in order
        ]
    return [task for task in found if task.member.name.startswith(only)][offset::every]


Line = Callable[[Watching, "Task", float], Supervisor]
"""Through what a watcher hears of its loop, sampled every so many seconds."""


def run(task: Task, line: Line | None = None) -> Row:
    """One run; keys spec, ms, j (a value a disturbance), changes, and where verbose the story."""
    dt_s = Judge.theta(task.member.process) / SAMPLES_PER_THETA
    judge = Judge(task.member.process, dt_s)
    kc, tau_i = task.start
    gains = PidGains(judge.best.kp * kc, judge.best.ki * kc / tau_i)
    story: list[str] = []

    # writes down each decision in one line
    def tell(decision: Decision) -> None:
        story.append("   " + told(decision, judge))

    watching = Watching(one_region(gains), settings(dt_s, PV_SPAN, opened=task.opened), tell)
    hears = line(watching, task, dt_s) if line else watching
    loop = WatchedLoop(HeldPlant(task.member.process, dt_s), watching.retuner.table, dt_s, hears)
    judged = disturbed(loop, judge, task, story)
    first = judge.of(gains)
    return {
        "part": "batch",
        "process": task.member.name,
        "family": task.member.family,
        "kc": kc,
        "tau_i": tau_i,
        "seed": task.seed,
        "opened": task.opened,
        "changes": loop.changes,
        "ms0": first.ms,
        "j0": first.j,
        "ms_limit": judge.ms_limit,
        "reach": reaches(judge, gains, opened=task.opened),
        "spec": [found.in_spec for found in judged],
        "ms": [found.ms for found in judged],
        "j": [found.j for found in judged],
        "kc_now": loop.gains.kp / judge.best.kp,
        "ki_now": loop.gains.ki / judge.best.ki,
        "story": story if task.verbose else [],
        "rivals": rivals(task, judge, gains) if task.rivals else {},
    }


def rivals(task: Task, judge: Judge, gains: PidGains) -> dict[str, list[bool]]:
    """In spec after each disturbance, under those that retuner is compared with."""
    process, dt_s = task.member.process, judge.dt_s
    rng = np.random.default_rng(task.seed + 1)
    relay = relay_then_ziegler_nichols(HeldPlant(process, dt_s), process, dt_s, task.noise, rng)
    simc = step_then_simc(HeldPlant(process, dt_s), process, judge.theta_s, dt_s, task.noise, rng)
    pattern = PatternAlone(one_region(gains), settings(dt_s, PV_SPAN))
    loop = WatchedLoop(HeldPlant(process, dt_s), pattern.table, dt_s, pattern)
    once = {"fixed": gains, "relay once": relay, "simc once": simc}
    found = {who: [x is not None and judge.of(x).in_spec] * DISTURBANCES for who, x in once.items()}
    return found | {"pattern": [x.in_spec for x in disturbed(loop, judge, task, [])]}


def disturbed(loop: WatchedLoop, judge: Judge, task: Task, story: list[str]) -> list[Judgement]:
    """What is in force after each disturbance; a lost loop counts as unstable from then on."""
    rng = np.random.default_rng(task.seed)
    n = int(LENGTH_THETA * SAMPLES_PER_THETA * max(1.0, 1 / task.start[0]))
    judged: list[Judgement] = []
    load_size = judge.load_like_setpoint()
    sp = load = 0.0
    try:
        loop.run(sp, load, _noise(rng, task.noise, REST_SAMPLES))
        for i in range(DISTURBANCES):
            sp, load = (1.0 - sp, load) if i % 2 == 0 else (sp, load_size - load)
            story.append(f"{i + 1}. {'setpoint' if i % 2 == 0 else 'load'} at {loop.t_s:.4g} s")
            loop.run(sp, load, _noise(rng, task.noise, n))
            judged.append(judge.of(loop.table.gains_of(0)))
            story.append(f"   now {_words(judged[-1])}")
    except LostLoop:
        story.append(f"   lost at {loop.t_s:.4g} s")
        judged += [Judgement(float("inf"), float("inf"), in_spec=False)] * (DISTURBANCES - len(judged))
    return judged


def _noise(rng: np.random.Generator, size: float, n: int) -> list[float]:
    return [float(x) for x in size * rng.standard_normal(n)]


def told(d: Decision, judge: Judge) -> str:
    """A decision in one line: what was recognised, cause, ruling, and what is true of the gains that follow."""
    seen = "-"
    if d.response:
        damping = "" if d.response.damping is None else f" damping {d.response.damping:.2f}"
        upset, peaks = "sp" if d.response.sp_changed else "load", len(d.response.peaks)
        seen = f"{upset} {peaks} peaks{damping} {d.response.ending.name}"
    model = f"{d.estimate.to_dict()['model']}" if d.estimate and d.estimate.identifiable else "no model"
    after = f"-> {_words(judge.of(d.gains_after))}" if d.gains_after else ""
    cause = str(d.diagnosis.cause) if d.diagnosis else "-"
    ruling = d.proof.ruling.name if d.proof else "-"
    return f"t {d.t_s:.4g}: {seen}; {cause}; {ruling}; {d.action} {after}; {model}; {d.reason}"


def _words(found: Judgement) -> str:
    return f"Ms {found.ms:.2f} J {found.j:.2f} {'in spec' if found.in_spec else 'OUT'}"


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
        f"in spec after {n} disturbances, and staying  {counted(sum(staying(r, n) for r in rows), len(rows))}"
        f"   (at that moment {sum(r['spec'][n - 1] for r in rows)})"
        for n in range(1, DISTURBANCES + 1)
    ]
    kinds = {
        "where one change reaches": [row for row in rows if in_one_change(row)],
        "where a set of one change is in spec": [row for row in rows if row.get("reach", False)],
    }
    lines += [
        f"{kind}: after {n}, and staying  {counted(sum(staying(r, n) for r in of), len(of))}"
        for kind, of in kinds.items()
        for n in (1, 3, 6)
        if of
    ]
    for who in sorted({name for row in rows for name in row["rivals"]}):
        of = [row["rivals"][who] for row in rows if who in row["rivals"]]
        lines += [
            f"{who}: after {n}, and staying  {counted(sum(all(x[n - 1 :]) for x in of), len(of))}" for n in (1, 3, 6)
        ]
    at_end = Counter(_fault(row) for row in rows)
    lines.append("at the end: " + ", ".join(f"{name} {number}" for name, number in at_end.most_common()))
    for key in ("family", "kc", "tau_i"):
        lines.append(f"{key:<8} runs  staying after 1 / 3 / 6")
        for value in sorted({row[key] for row in rows}):
            of = [row for row in rows if row[key] == value]
            lines.append(
                f"  {value!s:<6} {len(of):4d}  "
                + " / ".join(f"{sum(staying(r, n) for r in of) / len(of):4.0%}" for n in (1, 3, 6))
            )
    return lines


def _fault(row: Row) -> str:
    """What is wrong after the last disturbance."""
    if row["spec"][-1]:
        return "in spec"
    if row["ms"][-1] == float("inf"):
        return "unstable"
    return "Ms too large" if row["ms"][-1] > row["ms_limit"] else "J too large"
