"""A tone from outside, in the load beside its walk: columns of a fit, whose size and phase are free.

A loop near instability swings at a frequency of its own, but loads that wander move it: it forgets its size and phase
within a few periods. A tone keeps its period. Without one among the hypotheses, a process on which the loop is just
unstable at its frequency, G(jw) = -1/C(jw), explains any tone. Two kinds, likely alike:

    line      one frequency, a size and a phase that change evenly: what the window's own lines tell of the frequency is
              off by a share of a line, and what that leaves of a tone passed for a loop near instability     4 columns
    drifting  besides, one with the phase that the error had over TRACKED periods, in a mean, and that times its own
              frequency's distance from the line, since a filter turns each by another angle (where the window has as
              many)                                                                                           8 columns

The frequency is that of the error's line that is highest over those around it: a setpoint step, or a load that
wanders, has the highest of all at the lowest frequencies. What was chosen by the record is paid for: the half of
ln(n/2) for a column and for a phase (Schwarz 1978), and the logarithm of the number of lines for the frequency.
"""

import math

import numpy as np

from retuner.adaptive.signals.sample import FloatArray

FEWEST_PERIODS, FEWEST_SAMPLES = 1.5, 6
"""Fewest periods of a tone within a window, and samples to a period: others are how a load wanders, or noise."""
TRACKED = 2.0
"""Periods over which the phase of a drifting tone is a mean; the periods of other loops' cycles are not all alike."""
FINER = 16  # times that lines are looked at closer than those of a Fourier series lie
AROUND, LEAST = 4, 1e-9
"""Factor on both sides of a line's frequency within which it is compared; least share of the most that a line has."""


def likeliest_tone(error: FloatArray) -> tuple[FloatArray, tuple[int, int, int], tuple[float, float, float]]:
    """The columns of a window's tone, shape (number, n); how many of them no tone, a line and a drifting one take; and
    the price of each, as a logarithm that is not tempered. error : setpoint less pv, shape (n,).
    """
    n, away = len(error), error - np.mean(error)
    top, length = _line(away)
    turned, mean_over = 2.0 * math.pi * top / length * np.arange(n), round(TRACKED * length / top)
    line, phases = np.array([np.cos(turned), np.sin(turned)]), 0.0
    line = besides = np.vstack([line, line * np.linspace(-1.0, 1.0, n)])
    if mean_over + 2 <= n:
        off = np.unwrap(np.angle(np.convolve(away * np.exp(-1j * turned), np.hanning(mean_over + 2), "same")))
        drifting, phases = np.array([np.cos(turned + off), np.sin(turned + off)]), 2.0 * n / mean_over
        besides = np.vstack([line, drifting, drifting * np.gradient(off)])
    column, chosen, few, many = 0.5 * math.log(n / 2.0), math.log(n / FEWEST_SAMPLES), len(line), len(besides)
    return besides, (0, few, many), (0.0, few * column + chosen, (many + phases) * column + chosen)


def tone_seen(error: FloatArray) -> tuple[float, float]:
    """The frequency of the likeliest tone, rad per sample, and the standard deviation that it gives the error."""
    top, length = _line(error - np.mean(error))
    basis = np.linalg.qr(likeliest_tone(error)[0].T)[0]
    return 2.0 * math.pi * top / length, float(np.std(basis @ (basis.T @ (error - np.mean(error)))))


def _line(away: FloatArray) -> tuple[int, int]:
    """The line that is highest over those around it, of so many to a turn. away : an error less its mean."""
    n = len(away)
    length = FINER << (n - 1).bit_length()
    first = math.ceil(FEWEST_PERIODS * length / n)
    least = LEAST * float(np.sum(np.abs(away))) or np.finfo(np.float64).tiny  # an even error has no line
    size = np.log(np.abs(np.fft.rfft(away * np.hanning(n), length)) + least)
    lines, upto = np.arange(first, length // FEWEST_SAMPLES), np.concatenate([[0.0], np.cumsum(size)])
    low, high = lines // AROUND, np.minimum(lines * AROUND, len(size))
    over = first + int(np.argmax(size[lines] - (upto[high] - upto[low]) / (high - low)))
    wide = max(over - FINER, first)
    return wide + int(np.argmax(size[wide : over + FINER])), length
