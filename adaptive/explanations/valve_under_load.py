"""Does a valve between co and the process make a record likelier, with a load that wanders on top?

    ln B = ln mean over valves of L(record | valve, process, load)  -  ln L(record | co itself, process, load)

A valve that sticks moves in jumps, and a jump through the process is what no walk makes. Both sides are the likelihood
of wandering_load.py, tempered alike, on the same coarse grid of processes and loads, so only the valve differs. The
mean over valves is the price of its numbers: a narrow valley in band and jump is worth its share of the grid.

co itself may go through a second lag as well, a valve's position may not: play delays as a lag does, and a setpoint
that moves all the time, as a master moves it, shows every lag that a grid lacks. With one lag for both, 5 of 6 slaves
of a cascade had a factor for a valve, without one at all; so 2 of 6, and no sticking valve of the world was lost.
"""

import math

import numpy as np

from retuner.adaptive.explanations.wandering_load import Prepared, under_loads
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.valve.stuck_valve import Family, StuckValve

BANDS = (0.08, 0.12, 0.17, 0.24, 0.33, 0.45, 0.6, 0.8)
"""Stick bands, as shares of co's range."""
VALVES = ((Family.KANO, 0.0), (Family.KANO, 0.5), (Family.HE, 0.95))
"""Play; a valve that follows after a slip; one that jumps all the way. Jumps as shares of the band."""
LAGS = (1.0, 3.0, 7.0, 15.0, 33.0, 80.0, math.inf)
DEAD_TIMES = (0.0, 1.0, 2.0, 4.0, 7.0, 12.0)
LOADS = tuple((bandwidth, order) for order in (1, 2) for bandwidth in (0.05, 0.2, 0.8, math.inf))
"""Bandwidth and order of the loads that are tried."""


def positions(co: FloatArray) -> FloatArray:
    """co itself, then what each valve that moves at all makes of it, from their first values; shape (1 + valves, n)."""
    travel = float(np.ptp(co))
    found = [co - co[0]]
    for band in BANDS:
        for family, jump in VALVES:
            position = StuckValve(family, band * travel, jump * band * travel).position(co)
            if np.ptp(position) > 0:
                found.append(position - position[0])
    return np.array(found)


def log_odds_of_valve(record: Prepared, direction: int) -> float:
    """Tempered logarithm of the Bayes factor of a valve that sticks or has play; 0 where no valve moves.

    direction : sign of the process gain.
    """
    inputs = positions(record.co) if np.ptp(record.co) > 0 else np.zeros((1, 0))
    if len(inputs) == 1:
        return 0.0
    behind: list[FloatArray] = []
    free: list[FloatArray] = []
    for lag in LAGS:
        for found, rows in ((free, inputs[:1]), (behind, inputs[1:])):
            fits = under_loads(record, rows, lag, LOADS, DEAD_TIMES, first_only=found is behind)
            right = np.where(fits.gain * direction > 0, fits.gain, 0.0)  # no gain where it has the wrong sign
            found.append(fits.tempered(right[..., None])[..., 0])
    one_lag = np.array([found[:, 0] for found in free])
    two_lags = np.concatenate([found.ravel() for found in free])
    linear = max(log_mean(one_lag), log_mean(two_lags))  # a second lag that is not needed costs nothing
    return log_mean(np.array(behind)) - linear


def log_mean(values: FloatArray) -> float:
    """Logarithm of the mean of exp(values)."""
    top = float(values.max())
    return top + math.log(float(np.mean(np.exp(values - top))))
