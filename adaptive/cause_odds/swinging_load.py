"""A load that swings and forgets its phase: how likely it makes each process, beside one that wanders alone.

    pv = K x + (z + v)/R,     R = (1 - 2 r cos w q + r^2 q^2) / (1 - 2 s cos w q + s^2 q^2),     r < 1, s < r

z + v as in wandering_load.py; 1/R lets the rest of a record swing at w. R is monic and stable, so that pv and x through
it have the likelihood of pv itself; w is the frequency at which the whitened pv moves most. Without R only a loop near
instability swings, whatever swings in the plant: of 6 good loops under narrow bands and tones that setpoint steps moved
as well, 5 were told as too tight by 51 to 99 %, and 1 is with it; of 6 loops under other loads none turned.

A loop near instability and a good loop under such a load are the same series where nothing but the load moves them (of
4 tight loops under real loads one was explained away). So it is asked only where the setpoint moves the record.
"""

import math
from dataclasses import replace

import numpy as np

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, LAGS, second_lags, shapes, units
from retuner.adaptive.explanations.wandering_load import (
    AT_PV,
    TEMPER,
    VALUE,
    Prepared,
    filtered,
    impulse_response,
    likeliest_load,
    spectrum,
    under_loads,
)
from retuner.adaptive.indexes.autocovariance import regularity
from retuner.adaptive.signals.sample import FloatArray, median

LOADS = (*((one, VALUE) for one in (0.02, 0.1, 0.4, 1.6, math.inf)), *((one, AT_PV) for one in (0.1, 0.8, math.inf)))
"""Walks beside it: every third of those that are tried where nothing swings."""
NARROW, WIDER = (0.01, 0.1), 12.0  # -ln r as a share of w, and how many times as much -ln s is
FEWEST_PERIODS, FEWEST_SAMPLES, FINER = 3, 6, 8
"""Periods in a record, samples to a period, and how much closer than those of a Fourier series lines are looked at."""
STANDS_OUT = 20.0
"""Power of the largest line over the middle one, in halves of a record, from which a record swings whose error does not
do so regularly: 27 and more in 8 of 9 loops under such loads, 14 and less in 11 of 12 others that are robust.
"""


def swing_frequency(record: Prepared, setpoint: FloatArray, likelihood: FloatArray) -> float | None:
    """w of the head of this file, rad per sample; None where nothing swings.

    setpoint : from its first value, shape (n,). likelihood : of the grid's processes; the likeliest whitens.
    """
    row = int(np.unravel_index(int(np.argmax(likelihood)), likelihood.shape)[0])
    load, n = likeliest_load(record, shapes()[row].lag)[0], len(record.pv)
    white = filtered(spectrum(record.pv), n, impulse_response(load.a, load.c, n))
    half = n // 2
    parts = np.array([white[first : first + half] for first in range(0, n - half + 1, half // 2)]) * np.hanning(half)
    power = np.sum(np.abs(np.fft.rfft(parts)) ** 2, axis=0)[FEWEST_PERIODS - 1 :]
    wave = regularity(setpoint - record.pv)
    if float(np.max(power)) < STANDS_OUT * median(power) and (wave is None or not wave.lasting):
        return None
    length = FINER << (n - 1).bit_length()
    first = math.ceil(FEWEST_PERIODS * length / n)
    size = np.abs(np.fft.rfft(white * np.hanning(n), length))[first : length // FEWEST_SAMPLES]
    return 2.0 * math.pi * (first + int(np.argmax(size))) / length


def likelihood_swinging(record: Prepared, direction: int, gain_unit: float, w: float) -> FloatArray:
    """Tempered log-likelihood of every process of the grid, as log_likelihood gives it, where the load swings at w."""
    gains, n = direction * GAINS * units() / gain_unit, len(record.pv)
    found = []
    for narrow in NARROW:
        near = max(narrow * w, 1.0 / n)
        far = min(WIDER * near, 1.0)
        top, bottom = ((1.0, -2.0 * math.exp(-b) * math.cos(w), math.exp(-2.0 * b)) for b in (near, far))
        pv, co = filtered(spectrum(np.array([record.pv, record.co])), n, impulse_response(top, bottom, n))
        through = replace(record, pv=pv, co=co)
        rows = [
            under_loads(through, co[None], lag, LOADS, DEAD_TIMES, through=second)
            for lag in LAGS
            for second in range(len(second_lags(lag)))
        ]
        larger = (n - len(LOADS)) / (2.0 * TEMPER) * math.log(float(np.var(pv)) / float(np.var(record.pv)))
        found.append(np.stack([fits.mixed(gains[i : i + 1])[0, 0] for i, fits in enumerate(rows)]) - larger)
    return np.asarray(np.logaddexp(*found) - math.log(len(NARROW)))
