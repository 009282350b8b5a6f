"""A plant of loops for an audit to judge: good, sluggish, aggressive, sticking, upset from a neighbour, manual,
saturated, dead, cascades; sampled, quantised and compressed as a historian does. What is true of each is beside it.

Each loop is a first-order process with dead time under PI control, all of them stepped together. Nothing here is shared
with the product: the valve is that of He et al. (2007), the historian's compression a swinging door (Bristol 1990).
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from cases.signals import swinging_door

DT_S = 10.0
KINDS = {
    "ok": 0.36,
    "sluggish": 0.10,
    "aggressive": 0.10,
    "stiction": 0.10,
    "external": 0.10,
    "manual": 0.07,
    "saturation": 0.05,
    "dead": 0.03,
    "cascade": 0.05,
    "interaction": 0.04,
}
"""Share of the loops of each kind; a cascade is a slave in order, the output of another loop is its setpoint; two loops
that are each in order swing against each other (interaction)."""
FAULTS = ("sluggish", "aggressive", "stiction", "external", "saturation", "manual", "dead", "interaction")
CROSS = 1.0
"""What an interacting loop's output does to the other, over what it does to its own process; of opposite signs."""
GROUP = 10  # Loops that one sticking valve upsets, besides the loop of the valve itself


@dataclass(frozen=True)
class Loop:
    """What is true: kind, process k, tau_s, theta_s, settings, stick band, size of loads.

    root : the loop that upsets it. master : of a cascade's slave. against : the loop that it swings against.
    """

    tag: str
    kind: str
    k: float
    tau_s: float
    theta_s: float
    kc: float
    tau_i_s: float
    stick: float
    load: float
    root: str = ""
    master: str = ""
    against: str = ""


