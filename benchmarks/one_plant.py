"""Two loops of one plant that both start with wrong gains, retuned at once: each by itself, or with regard to both.

Plants are published transfer functions: Wood & Berry's column, Vinante & Luyben's, and Johansson's quadruple tank at
its easy working point (P-) and at the one with a right half plane zero (P+, paired crosswise).
Setpoints of both loops step in turn; noise is 1 % of a step. What is true is worked out on the plant itself: Ms of each
loop with the other closed, infinite where the two are not stable together.

    python benchmarks/one_plant.py --seed 1 --sessions 2 --plants wood-berry
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cases.plant import HeldPlant

from retuner import Action, PidController, PidGains
from retuner.adaptive.interaction.answers import Element, StepAnswers
from retuner.adaptive.interaction.together import Closed, together
from retuner.adaptive.process.model import LinearProcess
from retuner.one_plant.controllers import on_one_plant

MS_MOST, NOTICED, NOISE, LOST = 2.1, 1.05, 0.01, 20.0


@dataclass(frozen=True, slots=True)
class Plant:
    """rows : by process value, (k, tau1, tau2, theta) of each output, seconds. gains : published kc and tau_I.
    events, hold_s : setpoint steps of size `step`, of the loops in turn, and the time between two.
    """

    rows: tuple[tuple[tuple[float, float, float, float], ...], ...]
    gains: tuple[tuple[float, float], ...]
    dt_s: float
    hold_s: float
    step: float
    events: int = 12


PLANTS = {
    "wood-berry": Plant(
        (((12.8, 1002, 0, 60), (-18.9, 1260, 0, 180)), ((6.6, 654, 0, 420), (-19.4, 864, 0, 180))),
        ((0.375, 497.4), (-0.075, 1416.0)),
        20.0,
        9000.0,
        0.75,
    ),
    "vinante-luyben": Plant(
        (((-2.2, 420, 0, 60), (1.3, 420, 0, 18)), ((-2.8, 570, 0, 108), (4.3, 552, 0, 21))),
        ((-1.07, 426.0), (1.97, 154.8)),
        6.0,
        3600.0,
        1.0,
    ),
    "tank P-": Plant(
        (((2.6, 62, 6, 0), (1.5, 23, 62, 6)), ((1.4, 30, 90, 6), (2.8, 90, 6, 0))),
        ((3.0, 30.0), (2.7, 40.0)),
        2.0,
        900.0,
        1.0,
    ),
    "tank P+ crossed": Plant(
        (((2.5, 39, 63, 6), (1.5, 63, 6, 0)), ((1.6, 91, 6, 0), (2.5, 56, 91, 6))),
        ((0.6, 100.0), (0.6, 140.0)),
        2.0,
        1800.0,
        1.0,
    ),
}
"""The tanks' pumps have a lag of 6 s, as in examples/plants/quadruple_tank.py; P+ begins from gains of ours."""
STARTS = {
    "low, low": ((1 / 4, 1), (1 / 4, 1)),
    "high, low": ((3, 1), (1 / 4, 1)),
    "low, high": ((1 / 4, 1), (3, 1)),
    "slow, slow": ((1 / 4, 4), (1 / 4, 4)),
    "published": ((1, 1), (1, 1)),
}


def gains_of(plant: Plant, start: str) -> list[PidGains]:
    """Kc and tau_I of the start."""
    return [
        PidGains(kc * a, kc * a / (tau_i * b), 0.0)
        for (kc, tau_i), (a, b) in zip(plant.gains, STARTS[start], strict=True)
    ]


def ms_of(plant: Plant, gains: list[PidGains]) -> tuple[float, ...]:
    """Of each loop on the true plant."""
    true = [StepAnswers(tuple(Element(*cell) for cell in row), 0.0) for row in plant.rows]
    return together(true, [Closed(one, plant.dt_s) for one in gains])


