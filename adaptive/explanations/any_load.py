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

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, EVERY_LAG, GAINS, BoolArray, second_lags, units
from retuner.adaptive.explanations.wandering_load import Prepared, pole_of, reduced, responses
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.signals.sample import FloatArray

ORDER = 20  # of the autoregression; a window of the book has a hundred samples per integral time
T_ANSWERS = 4.5
"""What the log-likelihood is divided by before it counts, as T_SETPOINT is for a walk; 3 to 8."""


def log_likelihood_of_answers(record: Prepared, direction: int, gain_unit: float, asked: BoolArray) -> FloatArray:
    """Log-likelihood of every process of the grid, a load of any spectrum besides; not tempered.

    direction : sign of the process gain. gain_unit : loop gains are counted by it (process_grid.gain_unit). asked :
    processes that are asked for, shape (shapes, dead times, gains), which the answer has; others are -inf.
    """
    gains, rows = direction * GAINS * units(EVERY_LAG)[:, :, 0] / gain_unit, len(record.pv) - ORDER
    time, dead = np.arange(float(max(rows, 0))), np.array(DEAD_TIMES)
    found, row = np.where(asked, 0.0, -math.inf), 0  # a window shorter than the past says nothing
    for lag in EVERY_LAG:
        away = (pole_of(lag),) if lag < 0 else ()
        pv = reduced(record.pv, away)
        for x, second in zip(responses(record.co, lag), second_lags(lag), strict=True):
            if rows > 2 * ORDER and (late := np.flatnonzero(asked[row].any(axis=1))).size:
                falls = [pole_of(one) ** time for one in ((second,) if away else (lag, second)) if 0 < one < math.inf]
                rest = np.linalg.qr(np.array([np.ones(rows), *falls, *([time] if math.isinf(lag) else [])]).T)[0].T
                left = _left(pv, x, rest, dead[late], gains[row], asked[row, late], rows * record.resolution**2)
                found[row, late] = -0.5 * (rows - ORDER - len(rest)) * np.log(left)
            row += 1
    return np.where(asked, found, -math.inf)


def _left(
    pv: FloatArray, x: FloatArray, rest: FloatArray, dead_times: FloatArray, gains: FloatArray, asked: BoolArray,
    noise: float,
) -> FloatArray:  # fmt: skip
    """What the autoregression leaves of pv - K x, its sum of squares, at every dead time and gain that is asked.

    rest : orthonormal, what it may have besides, shape (number, n - ORDER). noise : sum of squares pv cannot show.
    """
    if (engine := compiled()) is not None:
        spans = np.stack([np.argmax(asked, axis=1), len(gains) - np.argmax(asked[:, ::-1], axis=1)], axis=1)
        return np.asarray(engine.any_load(pv, x, rest, dead_times, gains, spans.astype(np.float64), ORDER, noise))
    samples = np.arange(-1.0, len(x))
    late = np.interp(samples[1:] - dead_times[:, None], samples, np.concatenate([[0.0], x]))
    own, both, by_x = (_products(a, b, rest) for a, b in ((pv[None], pv[None]), (pv[None], late), (late, late)))
    k = gains[:, None, None]
    forms = own[:, None] - k * (both + np.swapaxes(both, 1, 2))[:, None] + k**2 * by_x[:, None]
    forms = forms[..., ::-1, ::-1] + noise * np.eye(ORDER + 1)  # the sample itself is last: its pivot is left
    return np.asarray(np.linalg.cholesky(forms)[..., -1, -1] ** 2)


def _products(one: FloatArray, other: FloatArray, rest: FloatArray) -> FloatArray:
    """Products of rows at each lag with rows at each, both without the rest; shape (rows, ORDER + 1, ORDER + 1)."""
    lags = np.arange(ORDER + 1)
    a, b = (np.stack([x[:, ORDER - lag : x.shape[1] - lag] for lag in lags], axis=1) for x in (one, other))
    return np.asarray(a @ np.swapaxes(b, 1, 2) - (a @ rest.T) @ np.swapaxes(b @ rest.T, 1, 2))
