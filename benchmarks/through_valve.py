"""What does a setpoint step through a valve say of the process, with the valve as a hypothesis and without?

    python benchmarks/through_valve.py [--seed 1] [--loops 20] [--kind play] [--out FILE]

Loops of benchmarks/cases with gains in spec, at rest after one setpoint step, make another; between co and the process
stands a valve with play, or one that sticks (Kano 2004, He 2007, and one whose band is another at every stop). Its band
is an eighth to a half of what it travels. Beside these stand loops without a valve: with noise alone, with a load step,
a ramp, and a random walk. The table shows, of settings that follow from the linear fit and from the one that asks for a
valve (adaptive/valve/through_valve.py):

    valve     records in which one is found
    given     records that carry settings
    in spec   of these, on the true process without the valve (online/judge.py)
    Ms over   of these, Ms over its limit; and the largest Ms
    k         median of |ln| of the gain over the true one
"""

import argparse
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cases.case import FloatArray
from cases.cycling import sticking
from cases.loop import Controller, Upsets, run
from cases.processes import log_uniform
from cases.setting import Loop, draw_loop
from cases.signals import random_walk
from online.harm import SELF_REGULATING, in_spec_gains
from online.judge import Judge

from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.identification.identify import Fits, FitSettings
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.valve.through_valve import through_valve
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
VALVES = ("play", "kano", "he", "irregular")
KINDS = (*VALVES, "noise", "load", "ramp", "walk")
BEFORE, LENGTH, KEPT = 30, 60, 5
"""Effective dead times before the second step, after it, and how many of the former are kept."""
FIRST_SAMPLES, RAMP = 5, 15
"""Samples before the first step; effective dead times of a ramp."""
WALK = 0.15
"""A walk's travel in ten effective dead times, over what the step needs of co."""


def record(rng: np.random.Generator, kind: str) -> tuple[Loop, PidGains, Window]:
    """A loop, its gains and its record."""
    gains = None
    while gains is None:
        loop = draw_loop(rng, str(rng.choice(SELF_REGULATING)), (5.0, 20.0))
        gains = in_spec_gains(rng, loop)
    band = loop.room * log_uniform(rng, 0.03, 0.15)
    valve = sticking(rng, kind, band)[0](loop.co0) if kind in VALVES else None
    travel = float(rng.uniform(2.0, 8.0)) * band
    step = travel * abs(loop.process.k)
    theta = loop.theta_s / loop.dt_s
    n0, n = int(BEFORE * theta), int(LENGTH * theta)
    first = float(rng.choice([-1, 1])) * step * float(rng.uniform(0.3, 1.0))
    second = first + step * float(rng.choice([-1, 1]))
    sp = np.concatenate([np.zeros(FIRST_SAMPLES), np.full(n0, first), np.full(n, second)])
    noise = log_uniform(rng, 0.003, 0.02) * step * rng.standard_normal(len(sp))
    upsets = Upsets(sp, load=_load(rng, kind, len(sp), n, theta, travel), noise=noise)
    found = run(loop.process, Controller(gains), loop.dt_s, upsets, co0=loop.co0, valve=valve)
    kept = slice(FIRST_SAMPLES + n0 - int(KEPT * theta), None)
    return loop, gains, Window(found.t[kept], found.sp[kept], found.pv[kept], found.co[kept])


def _load(rng: np.random.Generator, kind: str, n: int, after: int, theta: float, travel: float) -> FloatArray:
    """What moves a loop without a valve, co units."""
    load = np.zeros(n)
    at = n - after + int(rng.uniform(2.0, 30.0) * theta)
    size = travel * float(rng.uniform(-1.0, 1.0))
    if kind == "load":
        load[at:] = size
    elif kind == "ramp":
        load[at:] = size * np.minimum(np.arange(n - at) / (RAMP * theta), 1.0)
    elif kind == "walk":
        load = WALK * travel * random_walk(rng, n) / math.sqrt(10 * theta)
    return load


def rows_of(kinds: tuple[str, ...], seed: int, loops: int) -> Iterator[Row]:
    """One for each record."""
    settings = FitSettings()
    for index in range(loops):
        for kind in kinds:
            loop, gains, window = record(np.random.default_rng([seed, index, KINDS.index(kind)]), kind)
            judge = Judge(loop.process, loop.dt_s, (loop.best, loop.theta_s))
            fits = Fits(window, (gains.direction,), settings)
            found = through_valve(window, gains.direction, fits, settings)
            told = {"kind": kind, "index": index, "family": loop.family, "found": found is not None}
            plain = scored(judge, fits.estimate())
            yield told | {"linear": plain, "asked": plain if found is None else scored(judge, found.fits.estimate())}


def scored(judge: Judge, estimate: ModelEstimate) -> Row:
    """Settings of an estimate on the true process, and how far its gain is from the true one."""
    if not estimate.identifiable:
        return {"given": False}
    after = judge.of(robust_simc(estimate, judge.dt_s, RobustSettings()).tuning.gains)
    k = abs(math.log(estimate.log.model().k / judge.process.k)) if estimate.log.model().tau1_s else None
    return {"given": True, "ms": after.ms, "over": after.ms > judge.ms_limit, "in_spec": after.in_spec, "k": k}


def table(rows: list[Row]) -> list[str]:
    """By kind of record."""
    lines = [f"{'':<10}{'records':>8}{'valve':>7}   {'linear: given, in spec, Ms over, k':<44}with the valve asked for"]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        of = [row for row in rows if row["kind"] == kind]
        told = [_told([row[way] for row in of]) for way in ("linear", "asked")]
        lines.append(f"{kind:<10}{len(of):>8}{sum(row['found'] for row in of):>7}   {told[0]:<44}{told[1]}")
    return lines


def _told(of: list[Row]) -> str:
    """Counts of one way."""
    given = [row for row in of if row["given"]]
    if not given:
        return "0"
    gains = [row["k"] for row in given if row["k"] is not None]
    off = f"{np.median(gains):.3f}" if gains else "-"
    worst = max(row["ms"] for row in given)
    return (
        f"{len(given)}, {sum(row['in_spec'] for row in given)}, {sum(row['over'] for row in given)} "
        f"(worst {worst:.2f}), {off}"
    )


def main() -> None:
    """Command line."""
    options = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--loops", type=int, default=20, help="of each kind")
    options.add_argument("--kind", action="append", choices=KINDS, default=[])
    options.add_argument("--out", type=Path, help="every record as a line of JSON")
    given = options.parse_args()
    rows = []
    for row in rows_of(tuple(given.kind) or KINDS, given.seed, given.loops):
        rows.append(row)
        if given.out:
            with given.out.open("a", encoding="utf-8") as out:
                out.write(json.dumps(row) + "\n")
    print("\n".join([f"setpoint steps through a valve, seed {given.seed}", *table(rows)]))


if __name__ == "__main__":
    main()
