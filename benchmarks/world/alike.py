"""Can records of this world be told from real ones? A forest on 49 scale-free indexes tries, cross-validated by tag.

    python benchmarks/world --data FOLDER --alike [--seed 1] [--cases 80] [--historian]

Area under the curve: 0.5 where nothing tells them apart, 1 where everything does. A record of the world belongs to the
tag whose co was its load, so no tag is both learned from and asked. Each tag counts alike, however many records it has.
Trees are those of Geurts et al. (2006): each node takes the best of some random cuts.
"""

import csv
from pathlib import Path

import numpy as np

from world.draw import drawn
from world.process import FloatArray

BANDS = (0.003, 0.01, 0.03, 0.1, 0.3)  # Edges of the bands of the spectrum, cycles a sample
TREES, CUTS, DEEPEST, FEWEST = 100, 12, 8, 4
"""Trees of a forest, random cuts tried at a node, levels of a tree, records of a node that is cut."""
ROUNDS = 4  # Times that tags are dealt into FOLDS
FOLDS = 5
LEAST = 1e-12
PER_SIGNAL = ("still", "values", "kurtosis", "jump", "rough", "lag 1", "lag 10", "lag 50", "longest still", "reversals",
              *(f"band {edge:g}" for edge in BANDS))  # fmt: skip
BOTH = ("pv with co", "their changes", "error with co's change", "still together")
NAMES = (*(f"{signal} {name}" for signal in ("pv", "co", "error") for name in PER_SIGNAL), *BOTH)


def of_signal(x: FloatArray) -> list[float]:
    """What a signal looks like, whatever its unit and sampling interval: PER_SIGNAL."""
    x = x - np.mean(x)
    std, moves = float(np.std(x)) + LEAST, np.diff(x)
    still = moves == 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    turned = np.sign(moves[~still])
    lags = [float(np.mean(x[lag:] * x[:-lag])) / std**2 for lag in (1, 10, 50)]
    power = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2
    at = np.searchsorted(np.fft.rfftfreq(len(x)), BANDS)
    bands = [float(np.sum(part)) / (float(np.sum(power)) + LEAST) for part in np.split(power, at)[:-1]]
    return [
        float(np.mean(still)), len(np.unique(x)) / len(x), float(np.mean(x**4)) / std**4,
        float(np.max(np.abs(moves))) / std, float(np.std(np.diff(moves))) / std, *lags,
        float(np.max(edges[1::2] - edges[::2], initial=0)) / len(x),
        float(np.mean(turned[1:] != turned[:-1])) if len(turned) > 1 else 0.0, *bands,
    ]  # fmt: skip


def indexes(sp: FloatArray, pv: FloatArray, co: FloatArray) -> list[float]:
    def like(a: FloatArray, b: FloatArray) -> float:
        a, b = a - np.mean(a), b - np.mean(b)
        return abs(float(np.mean(a * b))) / (float(np.std(a) * np.std(b)) + LEAST)

    moved = [np.diff(x) for x in (pv, co)]
    both = [
        like(pv, co),
        like(*moved),
        like((sp - pv)[1:], moved[1]),
        float(np.mean((moved[0] == 0) & (moved[1] == 0))),
    ]
    return [*of_signal(pv), *of_signal(co), *of_signal(sp - pv), *both]


def forest(x: FloatArray, y: FloatArray, weight: FloatArray, asked: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Mean vote of TREES for y = 1. x, y, weight : learned from. asked : shape (records, indexes)."""
    votes = np.zeros(len(asked))

    def grow(rows: FloatArray, at: FloatArray, level: int) -> None:
        share = float(np.average(y[rows], weights=weight[rows]))
        best: tuple[float, int, float] | None = None
        if level < DEEPEST and len(rows) >= FEWEST and 0.0 < share < 1.0 and len(at):
            for _ in range(CUTS):
                j = int(rng.integers(x.shape[1]))
                low, high = float(np.min(x[rows, j])), float(np.max(x[rows, j]))
                cut = rng.uniform(low, high)
                left = x[rows, j] <= cut
                if low == high or left.all() or not left.any():
                    continue
                impurity = 0.0
                for part in (rows[left], rows[~left]):
                    p = float(np.average(y[part], weights=weight[part]))
                    impurity += float(np.sum(weight[part])) * p * (1.0 - p)
                if best is None or impurity < best[0]:
                    best = impurity, j, cut
        if best is None:
            votes[at] += share / TREES
            return
        _, j, cut = best
        left, goes = x[rows, j] <= cut, asked[at, j] <= cut
        grow(rows[left], at[goes], level + 1)
        grow(rows[~left], at[~goes], level + 1)

    for _ in range(TREES):
        grow(np.arange(len(x)), np.arange(len(asked)), 0)
    return votes


def area(scores: FloatArray, y: FloatArray, weight: FloatArray) -> float:
    """Area under the curve: how probably a real record has the larger score, ties half."""
    real, made = y == 1, y == 0
    larger = (scores[real][:, None] > scores[made]) + 0.5 * (scores[real][:, None] == scores[made])
    return float(np.average(larger, weights=weight[real][:, None] * weight[made]))


def alike(folder: str, seed: int, cases: int, *, historian: bool) -> list[str]:
    """The area, and the indexes that tell most by themselves."""
    rows: list[tuple[list[float], int, str]] = []
    with (Path(folder) / "index.csv").open() as index:
        for row in csv.DictReader(index):
            table = np.genfromtxt(Path(folder) / row["file"], delimiter=",", names=True)
            whole = np.all([np.isfinite(table[name]) for name in ("sp", "pv", "co")], axis=0)
            sp, pv, co = (table[name][whole] for name in ("sp", "pv", "co"))
            if np.std(co) > 0 and np.std(pv) > 0:
                rows.append((indexes(sp, pv, co), 1, row["tag"]))
    for i in range(cases):
        case = drawn(seed, i, "real", folder, historian=historian)
        rows.append((indexes(case.sp, case.pv, case.co), 0, case.tag))
    x, y, tags = (np.array(part) for part in zip(*rows, strict=True))
    weight = np.array([1.0 / np.sum((tags == tag) & (y == kind)) for tag, kind in zip(tags, y, strict=True)])
    weight /= np.where(y == 1, np.sum(weight[y == 1]), np.sum(weight[y == 0]))
    rng, names, areas = np.random.default_rng(seed), np.unique(tags), []
    for _ in range(ROUNDS):
        of = dict(zip(names.tolist(), rng.permutation(len(names)) % FOLDS, strict=True))
        fold, scores = np.array([of[tag] for tag in tags.tolist()]), np.zeros(len(y))
        for k in range(FOLDS):
            learned, asked = fold != k, fold == k
            scores[asked] = forest(x[learned], y[learned].astype(float), weight[learned], x[asked], rng)
        areas.append(area(scores, y, weight))
    alone = [area(x[:, j], y, weight) for j in range(len(NAMES))]
    order = sorted(range(len(NAMES)), key=lambda j: -abs(alone[j] - 0.5))
    told = [f"  {NAMES[j]:24} {alone[j]:.2f}" for j in order[:8]]
    count = f"{int(np.sum(y == 1))} real records of {len(set(tags[y == 1].tolist()))} tags, {int(np.sum(y == 0))} drawn"
    spread = f"{min(areas):.2f} to {max(areas):.2f}"
    return [f"area under the curve {np.mean(areas):.2f} ({spread}, {ROUNDS} times); {count}",
            "largest alone (over a half: real records have more of it)", *told]  # fmt: skip
