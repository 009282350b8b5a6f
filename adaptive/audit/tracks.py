"""What of a loop's record is kept to compare it with other loops: a few numbers at moments that all loops share.

A swing's track is its complex amplitude at a frequency f of a grid that all loops share, over segments of CYCLES / f
that begin at the same moments for all:

    X_s = mean over segment s of (e - its mean) exp(-i 2 pi f t)
    coherence of two loops = |sum X_s conj(Y_s)|^2 / (sum |X_s|^2  sum |Y_s|^2)

Loops that swing together keep their phase over the segments, those that have the same period by chance lose it. The
angle of the sum tells which is later (up to a period). Two loops that act on each other have one damped oscillation
between them: whatever upsets either, both go through it in one ratio and one phase.

A trend's track are its values at common moments: the setpoint of a cascade's slave goes with the output of its master.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass

OCTAVE = 16  # frequencies of the grid an octave: 4.4 % apart
BESIDE = 1  # frequencies either side of its own at which a loop's track is kept, so that like periods share one
CYCLES = 8.0  # periods of a segment
MOST_SEGMENTS = 96  # segments that are kept, the newest
FEWEST_SEGMENTS = 6  # common segments from which a coherence says anything
POINTS = 96  # moments of a trend's track at most
FEWEST_POINTS = 24  # common moments from which two trends are compared
STILL = 0.5  # share of moments with a change from which a signal moves
DIGITS = 4
COARSE = 4  # every so many frequencies of the grid one is kept where an oscillation dies away: its peak is broad
FREQUENCIES_KEPT = 3  # frequencies kept either side of the oscillation's own: two thirds of an octave


@dataclass(frozen=True, slots=True)
class SwingTrack:
    """A swing over time: by number of the frequency the first segment and the amplitudes from it on, nan for none."""

    parts: dict[int, tuple[int, np.ndarray]]

    def to_dict(self) -> dict[str, object]:
        """Plain JSON values; a segment without amplitude is null."""
        return {
            str(k): {"first": first, "re": _plain(x.real), "im": _plain(x.imag)} for k, (first, x) in self.parts.items()
        }

    @classmethod
    def of_dict(cls, told: dict[str, Any]) -> "SwingTrack":
        """The track from its plain form."""
        return cls({int(k): (int(v["first"]), _array(v["re"]) + 1j * _array(v["im"])) for k, v in told.items()})


def _plain(x: FloatArray) -> list[float | None]:
    """Numbers with as many digits as a comparison needs."""
    return [float(f"{v:.{DIGITS}g}") if math.isfinite(v) else None for v in x.tolist()]


def _array(values: list[float | None]) -> FloatArray:
    return np.array([math.nan if v is None else v for v in values], dtype=np.float64)


def swing_track(t_s: FloatArray, error: FloatArray, period_s: float) -> SwingTrack:
    """The track of a swing of this period.

    t_s : moments of a clock that the loops share, s, shape (n,). error : sp - pv.
    """
    own = round(-OCTAVE * math.log2(period_s))
    return SwingTrack({k: _amplitudes(t_s, error, 2 ** (k / OCTAVE)) for k in range(own - BESIDE, own + BESIDE + 1)})


def damped_track(t_s: FloatArray, error: FloatArray, period_s: float) -> SwingTrack:
    """The track of an oscillation that dies away after every upset; period_s : roughly. See swing_track."""
    own = round(-OCTAVE / COARSE * math.log2(period_s))
    kept = [COARSE * k for k in range(own - FREQUENCIES_KEPT, own + FREQUENCIES_KEPT + 1)]
    return SwingTrack({k: _amplitudes(t_s, error, 2 ** (k / OCTAVE)) for k in kept})


def _amplitudes(t_s: FloatArray, error: FloatArray, f_hz: float) -> tuple[int, np.ndarray]:
    """Number of the first segment, and the amplitudes of the newest ones; nan where less than half is on record."""
    segment_s = CYCLES / f_hz
    number = np.floor(t_s / segment_s).astype(np.int64)
    begin = int(np.searchsorted(number, number[-1] - MOST_SEGMENTS + 1))
    number, t, e = number[begin:], t_s[begin:], error[begin:]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1])
    counts = np.diff(np.append(edges, len(number)))
    level = e - np.repeat(np.add.reduceat(e, edges) / counts, counts)
    turned = level * np.exp(-2j * math.pi * f_hz * t)
    found = np.full(int(number[-1] - number[0]) + 1, complex(math.nan, math.nan))
    full = counts >= 0.5 * np.max(counts)
    found[(number[edges] - number[0])[full]] = (np.add.reduceat(turned, edges) / counts)[full]
    return int(number[0]), found


def coherence(a: SwingTrack, b: SwingTrack) -> tuple[float, float] | None:
    """Coherence, 0 to 1, and by which part of a period b is later than a, -0.5 to 0.5; None: too little in common."""
    found = max(_compared(a, b), default=None)
    return None if found is None else (found[1], found[2])


def by_chance(a: SwingTrack, b: SwingTrack) -> float:
    """Odds of so large a coherence where two loops have nothing to do with each other; 1: too little in common.

    Of n segments of equal weight and random phases it exceeds c with (1 - c)^(n - 1) (Goodman 1957); a few upsets carry
    most of the weight, so n is their effective number.
    """
    found = max(_compared(a, b), default=None)
    return 1.0 if found is None else (1 - found[1]) ** max(found[3] - 1, 0.0)


def _compared(a: SwingTrack, b: SwingTrack) -> Iterator[tuple[float, float, float, float]]:
    """Power, coherence, delay and effective number of segments at every common frequency."""
    for k in a.parts.keys() & b.parts.keys():
        first = max(a.parts[k][0], b.parts[k][0])
        x, y = (values[first - begin :] for begin, values in (a.parts[k], b.parts[k]))
        many = min(len(x), len(y))
        x, y = x[: max(many, 0)], y[: max(many, 0)]
        both = np.isfinite(x) & np.isfinite(y)
        power = float(np.sum(np.abs(x[both]) ** 2)), float(np.sum(np.abs(y[both]) ** 2))
        if np.count_nonzero(both) < FEWEST_SEGMENTS or min(power) <= 0:
            continue
        crossed = x[both] * y[both].conj()
        cross, sizes = complex(np.sum(crossed)), np.abs(crossed)
        effective = float(np.sum(sizes)) ** 2 / max(float(np.sum(sizes**2)), 1e-300)
        both_powers = power[0] * power[1]
        delay = math.atan2(cross.imag, cross.real) / (2 * math.pi)
        yield both_powers, min(abs(cross) ** 2 / both_powers, 1.0), delay, effective


@dataclass(frozen=True, slots=True)
class TrendTrack:
    """Setpoint and output at common moments: every `every_s` seconds, from moment number `first` on."""

    every_s: float
    first: int
    sp: FloatArray
    co: FloatArray

    def to_dict(self) -> dict[str, object]:
        """Plain JSON values; a segment without amplitude is null."""
        return {"every_s": self.every_s, "first": self.first, "sp": _plain(self.sp), "co": _plain(self.co)}

    @classmethod
    def of_dict(cls, told: dict[str, Any]) -> "TrendTrack":
        """The track from its plain form."""
        return cls(float(told["every_s"]), int(told["first"]), _array(told["sp"]), _array(told["co"]))


def trend_track(t_s: FloatArray, sp: FloatArray, co: FloatArray) -> TrendTrack:
    """Values at moments of a grid of 2^j seconds that is the same for loops of the same length of record."""
    every_s = 2.0 ** math.ceil(math.log2(max(float(t_s[-1] - t_s[0]) / POINTS, 1e-6)))
    first = math.ceil(t_s[0] / every_s)
    moments = np.arange(first, math.floor(t_s[-1] / every_s) + 1) * every_s
    at = np.clip(np.searchsorted(t_s, moments, side="right") - 1, 0, len(t_s) - 1)
    return TrendTrack(every_s, first, sp[at], co[at])


FOLLOWS = 0.99  # correlation from which a setpoint is another loop's output
AT_ONCE = 256  # slaves that are compared with all masters at once: what that takes stays small with ten thousand loops


@dataclass(frozen=True, slots=True)
class _Clocked:
    """Signals that have their moments in common: of these loops, shape (loops, moments)."""

    every_s: float
    first: int
    tags: tuple[str, ...]
    values: FloatArray

    def between(self, first: int, end: int) -> FloatArray:
        """The signals at some moments, each of mean 0 and length 1; one that does not move is 0."""
        x = self.values[:, first - self.first : end - self.first]
        x = x - np.mean(x, axis=1, keepdims=True)
        size = np.sqrt(np.sum(x * x, axis=1, keepdims=True))
        return np.asarray(np.divide(x, size, out=np.zeros_like(x), where=size > 0))


def cascades(tracks: Mapping[str, TrendTrack]) -> dict[str, str]:
    """The master of each slave among loops, by tag: the setpoint goes with its output, their correlation is FOLLOWS."""
    best: dict[str, tuple[float, str]] = {}
    masters = _by_clock({tag: (track, track.co) for tag, track in tracks.items() if _moves(track.co)})
    for slaves in _by_clock({tag: (track, track.sp) for tag, track in tracks.items() if _moves(track.sp)}):
        for some in masters:
            if slaves.every_s == some.every_s:
                for tag, found in _followed(slaves, some):
                    best[tag] = max(best.get(tag, found), found, key=lambda one: one[0])
    return {tag: best[tag][1] for tag in tracks if tag in best}


def twins(tracks: Mapping[str, TrendTrack]) -> dict[str, str]:
    """Loops whose setpoint and moving output are another's at every moment, by that other's tag: exported twice."""
    first: dict[tuple[float, int, bytes, bytes], str] = {}
    found: dict[str, str] = {}
    for tag, track in sorted(tracks.items()):
        if _moves(track.co):
            other = first.setdefault((track.every_s, track.first, track.sp.tobytes(), track.co.tobytes()), tag)
            found |= {tag: other} if other != tag else {}
    return found


def _by_clock(signals: Mapping[str, tuple[TrendTrack, FloatArray]]) -> list[_Clocked]:
    """Signals, those with the same moments together."""
    groups: dict[tuple[float, int, int], list[str]] = {}
    for tag, (track, values) in signals.items():
        groups.setdefault((track.every_s, track.first, len(values)), []).append(tag)
    return [
        _Clocked(every_s, first, tuple(tags), np.stack([signals[tag][1] for tag in tags]))
        for (every_s, first, _), tags in groups.items()
    ]


def _followed(slaves: _Clocked, masters: _Clocked) -> Iterator[tuple[str, tuple[float, str]]]:
    """Slaves with how far they follow which of these masters, where that says something."""
    first = max(slaves.first, masters.first)
    end = min(slaves.first + slaves.values.shape[1], masters.first + masters.values.shape[1])
    if end - first < FEWEST_POINTS:
        return
    x, y = slaves.between(first, end), masters.between(first, end)
    place = {tag: j for j, tag in enumerate(masters.tags)}
    for begin in range(0, len(x), AT_ONCE):
        told = np.nan_to_num(np.abs(x[begin : begin + AT_ONCE] @ y.T))
        for row, tag in zip(told, slaves.tags[begin : begin + AT_ONCE], strict=True):
            if tag in place:
                row[place[tag]] = 0.0
            j = int(np.argmax(row))
            if row[j] >= FOLLOWS:
                yield tag, (float(row[j]), masters.tags[j])


def _moves(x: FloatArray) -> bool:
    return len(x) >= FEWEST_POINTS and float(np.mean(np.diff(x) != 0)) > STILL
