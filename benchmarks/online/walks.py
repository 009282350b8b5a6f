"""Random walks of the setpoint over a process whose gain, lags and dead time change with pv by a factor of 4 each.

pv runs over 0 to 100. Gain, lags and dead time each grow or shrink by 4 from end to end (varying.py), the direction of
each drawn. The setpoint goes to a new random place every HOLD_THETA dead times of the middle of the range, up to
FARTHEST away; noise is 0.1. Four regions along pv, equally wide. All watch the same walk with the same noise:

fixed        SIMC with perfect knowledge of the middle of the range, everywhere
relay once   relay experiment in the middle, Ziegler-Nichols, everywhere
simc once    step experiment in the middle, identified, SIMC, everywhere
table once   a step experiment in the centre of each region, identified, SIMC: a table tuned once
pattern      the pattern rule alone, a table that starts as fixed
retuner      retuner, a table that starts as fixed; default limits
perfect      a table of SIMC with perfect knowledge of each region's centre

Judged are the IAE (noise aside) over that of the perfect table, in the first and in the last third of the walk, and the
share of setpoints at which the gains in force are in spec on the process linearised there.
"""

import math
import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np
from cases.processes import log_uniform

from online.counting import counted
from online.judge import Judge
from online.loop import FixedGains, LostLoop, Supervisor, WatchedLoop
from online.rivals import PatternAlone, relay_then_ziegler_nichols, step_then_simc
from online.supervisors import Watching, settings
from online.varying import Local, Range, VaryingPlant
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import Regions
from retuner.schedule.table import GainTable

Row = dict[str, Any]
WHO = ("fixed", "relay once", "simc once", "table once", "pattern", "retuner", "perfect")
NAMES = ("low", "lower", "upper", "high")
CENTRES = (12.5, 37.5, 62.5, 87.5)
SETPOINTS = 60
HOLD_THETA = 80.0
SAMPLES_PER_THETA = 10
"""Of the dead time in the middle of the range: 5 to 20 over the range."""
FARTHEST = 20.0
NOISE = 0.1
TEST_STEP = 5.0
"""Size of pv's move in an experiment."""


@dataclass(frozen=True, slots=True)
class Task:
    """One process and walk."""

    seed: int
    index: int
    setpoints: int = SETPOINTS


def tasks(seed: int, count: int, setpoints: int = SETPOINTS) -> list[Task]:
    """The first `count` walks."""
    return [Task(seed, index, setpoints) for index in range(count)]


@dataclass(frozen=True, slots=True)
class Walk:
    """What all see: the process, the setpoints, the noise of each hold, and the judges at the setpoints."""

    process: Range
    dt_s: float
    sps: list[float]
    noise: list[list[float]]
    judges: list[Judge]

    @staticmethod
    def drawn(task: Task) -> "Walk":
        """From its seed."""
        rng = np.random.default_rng([task.seed, task.index, 30])
        scale = 10 ** rng.uniform(-1, 2)
        tau1 = log_uniform(rng, 0.7, 15.0)
        tau2 = tau1 * log_uniform(rng, 0.05, 0.5) if rng.uniform() < 0.5 else 0.0
        signs = tuple(int(rng.choice([-1, 1])) for _ in range(3))
        k = float(rng.choice([-1, 1])) * log_uniform(rng, 0.5, 5.0)
        process = Range(Local(k, tau1 * scale, tau2 * scale, scale), (signs[0], signs[1], signs[2]))
        dt_s, sps = scale / SAMPLES_PER_THETA, [float(rng.uniform(10, 90))]
        while len(sps) < task.setpoints:
            sp = sps[-1] + float(rng.uniform(4, FARTHEST)) * float(rng.choice([-1, 1]))
            sps += [sp] if 5 <= sp <= 95 else []
        n = int(HOLD_THETA * SAMPLES_PER_THETA)
        noise = [(NOISE * rng.standard_normal(n)).tolist() for _ in sps]
        return Walk(process, dt_s, sps, noise, [Judge(process.at(sp).linear(), dt_s) for sp in sps])

    def plant(self, y0: float) -> VaryingPlant:
        """At rest at y0."""
        return VaryingPlant(self.process.at, self.process.rest, self.dt_s, y0)

    def best(self, y: float) -> PidGains:
        """SIMC with perfect knowledge at y."""
        return Judge(self.process.at(y).linear(), self.dt_s).best


def table_of(gains: list[PidGains]) -> GainTable:
    """Four regions along pv."""
    return GainTable("loop", Regions("pv", "%", NAMES, 0.0, (25.0, 50.0, 75.0), 100.0, 0.5), tuple(gains))


