"""A plant whose process changes with two variables at once, and how a schedule over both does on it.

    C dT/dt = POWER u (1 - T / STEAM) - w (T - COLD),   dT'/dt = (T - T') / THERMOMETER_S,   dead time PIPE / w

Material that goes through a vessel heated by steam: its flow w comes from outside, its temperature is where it is held.
The slope gain falls with T, the dead time with w, the lag with both, and that is no product of two curves.

    python benchmarks/schedules both --seed 1 --count 4
"""

import math
import sys
import time
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from cases.counting import share
from online.judge import Judge

from retuner.adaptive.process.model import LinearProcess
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains
from retuner.scheduling import ScheduleDesign, design_schedule

CAPACITY, POWER, STEAM, COLD = 2000.0, 120.0, 260.0, 20.0
PIPE, THERMOMETER_S, DT_S, NOISE = 240.0, 4.0, 2.0, 0.05
LOW, HIGH = (60.0, 6.0), (200.0, 24.0)
"""Temperature and throughput."""
VISITS, HOLD = 20, 350
"""Places visited in the record, and samples of each."""
CO_MAX = 250.0
GRID = 5
"""Places judged along each variable."""


def local(temp: float, flow: float) -> LinearProcess:
    """The linearisation at rest."""
    heat, loss = POWER * (1 - temp / STEAM), flow + POWER * rest(temp, flow) / STEAM
    return LinearProcess(heat / loss, (CAPACITY / loss, THERMOMETER_S), (), PIPE / flow)


def rest(temp: float, flow: float) -> float:
    """The output that holds a temperature."""
    return flow * (temp - COLD) / (POWER * (1 - temp / STEAM))


@dataclass(frozen=True)
class Day:
    """A record, and the throughput at its samples."""

    window: Window
    flow: np.ndarray


def day(rng: np.random.Generator) -> Day:
    """Visits all over both ranges under one poor set of gains."""
    judges = [Judge(local(*at), DT_S) for at in product((LOW[0], HIGH[0]), (LOW[1], HIGH[1]))]
    least = min((j.best for j in judges), key=lambda g: g.kp)
    tau_i = float(np.median([j.best.kp / j.best.ki for j in judges]))
    kp, ki = 0.8 * least.kp, 0.8 * least.kp / tau_i
    temps, flows = (rng.uniform(low, high, VISITS) for low, high in zip(LOW, HIGH, strict=True))
    temp = shown = float(temps[0])
    flow, load = float(flows[0]), 0.0
    integral = rest(temp, flow)
    late = [integral] * math.ceil(PIPE / LOW[1] / DT_S + 2)
    rows = []
    for i in range(VISITS * HOLD):
        visit, at = divmod(i, HOLD)
        flow += (float(flows[visit]) - flow) * DT_S / 40.0
        load = float(rng.normal(0.0, 1.5)) if at == HOLD // 2 and visit % 2 else load
        sp, pv = float(temps[visit]), shown + float(rng.normal(0.0, NOISE))
        integral += ki * (sp - pv) * DT_S
        co = min(max(kp * (sp - pv) + integral, 0.0), CO_MAX)
        integral = min(max(integral, 0.0), CO_MAX)
        rows.append((i * DT_S, sp, pv, co, flow))
        late.append(co)
        u = late[-1 - round(PIPE / flow / DT_S)] + load
        for _ in range(4):
            heat = POWER * u * (1 - temp / STEAM) - flow * (temp - COLD)
            temp += heat / CAPACITY * DT_S / 4
            shown += (temp - shown) / THERMOMETER_S * DT_S / 4
    columns = np.array(rows).T
    return Day(Window(*columns[:4]), columns[4])


def judged(found: ScheduleDesign) -> dict[str, int]:
    """Places, those in spec, those where Ms is too large, with the schedule; and those in spec with one middle set."""
    counts = {"places": 0, "spec": 0, "fast": 0, "fixed": 0}
    middle = Judge(local(*((a + b) / 2 for a, b in zip(LOW, HIGH, strict=True))), DT_S).best
    axes = [np.linspace(low, high, GRID + 2)[1:-1] for low, high in zip(LOW, HIGH, strict=True)]
    for temp, flow in product(*axes):
        judge = Judge(local(temp, flow), DT_S)
        of = judge.of(gains_at(found, temp, flow))
        counts["places"] += 1
        counts["spec"] += of.in_spec
        counts["fast"] += of.ms > judge.ms_limit
        counts["fixed"] += judge.of(middle).in_spec
    return counts


def gains_at(found: ScheduleDesign, temp: float, flow: float) -> PidGains:
    """Of the schedule, whichever variables it follows."""
    at = {"pv": temp, "sp": temp, "flow": flow}
    if found.second:
        return found.gains_at(at[found.variable], at[found.second])
    return found.gains_at(at[found.variable])


def measure(seed: int, index: int, by: tuple[str, ...]) -> dict[str, Any]:
    """One record, and the schedule along these variables."""
    made = day(np.random.default_rng([seed, index, 42]))
    begun = time.perf_counter()
    found = design_schedule(made.window, by, values={"flow": [made.flow]}, co_min=0.0, co_max=CO_MAX)
    row: dict[str, Any] = {"index": index, "by": by, "seconds": time.perf_counter() - begun, "reason": found.reason}
    row["variables"] = " and ".join(filter(None, (found.variable, found.second)))
    row["sets"] = 0 if found.table is None else len(found.table.gains)
    return row | (judged(found) if found.table is not None else {})


def tell(seed: int, count: int) -> int:
    """A line a record and way, and the sums; the exit status."""
    rows = []
    for index, by in product(range(count), (("pv", "flow"), ("pv",), ("flow",))):
        row = measure(seed, index, by)
        rows.append(row)
        places = f"{row['spec']} of {row['places']} in spec, Ms too large {row['fast']}" if row["sets"] else "no table"
        sys.stdout.write(
            f"{index} by {','.join(by)}: {row['variables']}, {row['reason']}; {places}; {row['seconds']:.0f} s\n"
        )
    for by in (("pv", "flow"), ("pv",), ("flow",)):
        some = [row for row in rows if row["by"] == by]
        told = share(sum(row.get("spec", 0) for row in some), GRID**2 * len(some))
        sys.stdout.write(f"{','.join(by):<10} {told} in spec, Ms too large {sum(row.get('fast', 0) for row in some)}\n")
    fixed = share(sum(row.get("fixed", 0) for row in rows), sum(row.get("places", 0) for row in rows))
    sys.stdout.write(f"one set     {fixed} in spec (perfect knowledge of the middle)\n")
    return 0
