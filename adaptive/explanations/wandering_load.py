"""Process, load that wanders and noise: how likely each process of the grid makes a record.

    pv = K x + z + v        x: co through dead time and lags;  v: white noise
    rw:   z is a random walk at the process input, seen through the first lag          (1 - q)(1 - a q) z = w
    rw2:  the same of a load whose slope is the random walk: it ramps and pauses     (1 - q)^2 (1 - a q) z = w
    pv:   z is a random walk that enters behind the process, at pv itself              (1 - q) z = w

For the book (log_likelihood) a walk goes through both lags, as a load at the process input does: behind the first alone
it made processes of two lags look tight. One that enters at pv is as likely as its share of the loads that are tried:
behind a lag, it made processes look as if they had next to none (good loops under one: Ms 2.26 with 97 %, 1.60 true).

Real loads wander, pause, step and oscillate. The output of a well-controlled loop is its load with the sign turned, so
a fit that knows only steps and ramps must buy steps that never were. Here the load is a state with its own variance.
For given lags and ratio of load to noise the Kalman filter of (z, v) in its steady state is the filter A/C, with C from
    r + A(q) A(1/q) = s C(q) C(1/q)                              (spectral factorisation; Astrom 1970, ch. 5)
which whitens pv and x alike: A first, by differences, which are exact where signals are slow, then 1/C. The unknown
start of the filter and of the lags is a column each of a least squares fit (a diffuse start). The compiled engine does
it by recursion, in a tenth of the time; here it is done by transforms.
The gain follows in closed form with its variance, so its whole likelihood is known:
    ln L(K) = -(n - m)/2 ln(RSS + S (K - K_ls)^2)                          (noise variance profiled)

A recorder that averages over its interval, or draws lines between samples of its own, smooths pv and co alike: both go
through 1 + f q. So 1/(1 + f q) comes before A/C; without it only a short first lag makes so smooth a pv, whatever the
process is (smoothed_record.py).

Samples under a real load are far from independent: no model of a load is right. So ln L is divided by a temper before
it counts. What the setpoint makes co do owes nothing to loads, and is trusted more than what loads and controller do to
each other: with s the share of the setpoint in what moves the record, in whitened coordinates,
    1/T = (1 - s)/T_LOADS + s/T_SETPOINT,      s = E/(E + m),      E = sum (A/C sp)^2 / sigma^2
and m, of n samples, those of the load: n times the mean over frequencies of its share, C(1)^2 / |C|^2. The rest is
noise, whose model is right; with n for m a level that is sampled fast seemed to be moved by loads alone.
Both were chosen so that what is told at 90 % is right in nine of ten (benchmarks/world). A load that oscillates (poles
near the unit circle, at pv's own peak) explains every tight loop away; a tone that keeps its phase does not. The book
has it (tone.py), the odds of a record do not.
"""

import cmath
import math
from collections.abc import Sequence
from functools import cache, lru_cache

import numpy as np

from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    GAINS,
    LAGS,
    BoolArray,
    ComplexArray,
    second_lags,
    units,
)
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.indexes.recording_quality import hidden_sigma
from retuner.adaptive.signals.noise import quantum_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass, field, replace

