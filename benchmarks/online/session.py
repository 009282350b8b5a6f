"""Retuner in charge of one loop that is upset again and again: what the parts of the measurement have in common.

Who watches the loop and what is told of it, gains that are off at the start, the row of a loop, and the counts of rows.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from cases.case import share
from cases.plant import FAMILIES, HeldPlant
from cases.setting import Loop, draw_loop, scaled

from online.judge import Effect, Judge, Judgement, effect
from online.loop import LostLoop, Moved, WatchedLoop, Watching, one_region, settings
from online.runner import Task
from retuner import Action, Decision, PidGains

Row = dict[str, Any]
STARTS = tuple((kc, tau_i) for kc in (4.0, 0.25, 2.0) for tau_i in (4.0, 0.25, 1.0))
"""Factors on Kc and tau_I of the right settings at the start."""
SAMPLES_PER_THETA, LENGTH_THETA, REST_SAMPLES = 8, 60.0, 60
"""Samples in an effective dead time, dead times from one upset to the next, samples before the first."""
NOISE, PV_SPAN = 0.01, 10.0  # Of a setpoint step of one
LOST = Judgement(math.inf, math.inf, in_spec=False)
AFTER = (1, 3, 6)  # Upsets after which loops in spec are counted


def noise_of(rng: np.random.Generator, n: int, size: float = NOISE) -> list[float]:
    """White noise of n samples."""
    return [float(x) for x in size * rng.standard_normal(n)]


def loop_with_start(rng: np.random.Generator, *, stable: bool = True) -> tuple[Loop, Judge, tuple[float, float]]:
    """A loop of any family, its judge, and one of STARTS, on request one with which it is stable."""
    loop = draw_loop(rng, str(rng.choice(FAMILIES)), (SAMPLES_PER_THETA, SAMPLES_PER_THETA + 1e-9))
    judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
    factors = STARTS[int(rng.integers(len(STARTS)))]
    while stable and not loop.margins(scaled(loop.best, *factors)).stable:
        factors = STARTS[int(rng.integers(len(STARTS)))]
    return loop, judge, factors


def told(d: Decision, judge: Judge) -> str:
    """A decision in one line: what was recognised, cause, ruling, and what is true of the gains that follow."""
    seen = "-"
    if d.response:
        damping = "" if d.response.damping is None else f" damping {d.response.damping:.2f}"
        upset, peaks = "sp" if d.response.sp_changed else "load", len(d.response.peaks)
        seen = f"{upset} {peaks} peaks{damping} {d.response.ending.name}"
    model = f"{d.estimate.to_dict()['model']}" if d.estimate and d.estimate.identifiable else "no model"
    after = f"-> {in_words(judge.of(d.gains_after))}" if d.gains_after else ""
    cause = str(d.diagnosis.cause) if d.diagnosis else "-"
    ruling = d.proof.ruling.name if d.proof else "-"
    return f"t {d.t_s:.4g}: {seen}; {cause}; {ruling}; {d.action} {after}; {model}; {d.reason}"


def in_words(found: Judgement) -> str:
    return f"Ms {found.ms:.2f} J {found.j:.2f} {'in spec' if found.in_spec else 'OUT'}"


def effects(judge: Judge, watching: Watching) -> list[Effect]:
    """The effect of every change that was written, in order."""
    return [
        effect(judge, d.t_s, d.gains_before, d.gains_after, restored=d.action != Action.WRITE)
        for d in watching.writes
        if d.gains_after is not None
    ]


class Session:
    """One loop with retuner in charge, from rest. plant : of the judge's process where none is given. watching : where
    it is not retuner alone. loop : as WatchedLoop takes it. judged : after each upset. story : what was decided and
    what was true then, a line each. task : of the batch its own, which has no row() here.
    """

    def __init__(
        self,
        task: Task,
        judge: Judge,
        gains: PidGains,
        plant: Moved | None = None,
        pv_span: float = PV_SPAN,
        watching: Watching | None = None,
        **loop: Any,
    ) -> None:
        self.task, self.judge, self.first = task, judge, judge.of(gains)
        self.judged, self.story, self.lost = list[Judgement](), list[str](), False

        def tell(decision: Decision) -> None:
            if task.verbose:
                self.story.append(f"   Ms {judge.of(decision.gains_before).ms:.2f} {told(decision, judge)}")

        wanted = settings(judge.dt_s, pv_span, opened=task.opened)
        self.watching = watching or Watching(one_region(gains), wanted, tell)
        plant = plant or HeldPlant(judge.process, judge.dt_s)
        self.loop = WatchedLoop(plant, self.watching.retuner.table, judge.dt_s, self.watching, **loop)

    def run(self, upsets: Iterable[Judge | None], most: int = 0) -> None:
        """To the end, or until the loop is lost. upsets : gives the true judge after each, where it is to be judged, so
        often at most; a lost loop counts as unstable from then on.
        """
        try:
            for judge in upsets:
                if judge is not None:
                    self.judge = judge
                    self.judged.append(judge.of(self.loop.gains))
                    self.story.append(f"{len(self.judged)}. {in_words(self.judged[-1])}")
        except LostLoop:
            self.lost = True
        self.judged += [LOST] * (most - len(self.judged))

    def row(self, part: str, what: str, **more: object) -> Row:
        """What came of it. more : of that part alone."""
        task, found = self.task, effects(self.judge, self.watching)
        common = {
            "part": part, "kind": task.kind, "seed": task.seed, "index": task.index, "opened": task.opened,
            "what": what, "first": asdict(self.first), "spec": [x.in_spec for x in self.judged],
            "ms": [x.ms for x in self.judged], "j": [x.j for x in self.judged], "ms_limit": self.judge.ms_limit,
            "records": len(self.watching.decisions), "changes": len(found), "lost": self.lost,
            "worse": sum(x.worse and not x.restored for x in found),
            "made_unstable": sum(math.isfinite(x.before.ms) and math.isinf(x.after.ms) for x in found),
            "story": self.story if task.verbose else [],
        }  # fmt: skip
        return common | more


def line(row: Row) -> str:
    """A loop for people."""
    first, last = row["first"], {key: row[key][-1] for key in ("ms", "j")}
    said = [f"Ms {x['ms']:5.2f} J {x['j']:5.2f}" for x in (first, last)]
    spec = "".join("+" if ok else "." for ok in row["spec"])
    head = f"{row['kind']:<9}{row['index']:>4} {spec:<7} {said[0]} -> {said[1]} changes {row['changes']} "
    head += f"worse {row['worse']}{' LOST' if row['lost'] else ''} {row['what']}"
    return "\n".join([head, *(f"    {text}" for text in row["story"])])


def by_kind(rows: list[Row], kinds: Iterable[str]) -> Iterator[tuple[str, list[Row], str]]:
    """The rows of each kind that there are ("all" : of every kind), with the head of their lines in a table."""
    for kind in kinds:
        if of := [row for row in rows if kind in {"all", row["kind"]}]:
            names = {"worse": "worse", "made unstable": "made_unstable", "responses": "records", "lost": "lost"}
            sums = ", ".join(f"{name} {sum(row[key] for row in of)}" for name, key in names.items())
            changes = sum(row["changes"] for row in of)
            yield kind, of, f"{kind}: {len(of)} loops, {changes} changes ({changes / len(of):.1f} a loop), {sums}"


def in_spec_after(rows: list[Row], after: Iterable[int] = AFTER) -> list[str]:
    """Shares in spec after so many upsets."""
    return [f"  in spec after {n}  {share(sum(row['spec'][n - 1] for row in rows), len(rows))}" for n in after]


def faults(rows: list[Row]) -> str:
    """What is wrong after the last upset, and how often."""

    def fault(row: Row) -> str:
        if row["spec"][-1]:
            return "in spec"
        if math.isinf(row["ms"][-1]):
            return "unstable"
        return "Ms too large" if row["ms"][-1] > row["ms_limit"] else "J too large"

    return "at the end: " + ", ".join(f"{name} {number}" for name, number in Counter(map(fault, rows)).most_common())
