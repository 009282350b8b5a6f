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

import numpy as np
import numpy.typing as npt

from retuner.adaptive.indexes.autocovariance import crossings, detrended
from retuner.adaptive.signals.sample import FloatArray, least_squares, median
from retuner.schedule.late_dataclass import dataclass

HARMONICS = 5  # highest harmonic fitted
SAMPLES_PER_PERIOD = 3.0  # A harmonic needs this many samples in its period to be told from its aliases
SEARCH_CYCLES = 0.75  # how far the frequency is looked for round the first guess, in cycles over the record


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
    dt = median(np.diff(t_s))
    highest = min(HARMONICS, int(2 * math.pi / (w_rad_s * dt * SAMPLES_PER_PERIOD)))
    x = np.stack([detrended(s) for s in signals], axis=1)
    power = np.mean(x * x, axis=0)
    if highest < 1 or float(np.min(power)) <= 0:
        return None
    angles = np.outer(t, w_rad_s * np.arange(1, highest + 1))
    columns = np.concatenate([np.ones((len(t), 1)), t[:, None] / t[-1], np.cos(angles), np.sin(angles)], axis=1)
    found = least_squares(columns, x)
    phasors = found[2 : 2 + highest] - 1j * found[2 + highest :]
    told = []
    for j in range(len(signals)):
        own = np.asarray(phasors[:, j], dtype=np.complex128)
        a = np.zeros(HARMONICS)
        a[:highest] = np.abs(own)
        first = max(float(a[0]), 1e-300)
        third, distortion, even = (float(x) / first for x in (a[2], np.linalg.norm(a[1:]), np.linalg.norm(a[[1, 3]])))
        told.append(Tone(first, min(first * first / 2 / float(power[j]), 1.0), third, distortion, even, own))
    return told


def phase_deg(pv: Tone, co: Tone, direction: int) -> float:
    """Phase of pv against co at the fundamental in degrees, -270 to 90; direction : sign of the process gain."""
    angle = math.degrees(float(np.angle(direction * pv.phasors[0] / co.phasors[0])))
    return angle - 360 if angle > 90 else angle


FEWEST_CYCLES = 3  # cycles of a tone that is told by itself
PADDED = 4
PURE = 0.9  # Share of a signal's movement from which one sinusoid is what moves it


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


# ---- Shape of the half waves of an oscillation: sine, triangle, or relay response?
#
# Each half wave between two zero crossings is brought to unit length and fitted, its height free, with
#
#     sine       sin(pi s)
#     triangle   two straight lines with the apex at a free place
#     relay      1 - e^(-s/tau) up to s* = tau ln((1 + e^(1/tau)) / 2), then -1 + (2 - e^(-s*/tau)) e^(-(s - s*)/tau)
#
# the last being the first-order answer to a square wave, from a triangle (tau large) to a square (tau small). What a
# sticking valve moves is a square wave: co of a PI loop (or pv of an integrating process) then is a triangle and pv a
# relay response, while a linear loop at its limit and an outside tone give sines.
#
#     triangle index = mse_sine / (mse_sine + mse_triangle)            He et al. 2007: above 0.6 stiction, below 0.4 not
#     relay index    = (rms_sine - rms_best) / (rms_sine + rms_best)   Rossi & Scali 2005: above 0.21 stiction, below 0
#                      best: the better of relay and triangle          not
#
# Here the apex is scanned instead of solved for, and the mean squares are taken over all half waves, so that one
# odd half wave does not decide.

POINTS = 41  # points per half wave after resampling
FEWEST_SAMPLES = 4.0  # A half wave of fewer samples has no shape
FEWEST_HALF_WAVES = 4  # two full periods
SHORT = 0.4  # half waves shorter than this share of the median are noise or a drift across zero
SMALLEST_MISFIT = 1e-9
"""Mean square below which a fit is exact (of a half wave of unit height), so that 0/0 does not arise."""


@dataclass(frozen=True, slots=True)
class HalfWaveShape:
    """Shape of the half waves of one signal.

    triangle_index : 0 sine to 1 triangle. relay_index : -1 sine to 1 relay response or triangle.
    asymmetry : median |apex - 0.5| of the best triangles, 0 to 0.4: 0 for symmetric waves, large for a saw.
    """

    triangle_index: float
    relay_index: float
    asymmetry: float


def half_wave_shape(x: FloatArray, band: float) -> HalfWaveShape | None:
    """Judge the half waves of a signal without level and drift; None with fewer than four of them.

    x : signal round zero, shape (n,). band : half width of its noise band, units of x.

    Sources: He, Wang, Pottmann & Qin (2007), Ind. Eng. Chem. Res. 46, 4549-4560; Rossi & Scali (2005), Journal of
    Process Control 15, 505-514.
    """
    waves = _waves(x, crossings(x, band))
    if len(waves) < FEWEST_HALF_WAVES:
        return None
    power = np.sum(waves * waves, axis=1)
    # the sum of squares that each unit shape leaves of each half wave, its height free
    heights = [waves @ shapes.T for shapes in (_SINE, _TRIANGLES, _RELAYS)]
    left = [np.maximum(power[:, None] - of * of, 0.0) for of in heights]
    mse = [float(np.mean(np.min(m, axis=1) / power)) + SMALLEST_MISFIT for m in left]
    best = min(mse[1], mse[2]) ** 0.5
    apex = np.abs(_APEX[np.argmin(left[1], axis=1)] - 0.5)
    index = mse[0] / (mse[0] + mse[1])
    return HalfWaveShape(index, (mse[0] ** 0.5 - best) / (mse[0] ** 0.5 + best), median(apex))


def _waves(x: FloatArray, at: FloatArray) -> FloatArray:
    """Half waves on POINTS points each, zero at both ends, upside up; shape (m, POINTS)."""
    lengths = np.diff(at)
    if not lengths.size:
        return np.zeros((0, POINTS))
    typical = median(lengths)
    kept = (lengths >= max(FEWEST_SAMPLES, SHORT * typical)) & (lengths <= typical / SHORT)
    starts, lengths = at[:-1][kept], lengths[kept]
    places = starts[:, None] + lengths[:, None] * _S[None, :]
    waves = np.interp(places.ravel(), np.arange(len(x)), x).reshape(places.shape)
    waves[:, [0, -1]] = 0.0
    waves = waves * np.sign(np.sum(waves, axis=1, keepdims=True))
    return np.asarray(waves[np.sum(waves * waves, axis=1) > 0], dtype=np.float64)


def _unit(shapes: FloatArray) -> FloatArray:
    return np.asarray(shapes / np.linalg.norm(shapes, axis=1, keepdims=True), dtype=np.float64)


def _relays(tau: FloatArray) -> FloatArray:
    """Relay responses for time constants in half periods."""
    tau = tau[:, None]
    switch = tau * (np.logaddexp(0.0, 1 / tau) - np.log(2.0))
    rise = 1 - np.exp(-_S / tau)
    peak = 1 - np.exp(-switch / tau)
    fall = -1 + (1 + peak) * np.exp(-np.maximum(_S - switch, 0.0) / tau)
    return np.asarray(np.where(switch > _S, rise, fall), dtype=np.float64)


_S = np.linspace(0.0, 1.0, POINTS)
_APEX = np.linspace(0.1, 0.9, 17)
_SINE = _unit(np.sin(np.pi * _S)[None, :])
_TRIANGLES = _unit(np.minimum(_S / _APEX[:, None], (1 - _S) / (1 - _APEX[:, None])))
_RELAYS = _unit(_relays(np.geomspace(0.03, 3.0, 13)))