def draw(count: int, rng: np.random.Generator) -> list[Loop]:
    """The loops of a plant; each group of externally upset ones has a sticking loop as its root."""
    kinds = [kind for kind, share in KINDS.items() for _ in range(round(share * count))]
    kinds += ["ok"] * (count - len(kinds))
    rng.shuffle(kinds)
    loops = [_loop(f"{'FTPL'[i % 4]}IC{1001 + i}", kind, rng) for i, kind in enumerate(kinds)]
    roots = [loop.tag for loop in loops if loop.kind == "stiction"]
    upset = [i for i, loop in enumerate(loops) if loop.kind == "external"]
    for j, i in enumerate(upset):
        loops[i] = replace(loops[i], root=roots[(j // GROUP) % len(roots)])
    masters = [loop.tag for loop in loops if loop.kind == "ok"]
    for j, i in enumerate(i for i, loop in enumerate(loops) if loop.kind == "cascade"):
        loops[i] = replace(loops[i], master=masters[j % len(masters)])
    pairs = [i for i, loop in enumerate(loops) if loop.kind == "interaction"]
    for i, j in zip(pairs[::2], pairs[1::2], strict=False):
        loops[j] = replace(loops[i], tag=loops[j].tag, against=loops[i].tag)
        loops[i] = replace(loops[i], against=loops[j].tag)
    return loops


def _loop(tag: str, kind: str, rng: np.random.Generator) -> Loop:
    theta_s = float(10 ** rng.uniform(np.log10(20), np.log10(120)))
    tau_s = theta_s * float(10 ** rng.uniform(-0.2, 0.8))
    k = float(10 ** rng.uniform(-0.5, 0.5))
    kc, tau_i_s = tau_s / (2 * theta_s * k), min(tau_s, 8 * theta_s)  # SIMC, tau_c = theta
    worse = {"sluggish": rng.uniform(0.12, 0.25), "aggressive": rng.uniform(2.2, 2.8)}.get(kind, rng.uniform(0.85, 1.1))
    stick = float(rng.uniform(1.0, 4.0)) if kind == "stiction" else 0.0
    return Loop(tag, kind, k, tau_s, theta_s, kc * float(worse), tau_i_s, stick, float(rng.uniform(1.0, 4.0)))


def simulate(
    loops: list[Loop], days: float, rng: np.random.Generator, outside: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Trends of some loops, shape (samples, loops) each: sp, pv, co. outside : what a root sends to those it upsets."""
    n, m = int(days * 86_400 / DT_S), len(loops)
    a = np.exp(-DT_S / np.array([loop.tau_s for loop in loops]))
    k, kc = (np.array([getattr(loop, name) for loop in loops]) for name in ("k", "kc"))
    ki = kc * DT_S / np.array([loop.tau_i_s for loop in loops])
    delay = np.maximum(np.round(np.array([loop.theta_s for loop in loops]) / DT_S).astype(int), 1)
    stick = np.array([loop.stick for loop in loops])
    sp, load = _setpoints(loops, n, rng, outside), _loads(loops, n, rng)
    at = {loop.tag: j for j, loop in enumerate(loops)}
    cross = np.zeros((len(loops), len(loops)))
    for j, loop in enumerate(loops):
        if loop.against in at:
            cross[at[loop.against], j] = CROSS if at[loop.against] < j else -CROSS
    for j, loop in enumerate(loops):
        if loop.root in outside:
            load[:, j] += outside[loop.root][:n] * loop.load
    noise = rng.normal(size=(n, m)) * 0.1 * np.abs(k)
    manual = np.array([loop.kind == "manual" for loop in loops])
    small = [loop.kind == "saturation" for loop in loops]
    high = np.where(small, 50.0 + 0.3 * np.array([loop.load for loop in loops]), 100.0)
    pv, co = np.zeros((n, m)), np.zeros((n, m))
    x, integral, valve = k * 50.0, np.full(m, 50.0), np.full(m, 50.0)
    sent = np.full((n + int(delay.max()) + 1, m), 50.0)
    columns = np.arange(m)
    for i in range(n):
        felt = sent[i + delay.max() - delay, columns]
        x = a * x + (1 - a) * k * (felt + (felt - 50.0) @ cross + load[i])
        pv[i] = x + noise[i]
        error = sp[i] - pv[i]
        wanted = kc * error + integral
        out = np.where(manual, 50.0, np.clip(wanted, 0.0, high))
        integral = np.where(manual | (wanted != out), integral, integral + ki * error)
        co[i] = out
        moved = np.abs(out - valve) > stick
        valve = np.where(moved, out, valve)
        sent[i + delay.max()] = valve
    dead = [loop.kind == "dead" for loop in loops]
    pv[:, dead] = pv[0, dead]
    return {"sp": sp, "pv": pv, "co": co}


def _setpoints(loops: list[Loop], n: int, rng: np.random.Generator, outside: dict[str, np.ndarray]) -> np.ndarray:
    """Setpoints: a change now and then; a cascade's is its master's output."""
    sp = np.tile([50.0 * loop.k for loop in loops], (n, 1))
    for j, loop in enumerate(loops):
        if loop.kind == "cascade":
            sp[:, j] += loop.k * 0.5 * outside[loop.master][:n]
        elif rng.random() < 0.5 and loop.kind != "manual":
            for at in rng.integers(0, n, max(int(n * DT_S / 86_400), 1)):
                sp[at:, j] += loop.k * rng.choice([-1, 1]) * rng.uniform(1.0, 3.0)
    return sp


def _loads(loops: list[Loop], n: int, rng: np.random.Generator) -> np.ndarray:
    """Loads: steps some times a day, and a slow walk."""
    load = np.zeros((n, len(loops)))
    for j, loop in enumerate(loops):
        for at in rng.integers(0, n, max(int(4 * n * DT_S / 86_400), 2)):
            load[at:, j] += rng.choice([-1, 1]) * loop.load
        if loop.kind == "saturation":
            load[:, j] -= 0.8 * loop.load * (np.arange(n) % (n // 3) > n // 6)
    return load - load.mean(axis=0) * np.array([loop.kind != "saturation" for loop in loops])


def recorded(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a historian keeps of a signal: a grid of 12 bits; of one tag in four straight lines between corners."""
    span = float(np.ptp(values)) or 1.0
    stored = np.round(values / (2 * span) * 4096) / 4096 * 2 * span
    return swinging_door(np.arange(len(stored)), stored, 0.004 * span) if rng.random() < 0.25 else stored


def plant(folder: Path, count: int, days: float, seed: int, chunk: int = 125) -> Iterator[list[Loop]]:
    """Write a plant as wide Parquet files of some loops each; what is true of their loops, file by file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng = np.random.default_rng(seed)
    loops = draw(count, rng)
    loops.sort(key=lambda loop: loop.kind != "interaction")  # the two of a pair in one file
    later = [loop for loop in loops if loop.root or loop.master]  # after the loops that they hang on
    loops = [loop for loop in loops if loop not in later]
    files = [some[i : i + chunk] for some in (loops, later) for i in range(0, len(some), chunk)]
    outside: dict[str, np.ndarray] = {}
    masters = {loop.master for loop in later}
    for number, some in enumerate(files, start=1):
        trends = simulate(some, days, rng, outside)
        for j, loop in enumerate(some):
            if loop.kind == "stiction":
                wave = trends["pv"][:, j] - trends["sp"][:, j]
                outside[loop.tag] = wave / (np.std(wave) or 1.0)
            elif loop.tag in masters:
                outside[loop.tag] = trends["co"][:, j] - 50.0
        since = (np.arange(len(trends["sp"])) * int(DT_S)).astype("timedelta64[s]")
        columns = {"time": np.datetime64(1_700_000_000, "s") + since}
        for j, loop in enumerate(some):
            for role, name in (("sp", "SP"), ("pv", "PV"), ("co", "OP")):
                values = trends[role][:, j]
                columns[f"{loop.tag}.{name}"] = (values if role == "sp" else recorded(values, rng)).astype(np.float32)
        pq.write_table(pa.table(columns), folder / f"unit{number:03d}.parquet")
        yield some
