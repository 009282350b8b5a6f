"""What upsets a loop: steps, drift, outside oscillations of many shapes, random loads. Each of shape (n,)."""

import math
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from cases.case import FloatArray, Record


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


# ---- What historians do to a signal before they store it, and give back between the stored points


def corners(t: FloatArray, x: FloatArray, deviation: float) -> list[int]:
    """Points that a swinging door of that half-width keeps, straight lines between them (Bristol 1990)."""
    kept = [0]
    low, high = -np.inf, np.inf
    for i in range(1, len(x)):
        span = t[i] - t[kept[-1]]
        upper, lower = (x[i] + deviation - x[kept[-1]]) / span, (x[i] - deviation - x[kept[-1]]) / span
        low, high = max(low, lower), min(high, upper)
        if low > high:
            kept.append(i - 1)
            span = t[i] - t[i - 1]
            low, high = (x[i] - deviation - x[i - 1]) / span, (x[i] + deviation - x[i - 1]) / span
    return [*kept, len(x) - 1] if kept[-1] < len(x) - 1 else kept


def swinging_door(t: FloatArray, x: FloatArray, deviation: float) -> FloatArray:
    """The lines between its corners."""
    at = corners(t, x, deviation)
    return np.interp(t, t[at], x[at])


def exceptions(x: FloatArray, deviation: float) -> list[int]:
    """Samples that are sent on: the first, and each that is a deviation away from the last one."""
    sent = [0]
    for i in range(1, len(x)):
        if abs(x[i] - x[sent[-1]]) > deviation:
            sent.append(i)
    return sent


def held(x: FloatArray, sent: list[int]) -> FloatArray:
    """The last sample that was sent on."""
    return x[np.array(sent)[np.searchsorted(sent, np.arange(len(x)), side="right") - 1]]


def compressed(rng: np.random.Generator, record: Record) -> Record:
    """pv and co through one of the two, with deviations of 0.5 to 2 % of their ranges."""
    doors = rng.uniform() < 0.6
    pv, co = (
        swinging_door(record.t, x, d) if doors else held(x, exceptions(x, d))
        for x, d in ((x, float(rng.uniform(0.005, 0.02)) * float(np.ptp(x))) for x in (record.pv, record.co))
    )
    return Record(record.t, record.sp, pv, co)


# ---- Valves that stick: two published families, with stick band S and jump J in the units of the controller output.
#
# f_s = (S + J)/2 is the static and f_d = (S - J)/2 the kinetic friction. After a reversal the valve rests until the
# signal has travelled S, then jumps by J; after a stop in the same direction it rests until the signal has travelled J.
#
# Kano et al. (2004), "Practical model and detection algorithm for valve stiction": a moving valve lags by f_d and stops
# when the signal stops or turns. He et al. (2007), "A curve fitting method for detecting valve stiction": friction is
# overcome anew at every sample, no state of motion. J > S (overshoot) exists in Kano's model only.

Valve = Callable[[float], float]


def kano(s: float, j: float, start: float = 0.0) -> Valve:
    """Kano's valve at rest at `start`, in the middle of its stick band."""
    return KanoValve(lambda: s, j / s, start)


class KanoValve:
    """Kano's valve; the stick band may differ from one stop to the next (band()), J stays its share of S."""

    def __init__(self, band: Callable[[], float], jump_share: float, start: float) -> None:
        self._band, self._share = band, jump_share
        self._s = band()
        self._u = self._y = start
        self._direction = 0
        self._moving = False

    def __call__(self, u: float) -> float:
        """The valve's position after the signal u."""
        s, change = self._s, u - self._u
        self._u = u
        if self._moving and change * self._direction <= 0:
            self._moving = False
            self._s = s = self._band()
        if not self._moving and abs(u - self._y) > s * (1 + self._share) / 2:
            self._moving, self._direction = True, 1 if u > self._y else -1
        if self._moving:
            self._y = u - self._direction * s * (1 - self._share) / 2
        return self._y


def he(s: float, j: float, start: float = 0.0) -> Valve:
    """He's valve at rest at `start`; J at most S."""
    f_s, f_d = (s + j) / 2, (s - j) / 2
    left, y, last = 0.0, start, start

    def valve(u: float) -> float:
        nonlocal left, y, last
        pushed = left + u - last
        last = u
        if abs(pushed) > f_s:
            y += pushed - math.copysign(f_d, pushed)
            left = math.copysign(f_d, pushed)
        else:
            left = pushed
        return y

    return valve


def backlash(width: float, start: float = 0.0) -> Valve:
    """Play of that width: the valve follows when the signal has crossed it, without a jump."""
    y = start

    def valve(u: float) -> float:
        nonlocal y
        y = min(max(y, u - width / 2), u + width / 2)
        return y

    return valve


def irregular(rng: np.random.Generator, s: float, j: float, spread: float, start: float = 0.0) -> Valve:
    """Kano's valve with another stick band after every stop: it stops at many levels, never twice alike."""
    return KanoValve(lambda: s * float(np.exp(spread * rng.standard_normal())), j / s, start)
