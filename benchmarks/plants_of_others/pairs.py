"""Two loops of one plant that both start with wrong gains, retuned at once: each by itself, or with regard to both.

Plants are published transfer functions: Wood & Berry's column, Vinante & Luyben's, and Johansson's quadruple tank at
its easy working point (P-) and at the one with a right half plane zero (P+, paired crosswise).
Setpoints of both loops step in turn; noise is 1 % of a step. What is true is worked out on the plant itself: Ms of each
loop with the other closed, infinite where the two are not stable together.
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from cases.plant import HeldPlant

from plants_of_others.loop import Card, Controlled
from retuner import Action, LinearProcess, PidGains
from retuner.adaptive.interaction.multivariable_fit import Element, StepAnswers
from retuner.adaptive.interaction.together import Closed, together
from retuner.one_plant.controllers import on_one_plant

Row = dict[str, Any]
MS_MOST, NOTICED, NOISE, LOST, EVENTS = 2.1, 1.05, 0.01, 20.0, 12
HOW = ("fixed", "apart", "together")


@dataclass(frozen=True, slots=True)
class Pair:
    """rows : by process value, (k, tau1, tau2, theta) of each output, seconds. gains : published kc and tau_I.
    hold_s : between two setpoint steps of size `step`, of the loops in turn.
    """

    rows: tuple[tuple[tuple[float, float, float, float], ...], ...]
    gains: tuple[tuple[float, float], ...]
    dt_s: float
    hold_s: float
    step: float


PAIRS = {
    "wood-berry": Pair(
        (((12.8, 1002, 0, 60), (-18.9, 1260, 0, 180)), ((6.6, 654, 0, 420), (-19.4, 864, 0, 180))),
        ((0.375, 497.4), (-0.075, 1416.0)), 20.0, 9000.0, 0.75,
    ),
    "tank P-": Pair(
        (((2.6, 62, 6, 0), (1.5, 23, 62, 6)), ((1.4, 30, 90, 6), (2.8, 90, 6, 0))),
        ((3.0, 30.0), (2.7, 40.0)), 2.0, 900.0, 1.0,
    ),
    "tank P+ crossed": Pair(
        (((2.5, 39, 63, 6), (1.5, 63, 6, 0)), ((1.6, 91, 6, 0), (2.5, 56, 91, 6))),
        ((0.6, 100.0), (0.6, 140.0)), 2.0, 1800.0, 1.0,
    ),
}  # fmt: skip
"""The tanks' pumps have a lag of 6 s, as in examples/plants/quadruple_tank.py; P+ begins from gains of ours."""
STARTS = {
    "low, low": ((1 / 4, 1), (1 / 4, 1)),
    "high, low": ((3, 1), (1 / 4, 1)),
    "low, high": ((1 / 4, 1), (3, 1)),
    "slow, slow": ((1 / 4, 4), (1 / 4, 4)),
    "published": ((1, 1), (1, 1)),
}


@dataclass(frozen=True, slots=True)
class Task:
    """A pair under a start, its sessions from one seed."""

    pair: str
    start: str
    seed: int


def run(task: Task) -> Row:
    """The session under gains that stay, under retuners apart, and under retuners with regard to both."""
    found = {how: session(PAIRS[task.pair], STARTS[task.start], task.seed, how) for how in HOW}
    for row in found.values():
        row["over"] = [round(a / b, 2) for a, b in zip(row["iae"], found["fixed"]["iae"], strict=True)]
    return {"pair": task.pair, "start": task.start, "seed": task.seed, "how": {how: found[how] for how in HOW[1:]}}


def session(pair: Pair, start: tuple[tuple[float, float], ...], seed: int, how: str) -> Row:
    rng, span = np.random.default_rng([seed, 39]), 10.0 * pair.step
    now, controls = [], []
    for i, ((kc, tau_i), (a, b)) in enumerate(zip(pair.gains, start, strict=True)):
        now.append(PidGains(kc * a, kc * a / (tau_i * b), 0.0))
        card = Card(f"loop {i + 1}", pair.dt_s, (-span, span), (-1e3, 1e3), now[i], "", pair.step)
        controls.append(Controlled(card, now[i], 0.0, watched=how != "fixed"))
    if how == "together":
        on_one_plant(*(control.pid for control in controls))
    plants = [[_held(cell, pair.dt_s) for cell in row] for row in pair.rows]
    true = [StepAnswers(tuple(Element(*cell) for cell in row), 0.0) for row in pair.rows]

    def ms() -> tuple[float, ...]:
        return together(true, [Closed(one, pair.dt_s) for one in now])

    first, y, sp, iae, lost, changes = ms(), [0.0] * 2, [0.0] * 2, [0.0] * 2, False, []
    for event in range(EVENTS + 1):
        if event:
            sp[(event - 1) % 2] = 0.0 if sp[(event - 1) % 2] else pair.step
        for _ in range(int(pair.hold_s / pair.dt_s)):
            u = []
            for i, control in enumerate(controls):
                u.append(control(sp[i], y[i] + NOISE * pair.step * float(rng.standard_normal())))
                iae[i] += abs(sp[i] - y[i]) * pair.dt_s
                decided = control.pid.decision
                if decided and decided.action in {Action.WRITE, Action.RESTORE} and control.pid.gains != now[i]:
                    before, now[i] = ms(), control.pid.gains
                    changes.append((decided.action == Action.RESTORE, before, ms()))
            y = [sum(cell.move(x) for cell, x in zip(row, u, strict=True)) for row in plants]
            lost |= max(map(abs, y)) > LOST * pair.step
            if lost:
                break
    bad = [back for back, a, b in changes if max(b) > max(MS_MOST, NOTICED * max(a))]
    return {
        "ms first": first, "ms": ms(), "iae": iae, "lost": lost, "restored": sum(back for back, _, _ in changes),
        "changes": sum(not back for back, _, _ in changes), "bad": bad.count(False), "bad restored": bad.count(True),
        "unstable": sum(math.isinf(b[0]) and math.isfinite(a[0]) for _, a, b in changes),
        "codes": dict(Counter(one.code for control in controls for one in control.decisions)),
    }  # fmt: skip


def _held(cell: tuple[float, float, float, float], dt_s: float) -> HeldPlant:
    k, tau1, tau2, theta = cell
    return HeldPlant(LinearProcess(k, tuple(x for x in (tau1, tau2) if x), (), theta), dt_s)


def line(row: Row) -> str:
    told = []
    for how, of in row["how"].items():
        ms = [" ".join(f"{x:.2f}" for x in of[key]) for key in ("ms first", "ms")]
        told.append(
            f"{row['pair']:<16}{row['start']:<11}{row['seed']:>4} {how:<9} Ms {ms[0]} -> {ms[1]}  IAE x {of['over']}  "
            f"changes {of['changes']} restored {of['restored']} bad {of['bad']}+{of['bad restored']} unstable "
            f"{of['unstable']}{'  LOST' if of['lost'] else ''}  {of['codes']}"
        )
    return "\n".join(told)


def table(rows: list[Row]) -> list[str]:
    lines = []
    for how in HOW[1:]:
        own = [row["how"][how] for row in rows]
        sums = {key: sum(int(row[key]) for row in own) for key in ("changes", "restored", "bad", "unstable", "lost")}
        good, worst = sum(max(row["ms"]) <= MS_MOST for row in own), max(max(row["ms"]) for row in own)
        lines.append(f"{how}: {len(own)} sessions, {good} end with Ms <= {MS_MOST}, worst {worst:.2f}; {sums}")
    return lines
