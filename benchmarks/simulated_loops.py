"""Loops as users simulate them, with no noise or little: what does `diagnose` say of linear ones, and of true valves?

    python benchmarks/simulated_loops.py --seed 12320 --cases 200 [--only valve]

One lag, two, an integrator, or one with a lag, by Euler's rule; dead time 0 to 40 samples; PI, PID, or P on pv alone.
Setpoint steps or a ramp, load steps, a load that wanders by 0 to 0.05 a sample; noise 0 to 0.01, of a setpoint step
of 1. A linear loop is right where its tuning is told as its Ms has it (near the limits either is), wrong where a valve
or a gain that bends is named; a valve that slips to co or has play, in the same loops, is to be named.
"""

import argparse
import math
from collections import Counter
from collections.abc import Callable

import numpy as np
from world.process import FREQUENCIES, FloatArray, TrueProcess

from retuner import PidGains, diagnose

NOISES, WALKS, DEADS = (0.0, 1e-6, 1e-4, 1e-3, 1e-2), (0.0, 0.005, 0.02, 0.05), (0, 1, 2, 4, 7, 12, 20, 40)
LOOSE, TIGHT = 1.65, 2.15  # Ms below which a loop is not tight, and above which it is
INTEGRATED = 20.0  # samples in which a load moves an integrator by itself
MOVES = 4  # of a valve, at least, for a record to show it


def peak(process: TrueProcess, gains: PidGains) -> float:
    """Ms, infinite where the loop is unstable."""
    s = 1j * FREQUENCIES
    loop = process.response(FREQUENCIES) * (gains.kp + gains.ki / s + gains.kd * s)
    phase = np.unwrap(np.angle(loop))
    falls = np.flatnonzero((phase[:-1] > -math.pi) & (phase[1:] <= -math.pi))
    stable = phase[0] > -math.pi and all(abs(loop[falls]) < 1.0)
    return float(np.max(1.0 / np.abs(1.0 + loop))) if stable else math.inf


def drawn_loop(rng: np.random.Generator) -> tuple[TrueProcess, PidGains]:
    """A process and settings for it, from far too slow to too tight."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    kind, lag = str(rng.choice(["one lag", "two lags", "integrating", "integrating lag"])), between(4.0, 60.0)
    theta, integrates = float(rng.choice(DEADS)), kind.startswith("integrating")
    lags = {"one lag": (lag,), "two lags": (lag, lag * rng.uniform(0.1, 0.7)), "integrating": ()}.get(kind, (lag / 4,))
    process = TrueProcess(kind, between(0.3, 3.0) / (lag if integrates else 1.0), lags, theta, integrates)
    late = theta + 1.0 + sum(lags[0 if integrates else 1 :]) / 2
    slow = late * between(0.4, 4.0)
    kp = (1.0 if integrates else lag) / (process.k * (slow + late))
    ti = min(math.inf if integrates else lag, 4 * (slow + late)) * between(0.7, 1.8)
    return process, PidGains(kp, kp / ti, kp * late / 4 if rng.random() < 1 / 3 else 0.0)


def simulated(
    process: TrueProcess, gains: PidGains, sp: FloatArray, load: FloatArray, noise: FloatArray,
    valve: Callable[[float, float], float], *, on_pv: bool,
) -> tuple[FloatArray, FloatArray, int]:  # fmt: skip
    """pv and co from rest, and how often the valve moved. valve : where it goes, of co and where it stood. on_pv : P
    and D act on pv alone.
    """
    pv, co, at = np.zeros(len(sp)), np.zeros(len(sp)), np.zeros(len(sp))
    x, total, before, dead = [0.0] * (len(process.lags) + process.integrates), 0.0, 0.0, int(process.theta)
    for i in range(len(sp)):
        pv[i] = x[-1] + noise[i]
        error, shown = sp[i] - pv[i], -pv[i] if on_pv else sp[i] - pv[i]
        total += gains.ki * error
        co[i] = gains.kp * shown + total + gains.kd * (shown - before)
        before, at[i] = shown, valve(co[i], at[i - 1])
        u = process.k * ((at[i - dead] if i >= dead else 0.0) + load[i])
        for j, lag in enumerate(process.lags):
            x[j] += (u - x[j]) / lag
            u = x[j]
        if process.integrates:
            x[-1] += u
    return pv, co, int(np.count_nonzero(np.diff(at)))


def moving(kind: str, band: float) -> Callable[[float, float], float]:
    """A valve that slips all the way once co is a band away, or one with play."""
    if kind == "slips":
        return lambda co, at: co if abs(co - at) > band else at
    return lambda co, at: min(max(at, co - band / 2), co + band / 2)


def told(seed: int, index: int, only: str) -> tuple[str, float, str, str] | None:
    """What is true (Ms, or a valve), the noise, the cause told and whether that is right; None for no such record."""
    rng = np.random.default_rng([seed, index])
    (process, gains), n = drawn_loop(rng), int(rng.integers(300, 801))
    noise, walk, sort = float(rng.choice(NOISES)), float(rng.choice(WALKS)), int(rng.integers(4))
    kind = ("slips", "play")[int(rng.integers(2))]
    with_valve, on_pv = only == "valve" or (not only and rng.random() < 1 / 3), bool(rng.random() < 0.25)
    rows, ms = np.arange(n), peak(process, gains)
    sp = (rows > n // 8) - (rows > 5 * n // 8) * (sort == 1) * 1.0 if sort < 2 else np.clip((rows - 40) / 80, 0, 1)
    sp, step = (sp, 0.0) if sort < 3 else (np.zeros(n), 1.0)
    load = (np.cumsum(rng.standard_normal(n)) * walk - step * (rows > n // 3)) / process.k
    load /= INTEGRATED if process.integrates else 1.0
    given = process, gains, np.asarray(sp, float), load, noise * rng.standard_normal(n)
    pv, co, _ = simulated(*given, lambda co, _: co, on_pv=on_pv)
    if not 1.02 < ms < 5.0 or np.ptp(pv) > 100.0:
        return None
    if with_valve:
        band = float(np.ptp(co)) * rng.uniform(0.15, 0.5)
        pv, co, moves = simulated(*given, moving(kind, band), on_pv=on_pv)
        if moves < MOVES or not np.ptp(pv) < 100.0:
            return None
    cause = str(diagnose(rows * 1.0, sp, pv, co, gains=gains).cause)
    tight = {"aggressive", "slow_integrating"} if ms > LOOSE else set[str]()
    right = {"stiction"} if with_valve else tight | ({"ok", "sluggish"} if ms < TIGHT else set())
    name = "right" if cause in right else "valve or bend" if cause in {"stiction", "nonlinear"} else "else"
    drawn = f"{process.kind}, dead time {process.theta:.0f}, noise {noise:.0e}, walk {walk}"
    print(f"{index}: {f'valve {kind}' if with_valve else f'Ms {ms:.2f}'}, {drawn}: {cause}, {name}", flush=True)
    return ("valve" if with_valve else "linear"), noise, cause, name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--only", choices=("", "valve", "linear"), default="")
    asked = parser.parse_args()
    each = [one for i in range(asked.cases) if (one := told(asked.seed, i, asked.only)) is not None]
    for what in ("linear", "valve"):
        for noise in NOISES:
            these = [one for one in each if one[0] == what and one[1] == noise]
            print(what, f"noise {noise:.0e}", len(these), dict(Counter(one[3] for one in these)))


if __name__ == "__main__":
    main()