MOST_SAMPLES = 1024
"""Longer records are condensed, or cut into windows, to this many; transforms of a power of two hold them."""
BANDWIDTHS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, math.inf)
"""Frequency, rad per sample, at which load and noise are equally large; without end there is no noise."""
AT_PV, VALUE, SLOPE, BOTH = 0, 1, 2, 3
"""Orders of a walk: how often it is summed up behind the lags. One at pv goes through none; BOTH is VALUE through the
second lag as well, of inputs with one only."""
LOADS = tuple((bandwidth, order) for order in (VALUE, SLOPE) for bandwidth in BANDWIDTHS)
FINE = (0.02, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.57, 0.8, 1.13, 1.6, math.inf)
"""Bandwidths of the walk, for the book: between octaves the likelihood of a thousand samples falls by 50, and a wrong
process takes the place of a bandwidth that is missing."""
BEHIND_LAGS = (*((one, VALUE) for one in FINE), *((one, SLOPE) for one in BANDWIDTHS[1:-1]))
LOADS_OF_BOOK = (*BEHIND_LAGS, *((bandwidth, AT_PV) for bandwidth in BANDWIDTHS[1:]))
"""Loads that the book has for every process, and all that it has for those that do not run away by themselves."""
NO_TONES = np.zeros((0, 0))
ORDERS = (VALUE, SLOPE, AT_PV)  # As they stand in the loads of the book
TEMPER = 6.0  # What the logarithm of a likelihood is divided by as it is computed
T_LOADS, T_SETPOINT = 8.0, 3.5
"""What it should be divided by: where loads alone move a record, and where a setpoint alone does; 3 to 30. Of 270 loops
without a valve (benchmarks/world, seeds 12401 to 12404) with 11 for loads, tunings that were told at 85 % and more were
right in 90 of 90, which is too little told; the log score is best from 5 to 7."""
LEAST_NOISE = 1e-3  # Share of pv's standard deviation below which no noise of a record is believed


@dataclass(frozen=True, slots=True)
class LoadModel:
    """The whitening filter A/C. roots : A is the product of 1 - root q. c : coefficients of C, the newest first."""

    roots: tuple[float, ...]
    c: tuple[float, ...]

    @property
    def a(self) -> tuple[float, ...]:
        """Coefficients of A, the newest first."""
        return tuple(np.poly(self.roots).tolist())

    @property
    def packed(self) -> tuple[float, ...]:
        """The seven numbers that the compiled engine has of a load."""
        none = (0.0,) * (3 - len(self.roots))
        return (float(len(self.roots)), *self.roots, *none, *self.c[1:], *none)


@lru_cache(maxsize=4096)
def load_models(lag: float, bandwidths: tuple[float, ...], order: int, second: float = 0.0) -> tuple[LoadModel, ...]:
    """The filters that whiten a load behind a first lag and a second one (0: none), in samples, for several bandwidths.

    order : of the walk.
    """
    roots = (1.0,) * (order or 1)
    if order != AT_PV:
        roots = (pole_of(lag), *((pole_of(second),) if second else ()), *roots)
    return tuple(_factored(roots, bandwidth) for bandwidth in bandwidths)


@lru_cache(maxsize=8192)
def _factored(roots: tuple[float, ...], bandwidth: float) -> LoadModel:
    """The load model of these roots. Each factor 1 - root q times its mirror image is (1 - root)^2 + root y, with
    y = (1 - q)(1 - 1/q). So r + A(q) A(1/q) is a polynomial in y, and each of its roots is that of one factor of C.
    """
    if math.isinf(bandwidth):
        return LoadModel(roots, (1.0,) + (0.0,) * len(roots))
    least, rest, inside = [(1.0 - root) ** 2 for root in roots], 1.0, [1.0]
    for root, square in zip(roots, least, strict=True):
        rest *= square + root * 4.0 * math.sin(bandwidth / 2.0) ** 2
        inside = [square * one + root * other for one, other in zip((*inside, 0.0), (0.0, *inside), strict=True)]
    inside[0] += rest
    each: list[complex] = []
    if len(roots) > 2:  # Newton's rule from below finds the lowest root, which is real
        (d, c, b, a), before = inside, -math.inf
        y = min(-square / root for root, square in zip(roots, least, strict=True)) - (rest / a) ** (1 / 3)
        while y > before:
            before, y = y, y - (((a * y + b) * y + c) * y + d) / ((3.0 * a * y + 2.0 * b) * y + c)
        each, inside = [complex(y)], [-d / y, (-d / y - c) / y, a]
    if len(inside) > 2:
        e, b, a = inside
        side = cmath.sqrt(b * b - 4.0 * a * e)
        each += [-(b + side) / (2.0 * a), -2.0 * e / (b + side)]  # no difference of two that are alike
    else:
        each.append(complex(-inside[0] / inside[1]))
    bottom = [complex(1.0)]
    for found in each:  # q + 1/q = 2 - y, of which q is the one outside the unit circle
        half, side = 1.0 - found / 2.0, cmath.sqrt(found * (found / 4.0 - 1.0))
        pole = 1.0 / max(half + side, half - side, key=abs)
        bottom = [one - pole * other for one, other in zip((*bottom, 0.0), (0.0, *bottom), strict=True)]
    return LoadModel(roots, tuple(one.real for one in bottom))


