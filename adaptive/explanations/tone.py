"""A tone from outside, in the load beside its walk: columns of a fit, whose size and phase are free.

A loop near instability swings at a frequency of its own, but loads that wander move it: it forgets its size and phase
within a few periods. A tone keeps its period. Without one among the hypotheses, a process on which the loop is just
unstable at its frequency, G(jw) = -1/C(jw), explains any tone. Three kinds, likely alike:

    line      one frequency, one size, one phase                                                               2 columns
    drifting  besides, one with the phase that the error had over TRACKED periods, in a mean, and that times its own
              frequency's distance from the line, since a filter turns each by another angle                   6 columns
              (where a window has fewer periods: with a size that grows or falls evenly, 4 columns)
    shaped    besides, where they stand out, its HARMONICS: pulses, saws and triangles               up to 12 columns

The frequency is that of the error's line that is highest over those around it: a setpoint step, or a load that
wanders, has the highest of all at the lowest frequencies. What was chosen by the record is paid for: the half of
ln(n/2) for a column and for a phase (Schwarz 1978), and the logarithm of the number of lines for the frequency. A tone
is paid for once: where a window has the line that the one before had, its frequency and size are known. Otherwise each
window would speak for a loop just unstable there, which explains the same swing in every window, and pays once.
"""

import math

import numpy as np

from retuner.adaptive.explanations.wandering_load import block_means
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass

FEWEST_PERIODS, FEWEST_SAMPLES = 1.5, 6
"""Fewest periods of a tone within a window, and samples to a period: others are how a load wanders, or noise."""
TRACKED = 2.0
"""Periods over which the phase of a drifting tone is a mean; the periods of other loops' cycles are not all alike."""
HARMONICS, FEWEST_OF_HARMONIC = 4, 4  # Up to which a tone has harmonics, and samples to a period of one
STANDS_OUT = 1.0  # logarithm of a harmonic's height over the lines half way to its neighbours from which it is there
FINER = 16  # times that lines are looked at closer than those of a Fourier series lie
AROUND, LEAST = 4, 1e-9
"""Factor on both sides of a line's frequency within which it is compared; least share of the most that a line has."""


GOES_ON, BESIDE = 1.0, 2.0
"""Price of each of the two numbers of a line that goes on, twice what one explains of noise (Akaike 1974); and lines
that it may be."""


@dataclass(frozen=True, slots=True)
class ToneColumns:
    """columns : of a fit, shape (number, n). taken : how many of them no tone, a line, a drifting one and, where its
    harmonics stand out, one with these take. prices : of each, as a logarithm that is not tempered. period_s : of the
    line; 0 where there is none. goes_on : whether it is the line that was known.
    """

    columns: FloatArray
    taken: tuple[int, ...]
    prices: tuple[float, ...]
    period_s: float = 0.0
    goes_on: bool = False


def tone_of(window: Window, interval_s: float, known_s: float = 0.0) -> ToneColumns:
    """likeliest_tone of a window that is condensed to this interval. known_s : period in s of the window before."""
    window = window.on_even_clock()  # as Prepared.at has it
    n = max(round(interval_s / window.sample_time_s), 1)
    return likeliest_tone(block_means(window.sp - window.pv, n), interval_s, known_s)


def likeliest_tone(error: FloatArray, interval_s: float = 1.0, known_s: float = 0.0) -> ToneColumns:
    """The tone of a window. error : setpoint less pv, shape (n,). known_s : period of the tone before; 0 for none."""
    n, away = len(error), error - np.mean(error)
    length = FINER << (n - 1).bit_length()
    first = math.ceil(FEWEST_PERIODS * length / n)
    least = LEAST * float(np.sum(np.abs(away))) or np.finfo(np.float64).tiny  # an even error has no line
    size = np.log(np.abs(np.fft.rfft(away * np.hanning(n), length)) + least)
    lines, upto = np.arange(first, length // FEWEST_SAMPLES), np.concatenate([[0.0], np.cumsum(size)])
    low, high = lines // AROUND, np.minimum(lines * AROUND, len(size))
    over = first + int(np.argmax(size[lines] - (upto[high] - upto[low]) / (high - low)))
    wide = max(over - FINER, first)
    top = wide + int(np.argmax(size[wide : over + FINER]))
    turned, mean_over = 2.0 * math.pi * top / length * np.arange(n), round(TRACKED * length / top)
    line, phases = np.array([np.cos(turned), np.sin(turned)]), 0.0
    besides = line * np.linspace(-1.0, 1.0, n)
    if mean_over + 2 <= n:
        off = np.unwrap(np.angle(np.convolve(away * np.exp(-1j * turned), np.hanning(mean_over + 2), "same")))
        drifting, phases = np.array([np.cos(turned + off), np.sin(turned + off)]), 2.0 * n / mean_over
        besides = np.vstack([drifting, drifting * np.gradient(off)])
    kept = turned + (off if phases else 0.0)
    near = np.arange(-FINER, FINER)
    higher = [
        at
        for at in range(2, HARMONICS + 1)
        if at * top * FEWEST_OF_HARMONIC <= length
        and np.max(size[at * top + near]) - np.max(size[[at * top + near + side * (top // 2) for side in (-1, 1)]])
        > STANDS_OUT
    ]
    repeats = [wave(at * kept) for at in higher for wave in (np.cos, np.sin)]
    column, period_s = 0.5 * math.log(n / 2.0), length / top * interval_s
    goes_on = known_s > 0.0 and abs(1.0 / period_s - 1.0 / known_s) * n * interval_s <= 1.0
    chosen = math.log(BESIDE if goes_on else n / FEWEST_SAMPLES)
    line_costs = 2.0 * (GOES_ON if goes_on else column) + chosen
    taken = (2 + len(besides), *((2 + len(besides) + len(repeats),) if repeats else ()))
    prices = (0.0, line_costs, *(line_costs + (number - 2 + phases) * column for number in taken))
    return ToneColumns(np.vstack([line, besides, *repeats]), (0, 2, *taken), prices, period_s, goes_on)
