"""How well controller settings are read off closed-loop records, from a seed; and off recorded loops in a folder.

    python benchmarks/settings_in_force.py [--cases 60] [--seed 11] [--folder FOLDER]

A PI or PID of random gains, filter, setpoint weight and direction holds a lag with dead time through setpoint steps, a
load step and noise. Each case is recorded in several ways: as the law ran (every sample), with co rounded to 0.1, with
every tenth sample of a controller ten times as fast, the same with pv filtered by the recorder, with pv read later than
co, and compressed with an exception deviation. Printed per way: records with settings, median and 90 % quantile of the
error of kp and ki, share within two standard deviations.

FOLDER holds CSV files with t, sp, pv, co; printed is what is read off each. Repeated time stamps are dropped.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from retuner.adaptive.controller_settings.read_off import SettingsInForce, settings_in_force
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains
from retuner.schedule.pid import law, start, step

FAST = 10  # Samples of the fast controller per recorded one
Columns = np.ndarray


def ran(rng: np.random.Generator, gains: PidGains, n: int, lag: float, b: float, tau_f_s: float) -> Columns:
    """One loop at one sample a second: columns t, sp, pv, co, shape (n, 4)."""
    rules = law(gains, b=b, tau_f_s=tau_f_s)
    theta = max(round(lag * rng.uniform(0.05, 0.3)), 1)
    k = rng.uniform(0.2, 0.6) * lag / theta / 2 / gains.kp
    noise, load = rng.choice([0.02, 0.1, 0.3]), rng.uniform(-5, 5)
    pv, under_way, state = 50.0, [50.0] * theta, start(rules, 50.0, 50.0, 50.0)
    steps = 50 + rng.uniform(-1, 1, size=4) * min(8.0, 15 / abs(gains.kp))
    rows = np.zeros((n, 4))
    for i in range(n):
        sp, seen = steps[i * 4 // n], pv + noise * rng.normal()
        state, co = step(rules, state, sp, seen, 1.0)
        rows[i] = i, sp, seen, co
        under_way.append(co)
        pv += (50 - pv + k * (under_way.pop(0) - 50) + (load if i > 0.6 * n else 0.0)) / lag
    return rows


def filtered(pv: np.ndarray, samples: float) -> np.ndarray:
    out = pv.copy()
    for i in range(1, len(pv)):
        out[i] = out[i - 1] + (pv[i] - out[i - 1]) / (1 + samples)
    return out


def compressed(x: np.ndarray, deviation: float) -> np.ndarray:
    """Kept where it has moved by the deviation, straight lines between."""
    kept = [0]
    for i in range(1, len(x)):
        if abs(x[i] - x[kept[-1]]) > deviation:
            kept += [i - 1, i]
    kept = sorted({*kept, len(x) - 1})
    return np.interp(np.arange(len(x)), kept, x[kept])


def every(rows: Columns, late: int = 0) -> Columns:
    """Every tenth sample, pv read so many fast samples later than co."""
    thin = rows[: len(rows) - FAST : FAST].copy()
    thin[:, 2] = rows[late::FAST, 2][: len(thin)]
    return thin


def with_pv(rows: Columns, pv: np.ndarray) -> Columns:
    """The same record with another pv."""
    return np.column_stack([rows[:, :2], pv, rows[:, 3]])


WAYS: dict[str, tuple[bool, Callable[[Columns], Columns]]] = {
    "every sample": (False, lambda r: r),
    "co rounded to 0.1": (False, lambda r: np.column_stack([r[:, :3], np.round(r[:, 3], 1)])),
    "every tenth sample": (True, every),
    "pv filtered, tenth": (True, lambda r: every(with_pv(r, filtered(r[:, 2], 5.0)))),
    "pv read later, tenth": (True, lambda r: every(r, late=4)),
    "compressed, tenth": (True, lambda r: with_pv(every(r), compressed(every(r)[:, 2], 0.1))),
}
"""Name, whether the controller is ten times as fast, and what becomes of its record."""


def drawn(rng: np.random.Generator, fast: bool) -> tuple[PidGains, Columns]:
    scale = FAST if fast else 1
    kp, sign = 10 ** rng.uniform(-0.7, 0.7), rng.choice([1, -1])
    lag = scale * rng.uniform(10, 40)
    tau_i = lag * rng.uniform(0.5, 2)
    tau_d = rng.choice([0.0, lag * rng.uniform(0.1, 0.2)])
    gains = PidGains(sign * kp, sign * kp / tau_i, sign * kp * tau_d)
    return gains, ran(rng, gains, 800 * scale, lag, rng.choice([0.0, 0.6, 1.0]), tau_d * rng.uniform(0.1, 1))


def told(name: str, found: list[tuple[PidGains, SettingsInForce]]) -> str:
    sure = [(true, s, s.gains) for true, s in found if s.gains is not None]
    if not sure:
        return f"{name:<22} none of {len(found)}"
    errors = np.array([[abs(g.kp / true.kp - 1), abs(g.ki / true.ki - 1)] for true, _, g in sure])
    within = [abs(g.kp - true.kp) < 2 * s.std["kp"] and abs(g.ki - true.ki) < 2 * s.std["ki"] for true, s, g in sure]
    (kp, ki), (kp90, ki90) = np.quantile(errors, [0.5, 0.9], axis=0)
    return (
        f"{name:<22} {len(sure):>4}/{len(found):<4} {kp:8.2%} {kp90:8.2%} {ki:8.2%} {ki90:8.2%} {np.mean(within):7.0%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    print(f"seed {options.seed}, {options.cases} records each; errors are medians and 90 % quantiles")
    print(f"{'recorded':<22} {'told':>9} {'kp':>8} {'kp 90%':>8} {'ki':>8} {'ki 90%':>8} {'2 sigma':>7}")
    for number, (name, (fast, recorded)) in enumerate(WAYS.items()):
        rng = np.random.default_rng([options.seed, number])
        found = []
        for _ in range(options.cases):
            gains, rows = drawn(rng, fast)
            found.append((gains, settings_in_force(Window(*recorded(rows).T.copy()), 0, 100)))
        print(told(name, found), flush=True)
    if options.folder is not None:
        found = {}
        for path in sorted(options.folder.glob("*.csv")):
            with path.open(encoding="utf-8") as stream:
                rows = list(csv.DictReader(stream))
            if not rows or not {"t", "sp", "pv", "co"} <= set(rows[0]):
                continue
            columns = np.array([[float(row[name]) for name in ("t", "sp", "pv", "co")] for row in rows])
            columns = columns[np.concatenate([[True], np.diff(columns[:, 0]) > 0])]
            found[path.name] = settings_in_force(Window(*columns.T.copy()))
        for name, s in found.items():
            if s.gains is not None:
                g, spread = s.gains, s.std["kp"] / abs(s.gains.kp or 1.0)
                tau_i = f"{g.kp / g.ki:8.4g} s" if g.ki else "      none"
                print(f"{name:<26} Kc {g.kp:9.4g} +-{spread:4.0%}  tau_I {tau_i}  {s.explained:6.1%}")
            else:
                print(f"{name:<26} {s.reason}")
        sure, signs = (
            sum(x is not None for x in values)
            for values in ([s.gains for s in found.values()], [s.direction for s in found.values()])
        )
        print(f"settings: {sure} of {len(found)}; direction: {signs} of {len(found)}")


if __name__ == "__main__":
    main()
