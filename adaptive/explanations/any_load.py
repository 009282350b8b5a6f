"""Process and a load of any spectrum: how likely each process of the grid answers the setpoint as a window shows it.

    pv = K x + v,   v(t) = a1 v(t-1) + ... + ap v(t-p) + starts + e(t)
    ln L(K) = -(n - 2p - m)/2 ln RSS(K)

x is co through dead time and lags, e is white, and RSS is what the autoregression of pv - K x leaves of n samples; m
numbers belong to the starts of the lags.

A load that wanders (wandering_load.py) is one family of spectra. Others, such as a tone whose period varies beside
drift and noise, leave much of themselves when they are whitened so; in closed loop the inverse of the controller then
explains the rest, and passes for a process. An autoregression that is long enough has every spectrum, peaks as well, so
what is left is white whatever moves the loop (direct identification in closed loop: Ljung 1999, ch. 13; autoregressions
for any spectrum: Durbin 1960). By loads alone it can tell next to nothing, for then the load may be everything; what
the setpoint makes co do cannot be explained by it. A process that runs away goes through 1 - pole q, as its load does.
"""

import math

import numpy as np

from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    EVERY_LAG,
    GAINS,
    BoolArray,
    ProcessShape,
    second_lags,
    shapes,
    units,
)
from retuner.adaptive.explanations.wandering_load import Prepared, pole_of, reduced, responses, spans_of
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.signals.sample import FloatArray

ORDER = 30  # of the autoregression; a window of the book has a hundred samples per integral time
T_ANSWERS = 4.0  # What the log-likelihood is divided by before it counts, as T_SETPOINT is for a walk; 3 to 8


def log_likelihood_of_answers(record: Prepared, direction: int, gain_unit: float, asked: BoolArray) -> FloatArray:
    """Log-likelihood of every process of the grid, a load of any spectrum besides; not tempered.

    direction : sign of the process gain. gain_unit : loop gains are counted by it (process_grid.gain_unit). asked :
    processes that are asked for, shape (shapes, dead times, gains), which the answer has; others are -inf. Squares
    count in pv's variance, for freedoms differ: in pv's own units the odds would hang on these.
    """
    gains, rows = direction * GAINS * units(EVERY_LAG)[:, :, 0] / gain_unit, len(record.pv) - ORDER
    spans, dead, found = spans_of(asked), np.array(DEAD_TIMES), np.where(asked, 0.0, -math.inf)
    for row, shape in enumerate(shapes(EVERY_LAG) if rows > 2 * ORDER else ()):  # a shorter window says nothing
        if (late := np.flatnonzero(asked[row].any(axis=1))).size:
            left = _left(record, shape, dead[late], gains[row], spans[row, late], rows * record.resolution**2)
            freedom = rows - ORDER - 1 - (shape.lag > 0) - (shape.second > 0)
            found[row, late] = -0.5 * freedom * np.log(left / record.size)
    return np.where(asked, found, -math.inf)


def _left(
    record: Prepared, shape: ProcessShape, dead_times: FloatArray, gains: FloatArray, spans: FloatArray, noise: float
) -> FloatArray:
    """What the autoregression leaves of pv - K x, its sum of squares, at every dead time and gain that is asked.

    spans : gains from and to, of each dead time. noise : sum of squares that pv cannot show.
    """
    lags = shape.lag, shape.second
    if (engine := compiled()) is not None:
        return np.asarray(engine.any_load(record.pv, record.co, lags, dead_times, gains, spans, ORDER, noise))
    pole = pole_of(shape.lag) if shape.lag < 0 else 0.0
    pv = reduced(record.pv, (pole,) if pole else ())
    x, time = responses(record.co, shape.lag)[second_lags(shape.lag).index(shape.second)], np.arange(len(pv) - ORDER)
    falls = [time if math.isinf(lag) else pole_of(lag) ** time for lag in lags if lag > 0]
    rest = np.linalg.qr(np.stack([np.ones(len(time)), *falls], axis=1))[0].T
    samples = np.arange(-1.0, len(x))
    late = np.interp(samples[1:] - dead_times[:, None], samples, np.concatenate([[0.0], x]))
    own, both, by_x = (_products(a, b, rest) for a, b in ((pv[None], pv[None]), (pv[None], late), (late, late)))
    k = gains[:, None, None]
    forms = own[:, None] - k * (both + np.swapaxes(both, 1, 2))[:, None] + k**2 * by_x[:, None]
    white = (1.0 + pole**2) * np.eye(ORDER + 1) - pole * (np.eye(ORDER + 1, k=1) + np.eye(ORDER + 1, k=-1))
    forms = forms[..., ::-1, ::-1] + noise * white  # the sample itself is last: its pivot is left
    return np.asarray(np.linalg.cholesky(forms)[..., -1, -1] ** 2)


def _products(one: FloatArray, other: FloatArray, rest: FloatArray) -> FloatArray:
    """Products of rows at each lag with rows at each, both without the rest; shape (rows, ORDER + 1, ORDER + 1)."""
    lags = np.arange(ORDER + 1)
    a, b = (np.stack([x[:, ORDER - lag : x.shape[1] - lag] for lag in lags], axis=1) for x in (one, other))
    return np.asarray(a @ np.swapaxes(b, 1, 2) - (a @ rest.T) @ np.swapaxes(b @ rest.T, 1, 2))
