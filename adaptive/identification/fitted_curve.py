"""The pv that an estimated model gives for its record: for pictures and for judging what is left by eye.

    pv = bias + G co + sum_j a_j h(t - s_j) + start        everything linear fitted again (fit/misfit.py)

The estimate keeps process and load times. Whether its loads were rounded it does not say, so sharp loads and a few
lags are tried and the best is drawn.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.fit.misfit import Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.structure import parameters_of
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window

LOAD_LAGS = (0.003, 0.01, 0.03, 0.1)  # lags of rounded loads that are tried, as shares of the record's length
START_SPREAD = 0.3  # how far from rest a record may begin, as a share of pv's range; as in identification


def fitted_pv(window: Window, estimate: ModelEstimate) -> FloatArray:
    """pv as the model explains it, at every sample of the window; shape (n,).

    window : the record that the estimate is of. estimate : what was identified.
    """
    log = estimate.log
    return _best(window, (log.type, log.sign, log.x), estimate.load_times_s, estimate.residual_std)


def explained_pv(
    window: Window, model: ProcessModel, load_times_s: Sequence[float], residual_std: float
) -> FloatArray | None:
    """The curve of an estimate of which only its numbers were kept; None where they make no model that can be fitted.

    window : the record. model : the process. load_times_s : when load steps entered. residual_std : in pv units.
    """
    try:
        x = parameters_of(model)
    except ValueError:
        return None
    return _best(window, (model.type, 1 if model.k > 0 else -1, x), load_times_s, residual_std)


def _best(
    window: Window, process: tuple[ProcessType, int, FloatArray], load_times_s: Sequence[float], residual_std: float
) -> FloatArray:
    """The best of sharp and rounded loads; process : structure, sign and parameters."""
    type_, sign, x = process
    record = Record.of(window)
    loads = [t - float(window.t_s[0]) for t in load_times_s]
    sigma = max(residual_std, record.resolution)
    best: FloatArray | None = None
    for lag in (None, *LOAD_LAGS) if loads else (None,):
        rounded = [] if lag is None else [math.log(lag * record.span_s)]
        misfit = Misfit(record, type_, sign, len(loads), sigma, START_SPREAD, rounded=bool(rounded))
        fitted = misfit.solve(np.array([*x, *loads, *rounded])).explained
        if best is None or np.sum((record.pv - fitted) ** 2) < np.sum((record.pv - best) ** 2):
            best = fitted
    assert best is not None
    return best
