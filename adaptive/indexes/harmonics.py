"""One tone and its harmonics: how pure an oscillation is, and how pv stands to co in it.

    x = level + slope t + sum_k a_k cos(k w t) + b_k sin(k w t),   k = 1..5,   by least squares

    tone share   variance of the fundamental / variance of x without level and slope
    third        A_3 / A_1,   A_k = sqrt(a_k^2 + b_k^2)        sine 0, triangle 1/9, square 1/3
    distortion   sqrt(A_2^2 + ... + A_5^2) / A_1               sine 0, triangle 0.118, square 0.389
    even         sqrt(A_2^2 + A_4^2) / A_1                     0 for waves with equal halves; a saw has 0.56

The phase of pv against co at w is that of the process itself where the loop makes the oscillation: near -180 degrees
(times the sign of the process) at the stability limit of a P loop, -90 and less with much integral action.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.autocovariance import detrended
from retuner.adaptive.signals.sample import FloatArray

HARMONICS = 5
"""Highest harmonic fitted."""
SAMPLES_PER_PERIOD = 3.0
"""A harmonic needs this many samples in its period to be told from its aliases."""
SEARCH_CYCLES = 0.75
"""How far the frequency is looked for round the first guess, in cycles over the record."""


@dataclass(frozen=True, slots=True)
class Tone:
    """The oscillation of one signal; see the head of this file. amplitude : A_1 in the signal's units."""

    amplitude: float
    share: float
    third: float
    distortion: float
    even: float
    phasors: npt.NDArray[np.complex128]


def refined_frequency(t_s: FloatArray, x: FloatArray, w_rad_s: float) -> float:
    """The frequency near w at which a tone explains most of x, rad/s; t_s, x of shape (n,).

    The periodogram is evaluated on a fine grid of SEARCH_CYCLES either side, its peak refined by a parabola.
    """
    span = float(t_s[-1] - t_s[0])
    reach = min(2 * math.pi * SEARCH_CYCLES / span, 0.3 * w_rad_s)
    w = w_rad_s + np.linspace(-reach, reach, 25)
    power = np.abs(np.exp(-1j * np.outer(w, t_s - t_s[0])) @ detrended(x)) ** 2
    i = int(np.clip(np.argmax(power), 1, len(w) - 2))
    left, top, right = (float(power[j]) for j in (i - 1, i, i + 1))
    bend = left - 2 * top + right
    shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float(w[i] + np.clip(shift, -1.0, 1.0) * (w[1] - w[0]))


def tones(t_s: FloatArray, w_rad_s: float, *signals: FloatArray) -> list[Tone] | None:
    """Fit fundamental and harmonics to signals that share the frequency w; None when a signal is constant.

    Harmonics of fewer than three samples a period are left out. t_s and each signal of shape (n,).
    """
    t = t_s - t_s[0]
    dt = float(np.median(np.diff(t_s)))
    highest = min(HARMONICS, int(2 * math.pi / (w_rad_s * dt * SAMPLES_PER_PERIOD)))
    x = np.stack([detrended(s) for s in signals], axis=1)
    power = np.mean(x * x, axis=0)
    if highest < 1 or float(np.min(power)) <= 0:
        return None
    angles = np.outer(t, w_rad_s * np.arange(1, highest + 1))
    columns = np.concatenate([np.ones((len(t), 1)), t[:, None] / t[-1], np.cos(angles), np.sin(angles)], axis=1)
    found = np.linalg.lstsq(columns, x, rcond=None)[0]
    phasors = found[2 : 2 + highest] - 1j * found[2 + highest :]
    return [_tone(np.asarray(phasors[:, j], dtype=np.complex128), float(power[j])) for j in range(len(signals))]


def _tone(phasors: npt.NDArray[np.complex128], power: float) -> Tone:
    a = np.zeros(HARMONICS)
    a[: len(phasors)] = np.abs(phasors)
    first = max(float(a[0]), 1e-300)
    share = min(first * first / 2 / power, 1.0)
    return Tone(
        first,
        share,
        float(a[2]) / first,
        float(np.linalg.norm(a[1:])) / first,
        float(np.linalg.norm(a[[1, 3]])) / first,
        phasors,
    )


def phase_deg(pv: Tone, co: Tone, direction: int) -> float:
    """Phase of pv against co at the fundamental in degrees, -270 to 90; direction : sign of the process gain."""
    angle = math.degrees(float(np.angle(direction * pv.phasors[0] / co.phasors[0])))
    return angle - 360 if angle > 90 else angle


FEWEST_CYCLES = 3
"""Cycles of a tone that is told by itself."""
PADDED = 4
PURE = 0.9
"""Share of a signal's movement from which one sinusoid is what moves it."""


def pure_tone_s(t_s: FloatArray, x: FloatArray) -> float | None:
    """Period of the one sinusoid that a signal consists of, in seconds; None where it is something else.

    Three cycles are enough for that, where its regularity cannot be counted yet. t_s, x : shape (n,).
    """
    n, span_s = len(x), float(t_s[-1] - t_s[0])
    power = np.abs(np.fft.rfft(detrended(x) * np.hanning(n), PADDED * n)) ** 2
    first = FEWEST_CYCLES * PADDED - PADDED // 2
    peak = first + int(np.argmax(power[first:]))
    w = refined_frequency(t_s, x, 2 * math.pi * peak / (PADDED * span_s))
    found = tones(t_s, w, x)
    if found is None or found[0].share < PURE or w * span_s < 2 * math.pi * FEWEST_CYCLES:
        return None
    return 2 * math.pi / w
