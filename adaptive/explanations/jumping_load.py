"""Process, load that wanders and noise, where the load jumps or turns corners besides: how likely a process is.

    pv = K x + z + v + sum of u_j s(t - t_j)       s: what a shock of the walk does      (wandering_load.py: x, z, v)

What is summed up behind the lags jumps, or its slope does: a single shock of the whitened record, of any size. Each
costs 3/2 ln n (Schwarz 1978: a size, and a time that any row may be). Rows are found one by one, each where it takes
away most (orthogonal least squares, Chen, Billings & Luo 1989), beside what the likeliest process under a walk makes of
co; then all processes near its first lag are compared with these shocks at the same samples as without. A walk alone,
and one that jumps, are half of the loads each.
"""

import math

import numpy as np

from retuner.adaptive.explanations.process_grid import DEAD_TIMES, GAINS, LAGS, second_lags, units
from retuner.adaptive.explanations.wandering_load import (
    BOTH,
    SLOPE,
    TEMPER,
    VALUE,
    Prepared,
    filtered,
    impulse_response,
    load_models,
    reduced,
    responses,
    spectrum,
    under_loads,
    unsmoothed,
    whitening,
)
from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.valve.plateaus import steps_chosen

LOADS = ((0.01, VALUE), (0.1, VALUE), (0.4, VALUE), (0.01, SLOPE), (0.05, SLOPE), (0.2, SLOPE))
"""Bandwidths and orders of the walks that jump or turn corners: where these are, little is left to wander."""
EVERY = 2  # one first lag in so many is searched for shocks; the next ones have the same
MOST_JUMPS, JUMP_PRICE = 12, 1.5  # at the most, and the price of each, in ln n
NEXT_TO_NONE = 8.0  # tempered ln L behind the likeliest from which a load and first lag are left out
UNIQUE = 1e-6  # a shock of which less than this share is not explained by the others is no further one


def with_jumps(record: Prepared, walk: FloatArray, direction: int, gain_unit: float) -> FloatArray:
    """Tempered log-likelihood of every process of the grid where the load wanders, and in one half of cases jumps.

    walk : where it only wanders, of wandering_load.py. direction, gain_unit : as there.
    """
    n, gains, late = len(record.pv), direction * GAINS * units() / gain_unit, np.array(DEAD_TIMES)
    lags, ends = LAGS[::EVERY], np.cumsum([len(second_lags(lag)) for lag in LAGS])
    searched = []
    for lag, end in zip(lags, ends[::EVERY], strict=True):
        each = walk[end - len(second_lags(lag)) : end].max(axis=2)
        likeliest, dead = np.unravel_index(int(np.argmax(each)), each.shape)
        moved = delayed(responses(record.co, lag)[likeliest], int(late[dead]))
        searched.append([shocks_that_pay(record, lag, load, moved) for load in LOADS])
    least = max(float(walk.max()), max(told for one in searched for _, told in one) / TEMPER) - NEXT_TO_NONE
    found = np.full((len(LOADS), *walk.shape), -math.inf)
    for i, (lag, end) in enumerate(zip(LAGS, ends.tolist(), strict=True)):
        for through, second in enumerate(second_lags(lag)):
            at = end - len(second_lags(lag)) + through
            for load, told, (rows, most) in zip(LOADS, found, searched[i // EVERY], strict=True):
                if most / TEMPER < least:
                    continue
                (model,) = load_models(lag, load[:1], load[1], second * (load[1] == VALUE))
                one = impulse_response((1.0,), model.c, n)  # what a shock adds to the record that is whitened for it
                columns = np.array([delayed(one, row + 1) for row in sorted(rows)]) if rows else None
                given = record, record.co[None], lag, (load,), late.tolist()
                fit = under_loads(*given, through=through, tones=columns, ends=(len(rows),))
                told[at] = fit.mixed(gains[at : at + 1])[0, 0] - JUMP_PRICE * math.log(n) * len(rows) / TEMPER
    jumping = np.logaddexp.reduce(found, axis=0) - math.log(len(LOADS))
    return np.asarray(np.logaddexp(walk, jumping) - math.log(2.0))


def delayed(moved: FloatArray, rows: float) -> FloatArray:
    """The same so many rows later, from rest, straight between rows; at rest throughout beyond the end."""
    n, (whole, part) = len(moved), divmod(rows, 1.0)
    late = np.concatenate([np.zeros(min(int(whole), n) + 1), moved])
    return np.asarray((1.0 - part) * late[1 : n + 1] + part * late[:n])


def shocks_that_pay(
    record: Prepared, lag: float, load: tuple[float, int], beside: FloatArray, second: float = 0.0,
    most: int = MOST_JUMPS,
) -> tuple[list[int], float]:  # fmt: skip
    """Rows of the shocks that are worth their price, and ln L with them, priced. As for `shocks`."""
    rows, told = shocks(record, lag, second, load, most, beside)
    told = told - JUMP_PRICE * math.log(len(record.pv)) * np.arange(len(told))
    return rows[: int(np.argmax(told))], float(np.max(told))


def shocks(
    record: Prepared, lag: float, second: float, load: tuple[float, int], most: int, beside: FloatArray | None = None
) -> tuple[list[int], FloatArray]:
    """Rows of single shocks of a load, each where it takes away most: pv shows it one row later. ln L before and after
    each, unpriced.

    second : a further lag that the shocks go through, 0 for none. beside : what co does, shape (n,).
    """
    n = len(record.pv)
    y, basis, response, form = whitened(record, lag, load, beside, second)
    found, left = steps_chosen(y, response, basis, UNIQUE, most, form)
    noise = n * record.resolution**2
    told = -(n - basis.shape[1]) / 2.0 * np.log((np.array(left) + noise) / float(np.var(record.pv)))
    return [row + 1 for row in found], told


def whitened(
    record: Prepared, lag: float, load: tuple[float, int], beside: FloatArray | None = None, second: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, ...]]:
    """As for `shocks`: pv whitened, orthonormal columns of starts and co's part in it, and what a shock does, with its
    form (steps_chosen).
    """
    n, both = len(record.pv), load[1] == BOTH
    (model,) = load_models(lag, load[:1], *((VALUE, second) if both else load[1:]))
    pole = math.exp(-1.0 / second) if second and not both else 0.0
    poles = model.c if not pole else tuple(np.convolve(model.c, (1.0, -pole)).tolist())
    rows = record.pv[None]
    if beside is not None and np.any(beside):  # a dead time longer than the record leaves nothing of it
        rows = np.array([record.pv, beside])
    if (engine := compiled()) is not None:
        made = engine.whitened(rows[0], rows[1:], np.array(model.packed), record.smoothing, pole)
        return *made, (0.0, 1.0, *poles[1:])
    memory, basis = whitening(n, (pole,) if pole else (), model)
    if record.smoothing:
        rows = unsmoothed(rows, record.smoothing)
    y, *co = filtered(spectrum(reduced(rows, model.roots)), n, memory)
    if co:
        basis = np.linalg.qr(np.column_stack([basis, *co]))[0]
    response = np.concatenate([[0.0], memory[:-1]])
    if pole:
        response = filtered(spectrum(response), n, pole ** np.arange(n, dtype=np.float64))
    return y, basis, response, (0.0, 1.0, *poles[1:])
