"""A record whose whole excitation is a tone, in a loop whose setpoint stands: it shows the controller, not the process.

Whatever swings pv, co follows it by the controller's law, co = -C pv, at this one frequency alone. A process that has
-1/C there explains both as well as the true one beside a tone from outside: two numbers for three unknowns at best, and
they are the controller's.
"""

import math

import numpy as np

from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window

PADDED = 4  # zero padding of the spectrum: peaks to a quarter of a line


FEWEST_CYCLES = 4.0  # of the tone in the record
EXPLAINED = 0.95  # share of pv's variance that the tone must explain
LEFT_NOISE, LEAST = 1.5, 0.5
"""What it leaves as a multiple of pv's noise, at which it explains all, and the share that it must explain then."""


def one_tone(window: Window) -> float | None:
    """Period in s of the tone that is all that moves pv while the setpoint stands still; None where there is more."""
    pv, n = window.pv, len(window.pv)
    if np.ptp(window.sp) > 0 or np.ptp(pv) == 0:
        return None
    away = np.asarray(pv - np.mean(pv), dtype=np.float64)
    power = np.abs(np.fft.rfft(away * np.hanning(n), PADDED * n))
    line = int(np.argmax(power))
    cycles = line / PADDED
    if not FEWEST_CYCLES <= cycles <= n / 4:
        return None
    tried = np.linspace(cycles - 0.5, cycles + 0.5, 4 * PADDED + 1)
    left = [_left(away, f) for f in tried.tolist()]
    best = int(np.argmin(left))
    share = 1.0 - left[best] / float(np.mean(away**2))
    all_but_noise = math.sqrt(left[best]) <= LEFT_NOISE * noise_sigma(pv) and share >= LEAST
    if share < EXPLAINED and not all_but_noise:
        return None
    return float(window.t_s[-1] - window.t_s[0]) * n / (n - 1) / float(tried[best])


def _left(away: FloatArray, cycles: float) -> float:
    """Mean square that a tone of so many cycles leaves, beside a level and a slope."""
    phase = 2 * np.pi * cycles * np.arange(len(away)) / len(away)
    columns = np.stack([np.sin(phase), np.cos(phase), np.ones(len(away)), np.linspace(-1.0, 1.0, len(away))], axis=1)
    rest = away - columns @ np.linalg.lstsq(columns, away, rcond=None)[0]
    return float(np.mean(rest**2))
