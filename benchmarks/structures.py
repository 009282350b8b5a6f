"""Is a model believed as far as its structure deserves? Single records of the standard batch, each by itself.

    python benchmarks/structures.py [--seed 101] [--only P9] [--only "P8 a=0.3"] [--out FILE]

Each process runs under four sets of gains (the right ones, Kc x0.4, Kc x1.5, Kc x0.6 with tau_I x0.4), with a setpoint
step and with a load step, 1 % noise. A record is whole (60 effective dead times) or cut (20). For what may carry
settings the table shows, by process and by kind of record:

    Ku       bias and spread of ln of the ultimate gain over the true one; share within two claimed standard deviations
    k        the same share of the gain, where the process has one
    Ms       share of settings whose true Ms is over what any plausible model says (by more than 3 %), and the worst
    in spec  share of settings in spec on the true process (online/judge.py)
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cases.plant import HeldPlant
from online.astrom_hagglund import Member, batch
from online.counting import counted
from online.judge import Judge
from online.loop import FixedGains, LostLoop, WatchedLoop
from online.supervisors import one_region

from retuner.adaptive.identification.estimate import STRUCTURE_STD, ModelEstimate
from retuner.adaptive.identification.identify import identify_window
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc
from retuner.adaptive.loop.margins import sensitivity_peak, ultimate
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains

Row = dict[str, Any]
STARTS = ((1.0, 1.0), (0.4, 1.0), (1.5, 1.0), (0.6, 0.4))
"""Factors on Kc and tau_I of the right settings."""
KINDS = ("setpoint", "load")
LENGTHS = {"whole": 60.0, "cut": 20.0}
"""Of a record, in effective dead times."""
SAMPLES_PER_THETA, REST_SAMPLES, NOISE = 8, 60, 0.01
TWO_SIGMA, OVER = 2.0, 1.03


def record(judge: Judge, gains: PidGains, kind: str, length: float, rng: np.random.Generator) -> Window:
    """A step from rest under gains that nobody changes.

    Raises
    ------
    LostLoop
        The loop is unstable.
    """
    loop = WatchedLoop(HeldPlant(judge.process, judge.dt_s), one_region(gains), judge.dt_s, FixedGains())
    sp, load = (1.0, 0.0) if kind == "setpoint" else (0.0, judge.load_like_setpoint())
    noise = NOISE * rng.standard_normal(REST_SAMPLES + int(length * SAMPLES_PER_THETA))
    trace = loop.run(0.0, 0.0, noise[:REST_SAMPLES].tolist()) + loop.run(sp, load, noise[REST_SAMPLES:].tolist())
    pv, co = np.array(trace).T
    rows = np.arange(len(pv))
    return Window(judge.dt_s * rows, np.where(rows < REST_SAMPLES, 0.0, sp), pv, co)


def rows_of(members: list[tuple[int, Member]], seed: int) -> Iterator[Row]:
    """One for each record of these processes."""
    for place, member in members:
        judge = Judge(member.process, Judge.theta(member.process) / SAMPLES_PER_THETA)
        for which, (kc, tau_i) in enumerate(STARTS):
            gains = PidGains(judge.best.kp * kc, judge.best.ki * kc / tau_i)
            for (a, kind), (b, length) in ((x, y) for x in enumerate(KINDS) for y in enumerate(LENGTHS)):
                rng = np.random.default_rng([seed, place, which, a, b])
                try:
                    window = record(judge, gains, kind, LENGTHS[length], rng)
                except LostLoop:
                    continue
                named = {"process": member.name, "family": member.family, "kind": kind, "length": length}
                yield named | scored(judge, identify_window(window, 1))


def scored(judge: Judge, estimate: ModelEstimate) -> Row:
    """What an estimate claims, and what is true."""
    dt_s, log = judge.dt_s, estimate.log
    true, model = judge.process.seen_by_controller(dt_s), log.model().seen_by_controller(dt_s)

    def log_ultimate(model: ProcessModel) -> FloatArray:
        return np.log([ultimate(model.seen_by_controller(dt_s).linear())[0]])

    found: Row = {"given": estimate.identifiable, "structure": str(log.type), "loads": len(estimate.load_times_s)}
    if not estimate.identifiable:
        return found | {"reason": estimate.reason}
    gains = robust_simc(estimate, dt_s, RobustSettings()).tuning.gains
    after = judge.of(gains)
    plausible = [p.model.seen_by_controller(dt_s).linear() for p in estimate.plausible]
    has_gain = not judge.process.integrators and bool(model.tau1_s)
    return found | {
        "ku": float(log_ultimate(log.model())[0]) - math.log(ultimate(true)[0]),
        "ku_std": math.hypot(math.sqrt(float(log.covariance_of(log_ultimate)[0, 0])), STRUCTURE_STD),
        "k": math.log(model.k / true.k) if has_gain else None,
        "k_std": log.std()["k"] / abs(model.k),
        "ms": after.ms,
        "ms_most": max(sensitivity_peak(process, gains) for process in plausible),
        "j": after.j,
        "in_spec": after.in_spec,
    }


def within(rows: list[Row], name: str) -> str:
    """Share within two claimed standard deviations."""
    of = [row for row in rows if row[name] is not None]
    return counted(sum(abs(row[name]) < TWO_SIGMA * row[f"{name}_std"] for row in of), len(of)) if of else "-"


def line(name: str, rows: list[Row]) -> str:
    """A row of the table."""
    given = [row for row in rows if row["given"]]
    if not given:
        return f"{name:<22} {len(rows)} records, none given"
    ku = np.array([row["ku"] for row in given])
    over = sum(row["ms"] > OVER * row["ms_most"] for row in given)
    return (
        f"{name:<22} {len(rows)} records, {len(given)} given\n"
        f"    Ku bias {np.median(ku):+.2f} spread {np.std(ku):.2f}, within {within(given, 'ku')}; k within "
        f"{within(given, 'k')}\n"
        f"    Ms over all that is plausible {over}, worst {max(row['ms'] for row in given):.2f}; in spec "
        f"{counted(sum(row['in_spec'] for row in given), len(given))}"
    )


def table(rows: list[Row]) -> list[str]:
    """By process, and by kind and length of the records."""
    keys: list[Callable[[Row], str]] = [lambda r: f"{r['kind']}, {r['length']}", lambda r: str(r["process"])]
    found = [line("all", rows)]
    for key in keys:
        found += [line(name, [row for row in rows if key(row) == name]) for name in dict.fromkeys(map(key, rows))]
    return found


def main() -> None:
    """Command line."""
    options = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    options.add_argument("--seed", type=int, default=101)
    options.add_argument("--only", action="append", default=[], help='processes whose name begins so: "P9", "P8 a=0.3"')
    options.add_argument("--out", type=Path, help="every record as a line of JSON")
    given = options.parse_args()
    chosen = [(i, m) for i, m in enumerate(batch()) if not given.only or m.name.startswith(tuple(given.only))]
    rows = list(rows_of(chosen, given.seed))
    if given.out:
        given.out.write_text("".join(json.dumps(row) + "\n" for row in rows))
    print("\n".join(table(rows)) if rows else "no process of that name")


if __name__ == "__main__":
    main()