def run(task: Task) -> Row:
    """One walk under everybody; per name iae (a value a setpoint), spec, changes, lost."""
    walk = Walk.drawn(task)
    rng = np.random.default_rng([task.seed, task.index, 31])
    fixed = walk.best(50.0)
    relay = relay_then_ziegler_nichols(
        walk.plant(50.0), walk.process.at(50.0).linear(), walk.dt_s, NOISE, rng, TEST_STEP
    )
    tested = [_tested(walk, y, rng) or fixed for y in (50.0, *CENTRES)]
    same = [fixed] * len(NAMES)
    wanted = settings(walk.dt_s, 100.0)
    starts: dict[str, tuple[list[PidGains], Supervisor]] = {
        "fixed": (same, FixedGains()),
        "relay once": ([relay or fixed] * len(NAMES), FixedGains()),
        "simc once": (tested[:1] * len(NAMES), FixedGains()),
        "table once": (tested[1:], FixedGains()),
        "pattern": (same, PatternAlone(table_of(same), wanted)),
        "retuner": (same, Watching(table_of(same), wanted)),
        "perfect": ([walk.best(y) for y in CENTRES], FixedGains()),
    }
    found = {who: walked(walk, table_of(gains), supervisor) for who, (gains, supervisor) in starts.items()}
    return {
        "part": "walks",
        "seed": task.seed,
        "index": task.index,
        "signs": list(walk.process.signs),
        "tau1": walk.process.middle.tau1_s / walk.process.middle.theta_s,
        "who": found,
    }


def _tested(walk: Walk, y: float, rng: np.random.Generator) -> PidGains | None:
    """SIMC from a step experiment at y."""
    linear = walk.process.at(y).linear()
    theta = Judge.theta(linear)
    return step_then_simc(walk.plant(y), linear, theta, walk.dt_s, NOISE, rng, TEST_STEP)


def walked(walk: Walk, table: GainTable, supervisor: Supervisor) -> dict[str, Any]:
    """The walk under one of them."""
    loop = WatchedLoop(
        walk.plant(walk.sps[0]),
        table,
        walk.dt_s,
        supervisor,
        co0=walk.process.rest(walk.sps[0]),
        sp0=walk.sps[0],
        lost=1e4,
    )
    iae: list[float] = []
    spec: list[bool] = []
    for sp, noise, judge in zip(walk.sps, walk.noise, walk.judges, strict=True):
        try:
            trace = loop.run(sp, 0.0, noise)
        except LostLoop:
            break
        iae.append(sum(abs(sp - pv + more) for (pv, _), more in zip(trace, noise, strict=True)) * walk.dt_s)
        spec.append(judge.of(loop.gains).in_spec)
    missing = len(walk.sps) - len(iae)
    return {
        "iae": iae + [math.inf] * missing,
        "spec": spec + [False] * missing,
        "changes": loop.changes,
        "lost": missing > 0,
    }


def line(row: Row) -> str:
    """A walk for people: IAE over the perfect table's in the last third, share in spec there."""
    parts = [f"{who} {_ratio(row, who, 2):.2f} {_share(row, who, 2):.0%}" for who in WHO if who != "perfect"]
    return f"{row['index']:>3} signs {row['signs']} tau1/theta {row['tau1']:.1f}: " + "; ".join(parts)


def _third(values: list[Any], part: int) -> list[Any]:
    """A third of the setpoints (the first, where the loop starts at rest, left out); all of them for -1."""
    n = (len(values) - 1) // 3
    return values[1:] if part < 0 else values[1 + part * n : 1 + (part + 1) * n]


def _ratio(row: Row, who: str, part: int) -> float:
    iae, perfect = (sum(_third(row["who"][name]["iae"], part)) for name in (who, "perfect"))
    return iae / perfect


def _share(row: Row, who: str, part: int) -> float:
    spec = _third(row["who"][who]["spec"], part)
    return sum(spec) / len(spec)


def table(rows: list[Row]) -> list[str]:
    """A line a competitor."""
    lines = [
        f"{len(rows)} walks of {len(rows[0]['who']['fixed']['spec'])} setpoints",
        f"{'':<12}{'IAE over the perfect table: first, last third':>48}{'worst':>8}{'lost':>6}"
        f"{'changes':>9}   in spec, last third",
    ]
    for who in WHO:
        first, last = (statistics.median(_ratio(row, who, part) for row in rows) for part in (0, 2))
        worst = max(_ratio(row, who, 2) for row in rows)
        spec = [ok for row in rows for ok in _third(row["who"][who]["spec"], 2)]
        changes = sum(row["who"][who]["changes"] for row in rows) / len(rows)
        lost = sum(row["who"][who]["lost"] for row in rows)
        lines.append(
            f"{who:<12}{first:>40.2f}{last:>8.2f}{worst:>8.2f}{lost:>6}{changes:>9.1f}   "
            f"{counted(sum(spec), len(spec))}"
        )
    return lines