def session(plant: Plant, start: str, seed: int, how: str) -> dict[str, object]:
    """One session. how : "apart", "together" or "fixed"."""
    rng, first = np.random.default_rng([seed, 39]), gains_of(plant, start)
    span = 10.0 * plant.step
    pids = [
        PidController(
            gains,
            dt_s=plant.dt_s,
            pv_range=(-span, span),
            co_range=(-1e3, 1e3),
            mode="off" if how == "fixed" else "auto",
            name=f"loop {i + 1}",
        )
        for i, gains in enumerate(first)
    ]
    if how == "together":
        on_one_plant(*pids)
    cells = [[_held(cell, plant.dt_s) for cell in row] for row in plant.rows]
    y, sp, iae, lost = [0.0] * 2, [0.0] * 2, [0.0] * 2, False
    changes, codes = [], {}
    now = list(first)
    for event in range(plant.events + 1):
        if event:
            at = (event - 1) % 2
            sp[at] = 0.0 if sp[at] else plant.step
        for _ in range(int(plant.hold_s / plant.dt_s)):
            u = []
            for i, pid in enumerate(pids):
                seen = y[i] + NOISE * plant.step * float(rng.standard_normal())
                begun = {} if pid.retuner.samples else {"manual_co": 0.0}
                u.append(pid.step(sp[i], seen, **begun))
                iae[i] += abs(sp[i] - y[i]) * plant.dt_s
                if pid.decision is not None:
                    codes[pid.decision.code] = codes.get(pid.decision.code, 0) + 1
                    if pid.decision.action in {Action.WRITE, Action.RESTORE} and pid.gains != now[i]:
                        before = ms_of(plant, now)
                        now[i] = pid.gains
                        changes.append((pid.decision.action == Action.RESTORE, before, ms_of(plant, now)))
            y = [sum(cell.move(x) for cell, x in zip(row, u, strict=True)) for row in cells]
            lost |= max(map(abs, y)) > LOST * plant.step
            if lost:
                break
    bad = [max(b) > max(MS_MOST, NOTICED * max(a)) for _, a, b in changes]
    return {
        "start": start,
        "seed": seed,
        "how": how,
        "ms first": ms_of(plant, first),
        "ms": ms_of(plant, now),
        "iae": iae,
        "lost": lost,
        "changes": sum(not back for back, _, _ in changes),
        "restored": sum(back for back, _, _ in changes),
        "bad": sum(b and not back for b, (back, _, _) in zip(bad, changes, strict=True)),
        "bad restored": sum(b and back for b, (back, _, _) in zip(bad, changes, strict=True)),
        "unstable": sum(math.isinf(b[0]) and math.isfinite(a[0]) for _, a, b in changes),
        "codes": codes,
    }


def _held(cell: tuple[float, float, float, float], dt_s: float) -> HeldPlant:
    k, tau1, tau2, theta = cell
    return HeldPlant(LinearProcess(k, tuple(x for x in (tau1, tau2) if x), (), theta), dt_s)


def rows(options: argparse.Namespace) -> Iterator[dict[str, object]]:
    """Every session that is asked for, told as it ends."""
    for name in options.plants:
        plant = PLANTS[name]
        for start in options.starts:
            for seed in range(options.seed, options.seed + options.sessions):
                fixed = session(plant, start, seed, "fixed")["iae"]
                for how in options.how:
                    row = {"plant": name, **session(plant, start, seed, how)}
                    row["iae over start"] = [round(a / b, 2) for a, b in zip(row.pop("iae"), fixed, strict=True)]
                    sys.stdout.write(f"{_short(row)}\n")
                    sys.stdout.flush()
                    yield row


def _short(row: dict[str, object]) -> str:
    ms = [" ".join(f"{x:.2f}" for x in row[key]) for key in ("ms first", "ms")]
    return (
        f"{row['plant']:<16}{row['start']:<11}{row['seed']:>4} {row['how']:<9} Ms {ms[0]} -> {ms[1]}"
        f"  IAE x {row['iae over start']}  changes {row['changes']} restored {row['restored']} bad {row['bad']}"
        f"+{row['bad restored']} unstable {row['unstable']}{'  LOST' if row['lost'] else ''}  {row['codes']}"
    )


def main() -> int:
    """Run, and count by way of retuning."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sessions", type=int, default=1)
    parser.add_argument("--plants", nargs="+", choices=tuple(PLANTS), default=tuple(PLANTS))
    parser.add_argument("--starts", nargs="+", choices=tuple(STARTS), default=tuple(STARTS))
    parser.add_argument("--how", nargs="+", choices=("apart", "together"), default=("apart", "together"))
    parser.add_argument("--out", type=Path, metavar="FILE", help="every session as a line of JSON")
    options = parser.parse_args()
    found = list(rows(options))
    if options.out:
        options.out.write_text("".join(json.dumps(row) + "\n" for row in found), encoding="utf-8")
    for how in options.how:
        own = [row for row in found if row["how"] == how]
        sums = {key: sum(int(row[key]) for row in own) for key in ("changes", "restored", "bad", "unstable", "lost")}
        good = sum(max(row["ms"]) <= MS_MOST for row in own)
        worst = max(max(row["ms"]) for row in own)
        sys.stdout.write(f"{how}: {len(own)} sessions, {good} end with Ms <= {MS_MOST}, worst {worst:.2f}; {sums}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
