"""A loop of the world with real loads: known process, known tuning, loads and setpoints of other real loops.

class        in order (Ms up to 1.75, half of them calmer still), sluggish (Kc x 0.1 to 0.22), aggressive (gain
             margin 1.12 to 1.45), or a valve that sticks and makes the mean error at least a quarter larger
load         a piece of the co of a real loop, stretched by 0.5 to 1.5, at the process input
noise        0.2 to 6 % of pv's span; pv and co quantised in 7 of 10
setpoint     real: a piece of a real one in 6 of 10; none; step4, step8: one step out and back of 4 or 8 times the
             standard deviation that the load gives pv; bends: three steps of 4 one after another and back, in a loop
             in order whose process gain is 2.5 to 6 times larger at one end of pv than at the other
"""

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from world.historian import kept
from world.process import FloatArray, TrueProcess, drawn_process, margins, simc, simulated

CLASSES = ("ok", "sluggish", "aggressive", "stiction")
SETS = {"real": 0, "none": 1, "step4": 4, "step8": 8, "bends": 12}
BENDS = "nonlinear"  # The cause of every loop of the set bends
SAMPLES, DT_S = 751, 10.0
TRIES = 80
MOST_EVERY, SLOW = 8.0, 0.7
"""Where a historian keeps the record: samples of the controller from row to row, at most; share of loads that are as
slow as they were recorded, by rows.
"""
CALM = 1.76  # The largest Ms of a loop that is in order, sluggish, or behind a valve


@dataclass(frozen=True, slots=True)
class WorldCase:
    """A record with its truth.

    cause : one of CLASSES. kc, tau_i : in samples. ms : of them. tag : the load's loop. scene : what it was drawn with.
    """

    cause: str
    process: TrueProcess
    kc: float
    tau_i: float
    ms: float
    tag: str
    t: FloatArray
    sp: FloatArray
    pv: FloatArray
    co: FloatArray
    scene: "Scene"


@dataclass(frozen=True, slots=True)
class Scene:
    """What stays from record to record: noise, steps of the recorded pv and co, the valve's band, the load's source,
    and how many samples of the controller pass from row to row.
    """

    noise: float
    steps: tuple[float, float]
    band: float
    sign: int
    source: FloatArray
    every: int = 1

    @property
    def interval_s(self) -> float:
        """The controller's."""
        return DT_S / self.every


@lru_cache(maxsize=4)
def real_loops(folder: str, fold: int | None) -> tuple[tuple[str, FloatArray, FloatArray], ...]:
    """Tag, setpoint and output of every record that moves; of every second tag, where a fold (0, 1) is given."""
    with (Path(folder) / "index.csv").open() as index:
        rows = list(csv.DictReader(index))
    tags = sorted({row["tag"] for row in rows})
    kept = tags if fold is None else tags[fold::2]
    found = []
    for row in rows:
        if row["tag"] in kept:
            table = np.genfromtxt(Path(folder) / row["file"], delimiter=",", names=True)
            whole = np.all([np.isfinite(table[name]) for name in ("sp", "pv", "co")], axis=0)
            if np.std(table["co"][whole]) > 0:
                found.append((row["tag"], table["sp"][whole], table["co"][whole]))
    return tuple(found)


def piece(rng: np.random.Generator, x: FloatArray, samples: int = SAMPLES, slower: int = 1) -> FloatArray:
    """A piece of a signal, stretched by 0.5 to 1.5, times slower, from zero; what is too short goes on backwards."""
    stretch = slower * rng.uniform(0.5, 1.5)
    length = int(samples / stretch) + 2
    while len(x) < length:
        x = np.concatenate([x, x[::-1]])
    first = int(rng.integers(0, len(x) - length + 1))
    found = np.interp(np.arange(samples) / stretch, np.arange(length), x[first : first + length])
    return np.asarray(found - found[0], dtype=np.float64)


def where(meets: Callable[[float], bool], start: float) -> float:
    """The largest gain that meets a condition; nan where none does. Too little gain may fail it as too much does."""
    return next((kc for kc in start * np.logspace(1.5, -2.0, 300) if meets(kc)), math.nan)


def settings(rng: np.random.Generator, process: TrueProcess, cause: str) -> tuple[float, float]:
    start, tau_i = simc(process)
    tau_i *= rng.uniform(0.8, 1.3)
    limit = rng.uniform(1.5, 1.75)
    good = where(lambda kc: margins(process, kc, tau_i)[0] < limit, start)
    if cause == "sluggish":
        weak = rng.uniform(0.1, 0.22)  # an integral time that stays makes a slow swing of an integrating process
        return good * weak, tau_i / weak if process.integrates else tau_i
    if cause == "aggressive":
        margin = rng.uniform(1.12, 1.45)
        return where(lambda kc: margins(process, kc, tau_i)[1] > margin, start), tau_i
    return good * (rng.uniform(0.55, 1.0) if rng.random() < 0.5 else 1.0), tau_i


