"""Shape of the half waves of an oscillation: sine, triangle, or relay response?

Each half wave between two zero crossings is brought to unit length and fitted, its height free, with

    sine       sin(pi s)
    triangle   two straight lines with the apex at a free place
    relay      1 - e^(-s/tau) up to s* = tau ln((1 + e^(1/tau)) / 2), then -1 + (2 - e^(-s*/tau)) e^(-(s - s*)/tau)

the last being the first-order answer to a square wave, from a triangle (tau large) to a square (tau small). What a
sticking valve moves is a square wave: co of a PI loop (or pv of an integrating process) then is a triangle and pv a
relay response, while a linear loop at its limit and an outside tone give sines.

    triangle index = mse_sine / (mse_sine + mse_triangle)            He et al. 2007: above 0.6 stiction, below 0.4 not
    relay index    = (rms_sine - rms_best) / (rms_sine + rms_best)   Rossi & Scali 2005: above 0.21 stiction, below 0
                     best: the better of relay and triangle          not

Here the apex is scanned instead of solved for, and the mean squares are taken over all half waves, so that one odd half
wave does not decide.
"""

from dataclasses import dataclass

import numpy as np

from retuner.adaptive.indexes.autocovariance import crossings
from retuner.adaptive.signals.sample import FloatArray

POINTS = 41
"""Points per half wave after resampling."""
FEWEST_SAMPLES = 4.0
"""A half wave of fewer samples has no shape."""
FEWEST_HALF_WAVES = 4
"""Two full periods."""
SHORT = 0.4
"""Half waves shorter than this share of the median are noise or a drift across zero."""
SMALLEST_MISFIT = 1e-9
"""Mean square below which a fit is exact (of a half wave of unit height), so that 0/0 does not arise."""


@dataclass(frozen=True, slots=True)
class HalfWaveShape:
    """Shape of the half waves of one signal.

    triangle_index : 0 sine to 1 triangle. relay_index : -1 sine to 1 relay response or triangle. half_waves : how many.
    asymmetry : median |apex - 0.5| of the best triangles, 0 to 0.4: 0 for symmetric waves, large for a saw.
    """

    triangle_index: float
    relay_index: float
    half_waves: int
    asymmetry: float


def half_wave_shape(x: FloatArray, band: float) -> HalfWaveShape | None:
    """Judge the half waves of a signal without level and drift; None with fewer than four of them.

    Parameters
    ----------
    x : signal round zero, shape (n,). band : half width of its noise band, units of x.

    Sources: He, Wang, Pottmann & Qin (2007), Ind. Eng. Chem. Res. 46, 4549-4560; Rossi & Scali (2005), Journal of
    Process Control 15, 505-514.
    """
    waves = _waves(x, crossings(x, band))
    if len(waves) < FEWEST_HALF_WAVES:
        return None
    power = np.sum(waves * waves, axis=1)
    sine = _misfit(waves, power, _SINE)
    triangle = _misfit(waves, power, _TRIANGLES)
    relay = _misfit(waves, power, _RELAYS)
    mse = [float(np.mean(np.min(m, axis=1) / power)) + SMALLEST_MISFIT for m in (sine, triangle, relay)]
    best = min(mse[1], mse[2]) ** 0.5
    apex = np.abs(_APEX[np.argmin(triangle, axis=1)] - 0.5)
    index = mse[0] / (mse[0] + mse[1])
    return HalfWaveShape(index, (mse[0] ** 0.5 - best) / (mse[0] ** 0.5 + best), len(waves), float(np.median(apex)))


def _waves(x: FloatArray, at: FloatArray) -> FloatArray:
    """Half waves on POINTS points each, zero at both ends, upside up; shape (m, POINTS)."""
    lengths = np.diff(at)
    if not lengths.size:
        return np.zeros((0, POINTS))
    typical = float(np.median(lengths))
    kept = (lengths >= max(FEWEST_SAMPLES, SHORT * typical)) & (lengths <= typical / SHORT)
    starts, lengths = at[:-1][kept], lengths[kept]
    places = starts[:, None] + lengths[:, None] * _S[None, :]
    waves = np.interp(places.ravel(), np.arange(len(x)), x).reshape(places.shape)
    waves[:, [0, -1]] = 0.0
    waves = waves * np.sign(np.sum(waves, axis=1, keepdims=True))
    return np.asarray(waves[np.sum(waves * waves, axis=1) > 0], dtype=np.float64)


def _misfit(waves: FloatArray, power: FloatArray, shapes: FloatArray) -> FloatArray:
    """Sum of squares that each unit shape leaves of each half wave, its height free; shape (m, number of shapes)."""
    heights = waves @ shapes.T
    return np.asarray(np.maximum(power[:, None] - heights * heights, 0.0), dtype=np.float64)


def _unit(shapes: FloatArray) -> FloatArray:
    """Shapes as rows of unit length."""
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
