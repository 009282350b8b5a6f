"""Has a recorder smoothed pv and co? Averages over its interval, and lines between samples of its own, do so.

    pv = (1 + f q) pv',   co = (1 + f q) co'           f: 0 as sampled, towards 1 an average of two samples and more

All processes under a load that wanders are compared for each f (wandering_load.py). A process whose lags make pv smooth
needs no f: it is in the grid. What the recorder did is not: without f five of seven records of real levels were called
far too slow with 84 to 89 %, at a likelihood e^50 to e^166 times smaller.
"""

import math
from dataclasses import replace

import numpy as np

from retuner.adaptive.explanations.valve_odds import COARSE, LAGS, LOADS
from retuner.adaptive.explanations.wandering_load import TEMPER, Prepared, log_likelihood, under_loads
from retuner.adaptive.signals.sample import FloatArray

SMOOTHINGS = (0.5, 0.85)  # f that are tried: lines between samples that fall anywhere, and averages


def with_smoothing(
    record: Prepared, direction: int, gain_unit: float | None, prior: float
) -> tuple[Prepared, FloatArray]:
    """The record with the likeliest f (0: not smoothed), and the tempered log-likelihood of every process over all f.

    prior : probability that it was smoothed. gain_unit : None where no gains are known: then there is no likelihood.
    """
    alone = np.zeros(1) if gain_unit is None else log_likelihood(record, direction, gain_unit)
    odds, plain = math.log(prior / (1.0 - prior) / len(SMOOTHINGS)), _likeliest(record)
    tried = [replace(record, smoothing=f) for f in SMOOTHINGS]
    leads = [odds + _likeliest(one) - plain for one in tried]
    if max(leads) <= 0.0:
        return record, alone
    if gain_unit is None:
        return tried[int(np.argmax(leads))], alone
    each = np.array([alone, *(odds + log_likelihood(one, direction, gain_unit) for one in tried)])
    best = int(np.argmax(each.reshape(len(each), -1).max(axis=1)))
    return (record, *tried)[best], np.logaddexp.reduce(each, axis=0) + math.log(1.0 - prior)


def _likeliest(record: Prepared) -> float:
    """Tempered log-likelihood of the likeliest process and load, on a coarse grid."""
    fits = [under_loads(record, record.co[None], lag, LOADS, COARSE) for lag in LAGS]
    return max(float(np.max(-fit.freedom[:, None] / 2 * np.log(fit.left.min(axis=2)))) for fit in fits) / TEMPER