def setpoint(
    rng: np.random.Generator, kind: str, std: float, loops: tuple[tuple[str, FloatArray, FloatArray], ...], n: int
) -> FloatArray:
    """The setpoint of a set, n samples. std : of pv under the load."""
    sp = np.zeros(n)
    if kind == "bends":
        levels = np.repeat([0, 1, 2, 3, 2, 1, 0, 1], -(-n // 8))[:n]
        sp = levels * 4.0 * std * (1 if rng.random() < 0.5 else -1)
    elif SETS[kind] > 1:
        first = int(rng.integers(n // 8, n // 3))
        last = first + int(rng.integers(n // 5, n // 2))
        sp[first:last] = SETS[kind] * std * (1 if rng.random() < 0.5 else -1)
    elif kind == "real" and rng.random() < 0.6:
        moved = piece(rng, loops[int(rng.integers(len(loops)))][1], n, n // SAMPLES)
        if np.std(moved) > 0:
            sp = moved / np.std(moved) * std * np.exp(rng.uniform(np.log(0.3), np.log(3.0)))
    return sp


def drawn(
    seed: int, index: int, kind: str, folder: str, fold: int | None = None, *, historian: bool = False
) -> WorldCase:
    """One loop of a set. historian : its record as a historian keeps it.

    Raises RuntimeError: none could be drawn in TRIES.
    """
    rng = np.random.default_rng([seed, index, SETS[kind]])
    cause, loops = BENDS if kind == "bends" else CLASSES[index % len(CLASSES)], real_loops(folder, fold)
    for _ in range(TRIES):
        every = round(math.exp(rng.uniform(0.0, math.log(MOST_EVERY)))) if historian else 1
        found = _tried(rng, cause, kind, loops, every)
        if found is not None:
            return kept_by_historian(found, rng) if historian else found
    raise RuntimeError(f"seed {seed}, case {index}: no loop of class {cause} could be drawn")


def kept_by_historian(case: WorldCase, rng: np.random.Generator) -> WorldCase:
    """The same with pv and co as a historian gives them back."""
    pv, co = kept(rng, case.pv, case.co)
    return replace(case, pv=pv, co=co)


def _tried(
    rng: np.random.Generator, cause: str, kind: str, loops: tuple[tuple[str, FloatArray, FloatArray], ...], every: int
) -> WorldCase | None:
    """One try; None where the loop is not of its class, the load is still, or the valve does not matter.

    every : samples of the controller of which one is recorded.
    """
    n, coarse = SAMPLES * every, 0.7 if every == 1 else 0.1
    process = drawn_process(rng)
    gains = settings(rng, process, cause)
    ms = margins(process, *gains)[0]
    tag, _, co = loops[int(rng.integers(len(loops)))]
    load, rest = piece(rng, co, n, every if every > 1 and rng.random() < SLOW else 1), np.zeros(n)
    if not np.isfinite(ms) or (cause != "aggressive" and ms > CALM) or np.std(load) == 0:
        return None
    sign = 1 if rng.random() < 0.5 else -1
    source, load = sign * co / np.std(load), sign * load / np.std(load)
    std = float(np.std(simulated(process, gains, (rest, load, rest))[0]))
    sp = setpoint(rng, kind, std, loops, n)
    pv, co = simulated(process, gains, (sp, load, rest))
    if cause == BENDS:
        # A process whose gain is 2.5 to 6 times larger at one end of a linear loop's pv than at the other; that of pv
        # = 0 stays
        ratio = math.exp(rng.uniform(math.log(2.5), math.log(6.0)))
        low, high = (float(np.min(pv)), float(np.max(pv)))[:: 1 if rng.random() < 0.5 else -1]
        below, above = min(low / (high - low), 0.0), max(high / (high - low), 1.0)  # pv = 0 lies between
        share = (ratio - 1.0) / (above - ratio * below)
        process = replace(process, bend=share / (high - low))
        pv, co = simulated(process, gains, (sp, load, rest))
    spans = float(np.ptp(pv)), float(np.ptp(co))
    noise_std = spans[0] * float(np.exp(rng.uniform(np.log(0.002), np.log(0.06))))
    noise = rng.normal(size=n) * noise_std
    steps = [s * np.exp(rng.uniform(np.log(0.001), np.log(0.02))) if rng.random() < coarse else 0.0 for s in spans]
    signals, recorded = (sp, load, noise), (float(steps[0]), float(steps[1]))
    pv, co = simulated(process, gains, signals, 0.0, recorded)
    band = 0.0
    if cause == "stiction":
        free = float(np.mean(np.abs(pv - sp)))
        band = spans[1] * rng.uniform(0.15, 0.8)
        pv, co = simulated(process, gains, signals, band, recorded)
        if not np.mean(np.abs(pv - sp)) >= 1.25 * free:
            return None
    if not np.all(np.isfinite(pv)) or np.std(pv) > 100 * std:
        return None
    t = np.arange(SAMPLES) * DT_S
    scene = Scene(noise_std, recorded, band, sign, source, every)
    late = int(rng.integers(every)) if every > 1 else 0
    sp, pv, co = (x[::every] + 50.0 for x in (sp, pv, np.roll(co, -late)))
    return WorldCase(cause, process, gains[0], gains[1], ms, tag, t, sp, pv, co, scene)


def tested(case: WorldCase, seed: int, kind: str, size: float, hold: int) -> tuple[FloatArray, ...]:
    """The record of a test on the same loop, under a load from the same source: t, sp, pv, co.

    kind : "setpoint", a step out and back; "valve", in manual steps of co up, up, down, down. hold : samples of each.
    """
    rng = np.random.default_rng([seed, hold])
    levels = {"setpoint": (0.0, size, 0.0), "valve": (0.0, size, 2 * size, size, 0.0)}[kind]
    every = case.scene.every
    wanted = np.repeat(levels, [every * BEFORE, *([every * hold] * (len(levels) - 1))])
    load, noise = piece(rng, case.scene.source, len(wanted)), rng.normal(size=len(wanted)) * case.scene.noise
    signals = (wanted, load, noise)
    gains = (case.kc, case.tau_i)
    pv, co = simulated(case.process, gains, signals, case.scene.band, case.scene.steps, manual=kind == "valve")
    sp = wanted if kind == "setpoint" else pv
    sp, pv, co = (x[::every] + 50.0 for x in (sp, pv, co))
    return np.arange(len(sp)) * DT_S, sp, pv, co


BEFORE = 40  # Samples before a test's first step
