"""The pv that an estimated model gives for its record: for pictures and for judging what is left by eye.

    pv = bias + G co + sum_j a_j h(t - s_j) + start        everything linear fitted again (fit/misfit.py)

The estimate keeps process and load times. Whether its loads were rounded it does not say, so sharp loads and a few
lags are tried and the best is drawn.
"""

import math

import numpy as np

from retuner.adaptive.estimate import ModelEstimate
from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.sample import FloatArray, Window

LOAD_LAGS = (0.003, 0.01, 0.03, 0.1)
"""Lags of rounded loads that are tried, as shares of the record's length."""
START_SPREAD = 0.3
"""How far from rest a record may begin, as a share of pv's range; as in identification."""


def fitted_pv(window: Window, estimate: ModelEstimate) -> FloatArray:
    """pv as the model explains it, at every sample of the window; shape (n,).

    Parameters
    ----------
    window : the record that the estimate is of. estimate : what was identified.
    """
    record = Record.of(window)
    loads = [t - float(window.t_s[0]) for t in estimate.load_times_s]
    sigma = max(estimate.residual_std, record.resolution)
    log = estimate.log
    best: FloatArray | None = None
    for lag in (None, *LOAD_LAGS) if loads else (None,):
        rounded = [] if lag is None else [math.log(lag * record.span_s)]
        misfit = Misfit(record, log.type, log.sign, len(loads), sigma, START_SPREAD, rounded=bool(rounded))
        fitted = misfit.solve(np.array([*log.x, *loads, *rounded])).explained
        if best is None or np.sum((record.pv - fitted) ** 2) < np.sum((record.pv - best) ** 2):
            best = fitted
    assert best is not None
    return best
