"""What upsets a loop: steps, drift, outside oscillations of many shapes, random loads. Each of shape (n,)."""

import numpy as np
from scipy.signal import lfilter

from cases.case import FloatArray


def steps(n: int, at: list[float], sizes: list[float]) -> FloatArray:
    """Sum of steps at given places in samples; a place between two samples enters with the rest of its sample."""
    out = np.zeros(n)
    for place, size in zip(at, sizes, strict=True):
        i = int(np.floor(place))
        if i < n:
            out[i] += size * (i + 1 - place)
            out[i + 1 :] += size
    return out


def ramp(n: int) -> FloatArray:
    """From 0 to 1 over the record."""
    return np.linspace(0.0, 1.0, n)


def random_walk(rng: np.random.Generator, n: int) -> FloatArray:
    """Sum of independent normal steps, starting at 0."""
    return np.concatenate([[0.0], np.cumsum(rng.standard_normal(n - 1))])


def coloured(rng: np.random.Generator, n: int, corner: float) -> FloatArray:
    """White noise through a lag of `corner` samples, unit variance."""
    a = float(np.exp(-1 / corner))
    settle = int(5 * corner)
    raw = lfilter([np.sqrt(1 - a * a)], [1, -a], rng.standard_normal(n + settle))
    return np.asarray(raw[settle:], dtype=np.float64)


def narrow_band(rng: np.random.Generator, n: int, period: float, damping: float) -> FloatArray:
    """White noise through a resonance: random, and almost periodic; unit variance."""
    r = float(np.exp(-2 * np.pi * damping / period))
    settle = int(5 * period / damping / 6)
    e = rng.standard_normal(n + settle)
    raw = lfilter([1.0], [1, -2 * r * np.cos(2 * np.pi / period), r * r], e)[settle:]
    return np.asarray(raw / np.std(raw), dtype=np.float64)


SHAPES = ("sine", "triangle", "saw", "filtered-square", "skewed-triangle", "pulses")


def oscillation(rng: np.random.Generator, n: int, period: float, shape: str, jitter: float = 0.0) -> FloatArray:
    """An outside oscillation between about -1 and 1; jitter is the relative spread of its single periods."""
    cycles = int(n / period * (1 + 3 * jitter)) + 4
    lengths = period * np.exp(jitter * rng.standard_normal(cycles)) if jitter else np.full(cycles, period)
    edges = np.concatenate([[0.0], np.cumsum(lengths)]) - float(rng.uniform(0, 1)) * period
    phase = np.interp(np.arange(n), edges, np.arange(cycles + 1)) % 1.0
    if shape == "sine":
        return np.sin(2 * np.pi * phase)
    if shape == "triangle":
        return 1 - 4 * np.abs(phase - 0.5)
    if shape == "saw":
        return (2 * phase - 1) * float(rng.choice([-1.0, 1.0]))
    if shape == "skewed-triangle":
        up = float(rng.uniform(0.15, 0.85))
        return np.where(phase < up, 2 * phase / up - 1, 1 - 2 * (phase - up) / (1 - up))
    width = float(rng.uniform(0.1, 0.3)) if shape == "pulses" else 0.5
    square = np.where(phase < width, 1.0, -1.0)
    lag = max(period * float(rng.uniform(0.05, 0.3)), 1.0)
    a = float(np.exp(-1 / lag))
    return np.asarray(lfilter([1 - a], [1, -a], square, zi=[a * square[0]])[0], dtype=np.float64)
