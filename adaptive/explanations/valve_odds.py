"""Does a valve between co and the process make a record likelier, with a load that wanders on top?

    ln B = ln mean over valves of L(record | valve, process, load)  -  ln L(record | co itself, process, load)

A valve that sticks moves in jumps, and a jump through the process is what no walk makes. Both sides are the likelihood
of wandering_load.py, tempered alike. The mean over valves is the price of their numbers. Half of it is play and valves
that follow after a slip, on a coarse grid; the other half valves that slip all the way to co (He et al. 2007, J = S).
There each slip decides when the next one comes, so a band that is off by a twentieth makes another movement
altogether: 160 bands are screened under the likeliest load, the best compared under all. Of 40 sticking valves behind
setpoint steps in benchmarks/world 11 had a factor over e with eight bands, 21 have now; of 180 other loops none.

A record begins anywhere in a valve's band, and shows one or two slips of one whose band is wider than co's range there:
so bands go to 1.6 ranges, and not all valves begin in the middle. Where all did, in bands of 0.9 ranges at most and
behind a first lag of a sample at least, 11 of 27 records of three real valves had a factor under 1/e, one of e^-4; two
have, of e^-1.6 at the least. Of four records of healthy flow loops the largest was e^-1.1, and is e^-2.1.

co itself and such valves may go through a second lag, play may not: it delays as a lag does, and a setpoint that moves
all the time, as a master moves it, shows every lag that a grid lacks: of 6 slaves of a cascade 5 had a factor for play.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.explanations.wandering_load import Prepared, under_loads
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.valve.valve_model import Family, StuckValve

Valve = tuple[Family, float, float, float]
"""Band as a share of co's range, jump of the band, and where it stands in its band at first, -1 to 1."""
BANDS = (0.08, 0.12, 0.17, 0.24, 0.33, 0.45, 0.6, 0.8, 1.1, 1.6)
# Play comes to rest at an end of its band
MOVING: list[Valve] = [(Family.KANO, band, jump, 0.0) for band in BANDS for jump in (0.0, 0.5)]
MOVING += [(Family.KANO, band, 0.0, end) for band in (0.3, 0.7, 1.6) for end in (-1.0, 1.0)]
"""Play, and valves that follow after a slip (Kano et al. 2004)."""
SLIPPING: list[Valve] = [(Family.HE, float(band), 1.0, 0.0) for band in np.geomspace(0.05, 0.9, 160)]
SPREAD = math.sqrt(5.0) - 1.0  # its multiples, round and round from -1 to 1, are even over any stretch of the bands
SLIPPING += [
    (Family.HE, float(band), 1.0, i * SPREAD % 2.0 - 1.0) for i, band in enumerate(np.geomspace(0.05, 1.6, 80))
]
"""Valves that slip all the way."""
LIKELIEST = 12  # valves out of those that are compared with second lags and under every load
LAGS = (1.0, 3.0, 7.0, 15.0, 33.0, 80.0, math.inf)
DEAD_TIMES = (0.0, 1.0, 2.0, 4.0, 7.0, 12.0)
FREE_DEAD_TIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.0, 9.0, 12.0)
"""Dead times of co itself: half a sample that a grid lacks was taken for a valve, where the noise is small."""
Loads = Sequence[tuple[float, int]]
LOADS: Loads = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.2, 0.8, math.inf))
"""Bandwidth and order of the loads that are tried."""
FREE_LAGS = (0.5, *LAGS)
OCTAVES: Loads = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.1, 0.2, 0.4, 0.8, math.inf))
"""Those beside a valve, which takes the place of a lag or an octave that is missing."""


def positions(co: FloatArray, valves: Sequence[Valve]) -> FloatArray:
    """What each valve that moves at all makes of co, from its first value; shape (valves, n)."""
    travel = float(np.ptp(co))
    each = (StuckValve(family, b * travel, j * b * travel, start).position(co) for family, b, j, start in valves)
    return np.array([position - position[0] for position in each if np.ptp(position) > 0])


def log_odds_of_valve(record: Prepared, direction: int) -> float:
    """Tempered logarithm of the Bayes factor of a valve that sticks or has play; 0 where no valve moves.

    direction : sign of the process gain.
    """
    if not np.ptp(record.co) > 0:
        return 0.0
    valves, slips = positions(record.co, MOVING), positions(record.co, SLIPPING)
    if not len(valves) or not len(slips):
        return 0.0

    def weighed(rows: FloatArray, lag: float, loads: Loads, dead: tuple[float, ...], *, first_only: bool) -> FloatArray:
        """Tempered log-likelihoods, shape (loads, second lags, inputs, dead times); no gain of the wrong sign."""
        fits = under_loads(record, rows, lag, loads, dead, first_only=first_only)
        right = np.where(fits.gain * direction > 0, fits.gain, 0.0)
        return fits.tempered(right[..., None]).reshape(len(loads), -1, len(rows), len(dead))

    free = [weighed(record.co[None], lag, OCTAVES, FREE_DEAD_TIMES, first_only=False) for lag in FREE_LAGS]
    coarse = [FREE_DEAD_TIMES.index(dead) for dead in DEAD_TIMES]
    # a second lag, or a finer dead time, that is not needed costs nothing
    linear = max(
        log_mean(np.concatenate([found[:, :lags, :, dead].ravel() for found in free]))
        for lags in (1, None)
        for dead in (coarse, slice(None))
    )
    behind = [weighed(valves, lag, OCTAVES, DEAD_TIMES, first_only=True) for lag in FREE_LAGS]
    best = max(range(len(OCTAVES)), key=lambda i: max(float(found[i].max()) for found in (*free, *behind)))
    load = OCTAVES[best : best + 1]
    screened = np.max([weighed(slips, lag, load, DEAD_TIMES, first_only=True) for lag in FREE_LAGS], axis=(0, 1, 2, 4))
    likeliest = slips[np.argsort(-screened, kind="stable")[:LIKELIEST]]
    closer = np.concatenate(
        [weighed(likeliest, lag, OCTAVES, DEAD_TIMES, first_only=False).ravel() for lag in FREE_LAGS]
    )
    slipped = log_mean(closer) + math.log(len(likeliest) / len(slips))
    return float(np.logaddexp(log_mean(np.array(behind)), slipped)) - math.log(2.0) - linear


def log_mean(values: FloatArray) -> float:
    """Logarithm of the mean of exp(values)."""
    top = float(values.max())
    return top + math.log(float(np.mean(np.exp(values - top))))