def _walk(order: int, second: float, behind: float) -> tuple[int, float]:
    """How often it is summed up, and the second lag that it goes through."""
    return (VALUE, second) if order == BOTH else (order, behind * (order == VALUE))


def pole_of(lag: float) -> float:
    """What a sample later is there of a lag's state: more than before where it runs away."""
    return 1.0 if math.isinf(lag) else math.exp(-1.0 / lag)


@dataclass(frozen=True, slots=True)
class Prepared:
    """A window as this likelihood wants it: pv and co from their first values, pv's resolution, the interval.

    pv, co : shape (n,). resolution : standard deviation of what pv cannot show. sample_time_s : after condensing.
    first : the first value of pv. smoothing : f of a recorder that made both 1 + f q of what they were; 0 to 1.
    stepped : rows at which the setpoint changes. size : variance of pv, in which sums of squares are counted.
    """

    pv: FloatArray
    co: FloatArray
    resolution: float
    sample_time_s: float
    first: float = 0.0
    smoothing: float = 0.0
    stepped: tuple[int, ...] = ()
    size: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", float(np.var(self.pv)) or 1.0)  # asked for by each of sixty lags

    @classmethod
    def at(cls, window: Window, dt_s: float) -> "Prepared":
        """A window at an interval, by block means of pv and co alike: one filter on both leaves their relation."""
        finest = max(quantum_sigma(window.pv), hidden_sigma(window.pv))
        window = window.on_even_clock()
        stepped = tuple((np.flatnonzero(np.diff(window.sp)) + 1).tolist())
        raw = cls(window.pv, window.co, finest, window.sample_time_s, stepped=stepped)
        return raw.condensed(max(round(dt_s / window.sample_time_s), 1))

    def coarser(self, most: int) -> "Prepared":
        """The same in so many rows at the most."""
        n = -(-len(self.pv) // most)
        return self if n == 1 else self.condensed(n)

    def condensed(self, n: int) -> "Prepared":
        """The same in rows of n."""
        pv, co = (block_means(x, n) for x in (self.pv, self.co))
        finest = max(self.resolution / math.sqrt(n), LEAST_NOISE * float(np.std(pv)))
        first, stepped = self.first + float(pv[0]), tuple(row // n for row in self.stepped)
        return Prepared(pv - pv[0], co - co[0], finest, n * self.sample_time_s, first, stepped=stepped)


def block_means(x: FloatArray, n: int) -> FloatArray:
    """Means of n samples each, without those that are left at the end."""
    rows = len(x) // n
    return np.asarray(x[: rows * n].reshape(rows, n).mean(axis=1), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class UnderLoads:
    """Least squares of the whitened pv on every whitened input and dead time, under each of some loads.

    gain, information, left : K of least squares, S and RSS (head of this file), shape (loads, inputs, dead times).
    freedom : samples less nuisances, shape (loads,). size : of Prepared: loads of other orders have other freedoms.
    """

    gain: FloatArray
    information: FloatArray
    left: FloatArray
    freedom: FloatArray
    size: float

    def tempered(self, gain: FloatArray) -> FloatArray:
        """Tempered log-likelihood of gains; shape (loads, inputs, dead times, gains). gain : along the last axis."""
        more = self.information[..., None] * (gain - self.gain[..., None]) ** 2
        half = self.freedom[:, None, None, None] / (2 * TEMPER)
        return np.asarray(-half * np.log((self.left[..., None] + more) / self.size))

    def in_direction(self, direction: int) -> FloatArray:
        """The same of the likeliest gain of this sign, none if it has the other; shape (loads, inputs, dead times)."""
        more = np.where(self.gain * direction > 0, 0.0, self.information * self.gain**2)
        return np.asarray(np.log((self.left + more) / self.size) * (self.freedom / (-2 * TEMPER))[:, None, None])

    def mixed(self, gains: FloatArray, groups: FloatArray | None = None, spans: FloatArray | None = None) -> FloatArray:
        """ln of the mean over loads of exp(ln L / TEMPER), shape (groups, inputs, dead times, gains).

        gains : shape (inputs, 1, gains). groups : 1 for the loads that are in each, shape (groups, loads); None: all.
        spans : of spans_of, shape (inputs, dead times, 2), None for all gains; outside of them it is -inf.
        """
        groups = np.ones((1, len(self.freedom))) if groups is None else groups
        spans = np.tile((0.0, gains.shape[2]), (*self.gain.shape[1:], 1)) if spans is None else spans
        if (engine := compiled()) is not None:
            fits, half = (self.gain, self.information, self.left), self.freedom / (2 * TEMPER)
            return np.asarray(engine.walks_mixed(fits, half, gains[:, 0], groups, spans, self.size))
        each, at = (self.tempered(gains)[group > 0] for group in groups), np.arange(gains.shape[2])
        whole = [np.logaddexp.reduce(one, axis=0) - math.log(len(one)) for one in each]
        return np.where((at >= spans[..., :1]) & (at < spans[..., 1:]), whole, -math.inf)


def spans_of(asked: BoolArray) -> FloatArray:
    """The first gain that is asked for and the one after the last, shape (..., 2). asked : shape (..., gains)."""
    ends = np.argmax(asked, axis=-1), asked.shape[-1] - np.argmax(asked[..., ::-1], axis=-1)
    return np.stack(ends, axis=-1).astype(np.float64)


@lru_cache(maxsize=1024)
def _behind(
    lag: float, loads: tuple[tuple[float, int], ...], seconds: tuple[float, ...], through: int | None
) -> tuple[tuple[LoadModel, ...], tuple[float, ...], FloatArray, FloatArray, FloatArray]:
    """What under_loads needs of a first lag and loads, whatever the record: their models, poles that unknown starts
    fall with, how many unknowns there are under each load, poles of the second lags, and the models for the engine.
    """
    behind = 0.0 if through is None else second_lags(lag)[through]
    by_order = {
        order: iter(load_models(lag, tuple(b for b, o in loads if o == order), *_walk(order, seconds[0], behind)))
        for order in {order for _, order in loads}
    }
    models = tuple(next(by_order[order]) for _, order in loads)
    starts = second_lags(lag)[1:] if through is None else (lag if AT_PV in by_order else 0.0, behind)
    falls = tuple(pole_of(one) for one in starts if one)
    unknown = np.array([float(len({*falls} - {*model.roots}) + len(model.roots)) for model in models])
    poles = np.array([0.0 if not second else pole_of(second) for second in seconds])
    return models, falls, unknown, poles, np.array([model.packed for model in models])


def under_loads(
    record: Prepared, inputs: FloatArray, lag: float, loads: Sequence[tuple[float, int]], dead_times: Sequence[float],
    *, seconds: tuple[float, ...] | None = None, through: int | None = None, tones: FloatArray | None = None,
    ends: Sequence[int] = (0,),
) -> UnderLoads:  # fmt: skip
    """What inputs through a first lag, each second one and each dead time explain of a record under each load.

    inputs : held between samples, shape (inputs, n). loads : bandwidth and order of each. seconds : second lags, 0 for
    none; None for the grid's. through : the number of its only one, which a walk of VALUE goes through as well; None
    for all, and no load at pv. tones : sinusoids that a load may hold besides, shape (number, n). ends : how many of
    them it does, ascending; every load comes with each of these numbers. The answer's rows are second lags by inputs.
    """
    if seconds is None:
        seconds = second_lags(lag)[slice(through, None if through is None else through + 1)]
    models, falls, unknown, poles, packed = _behind(lag, tuple(loads), seconds, through)
    freedom = len(record.pv) - np.add.outer(unknown, ends).ravel()
    tones = NO_TONES if tones is None else tones
    size = record.size
    if (engine := compiled()) is not None:
        asked = (packed, poles, falls, dead_times, record.resolution**2, record.smoothing)
        gain, information, left = engine.walks(record.pv, inputs, lag, *asked, tones, ends)
        return UnderLoads(gain, information, left, freedom, size)
    if record.smoothing:
        both = unsmoothed(np.vstack([record.pv, inputs]), record.smoothing)
        record, inputs = replace(record, pv=both[0], smoothing=0.0), both[1:]
    moved = responses(inputs, lag, seconds).reshape(-1, len(record.pv))
    each = [_whitened(record, moved, falls, model, dead_times, tones[:end]) for model in models for end in ends]
    gain, information, left = (np.array(part) for part in zip(*each, strict=True))
    return UnderLoads(gain, information, left, freedom, size)


def unsmoothed(rows: FloatArray, smoothing: float) -> FloatArray:
    """Rows as they were before a recorder smoothed them, from rest; shape (..., n). smoothing : of Prepared."""
    n = rows.shape[-1]
    return filtered(spectrum(rows), n, impulse_response((1.0,), (1.0, smoothing), n))


_PAD = int(max(DEAD_TIMES)) + 2
_DAMPED = 1e-8
"""What is left of a response after the length of its transform, where it is computed: no echo of it comes back."""


def _length(n: int) -> int:
    return 1 << (2 * n - 1).bit_length()  # of transforms of n samples that are not to wrap round


def filtered(spectra: ComplexArray, n: int, response: FloatArray) -> FloatArray:
    """Rows through a filter, from rest. spectra : `spectrum` of rows of n samples. response : to an impulse, (n,)."""
    return np.asarray(np.fft.irfft(spectra * spectrum(response), _length(n))[..., :n], dtype=np.float64)


def spectrum(rows: FloatArray) -> ComplexArray:
    """Transform of rows of n samples, long enough for a filter of n."""
    return np.asarray(np.fft.rfft(rows, _length(rows.shape[-1])), dtype=np.complex128)


def impulse_response(top: tuple[float, ...], bottom: tuple[float, ...], n: int) -> FloatArray:
    """First n samples of top(q)/bottom(q) of the backward shift q; bottom has no root inside the unit circle."""
    length = _length(n)
    radius = _DAMPED ** (1.0 / length)  # on a smaller circle the response falls, so its echoes do not count
    shift = radius * np.exp(-2j * math.pi * np.arange(length // 2 + 1) / length)
    ratio = np.polyval(top[::-1], shift) / np.polyval(bottom[::-1], shift)
    return np.asarray(np.fft.irfft(ratio, length)[:n] / radius ** np.arange(n), dtype=np.float64)


def responses(inputs: FloatArray, lag: float, seconds: tuple[float, ...] | None = None) -> FloatArray:
    """What inputs held between samples do at gain one, through the first lag and each second one, 0 for none.

    inputs : shape (..., n). seconds : None for those of the grid. Returns shape (second lags, ..., n). Where the first
    runs away it is free of that, as A makes it: what grows leaves no digits to subtract.
    """
    n = inputs.shape[-1]
    k = np.arange(n, dtype=np.float64)
    pole = pole_of(lag)
    stays = pole if pole <= 1.0 else 0.0
    rise = np.where(k > 0, stays ** np.maximum(k - 1.0, 0.0), 0.0) * (1.0 if math.isinf(lag) else abs(1.0 - pole))
    first = filtered(spectrum(inputs), n, rise)
    passed, others = spectrum(first), (pole_of(second) if second else 0.0 for second in seconds or second_lags(lag))
    return np.array([filtered(passed, n, (1.0 - other) * other**k) if other else first for other in others])


def reduced(rows: FloatArray, roots: tuple[float, ...]) -> FloatArray:
    """Rows through A, from rest; shape (..., n)."""
    for root in roots:
        rows = np.concatenate([rows[..., :1], rows[..., 1:] - root * rows[..., :-1]], axis=-1)
    return rows


def _whitened(
    record: Prepared, moved: FloatArray, falls: tuple[float, ...], model: LoadModel, dead_times: Sequence[float],
    tones: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """gain, information and left under one load, shape (inputs, dead times). moved : of `responses`. falls : poles."""
    n = len(record.pv)
    memory, basis = whitening(n, falls, model)
    if len(tones):  # a filter makes of a tone the same one turned, and starts
        basis = np.linalg.qr(np.column_stack([basis, tones.T]))[0]
    own = model.roots[1:] if model.roots[0] > 1.0 else model.roots  # see `responses`
    both = np.vstack([reduced(record.pv[None], model.roots), reduced(moved, own)])
    rows = filtered(spectrum(both), n, memory)
    y = rows[0] - basis @ (basis.T @ rows[0])
    padded = np.concatenate([np.zeros((len(rows) - 1, _PAD)), rows[1:]], axis=1)
    delayed = np.empty((len(rows) - 1, len(dead_times), n))
    for i, dead in enumerate(dead_times):
        whole, part = int(dead), dead - int(dead)
        at = _PAD - whole
        delayed[:, i] = padded[:, at : at + n]
        if part:
            delayed[:, i] = (1 - part) * delayed[:, i] + part * padded[:, at - 1 : at - 1 + n]
    flat = delayed.reshape(-1, n)
    along = flat @ np.column_stack([y, basis])
    information = np.einsum("ij,ij->i", flat, flat) - np.sum(along[:, 1:] ** 2, axis=1)
    information = np.maximum(information, LEAST_SHARE * float(np.max(information, initial=0.0)) + LEAST_INFORMATION)
    gain = along[:, 0] / information
    left = np.maximum(y @ y - gain * along[:, 0], 0.0) + (n - basis.shape[1]) * record.resolution**2
    form = (len(rows) - 1, len(dead_times))
    return gain.reshape(form), information.reshape(form), left.reshape(form)


LEAST_SHARE, LEAST_INFORMATION = 1e-12, 1e-300
"""Below this an input says nothing of the gain: as a share of the most that one says, and in itself."""


@lru_cache(maxsize=1024)
def whitening(n: int, poles: tuple[float, ...], model: LoadModel) -> tuple[FloatArray, FloatArray]:
    """The impulse response of 1/C, and what unknown starts add to what A/C gives: orthonormal columns.

    Starts of the filter itself, and of the lags of these poles that are not in it.
    """
    memory = impulse_response((1.0,), model.c, n)
    starts = [np.concatenate([np.zeros(i), memory[: n - i]]) for i in range(len(model.roots))]
    falls = [pole ** np.arange(n) for pole in poles if pole not in model.roots]
    if falls:
        starts.extend(filtered(spectrum(reduced(np.array(falls), model.roots)), n, memory))
    return memory, np.asarray(np.linalg.qr(np.array(starts).T)[0], dtype=np.float64)


def likeliest_load(record: Prepared, lag: float) -> tuple[LoadModel, float]:
    """Load and noise that explain a record best behind a first lag, and the standard deviation of what they leave."""
    fits = under_loads(record, record.co[None], lag, LOADS, DEAD_TIMES)
    variance = fits.left.min(axis=(1, 2)) / fits.freedom
    best = int(np.argmin(variance))
    bandwidth, order = LOADS[best]
    (model,) = load_models(lag, (bandwidth,), order)
    c = tuple(np.convolve(model.c, (1.0, record.smoothing)).tolist()) if record.smoothing else model.c
    return LoadModel(model.roots, c), math.sqrt(float(variance[best]))


def lead_of_steps(left: float, steps: int, samples: int, record: Prepared, likelihood: FloatArray) -> float:
    """Lead, ln, of a fit whose loads are steps over every process under a load that wanders.

    left : mean square of what the fit leaves of a row of the record, its resolution at least. steps : of load, or
    harmonics of a tone. samples : that were fitted; each number costs half of their logarithm (Schwarz 1978).
    """
    price = (OWN_NUMBERS + NUMBERS_OF_STEP * steps) * math.log(samples) / (2 * samples)
    by_steps = -0.5 * math.log(max(left, record.resolution**2) * len(record.pv)) - price
    return samples * (by_steps - best_a_row(record, likelihood))


def best_a_row(record: Prepared, likelihood: FloatArray) -> float:
    """ln L a row of the likeliest process under a load that wanders; loads are summed over at their price once.

    likelihood : of log_likelihood. -ln(RSS)/2 of a fit is what it compares with.
    """
    best = TEMPER * float(np.max(likelihood)) + (TEMPER - 1.0) * math.log(len(LOADS_OF_BOOK))
    return best / len(record.pv) - 0.5 * math.log(record.size)


OWN_NUMBERS, NUMBERS_OF_STEP = 2.0, 2.0
"""Numbers of a fit: start and level, as the process is chosen under a walk as well; size and time of each load step."""


def setpoint_share(record: Prepared, setpoint: FloatArray, lag: float) -> tuple[float, float]:
    """The setpoint's share in what moves a record, and s of the head of this file.

    setpoint : of the record, from its first value, shape (n,). lag : of the process.
    """
    n = len(record.pv)
    if not np.ptp(setpoint) > 0:
        return 0.0, 0.0
    load, std = likeliest_load(record, lag)
    moved = filtered(spectrum(setpoint), n, impulse_response(load.a, load.c, n))
    ratio = float(moved @ moved) / (n * std**2)
    white = impulse_response((1.0, record.smoothing), load.c, n)
    part = (sum(load.c) / (1.0 + record.smoothing)) ** 2 * float(white @ white)
    return ratio / (ratio + 1.0), ratio / (ratio + part)


def temper(share: float) -> float:
    """T of the head of this file."""
    return 1.0 / ((1.0 - share) / T_LOADS + share / T_SETPOINT)


def log_likelihood(record: Prepared, direction: int, gain_unit: float) -> FloatArray:
    """Tempered log-likelihood of every process of the grid, loads and noise summed over.

    direction : sign of the process gain. gain_unit : loop gains are counted by it (process_grid.gain_unit).
    Returns shape (shapes, dead times, gains); the largest is not zero: differences between records count.
    """
    no_tones = np.zeros((0, len(record.pv)))
    return np.asarray(log_likelihoods(record, direction, gain_unit, no_tones, (0,))[0][0])


def log_likelihoods(
    record: Prepared, direction: int, gain_unit: float, tones: FloatArray, ends: Sequence[int],
    lags: tuple[float, ...] = LAGS, asked: BoolArray | bool = True,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The log-likelihoods where the load holds so many of these tones besides (under_loads), of any size and phase.

    asked : processes that are asked for, shape (shapes, dead times, gains); others may be -inf.
    Returns shape (ends, shapes, dead times, gains); and where it holds as many as the first of ends, with loads of each
    of ORDERS by themselves, shape (orders, shapes, dead times, gains).
    """
    gains, late = direction * GAINS * units(lags) / gain_unit, np.array(DEAD_TIMES)
    asked = np.broadcast_to(asked, (len(gains), len(late), len(GAINS)))
    whole, spans = np.full((len(ends) + len(ORDERS), *asked.shape), -math.inf), spans_of(asked)
    each = ((lag, second) for lag in lags for second in range(len(second_lags(lag))))
    for at, (lag, second) in enumerate(each):
        loads, dead = LOADS_OF_BOOK if lag > 0 else BEHIND_LAGS, np.flatnonzero(asked[at].any(axis=1))
        if dead.size:
            deads, groups = late[dead].tolist(), _groups(loads, len(ends))
            fits = under_loads(record, record.co[None], lag, loads, deads, through=second, tones=tones, ends=ends)
            whole[:, at, dead] = fits.mixed(gains[at : at + 1], groups, spans[at : at + 1, dead])[:, 0]
    return whole[: len(ends)], whole[len(ends) :]


@cache
def _groups(loads: tuple[tuple[float, int], ...], ends: int) -> FloatArray:
    """All loads with each number of tones, then those of each order with the first number: all, where it has none."""
    first, orders = np.eye(ends)[0], np.array([order for _, order in loads])
    of_order = [np.where(any(orders == one), orders == one, True) for one in ORDERS]
    return np.vstack([np.tile(np.eye(ends), len(loads)), *(np.outer(one, first).ravel() for one in of_order)])
