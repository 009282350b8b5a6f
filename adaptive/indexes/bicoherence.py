"""Bicoherence: do the harmonics of a signal hang together, as only a non-linearity makes them?

    bic^2(f1, f2) = |E[X(f1) X(f2) X*(f1+f2)]|^2 / (E|X(f1) X(f2)|^2 E|X(f1+f2)|^2),   0 to 1

over half-overlapping Hann windows. Phases of a linear process driven by Gaussian noise are independent: bic^2 is then
about 1 / K, K the number of independent windows; 2 K bic^2 is chi-square with 2 degrees of freedom in each of L bins.

    NGI  = mean(bic^2) - chi2(2 L, 99 %) / (2 K L)         non-Gaussianity index, above 0.001: not Gaussian
    NLI  = max(bic^2) - (mean + 2 std)                     non-linearity index, above 0.01 with NGI: not linear
    TNLI = sum of the bic^2 beyond chi2(2, 99 %) / (2 K)   total non-linearity, grows with its strength

all over the principal domain (f2 <= f1, f1 + f2 below half the sampling rate). Waves with equal halves (triangle,
square, what a sticking valve alone makes) have odd harmonics only, whose bicoherence is zero: a small index acquits
nothing.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.autocovariance import detrended
from retuner.adaptive.signals.sample import FloatArray

SEGMENT = 64
"""Samples per window (Choudhury, Shah & Thornhill 2004)."""
FEWEST_SEGMENTS = 8
"""Fewer windows give no expectation."""
MOST_SEGMENTS = 200
"""Longer records are thinned to so many windows: the rest adds time and no insight."""
CHI2_99 = 9.210
"""99 % point of chi-square with 2 degrees of freedom."""
NORMAL_99 = 2.326
"""The same of the normal distribution."""
INDEPENDENT = 0.9
"""Share of half-overlapping Hann windows that counts as independent for products of three spectra."""
INDEPENDENT_BINS = 0.3
"""Share of the bins that counts as independent: a Hann window ties neighbours together."""


@dataclass(frozen=True, slots=True)
class Bicoherence:
    """Indexes of one signal; see the head of this file."""

    ngi: float
    nli: float
    total: float

    @property
    def nonlinear(self) -> bool:
        """Whether both indexes pass the limits of Choudhury, Shah & Thornhill (2004)."""
        return self.ngi > 0.001 and self.nli > 0.01


def bicoherence(x: FloatArray, segment: int = SEGMENT) -> Bicoherence | None:
    """Bicoherence indexes of a signal, shape (n,); None when it is too short (n < 4.5 segments) or constant.

    x : signal, sampled so that a period of interest has 4 to 30 samples: see `thinned`.

    Sources: Choudhury, Shah & Thornhill (2004), Automatica 40, 1719-1728; the same (2008), Diagnosis of Process
    Nonlinearities and Valve Stiction, Springer, section 6.3.
    """
    starts = np.arange(0, len(x) - segment + 1, segment // 2)
    if len(starts) < FEWEST_SEGMENTS:
        return None
    starts = starts[:: -(-len(starts) // MOST_SEGMENTS)]
    flat = detrended(x)
    if not np.any(np.abs(flat) > 1e-12 * float(np.max(np.abs(x), initial=0.0))):
        return None
    pieces = np.lib.stride_tricks.sliding_window_view(flat, segment)[starts]
    spectra = np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * np.hanning(segment), axis=1)
    bic2 = _bic2(np.asarray(spectra / max(float(np.std(flat)), 1e-300), dtype=np.complex128), segment)
    windows = INDEPENDENT * len(starts)
    freedom = 2 * INDEPENDENT_BINS * len(bic2)
    point = (1 - 2 / (9 * freedom) + NORMAL_99 * (2 / (9 * freedom)) ** 0.5) ** 3  # Wilson & Hilferty (1931)
    strong = bic2[bic2 > CHI2_99 / (2 * windows)]
    ngi = float(np.mean(bic2)) - point / windows
    nli = max(float(np.max(bic2) - (np.mean(bic2) + 2 * np.std(bic2))), 0.0)
    return Bicoherence(ngi, nli, float(np.sum(strong)))


def thinned(x: FloatArray, period: float) -> FloatArray:
    """The signal averaged over so many samples that a period (in samples) has about 16 of them."""
    every = max(int(period / 16), 1)
    kept = len(x) // every * every
    return np.asarray(x[:kept].reshape(-1, every).mean(axis=1), dtype=np.float64)


@lru_cache(maxsize=4)
def _domain(segment: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Frequencies f1, f2 of the principal domain."""
    half = segment // 2
    f1, f2 = np.meshgrid(np.arange(1, half), np.arange(1, half), indexing="ij")
    inside = (f2 <= f1) & (f1 + f2 < half)
    return f1[inside], f2[inside]


def _bic2(spectra: npt.NDArray[np.complex128], segment: int) -> FloatArray:
    """Squared bicoherence on the principal domain; bins without power are 0."""
    f1, f2 = _domain(segment)
    pair, third = spectra[:, f1] * spectra[:, f2], spectra[:, f1 + f2]
    cross = np.abs(np.mean(pair * third.conj(), axis=0)) ** 2
    power = np.mean(np.abs(pair) ** 2, axis=0) * np.mean(np.abs(third) ** 2, axis=0)
    floor = 1e-9 * float(np.max(power))
    return np.asarray(np.where(power > floor, cross / np.maximum(power, floor), 0.0), dtype=np.float64)
